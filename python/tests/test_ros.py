"""Bytes of ROS 2 messages in and out, and the node without its ROS."""

import pytest
from conftest import POSE, data, done, same

import presight
from presight import ros

SCAN = "sensor_msgs/msg/LaserScan"


def scanner():
    return presight.Sensor.load("laser-scanner").replace(range_sigma=0.01, angle_sigma_deg=0.1)


def test_a_scan_as_bytes_is_the_same_frame(room, cpu):
    out = cpu.predict(room, scanner(), POSE)
    messages = presight.Messages(sensor=scanner(), mount=[0, 0, 0, 0, 0, 0])
    message = messages.laser_scan(out)
    assert message[:4] == b"\0\1\0\0" and messages.frame() is None
    messages.add("/scan", SCAN, message)
    frame = messages.frame()
    assert same(frame.ranges, out.range) and messages.frame() is None and messages.left_out == 0
    step = presight.Localizer(room, init=POSE, threads=2).step(frame)
    assert step.is_known and step.explained > 0.9 and step.verdicts.counts["confirmed"] > 200 and step.weak == []
    sent = {topic: (kind, latched) for topic, kind, latched, _ in messages.answers(step, ahead=0.1)}
    assert sent["/tf"] == ("tf2_msgs/msg/TFMessage", False) and set(sent) == {"/tf", "/presight/pose", "/diagnostics"}
    compared = {topic: message for topic, _, _, message in messages.comparison(cpu, room, frame, step)}
    assert set(compared) == {"/presight/predicted", "/presight/predicted/points", "/presight/verdict"}
    [(topic, kind, latched, model)] = messages.model(room)
    assert (topic, kind, latched) == ("/presight/model", "visualization_msgs/msg/MarkerArray", True) and len(model) > 1000
    with pytest.raises(presight.Error):
        messages.add("/scan", SCAN, message[:100])
    with pytest.raises(presight.Error):
        messages.image(out)


def test_a_scan_without_a_mount_waits(room, cpu):
    messages = presight.Messages()
    with pytest.warns(presight.Notice, match="mount="):
        messages.add("/scan", SCAN, messages.laser_scan(cpu.predict(room, scanner(), POSE)))
    assert messages.frame() is None


def test_a_bag_opens_with_its_choices():
    bag = data("ros/malaga_zstd.mcap")
    with pytest.warns(presight.Notice):
        log = presight.Log.open(bag, topic="/scan", base="base_link")
    assert len(log) > 30 and log.odometry.shape == (len(log), 7)
    with pytest.raises(presight.Error, match="/scan"):
        presight.Log.open(bag, topic="/other")


def test_odometry_may_come_in_front_of_an_older_scan():
    """A scan that waits in a driver comes behind the odometry of the next one: the motions are the same."""
    reader = pytest.importorskip("mcap.reader")
    with open(data("ros/malaga_zstd.mcap"), "rb") as file:
        taken = reader.make_reader(file).iter_messages(topics=["/odom", "/scan"])
        recorded = [(channel.topic, schema.name, message.data) for schema, channel, message in taken][:6]
    assert [topic for topic, *_ in recorded] == ["/odom", "/scan"] * 3

    def motions(order):
        messages, found = presight.Messages(mount=[0.78, 0, 0.3, 0, 0, 0]), []
        for k in order:
            messages.add(*recorded[k])
            if (frame := messages.frame()) is not None:
                found.append(frame.odometry)
        return found

    first, *expected = motions(range(6))
    assert first is None and len(expected) == 2 and all(motion is not None for motion in expected)
    late = motions([0, 2, 1, 3, 4, 5])
    assert late[0] is None and all(same(a, b) for a, b in zip(late[1:], expected, strict=True))


def test_a_learner_finds_what_the_command_finds(tmp_path):
    bag, model = data("ros/malaga_zstd.mcap"), data("lidar2d/malaga_corridor_map.glb")
    flags = ["--init", "unknown", "--model-sigma", "0.03", "--out", tmp_path / "command"]
    printed = done("update", bag, "--map", model, *flags)
    scene = presight.Scene.open(model)
    localizer, learner = presight.Localizer(scene, model_sigma=0.03), presight.Learner(scene, model_sigma=0.03)
    with pytest.warns(presight.Notice):
        log = presight.Log.open(bag)
    for frame in log:
        learner.observe(localizer.step(frame), frame)
    learner.end_drive()
    kinds = ("gone:", "moved:", "new:", "part gone:", "comes and goes:", "seen through")
    expected = [line for line in printed.splitlines() if line.startswith(kinds)]
    assert expected and learner.findings() == expected
    assert learner.write(tmp_path / "node") == len((tmp_path / "command" / "changes.jsonl").read_text().splitlines())
    with pytest.raises(presight.Error, match="the frame of the step"):
        learner.observe(presight.Localizer(scene).step(log[0]), log[1])


def test_a_follower_names_what_it_leaves_out():
    """The node without rclpy: the model is sent once, and a message that is cut is named."""
    arguments = ["--map", str(data("lidar2d/malaga_corridor_map.glb")), "--mount", "0.78,0,0.3,0,0,0"]
    sent, said = [], []
    follower = ros.Follower(ros.parser().parse_args(arguments), lambda *message: sent.append(message), said.append)
    try:
        assert [topic for topic, *_ in sent] == ["/presight/model"]
        follower.add("/scan", SCAN, b"\0\1\0\0")
        assert any("/scan is left out" in line for line in said)
    finally:
        follower.end()
    assert "0 measurements were matched" in said[-1]
    poses = presight.Messages()
    with pytest.raises(presight.Error):
        poses.initial_pose(b"\0\1\0\0")
