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
_put: dict[tuple[str, str], Any] = {}


def _predictor(backend: str, threads: int) -> Predictor:
    """The worker's predictor with these options."""
    if (backend, threads) not in _predictors:
        _predictors[backend, threads] = Predictor(backend, threads)
    return _predictors[backend, threads]


def _scene(key: str, ref: Any) -> Scene:
    """The scene with this content, unpickled once for each worker."""
    import ray  # type: ignore[import-not-found, unused-ignore]

    if key not in _scenes:
        _scenes.clear()
        _scenes[key] = ray.get(ref)
    return _scenes[key]


def _reference(key: str, scene: Scene) -> Any:
    """The scene in Ray's store, where it is put once."""
    import ray

    session = ray.get_runtime_context().get_session_name()
    if (session, key) not in _put:
        _put.clear()
        _put[session, key] = ray.put(scene)
    return _put[session, key]


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
    frames = {"pose_frame": pose_frame, "pose_of": pose_of, "world_frame": world_frame}
    given = np.asarray(poses, dtype=np.float64)
    # Checks all arguments here: a shard would count its poses from 0.
    _predictor("cpu", 1).predict_chunks(scene, sensor, given, outputs, None, **frames)
    if shards is None:
        shards = int(4 * ray.cluster_resources().get("CPU", 1) / max(threads, 1))
    parts = np.array_split(given, max(1, min(shards, len(given))))
    starts = np.cumsum([0, *map(len, parts)])
    key = scene.content_hash()
    ref = _reference(key, scene)
    task = ray.remote(_shard).options(num_cpus=max(threads, 1), max_retries=max_retries)
    more = {"backend": backend, "threads": threads, **frames}
    # In a list, a reference goes to the task as it is, and the worker keeps the scene from shard to shard.
    pending = {task.remote(key, [ref], sensor, part, outputs, more): start for part, start in zip(parts, starts)}
    found: dict[str, NDArray[Any]] = {}
    try:
        while pending:
            (done,), _ = ray.wait(list(pending), num_returns=1)
            start = pending.pop(done)
            # Ray's arrays are read-only views of its store; the caller gets own ones.
            for name, part in ray.get(done).items():
                if name not in found:
                    found[name] = np.empty((len(given), *part.shape[1:]), part.dtype)
                found[name][start : start + len(part)] = part
    except RayTaskError as e:
        raise e.as_instanceof_cause() from None
    finally:
        for unfinished in pending:
            ray.cancel(unfinished)
    return found
