"""The thread of the node that follows the robot. It knows no rclpy."""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import presight

# Seconds from one list of findings to the next: they cost about as much as a few measurements, and grow slowly.
FINDINGS_EVERY = 5.0


def pose(text: str) -> list[float] | None:
    """The pose of a flag; None for `unknown`."""
    if text == "unknown":
        return None
    try:
        numbers = [float(number) for number in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (6, 7) or not np.isfinite(numbers).all():
        raise argparse.ArgumentTypeError(f"{text} is not a pose; give x,y,z,roll_deg,pitch_deg,yaw_deg")
    return numbers


class Follower:
    """Follows the robot in a thread: of the measurements that come while one is matched, the newest waits."""

    def __init__(self, args: argparse.Namespace, publish: Callable[[str, str, bool, bytes], None], say: Callable[[str], None]):
        self.args, self.publish, self.say = args, publish, say
        self.scene = presight.Scene.open(args.map)
        self.predictor = presight.Predictor(backend="cpu", threads=args.threads)
        self.sensor = presight.Sensor.load(args.sensor) if args.sensor else None
        self.learner = presight.Learner(self.scene, model_sigma=args.model_sigma or 0.0) if args.update else None
        if args.update:
            Path(args.update).mkdir(parents=True, exist_ok=True)
        self.messages = presight.Messages(args.frame, base=args.base, sensor=self.sensor, mount=args.mount)
        self.changed, self.ended, self.count, self.told = threading.Condition(), False, 0, time.monotonic()
        self.pose: Any = None
        self.said: set[str] = set()
        self.restart(args.init, args.init_sigma, args.init_sigma_deg)
        for message in self.messages.model(self.scene):
            publish(*message)
        self.thread = threading.Thread(target=self.work, daemon=True)
        self.thread.start()

    def restart(self, init: Any, sigma: float, sigma_deg: float) -> None:
        """Starts anew; the measurements so far are forgotten, the transforms of the robot are kept."""
        a = self.args
        localizer = presight.Localizer(
            self.scene,
            init=init,
            init_sigma=sigma,
            init_sigma_deg=sigma_deg,
            model_sigma=a.model_sigma,
            floor=a.floor,
            threads=a.threads,
        )
        with self.changed:
            self.localizer = localizer

    def warn_once(self, text: str) -> None:
        for word in ("mount", "base", "sensor"):
            text = text.replace(f"{word}=", f"--{word}")
        if text not in self.said:
            self.said.add(text)
            self.say(text)

    def add(self, topic: str, kind: str, data: bytes) -> None:
        """A message of a subscription."""
        try:
            self.messages.add(topic, kind, data)
        except presight.Error as e:
            if topic == self.args.topic and "is not after" in str(e):
                self.say(f"the clock has jumped back, so the localizer starts anew: {str(e).split(';')[0]}")
                self.restart(self.pose, self.args.init_sigma, self.args.init_sigma_deg)
            else:
                self.warn_once(f"{topic} is left out: {e}")
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
                self.match(localizer, frame)
            except (presight.Error, presight.DeviceError, presight.SystemFault) as e:
                self.warn_once(f"the measurement at {frame.time:.3f} s is left out: {e}")

    def match(self, localizer: presight.Localizer, frame: presight.Frame) -> None:
        step = localizer.step(frame)
        self.count += 1
        self.pose = step.pose if step.is_known else None
        for message in self.messages.answers(step, ahead=self.args.tolerance):
            self.publish(*message)
        for message in self.messages.comparison(self.predictor, self.scene, frame, step):
            self.publish(*message)
        if self.learner is not None:
            self.learner.observe(step, frame)
            if time.monotonic() - self.told > FINDINGS_EVERY:
                self.tell_findings()

    def tell_findings(self) -> None:
        assert self.learner is not None
        self.learner.write(self.args.update)
        for line in self.learner.findings():
            # The evidence behind the last bracket grows.
            self.warn_once(line.rpartition(" (")[0])
        for message in self.messages.findings(self.learner):
            self.publish(*message)
        self.told = time.monotonic()

    def end(self) -> None:
        with self.changed:
            self.ended = True
            self.changed.notify()
        self.thread.join()
        if self.learner is not None and self.count:
            self.learner.end_drive()
            self.tell_findings()
        self.say(f"{self.count} measurements were matched, {self.messages.left_out} left out because a newer one came")
        for line in self.localizer.warnings:
            self.say(line)
