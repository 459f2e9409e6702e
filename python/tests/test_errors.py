"""Bad input: typed errors of one line, never a panic or a hang."""

import pickle

import numpy as np
import pytest
from conftest import POSE, one_line

import presight

NAN = float("nan")


@pytest.mark.parametrize(("pose", "words"), [
    ([1, 2, 3], ["(3,)", "(7,)"]),
    (np.zeros((2, 6)), ["(2, 6)"]),
    ([0, 0, 0, 0, 0, 0, 0], ["length"]),
    ([NAN, 0, 0, 0, 0, 0], ["finite"]),
    ([0, 0, 0, 0, 0, 0, NAN], []),
    ([1e300, 0, 0, 0, 0, 0], ["far"]),
    (["a"] * 6, ["dtype"]),
    (np.zeros(6, "c16"), ["complex"]),
    (None, ["dtype"]),
    (np.diag([1, 1, -1, 1.0]), ["rigid"]),
    (np.diag([2, 2, 2, 1.0]), ["rigid"]),
    (np.ones((4, 4)), ["rigid"]),
    ([[1], [1, 2]], ["pose"]),
])
def test_poses(room, cpu, pose, words):
    with pytest.raises(presight.Error) as raised:
        cpu.predict(room, "laser-scanner", pose)
    one_line(raised, "pose", *words)
    assert raised.value.kind == "usage"


def test_batches(room, cpu):
    for poses, word in [(np.zeros((0, 6)), "no pose"), (POSE, "(6,)"), (np.zeros((3, 5)), "(3, 5)"),
                        ([POSE, [NAN] * 6], "pose 1")]:
        with pytest.raises(presight.Error) as raised:
            cpu.predict_many(room, "laser-scanner", poses)
        one_line(raised, word)
        with pytest.raises(presight.Error):
            cpu.predict_chunks(room, "laser-scanner", poses)
    with pytest.raises(presight.Error, match="size"):
        cpu.predict_chunks(room, "laser-scanner", [POSE], size=0)
    with pytest.raises(presight.Error, match="feature_id"):
        cpu.predict_many(room, "laser-scanner", [POSE], outputs=("feature_id",))


def test_outputs_layers_and_options(room, cpu, tmp_path):
    predict = lambda **more: cpu.predict(room, "laser-scanner", POSE, **more)
    for more, words in [
        ({"outputs": ("rnge",)}, ["rnge", "choose from"]),
        ({"outputs": ()}, ["none"]),
        ({"outputs": 5}, ["outputs"]),
        ({"outputs": ("depth_z",)}, ["depth_z"]),
        ({"outputs": ("feature_id",)}, ["layers="]),
        ({"layers": []}, ["layers="]),
        ({"layers": [tmp_path / "no.json"]}, ["no.json"]),
        ({"layers": [7]}, ["layers"]),
        ({"pose_cov": [1] * 6}, ["layers="]),
        ({"deadline_ms": 0}, ["deadline_ms"]),
        ({"deadline_ms": NAN}, ["deadline_ms"]),
        ({"pose_frame": "sideways"}, ["pose_frame"]),
        ({"pose_of": "cat"}, ["pose_of"]),
        ({"world_frame": "y-up"}, ["world_frame"]),
        ({"pose_of": "robot", "pose_frame": "optical"}, ["pose_frame"]),
    ]:
        with pytest.raises(presight.Error) as raised:
            predict(**more)
        one_line(raised, *words)
    with pytest.raises(presight.Error, match="backend"):
        presight.Predictor("cuda")
    with pytest.raises(presight.Error, match="too many"):
        presight.Predictor("cpu", 100_000)
    with pytest.raises((TypeError, OverflowError)):
        presight.Predictor("cpu", -1)
    with pytest.raises(TypeError):
        cpu.predict("room", "laser-scanner", POSE)


CORNERS = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]


@pytest.mark.parametrize(("mesh", "words"), [
    ((CORNERS, [[0, 1, 3]]), ["vertex 3", "there are 3"]),
    ((CORNERS, [[0, 1, -1]]), ["negative"]),
    ((CORNERS, [[0, 1, 0.5]]), ["whole"]),
    ((CORNERS, np.zeros((0, 3), int)), ["no triangle"]),
    ((CORNERS, [[0, 1, 1]]), ["no triangle"]),
    ((CORNERS, [[0, 1]]), ["(1, 2)"]),
    (([[0, 0], [1, 1]], [[0, 1, 1]]), ["(2, 2)"]),
    (([[NAN, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]]), ["not a finite position"]),
    ((CORNERS, [["a", "b", "c"]]), ["dtype"]),
    (5, ["pair"]),
])
def test_meshes(mesh, words):
    with pytest.raises(presight.Error) as raised:
        presight.Scene.from_meshes({"m": mesh})
    one_line(raised, 'mesh "m"', *words)
    with pytest.raises(presight.Error):
        presight.Scene.example().insert("m", mesh)


def test_scenes(room):
    for call in (lambda: presight.Scene.from_meshes({"m": (CORNERS, [[0, 1, 2]])}, poses={"n": POSE}),
                 lambda: presight.Scene.from_meshes({"m": (CORNERS, [[0, 1, 2]])}, poses={"m": [0]}),
                 lambda: presight.Scene.from_meshes({"": (CORNERS, [[0, 1, 2]])}),
                 lambda: room.move("nobody", POSE), lambda: room.delete("nobody"), lambda: room.pose("nobody"),
                 lambda: room.insert("room/building/floor", (CORNERS, [[0, 1, 2]]))):
        with pytest.raises(presight.Error) as raised:
            call()
        one_line(raised)
    with pytest.warns(presight.Notice, match="1 triangles"):
        presight.Scene.from_meshes({"m": (CORNERS, [[0, 1, 2], [0, 1, 1]])})


def test_sensors():
    k = [500, 500, 320, 240]
    for call, word in [
        (lambda: presight.Sensor.load("vlp-17"), "vlp-16"),
        (lambda: presight.Sensor.camera([[1, 2, 3], [4, 5, 6], [7, 8, 9]], (4, 3)), "K"),
        (lambda: presight.Sensor.camera(k, (0, 3)), "0 x 3"),
        (lambda: presight.Sensor.camera(k, (4, 3), D=[1, 2, 3]), "D"),
        (lambda: presight.Sensor.camera(k, (4, 3), D=[0, 0, 0, 0], model="magic"), "magic"),
        (lambda: presight.Sensor.camera(k, (4, 3), range_mix=3), "range_max"),
        (lambda: presight.Sensor.camera(k, (4, 3), range_max="far"), "range_max"),
        (lambda: presight.Sensor.camera(k, (4, 3), range_max=-1), "range limits"),
        (lambda: presight.Sensor.scanner([]), "azimuth_deg"),
        (lambda: presight.Sensor.scanner([0, 5, 3]), "order"),
        (lambda: presight.Sensor.scanner([0, 1], [NAN]), "elevation"),
        (lambda: presight.Sensor.from_rays(np.zeros((0, 3))), "no ray"),
        (lambda: presight.Sensor.from_rays(np.full((2, 3), NAN)), "no ray"),
        (lambda: presight.Sensor.from_rays([[0, 0, 0]]), "direction 0"),
        (lambda: presight.Sensor.from_rays([1, 0, 0]), "(n, 3)"),
        (lambda: presight.Sensor.from_rays([[1, 0, 0]], origins=[[0, 0, 3]]), "metres"),
        (lambda: presight.Sensor.from_rays([[1, 0, 0]], origins=[0, 0, 1]), "as directions"),
        (lambda: presight.Sensor.from_rays([[1, 0, 0]], times=[0, 1]), "one for each ray"),
        (lambda: presight.Sensor.load("vlp-16-real", destagger=True), "no stagger"),
        (lambda: presight.Sensor.parse("kind = 7"), ""),
    ]:
        with pytest.raises(presight.Error) as raised:
            call()
        one_line(raised, word)


def test_measurements(room, cpu, tmp_path):
    for call in (lambda: presight.Frame("laser-scanner", 0.0, np.zeros(360)), lambda: presight.Frame("laser-scanner", NAN, np.ones(361)),
                 lambda: presight.Frame("laser-scanner", 0.0, np.ones(361), intensities=np.full(361, 2.0)),
                 lambda: presight.Frame("laser-scanner", 0.0, np.ones(361), times=np.arange(361) * 1e6),
                 lambda: presight.Frame("laser-scanner", 0.0, np.ones(361), times=np.zeros(360)),
                 lambda: presight.Frame("laser-scanner", 0.0, np.ones(361), twist=[1, 0, 0]),
                 lambda: presight.Frame("laser-scanner", 0.0, np.ones(361), twist=[NAN, 0, 0, 0, 0, 0]),
                 lambda: presight.Log.open(tmp_path), lambda: presight.Log.open(tmp_path / "no.json"),
                 lambda: cpu.likelihood(room, "laser-scanner", np.ones(360), [POSE]),
                 lambda: cpu.likelihood(room, "laser-scanner", np.full(361, NAN), [POSE]),
                 lambda: cpu.likelihood(room, "laser-scanner", np.ones(361), [POSE], headings=0),
                 lambda: cpu.likelihood(room, "laser-scanner", np.ones(361), [POSE], cell=(-1, 0)),
                 lambda: cpu.likelihood(room, "laser-scanner", np.ones(361), [POSE], headings=8, pose_of="robot"),
                 lambda: presight.Localizer(room, init=[1, 2]), lambda: presight.Localizer(room, init=POSE, init_sigma=0),
                 lambda: presight.Localizer(room, floor=NAN)):
        with pytest.raises(presight.Error) as raised:
            call()
        one_line(raised)


def test_a_deadline_that_nothing_meets(room, cpu):
    try:
        out = cpu.predict(room, "realsense-d435", POSE, deadline_ms=1e-3)
    except presight.DeadlineError as e:
        assert e.kind == "deadline" and "\n" not in str(e)
    else:
        assert out.given_up and out.not_predicted().any()


def test_errors_pickle(room, cpu):
    with pytest.raises(presight.Error) as raised:
        cpu.predict(room, "laser-scanner", [1])
    again = pickle.loads(pickle.dumps(raised.value))
    assert type(again) is presight.Error and str(again) == str(raised.value) and again.remedy == raised.value.remedy
    assert issubclass(presight.Error, ValueError) and issubclass(presight.DeviceError, RuntimeError)
    assert issubclass(presight.SystemFault, RuntimeError) and issubclass(presight.DeadlineError, RuntimeError)
