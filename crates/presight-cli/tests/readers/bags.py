"""Compares a bag with the arrays of the same predictions: bags.py BAG NAME, where NAME is the namespace of the sensor's topics."""

import sys
from pathlib import Path

import numpy as np
from mcap_ros2.reader import read_ros2_messages
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

bag, name = sys.argv[1:]
store = get_typestore(Stores.ROS2_JAZZY)
read, latched = {}, {}
with AnyReader([Path(bag)]) as reader:  # by the definitions in the bag
    for connection in reader.connections:
        [qos] = connection.ext.offered_qos_profiles
        latched[connection.topic] = qos.durability.name == "TRANSIENT_LOCAL"
    for connection, stamp, raw in reader.messages():
        message = reader.deserialize(raw, connection.msgtype)
        # Jazzy's own definitions give the same bytes.
        known = store.deserialize_cdr(raw, connection.msgtype)
        assert bytes(store.serialize_cdr(known, connection.msgtype)) == bytes(raw), connection.topic
        read.setdefault(connection.topic, []).append((stamp, message))

counts = {}
for found in read_ros2_messages(bag):
    at = counts.get(found.channel.topic, 0)
    stamp, message = read[found.channel.topic][at]
    assert found.log_time_ns == stamp, found.channel.topic
    if hasattr(message, "data"):
        assert bytes(found.ros_msg.data) == message.data.tobytes(), found.channel.topic
    counts[found.channel.topic] = at + 1
assert counts == {topic: len(messages) for topic, messages in read.items()}, counts
assert latched["/tf_static"] and not latched["/tf"], latched


def array(k, image):
    return np.load(f"{k}.{image}.npy")


def same(a, b):
    assert np.array_equal(np.asarray(a).ravel(), b.ravel(), equal_nan=b.dtype.kind == "f")


compared = 0
for k, (_, scan) in enumerate(read.get(f"/{name}/scan", [])):
    same(scan.ranges, array(k, "range"))
    compared += 1
for k, (_, cloud) in enumerate(read.get(f"/{name}/points", [])):
    kinds = {4: "u2", 6: "u4", 7: "f4"}
    fields = np.dtype({
        "names": [f.name for f in cloud.fields],
        "formats": ["<" + kinds[f.datatype] for f in cloud.fields],
        "offsets": [f.offset for f in cloud.fields],
        "itemsize": cloud.point_step,
    })
    points = cloud.data.view(fields)
    ranges = array(k, "range").ravel()
    lengths = np.sqrt(sum(points[axis].astype("f8") ** 2 for axis in "xyz"))
    seen = np.isfinite(ranges)
    assert np.array_equal(np.isfinite(lengths), seen) and not cloud.is_dense
    assert np.allclose(lengths[seen], ranges[seen], rtol=3e-7)
    assert np.array_equal(points["ring"], np.repeat(np.arange(cloud.height), cloud.width))
    same(points["object_id"], array(k, "object_id"))
    same(points["polygon_id"], array(k, "polygon_id"))
    compared += 1
for topic, image, dtype in [("depth", "depth_z", "<f4"), ("object_id", "object_id", "<u4"), ("polygon_id", "polygon_id", "<u4")]:
    for k, (_, message) in enumerate(read.get(f"/{name}/{topic}", [])):
        same(message.data.view(dtype), array(k, image))
        compared += 1
assert compared >= 2, read.keys()
print(f"{compared} messages equal the arrays")
