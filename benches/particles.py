"""CPU time of a particle: `presight batch --likelihood` with 361 level beams by one or more programs, in turns.

    python3 benches/particles.py PRESIGHT [OTHER_PRESIGHT ..]

Poses lie within 0.3 m of a free place, at any heading. Of 12,400 and of 400 poses the least CPU time of three runs counts; their
difference is that of 12,000 poses on one thread, the CSV row of each included.
"""

import math
import os
import random
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

DATA = Path(os.environ.get("PRESIGHT_DATA", Path(__file__).resolve().parents[2] / "shared" / "data")) / "env"
PLACES = {"hospital": (0.738, -2.967, 1.2), "factory_hall": (1.814, -5.116, 1.2), "office_willowgarage": (20.0, 25.0, 0.6)}
COUNTS = (400, 12_400)


def cpu_s(command):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, capture_output=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def main():
    programs = sys.argv[1:] or sys.exit(__doc__)
    print("| scene | " + " | ".join(f"{program}, us a pose" for program in programs) + " | first over last |")
    print("|---" * (len(programs) + 2) + "|")
    for scene, (x, y, z) in PLACES.items():
        model = DATA / f"{scene}.glb"
        with tempfile.TemporaryDirectory() as folder:
            rng, folder = random.Random(3), Path(folder)
            for count in COUNTS:
                lines = []
                for i in range(count):
                    half = rng.uniform(-math.pi, math.pi)
                    at = (x + rng.uniform(-0.3, 0.3), y + rng.uniform(-0.3, 0.3), z)
                    lines.append(f"{i} {at[0]} {at[1]} {at[2]} 0 0 {math.sin(half)!r} {math.cos(half)!r}\n")
                (folder / f"{count}.tum").write_text("".join(lines))
            common = [str(model), "--sensor", "laser-scanner", "--backend", "cpu", "--threads", "1"]
            subprocess.run([programs[0], "predict", *common, "--pose", f"{x},{y},{z},0,0,0", "--out", folder / "scan.exr"], check=True)
            least = {}
            for run in range(3):
                for k, program in enumerate(programs):
                    for count in COUNTS:
                        poses, out = folder / f"{count}.tum", folder / f"{run}-{k}-{count}"
                        told = cpu_s([program, "batch", *common, "--poses", poses, "--likelihood", folder / "scan.exr", "--out", out])
                        least[k, count] = min(told, least.get((k, count), math.inf))
            us = [(least[k, COUNTS[1]] - least[k, COUNTS[0]]) * 1e6 / (COUNTS[1] - COUNTS[0]) for k in range(len(programs))]
            print(f"| {scene} | " + " | ".join(f"{t:.1f}" for t in us) + f" | {us[0] / us[-1]:.2f} |", flush=True)


if __name__ == "__main__":
    main()
