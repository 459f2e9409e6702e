"""Batches and likelihoods: the bits of single calls and of the command, into arrays of the caller, until Ctrl-C."""

import csv
import os
import signal
import threading
import time

import numpy as np
import pytest
from conftest import done, one_line, same

import presight


def test_many_are_as_single_ones(room, cpu, poses):
    outputs = ("range", "object_id", "normal")
    many = cpu.predict_many(room, "laser-range-camera", poses, outputs=outputs)
    assert {name: array.shape[1:] for name, array in many.items()} == {
        "range": (41, 321), "object_id": (41, 321), "normal": (41, 321, 3)}
    for i, pose in enumerate(poses):
        single = cpu.predict(room, "laser-range-camera", pose, outputs=outputs)
        assert all(same(many[name][i], single[name]) for name in outputs)
    # A planted fault: two poses exchanged.
    assert not same(many["range"][0], many["range"][1])
    parts = list(cpu.predict_chunks(room, "laser-range-camera", poses, outputs=outputs, size=7))
    assert [len(part["range"]) for part in parts] == [7, 7, 6]
    for name in outputs:
        assert same(np.concatenate([part[name] for part in parts]), many[name])


TURNING = '''format = 1
kind = "scanner"
class = "laser"
turn_s = 0.1
[azimuth]
start_deg = -180
step_deg = 1
count = 360
[elevation]
start_deg = 10
step_deg = -10
count = 3
'''


def test_the_robot_moves_meanwhile(room, cpu, tmp_path):
    (tmp_path / "turning.toml").write_text(TURNING)
    sensor, pose = presight.Sensor.load(tmp_path / "turning.toml"), [1, 1.5, 0.5, 0, 0, 90]
    # By hand: at 0.5 m/s along y the last of 360 columns is measured 0.1 s x 359 / 360 after the stamp.
    last = 0.1 * 359 / 360
    end, turned = [1, 1.5 + 0.5 * last, 0.5, 0, 0, 90], [np.sqrt(0.5)]
    drive = np.array([[10 + t, 1, 1.5 + 0.5 * t, 0.5, 0, 0, *turned, *turned] for t in (-0.1, 0.2)])
    np.savetxt(tmp_path / "drive.tum", drive)
    ranges = {
        "twist": cpu.predict(room, sensor, pose, twist=[0.5, 0, 0, 0, 0, 0])["range"],
        "end": cpu.predict(room, sensor, pose, pose_end=end)["range"],
        "trajectory": cpu.predict(room, sensor, pose, trajectory=drive, stamp=10)["range"],
        "file": presight.predict(room, sensor, pose, trajectory=tmp_path / "drive.tum", stamp=10)["range"],
    }
    hit = np.isfinite(ranges["twist"])
    for name, other in ranges.items():
        # Edges may fall on the other side of a ray.
        assert np.mean(np.abs(other - ranges["twist"])[hit] > 1e-5) < 0.005, name
    # Planted: standing, and driving the other way.
    for fault in ({}, {"twist": [-0.5, 0, 0, 0, 0, 0]}):
        other = cpu.predict(room, sensor, pose, **fault)["range"]
        assert np.mean(np.abs(other - ranges["twist"])[hit] > 1e-3) > 0.3, fault
    poses = [pose, [1, 1.6, 0.5, 0, 0, 80], end]
    many = cpu.predict_many(room, sensor, poses, twist=[0.5, 0, 0, 0, 0, 0])["range"]
    parts = list(cpu.predict_chunks(room, sensor, poses, size=2, twist=[0.5, 0, 0, 0, 0, 0]))
    assert same(np.concatenate([part["range"] for part in parts]), many) and same(many[0], ranges["twist"])


@pytest.mark.parametrize(("motion", "words"), [
    ({"pose_end": [1, 1.5, 0.5, 0, 0, 270]}, "pose_end: 180.0 degrees"),
    ({"pose_end": [1, 1.5]}, "pose_end"),
    ({"pose_end": [1, 1.5, 0.5, 0, 0, 91], "twist": [0] * 6}, "more than one motion"),
    ({"trajectory": [[0, 1, 1.5, 0.5, 0, 0, 0, 1], [1, 1, 1.5, 0.5, 0, 0, 0, 1]]}, "stamp"),
    ({"trajectory": [[0, 1, 1.5, 0.5, 0, 0, 0, 1], [1, 1, 1.5, 0.5, 0, 0, 0, 1]], "stamp": 0.5}, "no pose between"),
    ({"trajectory": [[0, 1, 1.5, 0.5, 0, 0, 0, 1]], "stamp": 0}, "a trajectory of 1 poses"),
    ({"trajectory": [[0, 1, 1.5, 0.5, 0, 0, 0, 1], [-1, 1, 1.5, 0.5, 0, 0, 0, 1]], "stamp": 0}, "goes back"),
    ({"trajectory": [[0, 1, 1.5, 0.5, 0, 0, 0, 1], [0.2, 1, 1.5, 0.5, 0, 0, 0, 1]], "stamp": 0.15}, "outside of the traj"),
    ({"trajectory": [[0, 1, 1.5, 0.5, 0, 0, 0, 2], [0.2, 1, 1.5, 0.5, 0, 0, 0, 1]], "stamp": 0}, "pose 0: a quaternion"),
    ({"trajectory": [[0, 1, 1.5, 0.5, 0, 0, 0]], "stamp": 0}, "the shape is"),
    ({"trajectory": "missing.tum", "stamp": 0}, "missing.tum"),
    ({"stamp": 0}, "there is no trajectory"),
])
def test_bad_motions_are_refused(room, cpu, tmp_path, motion, words):
    (tmp_path / "turning.toml").write_text(TURNING)
    with pytest.raises((presight.Error, OSError)) as raised:
        cpu.predict(room, str(tmp_path / "turning.toml"), [1, 1.5, 0.5, 0, 0, 90], **motion)
    one_line(raised, words)


def test_arrays_of_the_caller_are_filled(room, cpu, poses):
    right = cpu.predict_many(room, "laser-scanner", poses)["range"]
    out = np.zeros((20, 1, 361), "f4")
    given = cpu.predict_many(room, "laser-scanner", poses, out={"range": out})
    assert given["range"] is out and same(out, right)
    both = np.zeros((2, 20, 1, 361), "f4")
    read_only = np.zeros((20, 1, 361), "f4")
    read_only.flags.writeable = False
    wrong = {
        "written": read_only,
        "shape": np.zeros((19, 1, 361), "f4"),
        "dtype": np.zeros((20, 1, 361), "f8"),
        "dtype is >f4": np.zeros((20, 1, 361), ">f4"),
        "contiguous": np.zeros((20, 1, 722), "f4")[..., ::2],
        "not a valid array": [0.0],
    }
    for word, array in wrong.items():
        with pytest.raises(presight.Error) as raised:
            cpu.predict_many(room, "laser-scanner", poses, out={"range": array})
        one_line(raised, word, 'out["range"]')
    flat = both.reshape(-1)
    overlapping = {"range": flat[:7220].reshape(20, 1, 361), "cos_incidence": flat[361:7581].reshape(20, 1, 361)}
    with pytest.raises(presight.Error) as raised:
        cpu.predict_many(room, "laser-scanner", poses, outputs=("range", "cos_incidence"), out=overlapping)
    one_line(raised, "written")
    # Of two owners, who do not know of each other.
    memory = bytearray(4 * 7220 + 4)
    overlapping = {name: np.frombuffer(memory, "f4", 7220, at).reshape(20, 1, 361) for name, at in
                   [("range", 0), ("cos_incidence", 4)]}
    with pytest.raises(presight.Error) as raised:
        cpu.predict_many(room, "laser-scanner", poses, outputs=("range", "cos_incidence"), out=overlapping)
    one_line(raised, "overlap")
    memory = bytearray(8 * 7220)
    beside = {name: np.frombuffer(memory, "f4", 7220, at).reshape(20, 1, 361) for name, at in
              [("range", 4 * 7220), ("cos_incidence", 0)]}
    assert same(cpu.predict_many(room, "laser-scanner", poses, ("range", "cos_incidence"), out=beside)["range"], right)
    with pytest.raises(presight.Error, match="not requested"):
        cpu.predict_many(room, "laser-scanner", poses, out={"range": out, "echo": out})
    with pytest.raises(presight.Error, match="no array"):
        cpu.predict_many(room, "laser-scanner", poses, outputs=("range", "echo"), out={"range": out})


def write_tum(path, poses):
    path.write_text("".join(f"{i} {' '.join(repr(float(x)) for x in pose)}\n" for i, pose in enumerate(poses)))


@pytest.mark.parametrize("headings", [None, 8])
def test_likelihoods_are_the_commands(tmp_path, room, room_file, cpu, headings):
    scanner = presight.Sensor.load("laser-scanner").replace(range_sigma=0.02)
    (tmp_path / "s.toml").write_text(scanner.toml())
    rng = np.random.default_rng(3)
    level = np.zeros((30, 7))
    level[:, :2], level[:, 2], level[:, 6] = rng.uniform([0.8, 1.2], [1.4, 1.8], (30, 2)), 0.5, 1
    done("predict", room_file, "--sensor", tmp_path / "s.toml", "--pose", "1,1.5,0.5,0,0,0", "--out", tmp_path / "seen.exr",
         "--backend", "cpu")
    write_tum(tmp_path / "poses.tum", level)
    more = ["--headings", headings] if headings else []
    done("batch", room_file, "--poses", tmp_path / "poses.tum", "--sensor", tmp_path / "s.toml", "--likelihood",
         tmp_path / "seen.exr", "--out", tmp_path / "w", "--cell-m", "0.1", "--backend", "cpu", *more)
    rows = list(csv.DictReader(open(tmp_path / "w" / "poses.csv")))
    weights = [float(row["log_likelihood"]) for row in rows]
    scene = presight.Scene.open(room_file)
    sensed = cpu.predict(scene, scanner, [1, 1.5, 0.5, 0, 0, 0]).range
    found = cpu.likelihood(scene, scanner, sensed, level, headings=headings, cell=(0.1, None))
    assert found.shape == ((30, 8) if headings else (30,)) and found.dtype == ("f4" if headings else "f8")
    assert found.ravel().tolist() == np.asarray(weights, found.dtype).tolist()
    frame = presight.Frame(scanner, 0.0, sensed)
    assert same(cpu.likelihood(scene, scanner, frame, level, headings=headings, cell=(0.1, None)), found)
    # A planted fault: the scan the other way round.
    assert not same(cpu.likelihood(scene, scanner, sensed[:, ::-1], level, headings=headings, cell=(0.1, None)), found)


@pytest.mark.parametrize("what", ["many", "chunks", "likelihood"])
def test_ctrl_c_ends_each_within_half_a_second(room, what):
    predictor = presight.Predictor("cpu", 1)
    poses = np.tile([1.0, 1.5, 0.5, 0.0, 0.0, 0.0], (30_000, 1))
    scanner = presight.Sensor.load("vlp-16").replace(range_sigma=0.02)
    sensed = predictor.predict(room, scanner, poses[0]).range
    sent = []

    def interrupt():
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(0.7, interrupt)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        if what == "many":
            predictor.predict_many(room, scanner, poses[:2000])
        elif what == "chunks":
            for _ in predictor.predict_chunks(room, scanner, poses):
                pass
        else:
            predictor.likelihood(room, scanner, sensed, poses)
    assert time.monotonic() - sent[0] < 0.5
    # The predictor goes on.
    assert same(predictor.predict(room, scanner, poses[0]).range, sensed)


def test_what_does_not_fit_is_not_begun(room, cpu):
    poses = np.tile([1.0, 1.5, 0.5, 0.0, 0.0, 0.0], (10_000_000, 1))
    started = time.monotonic()
    with pytest.raises(MemoryError) as raised:
        cpu.predict_many(room, "realsense-d435", poses)
    assert time.monotonic() - started < 30
    one_line(raised, "predict_chunks")
