"""A ROS 2 node: the robot's pose in a model, what each measurement should have been, and what has changed.

    python -m presight.ros --map hall.glb --topic /scan --init unknown

It runs on the rclpy of the user's ROS. It publishes `map` to `odom` on /tf, /presight/pose, /diagnostics, /presight/predicted,
/presight/verdict, the latched /presight/model, and with --update /presight/findings. A pose on /initialpose, as RViz sends it, starts
it anew.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import presight
from presight._follower import Follower, pose

SCAN, CLOUD = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2"
IMAGE, PACKED, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"
MEASURED = (SCAN, CLOUD, IMAGE, PACKED)
TF, ODOMETRY = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
POSE, MARKERS = "geometry_msgs/msg/PoseWithCovarianceStamped", "visualization_msgs/msg/MarkerArray"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m presight.ros", description="Follow a robot in a model, from its ROS 2 topics.")
    p.add_argument("--map", required=True, metavar="SCENE", help="the model: a .glb or .gltf file, a script, or a store")
    p.add_argument("--topic", default="/scan", help="LaserScan, PointCloud2 or depth image [default: /scan]")
    p.add_argument("--init", type=pose, metavar="POSE", help="x,y,z,roll_deg,pitch_deg,yaw_deg, or unknown [default]")
    p.add_argument("--init-sigma", type=float, default=0.05, metavar="METRES")
    p.add_argument("--init-sigma-deg", type=float, default=2.0, metavar="DEG")
    p.add_argument("--model-sigma", type=float, metavar="METRES", help="deviation of the model's surfaces")
    p.add_argument("--floor", type=float, default=0.0, metavar="METRES", help="height of the robot's frame in a search")
    p.add_argument("--sensor", metavar="PRESET|FILE", help="noise and limits of the sensor")
    p.add_argument("--base", metavar="FRAME", help="frame of the robot [default: base_link, else base_footprint]")
    p.add_argument("--mount", type=pose, metavar="POSE", help="pose of the sensor on the robot, where /tf_static does not tell it")
    p.add_argument("--odometry", metavar="TOPIC", help="a topic of nav_msgs/Odometry, where /tf has no odometry")
    p.add_argument("--frame", default="map", help="frame of the model [default: map]")
    p.add_argument("--tolerance", type=float, default=0.1, metavar="S", help="the transform is stamped ahead by this time")
    p.add_argument("--update", metavar="DIR", help="learn what has changed: DIR/changes.jsonl for `presight env apply`")
    p.add_argument("--threads", type=int, default=0, metavar="N", help="CPU threads, 0 = all cores")
    return p


def type_of(name: str) -> Any:
    """The Python class of a message type; ModuleNotFoundError if its package is not installed."""
    package, _, message = name.split("/")
    return getattr(import_module(f"{package}.msg"), message)


class Node:
    """Publishers and subscriptions of bytes on the user's rclpy."""

    def __init__(self, given: list[str], rclpy: Any):
        self.rclpy, self.stop = rclpy, threading.Event()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self.end)
        from rclpy.signals import SignalHandlerOptions  # type: ignore[import-not-found]

        # rclpy's own handlers would close the publishers before the last measurement is answered.
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node("presight")
        self.executor = rclpy.executors.SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.publishers: dict[str, Any] = {}

    def end(self, number: int, _: Any) -> None:
        """Ends the node after this round; a second signal ends it at once."""
        self.stop.set()
        signal.signal(number, signal.SIG_DFL)

    def say(self, text: str) -> None:
        self.node.get_logger().info(text)

    def advertise(self, topic: str, kind: str, latched: bool = False) -> None:
        """Makes a publisher. Subscribers find it before its first message, which they would otherwise miss."""
        from rclpy.qos import DurabilityPolicy, QoSProfile  # type: ignore[import-not-found]

        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        try:
            qos = QoSProfile(depth=1 if latched else 10, durability=durability)
            self.publishers[topic] = self.node.create_publisher(type_of(kind), topic, qos)
        except (ModuleNotFoundError, AttributeError):
            self.say(f"{topic} is not published: the package of {kind} is not installed")
            self.publishers[topic] = None

    def publish(self, topic: str, kind: str, latched: bool, data: bytes) -> None:
        if topic not in self.publishers:
            self.advertise(topic, kind, latched)
        if (publisher := self.publishers[topic]) is not None:
            publisher.publish(data)

    def subscribe(self, topic: str, kind: str, take: Callable[[bytes], None], depth: int, *, latched: bool = False) -> str:
        """Subscribes as reliably as all publishers of now offer, and returns the words for it."""
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        offers = self.node.get_publishers_info_by_topic(topic)
        reliable = all(offer.qos_profile.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
        qos = QoSProfile(
            depth=depth,
            reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
        )
        try:
            self.node.create_subscription(type_of(kind), topic, take, qos, raw=True)
        except (ModuleNotFoundError, AttributeError):
            self.say(f"{topic} is not read: the package of {kind} is not installed")
        return "reliable" if reliable else "best effort"

    def type_offered(self, topic: str) -> str | None:
        """The type of the topic, once somebody publishes it; None after a signal. A type that is no measurement raises Error."""
        waits_from = time.monotonic()
        while not (offers := self.node.get_publishers_info_by_topic(topic)):
            if self.stop.is_set():
                return None
            self.executor.spin_once(timeout_sec=0.2)
            if time.monotonic() - waits_from > 5.0:
                found = sorted(name for name, kinds in self.node.get_topic_names_and_types() if set(MEASURED) & set(kinds))
                say = f"nobody publishes {topic} yet; scans, clouds and images are on: {', '.join(found) or 'no topic'}; waiting"
                self.say(say)
                waits_from = float("inf")
        kinds = sorted({offer.topic_type for offer in offers})
        if len(kinds) > 1 or kinds[0] not in MEASURED:
            remedy = "give --topic with a LaserScan, a PointCloud2 or a depth image"
            raise presight.Error(f"{topic} is of type {' and '.join(kinds)}; {remedy}")
        return kinds[0]

    def spin(self) -> None:
        while not self.stop.is_set():
            self.executor.spin_once(timeout_sec=0.2)


def connect(node: Node, follower: Follower, args: argparse.Namespace, kind: str) -> None:
    """Subscribes to all that the follower needs."""

    def take(topic: str, kind: str, depth: int, latched: bool = False) -> str:
        return node.subscribe(topic, kind, lambda data: follower.add(topic, kind, data), depth, latched=latched)

    take("/tf_static", TF, 100, latched=True)
    take("/tf", TF, 100)
    if args.odometry:
        take(args.odometry, ODOMETRY, 100)
    if kind in (IMAGE, PACKED):
        take(args.topic.removesuffix("/compressedDepth").rpartition("/")[0] + "/camera_info", INFO, 5)
    node.subscribe("/initialpose", POSE, follower.initial_pose, 1)
    reliability = take(args.topic, kind, 5)
    node.say(f"reading {args.topic} ({kind}, {reliability})")


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs the node until Ctrl-C."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    args = parser().parse_args(given[: given.index("--ros-args")] if "--ros-args" in given else given)
    try:
        import rclpy  # type: ignore[import-not-found]
        import rclpy.exceptions  # type: ignore[import-not-found]
        import rclpy.executors  # type: ignore[import-not-found]
    except ImportError:
        print("presight.ros: there is no rclpy; source the setup of your ROS 2 in this shell", file=sys.stderr)
        return 3
    node, follower = Node(given, rclpy), None
    try:
        # Before the wait: a map that cannot be read is said at once.
        follower = Follower(args, node.publish, node.say)
        warnings.simplefilter("always", presight.Notice)
        warnings.showwarning = lambda message, *_: follower.warn_once(str(message))
        if (kind := node.type_offered(args.topic)) is not None:
            topics = {"/tf": TF, "/presight/pose": POSE, "/diagnostics": DIAGNOSTICS}
            if kind in (SCAN, CLOUD):
                topics |= {"/presight/predicted": kind, "/presight/verdict": CLOUD}
            if kind == SCAN:
                topics["/presight/predicted/points"] = CLOUD
            for topic, published in topics.items():
                node.advertise(topic, published)
            connect(node, follower, args, kind)
            node.spin()
    except (presight.Error, presight.DeviceError, presight.SystemFault) as e:
        print(f"presight.ros: {e}", file=sys.stderr)
        return 1
    except rclpy.exceptions.NameValidationException as e:
        print(f"presight.ros: {' '.join(str(e).split())}; give another --topic", file=sys.stderr)
        return 2
    finally:
        if follower is not None:
            follower.end()
        node.executor.shutdown()
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(run())
