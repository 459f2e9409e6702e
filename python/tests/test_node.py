"""The node on real rclpy, on this machine alone.

PRESIGHT_RCLPY names a Python that imports rclpy, such as that of an environment with `ros-jazzy-rclpy[fastrtps]`; without it the
Python of the tests is asked.
"""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import data, done

import presight

MODEL = "lidar2d/malaga_corridor_map.glb"
# What messages do not tell, and what `localize` would learn.
FLAGS = ["--model-sigma", "0.03", "--mount", "0.78,0,0.3,0,0,0"]


@pytest.fixture(scope="session")
def rclpy():
    """A Python with rclpy, and its environment: with this package, on the loopback interface, and in a domain of its own."""
    python = os.environ.get("PRESIGHT_RCLPY", sys.executable)
    environment = os.environ | {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_DOMAIN_ID": str(10 + os.getpid() % 80),
        # The wheel is abi3: one build serves every Python.
        "PYTHONPATH": os.pathsep.join(filter(None, [os.environ.get("PRESIGHT_ALONE"), os.environ.get("PYTHONPATH")])),
    }
    if os.environ.get("ROS_DISTRO") == "humble":
        environment["ROS_LOCALHOST_ONLY"] = "1"
    found = subprocess.run([python, "-c", "import rclpy, presight"], env=environment, capture_output=True, text=True)
    if found.returncode != 0:
        pytest.skip(f"{python} has no rclpy; PRESIGHT_RCLPY names a Python that has: {found.stderr.strip()[-200:]}")
    return python, environment


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    """The messages of the drive, as a pickle for the driver."""
    mcap = pytest.importorskip("mcap.reader")
    path = tmp_path_factory.mktemp("recorded") / "messages.pickle"
    with open(data("ros/malaga_zstd.mcap"), "rb") as file:
        reader = mcap.make_reader(file)
        # Every type of this bag but TFMessage begins with a stamp, in little endian behind four bytes of CDR.
        stamp = lambda message: np.frombuffer(message.data, "<u4", 2, 4) @ np.array([10**9, 1])
        messages = [(c.topic, s.name, int(stamp(m)), m.data) for s, c, m in reader.iter_messages()]
    path.write_bytes(pickle.dumps(messages))
    return path


def drive(scenario, rclpy, messages, folder, *flags):
    """Runs a scenario of the driver, and gives its result."""
    python, environment = rclpy
    result = folder / "result"
    arguments = ["--", "--map", data(MODEL), *FLAGS, *flags]
    ran = subprocess.run(
        [python, Path(__file__).with_name("node_driver.py"), scenario, messages, result, *arguments],
        env=environment, capture_output=True, text=True, timeout=240,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return pickle.loads(result.read_bytes())


def test_the_node_gives_the_poses_of_localize(rclpy, recorded, tmp_path):
    tum, found = tmp_path / "a.tum", tmp_path / "found"
    bag = data("ros/malaga_zstd.mcap")
    done("localize", bag, "--map", data(MODEL), "--init", "unknown", *FLAGS, "--out", tum)
    expected = np.loadtxt(tum)
    result = drive("follow", rclpy, recorded, tmp_path, "--odometry", "/odom", "--update", found)
    said = result["said"]
    assert result["status"] == 0, said

    messages = presight.Messages()
    poses = np.array([messages.initial_pose(pose)[0] for pose in result["poses"]])
    in_step = len(expected) - 8
    assert len(poses) > in_step > 20, (len(poses), said)
    assert np.abs(poses[:in_step, :3] - expected[:in_step, 1:4]).max() < 1e-4
    turned = np.abs((poses[:in_step, 3:] * expected[:in_step, 4:]).sum(axis=1)).clip(max=1)
    assert np.degrees(2 * np.arccos(turned)).max() < 1e-3
    # Anew from a pose that is known less well.
    assert np.abs(poses[in_step : in_step + 4, :2] - expected[in_step : in_step + 4, 1:3]).max() < 0.05
    # Of those that come at once, the newest is answered, and the others are counted.
    left_out = 4 - result["answers_to_burst"]
    assert 0 <= left_out < 4 and f"{left_out} left out because a newer one came" in said, said

    assert result["triangles"] > 10 and result["predicted"] > 20
    assert result["verdict_fields"] == ["x", "y", "z", "residual", "verdict", "object_id", "rgb"]
    assert (found / "changes.jsonl").exists()
    for words in ["reading /scan (sensor_msgs/msg/LaserScan, reliable)", "started anew at", "the clock has jumped back"]:
        assert words in said, said
    assert "Traceback" not in said and "ERROR" not in said, said


def test_a_planted_fault_moves_the_poses(rclpy, recorded, tmp_path):
    """The comparison above can fail: with the mount turned by a degree the poses are others."""
    flags = ["--model-sigma", "0.03", "--init", "unknown", "--mount"]
    for name, mount in [("a", "0.78,0,0.3,0,0,0"), ("b", "0.78,0,0.3,0,0,1")]:
        done("localize", data("ros/malaga_zstd.mcap"), "--map", data(MODEL), *flags, mount, "--out", tmp_path / f"{name}.tum")
    straight, turned = (np.loadtxt(tmp_path / f"{name}.tum") for name in "ab")
    assert np.abs(straight[-9:, 1:4] - turned[-9:, 1:4]).max() > 1e-3


def test_a_publisher_of_sensor_data_is_heard(rclpy, recorded, tmp_path):
    result = drive("best_effort", rclpy, recorded, tmp_path, "--init", "0,0,0,0,0,0")
    assert result["status"] == 0 and len(result["stamps"]) == 1, result["said"]
    assert "(sensor_msgs/msg/LaserScan, best effort)" in result["said"]


def test_a_topic_that_nobody_publishes_is_named(rclpy, recorded, tmp_path):
    result = drive("nobody", rclpy, recorded, tmp_path)
    assert result["status"] == 0, result["said"]
    assert "nobody publishes /scan yet" in result["said"] and "/front/scan; waiting" in result["said"]


def test_a_topic_of_another_type_is_refused(rclpy, recorded, tmp_path):
    result = drive("wrong_type", rclpy, recorded, tmp_path)
    assert result["status"] == 1, result["said"]
    assert "/scan is of type std_msgs/msg/String; give --topic" in result["said"]
