"""One wheel for all Pythons."""

import functools
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import POSE

import presight

ROOT = Path(__file__).resolve().parents[2]
WHEEL = os.environ.get("PRESIGHT_WHEEL")


@functools.cache
def others():
    """The oldest Python that the wheel is for and the newest one, where they are found."""
    found = {}
    for minor in range(10, 30):
        pyenv = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")).glob(f"versions/3.{minor}.*/bin/python3")
        for path in filter(None, [shutil.which(f"python3.{minor}"), *pyenv]):
            # pyenv has commands for versions that it does not use.
            if minor not in found and subprocess.run([path, "-c", ""], capture_output=True).returncode == 0:
                found[minor] = path
    return {minor: found[minor] for minor in {min(found, default=0), max(found, default=0)} & set(found)}


@pytest.mark.skipif(not WHEEL, reason="PRESIGHT_WHEEL names no wheel")
@pytest.mark.parametrize("which", ["oldest", "newest"])
def test_other_pythons_run_the_same_wheel(tmp_path, which, room, cpu):
    pythons = others()
    if not pythons:
        pytest.skip("there is no other Python")
    minor = min(pythons) if which == "oldest" else max(pythons)
    if minor == sys.version_info.minor:
        pytest.skip("it is the one that runs the tests")
    subprocess.run([pythons[minor], "-m", "venv", tmp_path / "env"], check=True)
    python = tmp_path / "env" / "bin" / "python"
    subprocess.run([python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", WHEEL], check=True)
    work = f"import presight, numpy as np; np.save('out.npy', presight.predict(presight.Scene.example(), 'vlp-16', {POSE}).range)"
    subprocess.run([python, "-W", "error", "-c", work], check=True, cwd=tmp_path)
    assert np.array_equal(np.load(tmp_path / "out.npy"), cpu.predict(room, "vlp-16", POSE).range)
    said = subprocess.run([tmp_path / "env" / "bin" / "presight", "--version"], capture_output=True, text=True, check=True)
    assert said.stdout == f"presight {presight.__version__}\n"


@pytest.mark.skipif(not (ROOT / "Cargo.toml").exists(), reason="outside of the repository")
def test_benches_name_their_files():
    """Cargo looks for the files of those that do not, and the source distribution has none."""
    text = (ROOT / "Cargo.toml").read_text()
    benches = text.split("[[bench]]")[1:]
    assert len(benches) > 10 and all("\npath = " in bench for bench in benches)
