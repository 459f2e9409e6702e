"""The command that the wheel brings."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from conftest import command, done

import presight


def test_the_command_runs_in_every_way_that_it_can_be_called():
    script = shutil.which("presight", path=str(Path(sys.executable).parent))
    assert script, "pip installs the console script"
    version = subprocess.run([script, "--version"], capture_output=True, text=True, check=True).stdout
    assert version == done("--version") == f"presight {presight.__version__}\n"
    assert "CPU engine" in done("doctor")
    assert "vlp-16" in done("sensors")


def test_opening_a_driver_prints_nothing_and_leaves_the_environment():
    work = "import os, presight; presight.Predictor('auto'); assert 'XDG_RUNTIME_DIR' not in os.environ"
    bare = {name: value for name, value in os.environ.items() if name != "XDG_RUNTIME_DIR"}
    ran = subprocess.run([sys.executable, "-c", work], capture_output=True, text=True, env=bare)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", "")


def test_arguments_and_statuses_are_those_of_the_command(tmp_path, room_file):
    ran = command("predict", room_file, "--sensor", "vlp-17", "--pose", "1,1.5,0.5,0,0,0")
    assert ran.returncode == 2 and ran.stderr.startswith('error: "vlp-17" is neither') and ran.stderr.count("\n") == 1
    ran = command("predict", "--nonsense")
    assert ran.returncode == 2 and ran.stderr.endswith("see presight predict --help\n")
    assert command("predict", tmp_path / "no.glb", "--sensor", "vlp-16", "--pose", "0,0,0,0,0,0").returncode == 1
    assert command("predict", room_file, "--sensor", "vlp-16", "--pose", "0,0,0,0,0,0", "--backend", "cpu").returncode == 0


def test_scripts_and_stores_are_in_it(tmp_path):
    (tmp_path / "box.rhai").write_text('place(cuboid(1, 1, 1), "box");\n')
    ran = command("inspect", tmp_path / "box.rhai")
    assert "built without" not in ran.stderr
    out = json.loads(done("predict", make_store(tmp_path), "--sensor", "vlp-16", "--pose", "1,1.5,0.5,0,0,0", "--json"))
    assert out["columns"] == 1800


def make_store(folder):
    path = folder / "room.presight"
    presight.Store.create(path, presight.Scene.example()).close()
    return path


def test_sigint_ends_a_command(tmp_path):
    import signal
    import time

    started = subprocess.Popen(
        [sys.executable, "-m", "presight", "report", make_store(tmp_path), "--out", tmp_path / "page"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    time.sleep(1.5)
    if started.poll() is None:
        started.send_signal(signal.SIGINT)
    assert started.wait(10) in (-signal.SIGINT, 0, 2), started.stderr.read()
