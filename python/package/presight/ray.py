"""Many poses on the machines of a Ray cluster: ``pip install presight[ray]``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ._presight import Predictor, Scene, Sensor

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["predict_many"]


_predictors: dict[tuple[str, int], Predictor] = {}
_scenes: dict[str, Scene] = {}


def _predictor(backend: str, threads: int) -> Predictor:
    """The worker's predictor with these options."""
    if (backend, threads) not in _predictors:
        _predictors[backend, threads] = Predictor(backend, threads)
    return _predictors[backend, threads]


def _scene(key: str, ref: Any) -> Scene:
    """The scene of a reference, unpickled once for each worker."""
    import ray  # type: ignore[import-not-found, unused-ignore]

    if key not in _scenes:
        _scenes.clear()
        _scenes[key] = ray.get(ref)
    return _scenes[key]


def _shard(
    key: str, held: list[Any], sensor: Sensor, poses: NDArray[np.float64], outputs: Sequence[str] | str, more: dict[str, Any]
) -> dict[str, NDArray[Any]]:
    options = dict(more)
    predictor = _predictor(options.pop("backend"), options.pop("threads"))
    return predictor.predict_many(_scene(key, held[0]), sensor, poses, outputs, **options)


def predict_many(
    scene: Scene,
    sensor: Sensor | str | os.PathLike[str],
    poses: ArrayLike,
    outputs: Sequence[str] | str = ("range",),
    *,
    shards: int | None = None,
    backend: str = "cpu",
    threads: int = 1,
    max_retries: int = 3,
    pose_frame: str = "body",
    pose_of: str = "sensor",
    world_frame: str = "z-up",
) -> dict[str, NDArray[Any]]:
    """As `Predictor.predict_many`, on the workers of the Ray cluster that this process is connected to (``ray.init``).

    The scene is put into Ray's store once. The poses are divided into `shards` (default: four for each CPU of the cluster), each a task
    on `threads` CPUs; a shard whose worker is lost is done again, at most `max_retries` times. The arrays have the bits of one machine.
    Raises what `Predictor.predict_many` raises.
    """
    import ray
    from ray.exceptions import RayTaskError  # type: ignore[import-not-found, unused-ignore]

    if not isinstance(sensor, Sensor):
        sensor = Sensor.load(sensor)
    given = np.asarray(poses, dtype=np.float64)
    if shards is None:
        shards = int(4 * ray.cluster_resources().get("CPU", 1) / max(threads, 1))
    parts = [part for part in np.array_split(given, max(1, min(shards, len(given)))) if len(part)] if given.ndim > 1 else [given]
    more = {
        "backend": backend,
        "threads": threads,
        "pose_frame": pose_frame,
        "pose_of": pose_of,
        "world_frame": world_frame,
    }
    ref = ray.put(scene)
    task = ray.remote(_shard).options(num_cpus=max(threads, 1), max_retries=max_retries)
    # In a list, a reference goes to the task as it is, and the worker keeps the scene from shard to shard.
    pending = [task.remote(ref.hex(), [ref], sensor, part, outputs, more) for part in parts]
    try:
        done: list[dict[str, NDArray[Any]]] = ray.get(pending)
    except RayTaskError as e:
        raise e.as_instanceof_cause() from None
    # Ray's arrays are read-only views of its store; these are the caller's own.
    return {name: np.concatenate([part[name] for part in done]) for name in done[0]}
