"""What the tests share: the room, predictors, the command, and the rule for skipping."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import presight

ROOT = Path(__file__).resolve().parents[2]
POSE = [1.0, 1.5, 0.5, 0.0, 0.0, 0.0]


def skip(reason):
    """Skips a test, or fails where nothing may be skipped (as the Rust tests do)."""
    if os.environ.get("CI") or os.environ.get("PRESIGHT_REQUIRE_DATA") == "1":
        pytest.fail(f"nothing may be skipped here: {reason}")
    if counted := os.environ.get("PRESIGHT_SKIPPED"):
        name = os.environ.get("PYTEST_CURRENT_TEST", "python").split(" ")[0]
        with open(counted, "a") as file:
            print(name, str(reason).splitlines()[0], sep="\t", file=file)
    pytest.skip(reason)


def data(name):
    """A file of the shared data."""
    path = Path(os.environ.get("PRESIGHT_DATA", ROOT.parent / "shared" / "data")) / name
    if not path.exists():
        skip(f"the shared data {path} is not there; set PRESIGHT_DATA")
    return path


def command(*arguments, **options):
    """Runs the command of the installed wheel."""
    return subprocess.run(
        [sys.executable, "-m", "presight", *map(str, arguments)], capture_output=True, text=True, timeout=120, **options
    )


def done(*arguments):
    """Runs a command that must succeed, and gives what it prints."""
    ran = command(*arguments)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout


def same(a, b):
    """True for arrays of the same dtype, shape and bits."""
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def one_line(raised, *words):
    """Checks that an error is one line with these words."""
    text = str(raised.value)
    assert text and "\n" not in text, text
    assert all(word in text for word in words), text


@pytest.fixture(scope="session", autouse=True)
def interruptible():
    """Shells ignore SIGINT for what they start in the background, and children inherit that."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def room():
    return presight.Scene.example()


@pytest.fixture(scope="session")
def room_file(tmp_path_factory):
    """The room as a file for the command: by way of a store, which keeps ids."""
    path = tmp_path_factory.mktemp("room") / "room.presight"
    presight.Store.create(path, presight.Scene.example()).close()
    return path


@pytest.fixture(scope="session")
def cpu():
    return presight.Predictor(backend="cpu", threads=2)


@pytest.fixture
def poses():
    """Twenty poses in the free middle of the room, with all their digits."""
    rng = np.random.default_rng(7)
    xyz = rng.uniform([0.8, 1.2, 0.4], [1.4, 1.8, 0.9], (20, 3))
    return np.hstack([xyz, rng.uniform(-5, 5, (20, 2)), rng.uniform(-180, 180, (20, 1))])
