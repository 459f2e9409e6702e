#!/usr/bin/env python3
"""Compares two builds of the command bit by bit: same_bits.py OLD NEW [SCENE..]

Each scene, each preset and lens of scenes/, five poses: EXR with all outputs, features as JSON with regions, and layers. Poses
are drawn by a fixed seed inside the scene's middle; one that stands in a wall is as good a comparison as any other.
The default scenes are those of this repository and, where it is there, the real models of ../shared/data. Exit 1 if any byte differs.
"""
import hashlib
import json
import random
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT.parent / "shared/data/env"
PRESETS = ["video-camera", "microwave-radar-scan", "microwave-radar-image", "laser-range-camera", "laser-scanner", "vlp-16",
           "os1-128", "realsense-d435"]
LENSES = [str(path) for path in sorted((ROOT / "scenes").glob("*.toml")) if "width" in path.read_text()]
CLASSES = ["video", "laser", "radar"]


def run(program, folder, arguments):
    """Runs the command; its status and the hashes of the files that it wrote."""
    done = subprocess.run([program, *arguments], cwd=folder, capture_output=True, text=True)
    files = {p.name: hashlib.blake2b(p.read_bytes()).hexdigest() for p in sorted(Path(folder).iterdir())}
    for path in Path(folder).iterdir():
        path.unlink()
    return done.returncode, files


def bounds(program, scene):
    said = subprocess.run([program, "inspect", scene, "--json"], capture_output=True, text=True)
    try:
        box = json.loads(said.stdout)["bounds"]
        return box["min"], box["max"]
    except (ValueError, KeyError, TypeError):
        return [-5, -5, 0], [5, 5, 3]


def main():
    old, new, *scenes = (str(Path(argument).resolve()) for argument in sys.argv[1:])
    if not scenes:
        scenes = [str(p) for p in sorted((ROOT / "scenes").iterdir()) if p.suffix in (".glb", ".rhai")]
        scenes += [str(p) for p in sorted(DATA.glob("*.glb"))]
    different = compared = 0
    with tempfile.TemporaryDirectory() as kept:
        # As the old command prints them: images name their sensor, and a preset may have learnt its noise since.
        for preset in PRESETS:
            text = subprocess.run([old, "sensors", preset], capture_output=True, text=True, check=True).stdout
            (Path(kept) / f"{preset}.toml").write_text(text)
        for scene in scenes:
            drawn = random.Random(1995)
            low, high = bounds(new, scene)
            layers = {}
            jobs = []
            for c in CLASSES:
                layers[c] = str(Path(kept) / f"{Path(scene).stem}.{c}.layer.json")
                jobs.append(["features", scene, "--class", c, "--out", "l.layer.json"])
                subprocess.run([new, "features", scene, "--class", c, "--out", layers[c]], capture_output=True)
            for sensor in [str(Path(kept) / f"{preset}.toml") for preset in PRESETS] + LENSES:
                for _ in range(5):
                    x, y = (drawn.uniform(0.7 * a + 0.3 * b, 0.3 * a + 0.7 * b) for a, b in zip(low[:2], high[:2]))
                    z = min(low[2] + drawn.uniform(0.3, 1.7), high[2])
                    pose = f"{x},{y},{z},{drawn.uniform(-5, 5)},{drawn.uniform(-10, 10)},{drawn.uniform(-180, 180)}"
                    name = Path(sensor).name
                    c = "radar" if "radar" in name else "laser" if name[:5] in ("laser", "vlp-1", "os1-1") else "video"
                    outputs = "range,polygon_id,object_id,cos_incidence,echo,normal,feature_id"
                    jobs.append(["predict", scene, "--sensor", sensor, f"--pose={pose}", "--backend", "cpu", "--layer",
                                 layers[c], "--outputs", outputs, "--out", "i.exr", "--features", "f.json",
                                 "--pose-cov", "0.02,0.02,0.01,0.2,0.2,0.5"])
            for job in jobs:
                with tempfile.TemporaryDirectory() as folder:
                    a, b = run(old, folder, job), run(new, folder, job)
                compared += len(a[1])
                if a != b:
                    different += 1
                    print("differs:", " ".join(job), a[0], b[0], [n for n in {*a[1], *b[1]} if a[1].get(n) != b[1].get(n)])
            print(f"{scene}: {len(jobs)} runs", flush=True)
    print(f"{compared} files compared, {different} runs differ")
    sys.exit(different > 0 or compared == 0)


main()
