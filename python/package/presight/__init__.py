"""What should this sensor see right now?

presight takes a polygonal 3D model of an environment, a sensor and a pose, and computes the images that the sensor should take there.

>>> import presight
>>> out = presight.predict(presight.Scene.example(), "realsense-d435", [0.3, 0.35, 1.65, 0, 12, 38])
>>> out.range.shape, out.range.dtype
((720, 1280), dtype('float32'))

Lengths are metres. Poses are world from sensor, x forward, y left, z up: (7,) x y z qx qy qz qw, (6,) x y z roll pitch yaw in degrees,
or (4, 4). Errors are `Error` (a ValueError), `DeviceError`, `SystemFault` and `DeadlineError` (RuntimeErrors), each of one line that
names the fault and a remedy; what is left out is a warning (`Notice`).
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from ._presight import (
    Chunks,
    DeadlineError,
    DeviceError,
    Error,
    Feature,
    Features,
    Frame,
    Layer,
    Learner,
    Localizer,
    Log,
    Messages,
    Notice,
    Prediction,
    Predictor,
    Scene,
    Sensor,
    Step,
    Store,
    SystemFault,
    Verdicts,
    __version__,
)

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

__all__ = [
    "Chunks",
    "DeadlineError",
    "DeviceError",
    "Error",
    "Feature",
    "Features",
    "Frame",
    "Layer",
    "Learner",
    "Localizer",
    "Log",
    "Messages",
    "Notice",
    "Prediction",
    "Predictor",
    "Scene",
    "Sensor",
    "Step",
    "Store",
    "SystemFault",
    "Verdicts",
    "__version__",
    "predict",
]


_kept: list[Predictor] = []


def _predictor() -> Predictor:
    if not _kept:
        _kept.append(Predictor())
    return _kept[0]


def predict(
    scene: Scene,
    sensor: Sensor | str | os.PathLike[str],
    pose: ArrayLike,
    outputs: Sequence[str] | str | None = None,
    layers: Iterable[Layer | str | os.PathLike[str]] | None = None,
    pose_cov: ArrayLike | None = None,
    confidence: float = 0.99,
    deadline_ms: float | None = None,
    pose_frame: str = "body",
    pose_of: str = "sensor",
    world_frame: str = "z-up",
    twist: ArrayLike | None = None,
    pose_end: ArrayLike | None = None,
    trajectory: ArrayLike | str | os.PathLike[str] | None = None,
    stamp: float | None = None,
) -> Prediction:
    """Predicts what a sensor should see at a pose, as `Predictor.predict`, on a predictor that the process keeps.

    >>> import presight
    >>> print(presight.predict(presight.Scene.example(), "laser-scanner", [1, 1.5, 0.5, 0, 0, 0]))  # doctest: +ELLIPSIS
    laser-scanner 361 x 1, 100.0 % of rays hit at ...
    """
    return _predictor().predict(
        scene,
        sensor,
        pose,
        outputs,
        layers,
        pose_cov,
        confidence,
        deadline_ms,
        pose_frame,
        pose_of,
        world_frame,
        twist,
        pose_end,
        trajectory,
        stamp,
    )
