"""Arrays have the bits of the command's files, and live as long as they are held."""

import gc
import threading

import numpy as np
import pytest
from conftest import POSE, command, done, same, skip

import presight

IMAGES = ("range", "polygon_id", "object_id", "cos_incidence", "echo", "normal")


def files_of(folder, room_file, sensor, pose, outputs, backend):
    pose = ",".join(repr(float(number)) for number in pose)
    done("predict", room_file, "--sensor", sensor, "--pose", pose, "--outputs", ",".join(outputs), "--backend", backend,
         "--npy", folder / "{output}.npy")
    return {output: np.load(folder / f"{output}.npy") for output in outputs}


def outputs_of(sensor):
    camera = presight.Sensor.load(sensor).sensor_class == "video"
    return (*IMAGES, "depth_z") if camera else IMAGES


# The GPU engine draws rays from one point.
ONE_CENTRE = [name for name in presight.Sensor.presets() if not presight.Sensor.load(name).origins().any()]


@pytest.mark.parametrize("sensor, backend", [(name, "cpu") for name in presight.Sensor.presets()] + [(name, "gpu") for name in ONE_CENTRE])
def test_arrays_equal_the_files_of_the_command(tmp_path, room_file, poses, sensor, backend):
    if backend == "gpu" and command("predict", room_file, "--sensor", "laser-scanner", "--pose", "0,0,0,0,0,0",
                                    "--backend", "gpu").returncode == 3:
        skip("there is no adapter; see presight doctor")
    pose, outputs = poses[0], outputs_of(sensor)
    files = files_of(tmp_path, room_file, sensor, pose, outputs, backend)
    out = presight.Predictor(backend).predict(presight.Scene.open(room_file), sensor, pose, outputs=outputs)
    assert out.outputs and set(out.outputs) == set(outputs)
    for output in outputs:
        assert same(out[output], files[output]), output


def test_planted_faults_are_found(tmp_path, room_file, room, cpu, poses):
    pose, sensor = poses[0], "laser-range-camera"
    files = files_of(tmp_path, room_file, sensor, pose, IMAGES, "cpu")
    right = cpu.predict(room, sensor, pose, outputs=IMAGES)
    # A turned axis.
    assert not same(right.range.T.reshape(right.range.shape), files["range"])
    assert not same(right.normal[..., ::-1].copy(), files["normal"])
    # A quaternion with its real part first.
    x, y, z, qx, qy, qz, qw = right.pose
    swapped = cpu.predict(room, sensor, [x, y, z, qw, qx, qy, qz], outputs=IMAGES)
    assert not same(swapped.range, files["range"])
    assert same(cpu.predict(room, sensor, right.pose, outputs=IMAGES).range, files["range"])
    # A stale buffer: another prediction into the same memory.
    kept = right.range
    kept[:] = cpu.predict(room, sensor, poses[1]).range
    assert not same(kept, files["range"])


def test_poses_of_all_forms_mean_the_same(room, cpu, poses):
    pose = poses[3]
    first = cpu.predict(room, "laser-scanner", pose)
    x, y, z, qx, qy, qz, qw = first.pose
    turn = np.array([
        [1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw)],
        [2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw)],
        [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy)],
    ])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn, [x, y, z]
    for form in (list(pose), tuple(first.pose), matrix, matrix.astype("f4").astype(">f8"), np.asfortranarray(matrix)):
        again = cpu.predict(room, "laser-scanner", form)
        assert np.allclose(again.range, first.range, atol=1e-5), form
    optical = matrix.copy()
    optical[:3, :3] = turn @ np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    assert np.allclose(cpu.predict(room, "laser-scanner", optical, pose_frame="optical").range, first.range, atol=1e-9)
    mounted = presight.Sensor.load("laser-scanner").replace(mount=[0.1, 0.2, 0.3, 0, 0, 0])
    robot = matrix.copy()
    robot[:3, 3] -= turn @ [0.1, 0.2, 0.3]
    assert np.allclose(cpu.predict(room, mounted, robot, pose_of="robot").range, first.range, atol=1e-5)


def test_arrays_are_the_engines_buffers(room, cpu):
    out = cpu.predict(room, "vlp-16", POSE, outputs=(*IMAGES,))
    for output in IMAGES:
        array = out[output]
        assert array.flags.c_contiguous and array.flags.writeable and array is out[output]
        assert array.dtype == ("uint32" if output.endswith("_id") else "float32")
        assert array.shape == ((16, 1800, 3) if output == "normal" else (16, 1800))
        shared = np.from_dlpack(array)
        assert np.shares_memory(shared, array)
    with pytest.raises(AttributeError, match="depth_z"):
        out.depth_z
    assert not hasattr(out, "depth_z")


def test_torch_shares_the_memory(room):
    torch = pytest.importorskip("torch", reason="torch is large; where it is, its tensors share the memory")
    out = presight.Predictor("cpu", 1).predict(room, "vlp-16", POSE)
    ranges, first = out.range, out.range.copy()
    tensor = torch.from_dlpack(ranges)
    assert tensor.dtype == torch.float32 and tuple(tensor.shape) == (16, 1800) and tensor.data_ptr() == ranges.ctypes.data
    tensor[3, 7] = 0.25
    assert ranges[3, 7] == 0.25
    ranges[3, 7] = first[3, 7]
    del out, ranges
    gc.collect()
    assert tensor.tolist() == first.tolist()


def test_arrays_outlive_everything_and_no_call_changes_them(poses):
    scene, predictor, sensor = presight.Scene.example(), presight.Predictor("cpu", 2), presight.Sensor.load("laser-scanner")
    held = [predictor.predict(scene, sensor, poses[i % 20]).range for i in range(1000)]
    first = [array.copy() for array in held]
    del scene, predictor, sensor
    gc.collect()
    assert all(same(a, b) for a, b in zip(held, first))
    assert all(same(held[i], held[i % 20]) for i in range(1000))
    held[0][:] = 0
    assert same(held[20], first[0])


@pytest.mark.parametrize("sensor", presight.Sensor.presets())
def test_rays_are_the_commands(tmp_path, room_file, sensor):
    rays = presight.Sensor.load(sensor).rays()
    assert rays.dtype == np.float64 and rays.shape == (*presight.Sensor.load(sensor).shape, 3)
    done("predict", room_file, "--sensor", sensor, "--pose", "0,0,0,0,0,0", "--outputs", "range", "--rays", tmp_path / "rays.npy")
    assert same(rays, np.load(tmp_path / "rays.npy"))
    # A planted fault: a turned axis.
    assert not same(np.ascontiguousarray(rays[:, ::-1]), np.load(tmp_path / "rays.npy"))


def test_points_and_rays_agree(room, cpu):
    out, rays = cpu.predict(room, "vlp-16", POSE), presight.Sensor.load("vlp-16").rays()
    points = out.points("sensor")
    expected = np.where(np.isfinite(out.range)[..., None], rays * out.range[..., None].astype(float), np.nan)
    assert np.array_equal(points, expected, equal_nan=True) and np.isfinite(points).mean() > 0.9
    world = out.points("world")
    assert np.allclose(world, points + [1, 1.5, 0.5], atol=1e-12, equal_nan=True)
    low, high = room.bounds
    seen = world[np.isfinite(out.range)]
    assert (seen.min(0) > np.array(low) - 1e-3).all() and (seen.max(0) < np.array(high) + 1e-3).all()


def test_pictures_and_texts_are_the_commands(room, cpu, tmp_path, room_file):
    pose = ",".join(map(str, POSE))
    arguments = ["predict", room_file, "--sensor", "laser-range-camera", "--pose", pose, "--backend", "cpu"]
    done(*arguments, "--png", tmp_path / "range.png")
    out = cpu.predict(presight.Scene.open(room_file), "laser-range-camera", POSE)
    assert out.png("range") == (tmp_path / "range.png").read_bytes() == out._repr_png_()
    assert out.png("object_id") != out.png("range")
    assert str(out) == done(*arguments).rsplit(", ", 1)[0]
    import json

    ours, commands = json.loads(out.json()), json.loads(done(*arguments, "--json"))
    for key in ("prediction_ms", "engine"):
        ours.pop(key), commands.pop(key)
    assert ours == commands
    assert out.stats["stages_ms"] and out.notices == [] and out.given_up is None and out.features is None


def test_features_are_the_commands(tmp_path, room_file, cpu):
    layer = tmp_path / "room.laser.layer.json"
    done("features", room_file, "--class", "laser", "--out", layer)
    pose = ",".join(map(str, POSE))
    done("predict", room_file, "--sensor", "laser-range-camera", "--pose", pose, "--layer", layer, "--pose-cov",
         "0.02,0.02,0,0,0,1", "--features", tmp_path / "seen.json", "--backend", "cpu", "--outputs", "range,feature_id",
         "--npy", tmp_path / "{output}.npy")
    scene = presight.Scene.open(room_file)
    for given in (layer, presight.Layer.load(layer)):
        out = cpu.predict(scene, "laser-range-camera", POSE, layers=[given], pose_cov=[0.02, 0.02, 0, 0, 0, 1])
        assert out.features.json().split() == (tmp_path / "seen.json").read_text().split()
    seen = out.features
    assert len(seen) > 10 and seen.id.dtype == np.uint32 and seen.roi.shape == (len(seen), 4)
    for i, feature in enumerate(seen):
        assert feature.id == seen.id[i] and feature.visible_fraction == seen.visible_fraction[i]
        assert (feature.roi is None) == np.isnan(seen.roi[i]).all() and bool(feature.visible) == (seen.reason[i] == "")
        assert feature.points.shape[1] == 3
    with pytest.raises(IndexError):
        seen[len(seen)]
    ids = cpu.predict(scene, "laser-range-camera", POSE, outputs="range,feature_id", layers=[layer]).feature_id
    assert same(ids, np.load(tmp_path / "feature_id.npy"))
    assert set(np.unique(ids)) - {0} <= set(seen.id.tolist())


def test_two_threads_with_one_predictor_and_with_two(room, poses):
    one, two = presight.Predictor("cpu", 1), presight.Predictor("cpu", 1)
    right = [one.predict(room, "vlp-16", pose).range for pose in poses]
    for predictors in [(one, one), (one, two)]:
        found = [[], []]

        def work(k):
            found[k] = [predictors[k].predict(room, "vlp-16", pose).range for pose in poses]

        threads = [threading.Thread(target=work, args=(k,)) for k in range(2)]
        [t.start() for t in threads]
        [t.join(60) for t in threads]
        assert all(same(a, b) for k in range(2) for a, b in zip(found[k], right, strict=True))


def test_other_threads_go_on(room, poses):
    """A thread that counts reaches a part of what it reaches alone; work under the interpreter's lock would leave nothing."""
    import time

    predictor, stop, counts = presight.Predictor("cpu", 1), threading.Event(), []

    def count():
        n = 0
        while not stop.is_set():
            n += 1
        counts.append(n)

    for busy in (False, True):
        stop.clear()
        thread = threading.Thread(target=count)
        thread.start()
        end = time.monotonic() + 0.4
        while time.monotonic() < end:
            if busy:
                predictor.predict_many(room, "vlp-16", poses)
            else:
                time.sleep(0.05)
        stop.set()
        thread.join()
    assert counts[1] > 0.1 * counts[0], counts


def test_no_panic_crosses_the_border():
    from presight import _presight

    with pytest.raises(presight.SystemFault, match="on purpose") as raised:
        _presight._panic()
    assert raised.value.kind == "system" and raised.value.remedy
