"""What sensors did see: logs, frames, verdicts, the localizer."""

import json

import numpy as np
import pytest
from conftest import POSE, data, same

import presight


def scanner():
    return presight.Sensor.load("laser-scanner").replace(range_sigma=0.01, angle_sigma_deg=0.1)


def test_a_log_reads_back_what_was_written(tmp_path):
    sensor = presight.Sensor.scanner([-10, 0, 10], range_max=30, name="three")
    frames = [
        {"t": 1.0, "range": [1.5, "inf", None], "reference": [1, 2, 0, 0, 0, 90]},
        {"t": 1.5, "range": [2.5, 3.5, "-inf"], "odometry": [0.5, 0, 0, 0, 0, 0, 1]},
    ]
    lines = [{"format": 1, "kind": "range-log", "sensor": sensor.toml()}, *frames]
    (tmp_path / "run.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.warns(presight.Notice):
        log = presight.Log.open(tmp_path / "run.jsonl")
    assert len(log) == 2 and log.sensor == sensor and log.time.tolist() == [1.0, 1.5]
    expected = np.array([[[1.5, np.inf, np.nan]], [[2.5, 3.5, -np.inf]]], "f4")
    assert np.array_equal(log.ranges, expected, equal_nan=True)
    assert np.isnan(log.odometry[0]).all() and log.odometry[1].tolist() == [0.5, 0, 0, 0, 0, 0, 1]
    assert np.allclose(log.reference[0], [1, 2, 0, 0, 0, 0.5**0.5, 0.5**0.5]) and np.isnan(log.reference[1]).all()
    assert [frame.time for frame in log] == [1.0, 1.5] and log[-1].odometry.shape == (7,) and log[0].odometry is None
    assert np.array_equal(log[0].ranges, expected[0], equal_nan=True)
    with pytest.raises(IndexError):
        log[2]


def test_verdicts_of_a_box_and_of_a_hole(room, cpu):
    sensor = scanner()
    sensed = cpu.predict(room, sensor, POSE).range
    sensed[0, 330] -= 0.3
    sensed[0, 320] += 0.5
    verdicts = cpu.verdicts(room, presight.Frame(sensor, 0.0, sensed), POSE, pose_cov=[0.001, 0.001, 0.001, 0.03, 0.03, 0.03])
    names = np.array(verdicts.names)[verdicts.pixels[0]]
    assert verdicts.pixels.dtype == np.uint8 and verdicts.difference.shape == (1, 361)
    assert names[330] == "nearer" and names[320] == "farther"
    assert verdicts.counts["confirmed"] > 200 and sum(verdicts.counts.values()) == 361
    assert verdicts.difference[0, 330] == pytest.approx(-0.3, abs=1e-3)


def test_the_localizer_follows_and_says_why(room, cpu):
    sensor, localizer = scanner(), presight.Localizer(room, init=POSE, threads=2)
    for k in range(5):
        truth = [POSE[0] + 0.02 * k, POSE[1], POSE[2], 0, 0, 2.0 * k]
        odometry = [0.02, 0, 0, 0, 0, 2.0] if k else None
        step = localizer.step(presight.Frame(sensor, 0.1 * k, cpu.predict(room, sensor, truth).range, odometry=odometry))
        assert np.linalg.norm(step.pose[:3] - truth[:3]) < 0.02, (k, step.reason)
        assert step.covariance.shape == (6, 6) and np.linalg.eigvalsh(step.covariance).min() > -1e-12
        assert step.state and step.reason and step.time == pytest.approx(0.1 * k)
    with pytest.raises(presight.Error):
        localizer.step(presight.Frame(sensor, 0.1, np.ones(361)))


def test_frames_say_when_their_rays_were_measured(tmp_path):
    times = np.linspace(-0.1, 0, 361)
    frame = presight.Frame("laser-scanner", 0.0, np.ones(361), times=times, twist=[1.5, 0, 0, 0, 0, 1])
    assert frame.times.shape == (1, 361) and np.allclose(frame.times[0], times) and frame.twist.tolist() == [1.5, 0, 0, 0, 0, 1]
    still = presight.Frame("laser-scanner", 0.0, np.ones(361))
    assert still.times is None and still.twist is None
    header = {"format": 1, "kind": "range-log", "sensor": presight.Sensor.scanner([0, 1]).toml()}
    # By hand: 0.2 m in 0.1 s.
    lines = [header, {"t": 0.0, "range": [2, 2], "times": [0, 0.05]},
             {"t": 0.1, "range": [2, 2], "times": [0, 0.05], "odometry": [0.2, 0, 0, 0, 0, 0]}]
    path = tmp_path / "run.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.warns(UserWarning, match="no pose lies beyond"):
        log = presight.Log.open(path)
    assert all(np.allclose(frame.twist, [2, 0, 0, 0, 0, 0]) and np.allclose(frame.times, [[0, 0.05]]) for frame in log)


def test_an_unknown_start_needs_a_level_scanner(room, cpu):
    camera = presight.Sensor.camera([50, 50, 32, 24], (64, 48), range_max=10, range_sigma=0.01)
    frame = presight.Frame(camera, 0.0, cpu.predict(room, camera, POSE).range)
    with pytest.raises(presight.Error, match="init="):
        presight.Localizer(room).step(frame)


def test_bad_lines_are_left_out_if_asked(tmp_path):
    header = {"format": 1, "kind": "range-log", "sensor": presight.Sensor.scanner([0, 1]).toml()}
    lines = [json.dumps(line) for line in (header, {"t": 0.0, "range": [2, 3]}, {"t": 1.0}, {"t": 2.0, "range": [2, 3]})]
    (tmp_path / "run.jsonl").write_text("\n".join(lines))
    with pytest.raises(presight.Error, match="line 3"):
        presight.Log.open(tmp_path / "run.jsonl")
    with pytest.warns(presight.Notice, match="1 of 3 frames are left out: line 3"):
        log = presight.Log.open(tmp_path / "run.jsonl", skip_bad=True)
    assert log.time.tolist() == [0.0, 2.0]


def test_angles_in_radians_are_noted(cpu, room):
    with pytest.warns(presight.Notice, match="90 degrees in radians"):
        cpu.predict(room, "laser-scanner", [1, 1.5, 0.5, 0, 0, 1.5708])


def test_a_real_log_of_a_corridor(cpu):
    with pytest.warns(presight.Notice):
        log = presight.Log.open(data("lidar2d/malaga_corridor_mapping_scans.json"))
    assert len(log) > 10 and log.ranges.shape == (len(log), 1, log.sensor.shape[1]) and (np.diff(log.time) > 0).all()
    corridor = presight.Scene.open(data("lidar2d/malaga_corridor_map.glb"))
    out = cpu.predict(corridor, log.sensor, log.reference[5], pose_of="robot")
    near = np.isfinite(out.range) & np.isfinite(log.ranges[5])
    # The map was made of these scans.
    assert near.mean() > 0.5 and np.median(np.abs(out.range - log.ranges[5])[near]) < 0.1
    assert same(log[5].ranges, log.ranges[5])
