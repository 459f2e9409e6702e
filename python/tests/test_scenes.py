"""Scenes and sensors from what users hold: arrays, calibrations, changes, pickles."""

import pickle

import numpy as np
import pytest
from conftest import POSE, done, one_line, same

import presight

BOX = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
FACES = np.array([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6],
                  [0, 6, 4], [1, 5, 7], [1, 7, 3]])


class Trimesh:
    vertices, faces = BOX, FACES


class Open3D:
    vertices, triangles = BOX.tolist(), FACES.astype("i4")


@pytest.mark.parametrize("mesh", [(BOX, FACES), (BOX.astype(">f4"), FACES.astype("u1")), Trimesh(), Open3D(),
                                  (np.asfortranarray(BOX), FACES.tolist())])
def test_a_box_of_arrays_stands_where_it_was_put(cpu, mesh):
    scene = presight.Scene.from_meshes({"box": mesh, "other": mesh}, poses={"box": [3, 0, 0, 0, 0, 0], "other": [0, 4, 0, 0, 0, 45]})
    out = cpu.predict(scene, "laser-scanner", [0, 0, 0, 0, 0, 0])
    # By hand: a face 2.5 m ahead, and an edge of the turned box at 4 - sqrt(1/2) to the left.
    assert out.range[0, 180] == 2.5 and scene.objects[out.object_id[0, 180] - 1] == "box"
    assert abs(out.range[0, 360] - (4 - 0.5**0.5)) < 1e-6 and scene.objects[out.object_id[0, 360] - 1] == "other"
    assert out.range[0, 0] == np.inf and out.object_id[0, 0] == 0
    # Coplanar triangles were merged: six polygons.
    assert int(cpu.predict(scene, "vlp-16", [0, 0, 0, 0, 0, 0]).polygon_id.max()) <= 12


def test_changes_in_memory_do_what_a_store_does(tmp_path, cpu):
    scene = presight.Scene.example()
    before, version = cpu.predict(scene, "vlp-16", POSE), scene.version
    first = before.range.copy()
    scene.insert("crate", (BOX, FACES), [2.2, 1.5, 0.5, 0, 0, 0])
    assert scene.version == version + 1 and scene.objects[-1] == "crate"
    out = cpu.predict(scene, "laser-scanner", POSE)
    assert out.range[0, 180] == pytest.approx(0.7, abs=1e-6) and scene.objects[out.object_id[0, 180] - 1] == "crate"
    scene.move("crate", [2.5, 1.5, 0.5, 0, 0, 0])
    assert cpu.predict(scene, "laser-scanner", POSE).range[0, 180] == pytest.approx(1.0, abs=1e-6)
    assert scene.pose("crate")[:3].tolist() == [2.5, 1.5, 0.5]
    scene.delete("crate")
    assert scene.objects[-1] == "" and same(cpu.predict(scene, "vlp-16", POSE).range, first)
    line = '{"op": "move", "object": "room/table", "pose": [1.2, 1, 0, 0, 0, 30]}'
    scene.apply(line)
    path = tmp_path / "room.presight"
    with presight.Store.create(path, presight.Scene.example()) as store:
        assert store.apply(line, cause="moved") == 1 == store.changes
        assert store.scene().content_hash() == scene.content_hash()
        with pytest.raises(presight.SystemFault):
            presight.Store(path)
    with pytest.raises(presight.Error, match="closed"):
        store.apply(line)
    assert presight.Scene.open(path).content_hash() == scene.content_hash()
    assert "moved" in done("env", "log", path)
    for wrong in ("{}", '{"op": "move", "object": "nobody", "pose": [0, 0, 0, 0, 0, 0]}', "nonsense"):
        with pytest.raises(presight.Error) as raised:
            scene.apply(wrong)
        one_line(raised)


def test_a_copy_is_its_own(cpu):
    scene = presight.Scene.example()
    copy = scene.copy()
    copy.delete("room/table/top")
    assert "room/table/top" in scene.objects and "room/table/top" not in copy.objects
    assert scene.content_hash() != copy.content_hash()


def test_scenes_and_sensors_pickle_by_content(tmp_path, cpu):
    scene = presight.Scene.example()
    scene.insert("crate", (BOX, FACES), [2.2, 1.5, 0.5, 0, 0, 30])
    scene.delete("room/table")
    again = pickle.loads(pickle.dumps(scene))
    assert again.content_hash() == scene.content_hash() and again.objects == scene.objects and again.path == scene.path
    a, b = (cpu.predict(s, "laser-range-camera", POSE) for s in (scene, again))
    assert all(same(a[name], b[name]) for name in a.outputs)
    # The file may be gone.
    path = tmp_path / "hall.presight"
    presight.Store.create(path, scene).close()
    packed = pickle.dumps(presight.Scene.open(path))
    path.unlink()
    assert pickle.loads(packed).content_hash() == scene.content_hash()
    # Another content than the hash says, and other bytes.
    make, (store, _, *rest) = scene.__reduce__()
    with pytest.raises(presight.Error, match="pickle") as raised:
        make(store, presight.Scene.example().content_hash(), *rest)
    one_line(raised)
    with pytest.raises(presight.Error, match="pickle"):
        make(store[:5000], scene.content_hash(), *rest)
    sensors = [presight.Sensor.load(name) for name in presight.Sensor.presets()]
    sensors += [
        presight.Sensor.camera([500.1, 499.9, 320.3, 240.7], (64, 48), D=[0.1, -0.2, 0.001, 0.002, 0.05]),
        presight.Sensor.from_rays(np.random.default_rng(1).normal(size=(3, 5, 3))),
        presight.Sensor.scanner(np.linspace(-1, 1, 7) * 100 / 3, [1.1, -2.2]).replace(angle_sigma_deg=0.1234567, mount=POSE),
    ]
    for sensor in sensors:
        again = pickle.loads(pickle.dumps(sensor))
        assert again == sensor and hash(again) == hash(sensor) and same(again.rays(), sensor.rays())
    assert sensors[0] != sensors[1]
    layer = presight.Layer.parse('{"format": 1, "class": "video", "features": [{"id": 3, "kind": "point", "points": [[1, 2, 3]]}]}')
    assert len(pickle.loads(pickle.dumps(layer))) == 1


def test_sensors_of_numbers(tmp_path):
    camera = presight.Sensor.camera([[525, 0, 319.5], [0, 525, 239.5], [0, 0, 1]], (640, 480), range_min=0.5, range_max=5)
    rays = camera.rays()
    # By hand, in body axes: x forward, y left, z up.
    ray = np.array([1, (319.5 - 0) / 525, (239.5 - 0) / 525])
    assert np.allclose(rays[0, 0], ray / np.linalg.norm(ray), atol=1e-15)
    assert (camera.range_min, camera.range_max, camera.sensor_class) == (0.5, 5.0, "video")
    scanner = presight.Sensor.scanner([-90, 0, 90], [10, -10])
    assert np.allclose(scanner.rays()[:, 1], [[np.cos(np.pi / 18), 0, z * np.sin(np.pi / 18)] for z in (1, -1)])
    any_rays = presight.Sensor.from_rays([[2, 0, 0], [np.nan, 0, 0], [0, 0, -5]])
    assert np.array_equal(any_rays.rays()[0], [[1, 0, 0], [np.nan] * 3, [0, 0, -1]], equal_nan=True)
    (tmp_path / "eye.yaml").write_text(
        "image_width: 4\nimage_height: 3\ncamera_matrix: {data: [2, 0, 1.5, 0, 2, 1, 0, 0, 1]}\nfoo: 1\n")
    with pytest.warns(presight.Notice, match="foo"):
        assert presight.Sensor.load(tmp_path / "eye.yaml").shape == (3, 4)
    assert presight.Sensor.camera([2, 2, 1.5, 1], (4, 3), D=[0.1, 0, 0, 0], model="equidistant").shape == (3, 4)


def test_open_takes_what_the_command_takes(tmp_path, room_file):
    with pytest.raises(presight.Error) as raised:
        presight.Scene.open(tmp_path / "no.glb")
    one_line(raised, "no.glb")
    assert raised.value.kind == "invalid" and raised.value.file.endswith("no.glb") and raised.value.remedy
    with pytest.raises(presight.Error, match="up="):
        presight.Scene.open(room_file, up="z")
    with pytest.raises(presight.Error):
        presight.Scene.open(room_file, up="w")
    without = presight.Scene.open(room_file, exclude=["room/table"])
    assert "room/table/top" not in without.objects and "room/sofa/seat" in without.objects
    (tmp_path / "loud.rhai").write_text('print("hello");\n')
    try:
        assert presight.Scene.open(tmp_path / "loud.rhai").messages == ["hello"]
    except presight.Error as e:
        assert "loud.rhai" in str(e)
