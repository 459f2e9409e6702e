"""A ROS 2 node: the robot's pose in a model, and what each scan should have been.

    python -m presight.ros --map hall.glb --topic /scan --init unknown

It runs on the rclpy of the user's ROS. It publishes `map` to `odom` on /tf, /presight/pose, /diagnostics, /presight/predicted,
/presight/verdict and the latched /presight/model, and starts anew at a pose on /initialpose, as RViz sends it.
"""

from __future__ import annotations

import argparse
import sys
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import numpy as np

import presight

SCAN, CLOUD = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2"
TF, ODOMETRY = "tf2_msgs/msg/TFMessage", "nav_msgs/msg/Odometry"
POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m presight.ros", description="Follow a robot in a model, from its ROS 2 topics.")
    p.add_argument("--map", required=True, metavar="SCENE", help="the model: a .glb or .gltf file, a script, or a store")
    p.add_argument("--topic", default="/scan", help="LaserScan or PointCloud2 [default: /scan]")
    p.add_argument("--init", default="unknown", metavar="POSE", help="x,y,z,roll_deg,pitch_deg,yaw_deg, or unknown [default]")
    p.add_argument("--init-sigma", type=float, default=0.05, metavar="METRES")
    p.add_argument("--init-sigma-deg", type=float, default=2.0, metavar="DEG")
    p.add_argument("--model-sigma", type=float, metavar="METRES", help="deviation of the model's surfaces")
    p.add_argument("--floor", type=float, default=0.0, metavar="METRES", help="height of the robot's frame in a search")
    p.add_argument("--sensor", metavar="PRESET|FILE", help="noise and limits of the sensor")
    p.add_argument("--base", metavar="FRAME", help="frame of the robot [default: base_link, else base_footprint]")
    p.add_argument("--mount", metavar="POSE", help="pose of the sensor on the robot, where /tf_static does not tell it")
    p.add_argument("--odometry", metavar="TOPIC", help="a topic of nav_msgs/Odometry, where /tf has no odometry")
    p.add_argument("--frame", default="map", help="frame of the model [default: map]")
    p.add_argument("--tolerance", type=float, default=0.1, metavar="S", help="the transform is stamped ahead by this time")
    p.add_argument("--threads", type=int, default=0, metavar="N", help="CPU threads, 0 = all cores")
    return p


def numbers(text: str, flag: str) -> list[float]:
    """A pose of a flag."""
    try:
        pose = [float(number) for number in text.split(",")]
    except ValueError:
        pose = []
    if len(pose) not in (6, 7):
        raise SystemExit(f"presight.ros: {flag} {text}: not a pose; give x,y,z,roll_deg,pitch_deg,yaw_deg")
    return pose


def type_of(name: str) -> Any:
    """The Python class of a message type; ModuleNotFoundError if its package is not installed."""
    package, _, message = name.split("/")
    return getattr(import_module(f"{package}.msg"), message)


class Follower:
    """Follows the robot in a thread: of the scans that come while one is matched, the newest waits. Knows no rclpy."""

    def __init__(self, args: argparse.Namespace, publish: Callable[[str, str, bool, bytes], None], say: Callable[[str], None]):
        self.args, self.publish, self.say = args, publish, say
        self.scene = presight.Scene.open(args.map)
        self.predictor = presight.Predictor(backend="cpu", threads=args.threads)
        self.sensor = presight.Sensor.load(args.sensor) if args.sensor else None
        self.changed, self.ended, self.count = threading.Condition(), False, 0
        self.pose: Any = None
        self.said: set[str] = set()
        init = None if args.init == "unknown" else numbers(args.init, "--init")
        self.restart(init, args.init_sigma, args.init_sigma_deg)
        for message in self.messages.model(self.scene):
            publish(*message)
        self.thread = threading.Thread(target=self.work, daemon=True)
        self.thread.start()

    def restart(self, init: Any, sigma: float, sigma_deg: float) -> None:
        """Starts anew; the measurements so far are forgotten, the transforms of the robot are kept."""
        a = self.args
        mount = numbers(a.mount, "--mount") if a.mount else None
        with self.changed:
            if not hasattr(self, "messages"):
                self.messages = presight.Messages(a.frame, base=a.base, sensor=self.sensor, mount=mount)
            self.localizer = presight.Localizer(
                self.scene,
                init=init,
                init_sigma=sigma,
                init_sigma_deg=sigma_deg,
                model_sigma=a.model_sigma,
                floor=a.floor,
                threads=a.threads,
            )

    def warn_once(self, text: str) -> None:
        if text not in self.said:
            self.said.add(text)
            self.say(text)

    def add(self, topic: str, kind: str, data: bytes) -> None:
        """A message of a subscription."""
        try:
            with warnings.catch_warnings(record=True) as notices:
                warnings.simplefilter("always")
                self.messages.add(topic, kind, data)
            for notice in notices:
                self.warn_once(str(notice.message))
        except presight.Error as e:
            self.warn_once(f"{topic} is left out: {e}")
            if topic == self.args.topic and "is not after" in str(e):  # the clock has jumped back
                self.restart(self.pose, self.args.init_sigma, self.args.init_sigma_deg)
        with self.changed:
            self.changed.notify()

    def initial_pose(self, data: bytes) -> None:
        """A pose of RViz: the localizer starts there, as wide as its covariance."""
        try:
            pose, covariance = self.messages.initial_pose(data)
        except presight.Error as e:
            return self.say(f"/initialpose is left out: {e}")
        sigmas = np.sqrt(np.diagonal(covariance))
        # RViz writes zeros for height, roll and pitch.
        spread, turn = max(float(sigmas[:3].max()), 1e-3), max(float(np.degrees(sigmas[3:].max())), 0.1)
        self.restart(pose, spread, turn)
        self.say(f"started anew at {np.round(pose[:3], 3).tolist()}, known to {spread:.2f} m and {turn:.0f} degrees")
        return None

    def work(self) -> None:
        while True:
            with self.changed:
                frame = self.messages.frame()
                while not self.ended and frame is None:
                    self.changed.wait(timeout=1.0)
                    frame = self.messages.frame()
                if self.ended or frame is None:
                    return
                localizer = self.localizer
            try:
                step = localizer.step(frame)
                self.count += 1
                self.pose = step.pose if step.is_known else None
                for message in self.messages.answers(step, ahead=self.args.tolerance):
                    self.publish(*message)
                for message in self.messages.comparison(self.predictor, self.scene, frame, step):
                    self.publish(*message)
            except (presight.Error, presight.DeviceError, presight.SystemFault) as e:
                self.warn_once(f"the scan at {frame.time:.3f} s is left out: {e}")

    def end(self) -> None:
        with self.changed:
            self.ended = True
            self.changed.notify()
        self.thread.join()
        self.say(f"{self.count} scans were matched, {self.messages.left_out} left out because a newer one came")
        for line in self.localizer.warnings:
            self.say(line)


def run(arguments: Sequence[str] | None = None) -> int:
    """Runs the node until Ctrl-C."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    args = parser().parse_args(given[: given.index("--ros-args")] if "--ros-args" in given else given)
    try:
        import rclpy  # type: ignore[import-not-found]
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy  # type: ignore[import-not-found]
    except ImportError:
        print("presight.ros: there is no rclpy; source the setup of your ROS 2 in this shell", file=sys.stderr)
        return 3
    rclpy.init(args=given)
    node = rclpy.create_node("presight")
    say, publishers, lock = node.get_logger().info, {}, threading.Lock()

    def publish(topic: str, kind: str, latched: bool, data: bytes) -> None:
        with lock:
            if topic not in publishers:
                durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
                try:
                    qos = QoSProfile(depth=10, durability=durability)
                    publishers[topic] = node.create_publisher(type_of(kind), topic, qos)
                except (ModuleNotFoundError, AttributeError):
                    say(f"{topic} is not published: the package of {kind} is not installed")
                    publishers[topic] = None
            if (publisher := publishers[topic]) is not None:
                publisher.publish(data)

    def subscribe(topic: str, kind: str, take: Callable[[bytes], None], qos: Any) -> None:
        try:
            node.create_subscription(type_of(kind), topic, take, qos, raw=True)
        except (ModuleNotFoundError, AttributeError):
            say(f"{topic} is not read: the package of {kind} is not installed")

    follower = None
    try:
        offers = offered(node, args.topic, say)
        follower = Follower(args, publish, say)
        static = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        subscribe("/tf_static", TF, lambda data: follower.add("/tf_static", TF, data), static)
        subscribe("/tf", TF, lambda data: follower.add("/tf", TF, data), QoSProfile(depth=100))
        if args.odometry:
            best = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
            subscribe(args.odometry, ODOMETRY, lambda data: follower.add(args.odometry, ODOMETRY, data), best)
        subscribe("/initialpose", POSE, follower.initial_pose, QoSProfile(depth=1))
        kind = offers[0].topic_type
        reliable = all(offer.qos_profile.reliability == ReliabilityPolicy.RELIABLE for offer in offers)
        reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        subscribe(args.topic, kind, lambda data: follower.add(args.topic, kind, data), QoSProfile(depth=5, reliability=reliability))
        say(f"reading {args.topic} ({kind}, {'reliable' if reliable else 'best effort'})")
        rclpy.spin(node)
    except (KeyboardInterrupt, rclpy.executors.ExternalShutdownException):
        pass
    except (presight.Error, presight.DeviceError, presight.SystemFault) as e:
        print(f"presight.ros: {e}", file=sys.stderr)
        return 1
    finally:
        if follower is not None:
            follower.end()
        rclpy.try_shutdown()
    return 0


def offered(node: Any, topic: str, say: Callable[[str], None]) -> list[Any]:
    """The publishers of the topic, once there are some. A type that is no scan raises Error."""
    import rclpy

    waits_from = time.monotonic()
    while not (offers := node.get_publishers_info_by_topic(topic)):
        rclpy.spin_once(node, timeout_sec=0.2)
        if time.monotonic() - waits_from > 5.0:
            known = sorted(name for name, kinds in node.get_topic_names_and_types() if {SCAN, CLOUD} & set(kinds))
            say(f"nobody publishes {topic} yet; scans and clouds are on: {', '.join(known) or 'no topic'}; waiting")
            waits_from = float("inf")
    if offers[0].topic_type not in (SCAN, CLOUD):
        raise presight.Error(f"{topic} is of type {offers[0].topic_type}; give --topic with a LaserScan or a PointCloud2")
    return list(offers)


if __name__ == "__main__":
    sys.exit(run())
