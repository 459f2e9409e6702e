"""Drives a node in a process with rclpy: node_driver.py SCENARIO MESSAGES RESULT -- arguments of the node.

MESSAGES is a pickle of [(topic, type, stamp_ns, bytes)] in the order of a recording, RESULT one of what the node said and published.
Everything is on this machine alone, by the environment that the caller sets.
"""

import pickle
import signal
import subprocess
import sys
import time
from importlib import import_module

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message, serialize_message

POSE = "geometry_msgs/msg/PoseWithCovarianceStamped"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
CLOUD, MARKERS = "sensor_msgs/msg/PointCloud2", "visualization_msgs/msg/MarkerArray"
PATIENCE = 60.0


def type_of(name):
    package, _, message = name.split("/")
    return getattr(import_module(f"{package}.msg"), message)


class Driver:
    def __init__(self, messages, arguments):
        rclpy.init()
        self.node = rclpy.create_node("driver")
        self.messages, self.arguments = messages, arguments
        self.publishers, self.received, self.process = {}, {}, None
        self.log = open(f"{sys.argv[3]}.log", "w+")

    def advertise(self, topic, kind, reliable=True):
        reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        self.publishers[topic] = self.node.create_publisher(type_of(kind), topic, QoSProfile(depth=50, reliability=reliability))

    def listen(self, topic, kind, latched=False):
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        taken = self.received.setdefault(topic, [])
        qos = QoSProfile(depth=50, durability=durability)
        self.node.create_subscription(type_of(kind), topic, lambda data: taken.append((time.time(), bytes(data))), qos, raw=True)

    def start(self):
        command = [sys.executable, "-m", "presight.ros", *self.arguments]
        self.process = subprocess.Popen(command, stdout=self.log, stderr=subprocess.STDOUT)

    def spin(self, done, patience=PATIENCE):
        """Spins until `done`; False if it takes too long or the node ends."""
        end = time.monotonic() + patience
        while not done():
            if time.monotonic() > end or self.process.poll() is not None:
                return False
            rclpy.spin_once(self.node, timeout_sec=0.05)
        return True

    def said(self):
        with open(self.log.name) as log:
            return log.read()

    def stamps(self):
        found = [deserialize_message(data, type_of(DIAGNOSTICS)).header.stamp for _, data in self.received["/diagnostics"]]
        return [stamp.sec * 10**9 + stamp.nanosec for stamp in found]

    def drive(self, messages, scan, in_step):
        """Publishes messages; in step, each scan is answered before the next. Its odometry may come behind it."""
        asked = None
        for topic, _, stamp, data in messages:
            if topic not in self.publishers:
                continue
            if topic == scan and in_step:
                self.answered(asked)
                asked = stamp
            self.publishers[topic].publish(data)
        self.answered(asked)

    def answered(self, stamp):
        assert stamp is None or self.spin(lambda: stamp in self.stamps()), f"no answer to {stamp}: {self.said()}"

    def end(self, number=signal.SIGINT):
        self.process.send_signal(number)
        try:
            return self.process.wait(30)
        except subprocess.TimeoutExpired:
            self.process.kill()
            return "it does not end"


def follow(driver, result):
    """In step, then anew from a pose, then all at once, then with a clock that jumps back."""
    [scan_type] = {kind for topic, kind, *_ in driver.messages if topic == "/scan"}
    driver.advertise("/scan", scan_type)
    driver.advertise("/odom", "nav_msgs/msg/Odometry")
    driver.advertise("/initialpose", POSE)
    for topic, kind in [("/presight/pose", POSE), ("/diagnostics", DIAGNOSTICS), ("/presight/verdict", CLOUD)]:
        driver.listen(topic, kind)
    driver.listen("/presight/predicted", scan_type)
    driver.start()
    ready = [*driver.publishers]
    assert driver.spin(lambda: all(driver.node.count_subscribers(topic) for topic in ready)), driver.said()
    assert driver.spin(lambda: all(driver.node.count_publishers(topic) for topic in driver.received)), driver.said()
    driver.spin(lambda: False, 1.0)  # for the matching of both ends
    scans = [k for k, (topic, *_) in enumerate(driver.messages) if topic == "/scan"]
    anew, burst = scans[-8], scans[-4]
    driver.drive(driver.messages[:anew], "/scan", True)

    pose = deserialize_message(driver.received["/presight/pose"][-1][1], type_of(POSE))
    pose.header.frame_id = "odom"
    driver.publishers["/initialpose"].publish(serialize_message(pose))
    assert driver.spin(lambda: "not in \"map\"" in driver.said()), driver.said()
    pose.header.frame_id = "map"
    pose.pose.covariance[0], pose.pose.covariance[7], pose.pose.covariance[35] = 0.25, 0.25, 0.068
    driver.publishers["/initialpose"].publish(serialize_message(pose))
    assert driver.spin(lambda: "started anew" in driver.said()), driver.said()
    driver.drive(driver.messages[anew:burst], "/scan", True)

    before = len(driver.received["/diagnostics"])
    driver.drive(driver.messages[burst:], "/scan", False)
    last = driver.messages[scans[-1]][2]
    assert driver.spin(lambda: last in driver.stamps()), driver.said()
    result["answers_to_burst"] = len(driver.received["/diagnostics"]) - before
    result["poses"] = [data for _, data in driver.received["/presight/pose"]]
    result["stamps"] = driver.stamps()

    # The first message behind the jump is left out, the next begins anew.
    first, second = driver.messages[scans[0]], driver.messages[scans[1]]
    driver.publishers["/scan"].publish(first[3])
    assert driver.spin(lambda: "has jumped back" in driver.said()), driver.said()
    driver.drive(driver.messages[scans[0] + 1 : scans[2]], "/scan", False)
    count = len(driver.received["/diagnostics"])
    assert driver.spin(lambda: len(driver.received["/diagnostics"]) > count), driver.said()
    assert driver.stamps()[-1] == second[2]

    # Latched: it comes to those who subscribe now.
    driver.listen("/presight/model", MARKERS, latched=True)
    assert driver.spin(lambda: driver.received["/presight/model"]), driver.said()
    model = deserialize_message(driver.received["/presight/model"][0][1], type_of(MARKERS))
    result["triangles"] = sum(len(marker.points) for marker in model.markers) // 3
    cloud = deserialize_message(driver.received["/presight/verdict"][-1][1], type_of(CLOUD))
    result["verdict_fields"] = [field.name for field in cloud.fields]
    result["predicted"] = len(driver.received["/presight/predicted"])


def best_effort(driver, result):
    """A publisher of sensor data."""
    [scan_type] = {kind for topic, kind, *_ in driver.messages if topic == "/scan"}
    driver.advertise("/scan", scan_type, reliable=False)
    driver.listen("/diagnostics", DIAGNOSTICS)
    driver.start()
    assert driver.spin(lambda: driver.node.count_subscribers("/scan")), driver.said()
    driver.spin(lambda: False, 1.0)
    [first, *_] = [message for message in driver.messages if message[0] == "/scan"]
    driver.drive([first], "/scan", True)
    result["stamps"] = driver.stamps()


def nobody(driver, result):
    """Another topic is published, the one that is wanted is not."""
    driver.advertise("/front/scan", "sensor_msgs/msg/LaserScan")
    driver.start()
    assert driver.spin(lambda: "nobody publishes" in driver.said(), 30.0), driver.said()


def wrong_type(driver, result):
    """The topic is of a type that is no measurement."""
    driver.advertise("/scan", "std_msgs/msg/String")
    driver.start()
    driver.spin(lambda: False, 30.0)


SCENARIOS = {"follow": follow, "best_effort": best_effort, "nobody": nobody, "wrong_type": wrong_type}


def main():
    scenario, messages, path = sys.argv[1:4]
    with open(messages, "rb") as file:
        driver = Driver(pickle.load(file), sys.argv[5:])
    result = {}
    try:
        SCENARIOS[scenario](driver, result)
    finally:
        ended = driver.process.poll()
        result["status"] = driver.end() if ended is None else ended
        result["said"] = driver.said()
        print(result["said"])
    with open(path, "wb") as file:
        pickle.dump(result, file)


main()
