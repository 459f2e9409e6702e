"""What the docs say runs: the guide, the readmes, the docstrings, the types."""

import doctest
import inspect
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT, data, skip

import presight


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page, re.S)


def run(page, folder):
    """Runs the blocks of a page in order, all of Python in one namespace. Gives the first failure, or None."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    environment = {**os.environ, "PATH": path}
    for block in blocks(page, "sh"):
        ran = subprocess.run(["bash", "-ec", block], cwd=folder, env=environment, capture_output=True, text=True)
        if ran.returncode:
            return ran.stderr
    ran = subprocess.run([sys.executable, "-c", "\n".join(blocks(page, "python"))], cwd=folder, env=environment,
                         capture_output=True, text=True)
    return ran.stderr if ran.returncode else None


@pytest.mark.skipif(not (ROOT / "docs").exists(), reason="outside of the repository")
def test_the_guide_runs(tmp_path):
    for name in ("malaga_corridor_map.glb", "malaga_corridor_run_scans.json"):
        (tmp_path / name).symlink_to(data(f"lidar2d/{name}"))
    page = (ROOT / "docs" / "python.md").read_text()
    assert len(blocks(page, "python")) == 4 and len(blocks(page, "sh")) == 1
    assert len(page.splitlines()) <= 90
    assert run(page, tmp_path) is None
    # A planted fault: a scanner that is turned does not find its way.
    turned = page.replace('pose_of="robot")', 'pose_of="robot", pose_frame="body") if 0 else np.zeros(1000)')
    assert turned != page and "AssertionError" in run(turned, tmp_path)


@pytest.mark.skipif(not (ROOT / "docs").exists(), reason="outside of the repository")
def test_the_notebook_is_the_guide(tmp_path):
    examples, page = ROOT / "python" / "examples", (ROOT / "docs" / "python.md").read_text()
    subprocess.run([sys.executable, examples / "make_tour.py", ROOT / "docs" / "python.md", tmp_path / "tour.ipynb"], check=True)
    remedy = "run python python/examples/make_tour.py docs/python.md python/examples/tour.ipynb"
    assert (tmp_path / "tour.ipynb").read_text() == (examples / "tour.ipynb").read_text(), remedy
    cells = json.loads((tmp_path / "tour.ipynb").read_text())["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    # The cells are the blocks, which `test_the_guide_runs` runs, and one ends with the picture.
    assert [cell.removesuffix("\nout") for cell in code if cell[0] != "!"] == [block.strip("\n") for block in blocks(page, "python")]
    assert sum(cell.endswith("\nout") for cell in code) == 1
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", "".join(line for cell in cells for line in cell["source"])):
        assert (examples / picture).exists(), picture


@pytest.mark.skipif(not (ROOT / "docs").exists(), reason="outside of the repository")
def test_the_readmes_run(tmp_path):
    section = (ROOT / "README.md").read_text().split("## In Python")[1].split("\n## ")[0]
    assert 3 <= len(blocks(section, "python")[0].splitlines()) <= 10
    assert run(section.replace("```sh", "```text"), tmp_path) is None
    assert run((ROOT / "python" / "README.md").read_text(), tmp_path) is None


def test_each_public_name_has_a_docstring_and_examples_run():
    missing, ran = [], 0
    finder, runner = doctest.DocTestFinder(exclude_empty=True), doctest.DocTestRunner()
    for name in presight.__all__:
        thing = getattr(presight, name)
        if name.startswith("__"):
            continue
        missing += [name] if not (thing.__doc__ or "").strip() else []
        scope = {}
        tests = []
        if inspect.isclass(thing):
            for member, value in sorted(vars(thing).items(), key=lambda item: item[0]):
                if not member.startswith("_") and member != "names" and not (getattr(value, "__doc__", "") or "").strip():
                    missing.append(f"{name}.{member}")
            own = [test for test in finder.find(thing, name) if test.name == name]
            tests = own + [test for test in finder.find(thing, name) if test.name != name]
            # pyo3's methods are no Python functions: doctest passes over some.
            known = {test.name for test in tests}
            parser = doctest.DocTestParser()
            for member, value in vars(thing).items():
                text = getattr(value, "__doc__", None) or getattr(getattr(value, "__func__", None), "__doc__", None)
                if text and ">>>" in text and f"{name}.{member}" not in known:
                    tests.append(parser.get_doctest(text, {}, f"{name}.{member}", None, 0))
        else:
            tests = finder.find(thing, name)
        order = ["Predictor.predict", "Predictor.predict_many", "Predictor.predict_chunks", "Predictor.likelihood"]
        tests.sort(key=lambda test: (test.name != name, order.index(test.name) if test.name in order else 9))
        scope["presight"] = presight
        for test in tests:
            if test.examples:
                test.globs = scope
                runner.run(test, clear_globs=False)
                ran += len(test.examples)
    assert not missing, missing
    assert runner.summarize(verbose=False).failed == 0 and ran > 30, ran


def test_types(tmp_path):
    try:
        import mypy  # noqa: F401
    except ImportError:
        skip("mypy is not installed")
    ran = subprocess.run([sys.executable, "-m", "mypy.stubtest", "presight"], capture_output=True, text=True, cwd=tmp_path)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    examples = "\n".join(blocks((ROOT / "docs" / "python.md").read_text(), "python")) if (ROOT / "docs").exists() else "import presight\n"
    examples = examples.replace("def planar(pose):", "def planar(pose: Any) -> Any:").replace(
        "def as_poses(particles):", "def as_poses(particles: Any) -> Any:")
    (tmp_path / "examples.py").write_text("from typing import Any\n" + examples.replace("rng, errors = np.random.default_rng(1), []", "rng = np.random.default_rng(1)\nerrors: list[Any] = []"))
    ran = subprocess.run([sys.executable, "-m", "mypy", "--strict", "examples.py"], capture_output=True, text=True, cwd=tmp_path)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    # A planted fault is found.
    (tmp_path / "wrong.py").write_text("import presight\npresight.Scene.example().objects.shape\n")
    assert subprocess.run([sys.executable, "-m", "mypy", "--strict", "wrong.py"], capture_output=True, cwd=tmp_path).returncode == 1
