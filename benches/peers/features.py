"""Features with their regions of interest beside Embree's trace of the same image; one Markdown table on stdout.

Embree traces before and after presight's turn at the same poses; both on all threads. PRESIGHT_FEATURES is the program
that `cargo bench --bench features --no-run` builds.
"""

import json
import os
import statistics
import subprocess

from embree import Embree
from peers import POSES_FILE, scene_file
from scene import triangles
from sensors import SENSORS

SENSOR = "video-camera"
REPEAT = 15


def main():
    poses = json.loads(POSES_FILE.read_text())["scenes"]
    print("| scene, pose | segments (seen) | samples | Embree, ms | CPU engine, ms | of Embree's | GPU engine, ms | of Embree's |")
    print("|---|---|---|---|---|---|---|---|")
    for scene in ("hospital", "factory_hall"):
        embree = Embree(triangles(scene_file(scene)), os.cpu_count())

        def trace(embree=embree, scene=scene):
            rays = [embree.rays(SENSORS[SENSOR]()[0], pose) for pose in poses[scene][:3]]
            return [embree.time_ms(r, REPEAT) for r in rays]

        before = trace()
        command = [os.environ["PRESIGHT_FEATURES"], "--bench", scene, SENSOR, "--no-rays"]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        after = trace()
        for line in said.splitlines()[2:]:
            case, seen, samples, *figures = (cell.strip() for cell in line.strip("|").split("|"))
            index = int(case.split(",")[0].split()[1])
            embree_ms = statistics.median(before[index] + after[index])
            cpu, gpu = float(figures[4]), float(figures[5])
            row = [case, seen, samples, f"{embree_ms:.1f}", f"{cpu:.1f}", f"{cpu / embree_ms:.2f} x", f"{gpu:.1f}"]
            print("|", " | ".join([*row, f"{gpu / embree_ms:.2f} x"]), "|")


if __name__ == "__main__":
    main()
