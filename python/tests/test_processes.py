"""Pools by fork, spawn and forkserver after a prediction in the parent: none waits, all have the same bits."""

import multiprocessing
import os

import numpy as np
import pytest
from conftest import POSE, same

import presight

SHARED = {}


def predicted(i):
    """In a child: with the parent's predictor and scene where it was forked, and with its own."""
    predictor = SHARED.get("predictor") or presight.Predictor("cpu", 2)
    scene = SHARED.get("scene") or presight.Scene.example()
    pose = [POSE[0] + 0.01 * i, *POSE[1:]]
    first = predictor.predict(scene, "vlp-16", pose).range
    again = presight.Predictor("cpu").predict(presight.Scene.example(), "vlp-16", pose).range
    assert same(first, again)
    assert same(predictor.predict_many(scene, "vlp-16", [pose])["range"][0], first)
    return first


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver"])
def test_pools(method):
    SHARED["predictor"], SHARED["scene"] = presight.Predictor("cpu", 2), presight.Scene.example()
    right = [predicted(i) for i in range(4)]
    with multiprocessing.get_context(method).Pool(2) as pool:
        found = pool.map_async(predicted, range(4)).get(timeout=30)
    SHARED.clear()
    assert all(same(a, b) for a, b in zip(right, found, strict=True))


def passed(arguments):
    scene, sensor, predictor, pose = arguments
    return predictor.predict(scene, sensor, pose).range


@pytest.mark.parametrize("method", ["spawn", "forkserver"])
def test_scenes_sensors_and_predictors_are_passed_on(method):
    predictor, scene, sensor = presight.Predictor("cpu", 1), presight.Scene.example(), presight.Sensor.load("laser-scanner")
    with multiprocessing.get_context(method).Pool(1) as pool:
        found = pool.map_async(passed, [(scene, sensor, predictor, POSE)]).get(timeout=30)
    assert same(found[0], predictor.predict(scene, sensor, POSE).range)


def in_child(work):
    """Runs work in a forked child, and gives what it returns as text."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            text = str(work())
        except BaseException as e:
            text = f"{type(e).__name__}: {e}"
        os.write(write, text.encode())
        os._exit(0)
    os.close(write)
    import select

    assert select.select([read], [], [], 30)[0], "the child waits for ever"
    text = os.read(read, 4096).decode()
    os.waitpid(child, 0)
    return text


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_gpu_of_the_parent_is_a_device_error_in_the_child():
    try:
        gpu = presight.Predictor("gpu")
    except presight.DeviceError:
        pytest.skip("there is no adapter")
    room = presight.Scene.example()
    assert np.isfinite(gpu.predict(room, "laser-scanner", POSE).range).all()
    said = in_child(lambda: gpu.predict(room, "laser-scanner", POSE))
    assert said.startswith("DeviceError") and "spawn" in said, said
    assert in_child(lambda: presight.Predictor("auto").engine) == "cpu"
    assert np.isfinite(gpu.predict(room, "laser-scanner", POSE).range).all()


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_what_cannot_be_shared_says_so(tmp_path):
    room = presight.Scene.example()
    scanner = presight.Sensor.load("laser-scanner").replace(range_sigma=0.01)
    frame = presight.Frame(scanner, 0.0, presight.predict(room, scanner, POSE).range)
    localizer = presight.Localizer(room, init=POSE)
    localizer.step(frame)
    assert in_child(lambda: localizer.step(frame)).startswith("Error: a localizer")
    with presight.Store.create(tmp_path / "s.presight", room) as store:
        assert in_child(lambda: store.changes).startswith("Error: the store")
        assert store.changes == 0
