"""CPU time of Embree and presight on the same rays and triangles, in turns, cold and warm; Markdown tables on stdout.

Cold: 32 MB are written before each frame, as other work of a robot does. Sensors of at most 30,000 rays get one thread on both
sides, others two. The least of the repeats at each pose counts, which a busy machine disturbs least; ratios are medians over
poses, with the worst pose in brackets.
"""

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from embree import Embree
from peers import Presight, cpu_name, differ
from scene import triangles

SCENES = "hospital,factory_hall,city,scenes/factory.rhai,open_hall,warehouse_small,office_willowgarage"
FEW = 30_000
LEVEL = ("laser-scanner", "scanner 270", "3600 level")


def arguments():
    parser = argparse.ArgumentParser(prog="benches/peers/run.sh by_cpu.py", description=__doc__)
    parser.add_argument("--scenes", default=SCENES)
    parser.add_argument("--sensors", help="names, comma-separated; all if left out")
    parser.add_argument("--poses", type=int, default=5)
    parser.add_argument("--repeat", type=int, default=11, help="frames at each pose and side, cold and warm")
    parser.add_argument("--json", type=Path, help="write every figure there")
    options = parser.parse_args()
    options.sensors = options.sensors and options.sensors.split(",")
    return options


def measure(scene, threads, options):
    """Rows of one scene for the sensors that get so many threads."""
    import open3d as o3d

    options.threads = threads
    others = np.zeros(4 << 20, dtype=np.uint64)
    with tempfile.TemporaryDirectory() as folder:
        presight = Presight(scene, options, "cpu", folder)
        presight.check_presets()
        embree = Embree(triangles(presight.glb), threads)
        half = (options.repeat + 1) // 2
        for number, sensor in enumerate(presight.sensors):
            count = sensor["size"][0] * sensor["size"][1]
            if (options.sensors and sensor["name"] not in options.sensors) or (count <= FEW) != (threads == 1):
                continue
            row = {"scene": scene, "sensor": sensor["name"], "size": sensor["size"], "differ": np.zeros(2, dtype=np.int64)}
            row |= {"embree": [[], []], "presight": [[], []], "cuts": []}
            for pose in range(options.poses):
                rays, there = presight.rays(number, pose)
                rays = o3d.core.Tensor(rays)
                embree.cpu_ms(rays, 2)
                for cold in (0, 1):
                    junk = others if cold else None
                    before = embree.cpu_ms(rays, half, junk)
                    mine = presight.cpu_ms(number, pose, options.repeat, cold)
                    row["embree"][cold].append(min(before + embree.cpu_ms(rays, half, junk)))
                    row["presight"][cold].append(min(mine))
                hits = embree.scene.cast_rays(rays, nthreads=threads)["t_hit"].numpy()
                ranges = np.fromfile(presight.folder / "range.f32", dtype=np.float32)
                row["differ"] += differ(ranges, hits, there, sensor["range_max"])
                if sensor["name"] in LEVEL:
                    row["cuts"].append(presight.cut(number, pose))
            print(f"measured {scene}, {sensor['name']}", file=sys.stderr)
            yield row
        presight.close()


def ratios(row, cold):
    return [a / b for a, b in zip(row["embree"][cold], row["presight"][cold])]


def shown(row, cold):
    all_poses = ratios(row, cold)
    return f"{statistics.median(all_poses):.2f} ({min(all_poses):.2f})"


def print_tables(rows):
    print("| scene | sensor | rays | Embree ms, warm, cold | presight ms, warm, cold | times as fast, warm (worst pose) | cold | other range | a cut, ms (segments) |")
    print("|---" * 9 + "|")
    for row in rows:
        size = "{} x {}".format(*row["size"])
        times = [", ".join(f"{statistics.median(row[side][cold]):.3f}" for cold in (0, 1)) for side in ("embree", "presight")]
        cut = "{:.2f} ({:.0f})".format(*map(statistics.median, zip(*row["cuts"]))) if row["cuts"] else ""
        other = f"{100 * row['differ'][1] / row['differ'][0]:.4f} %"
        cells = [row["scene"], row["sensor"], size, *times, shown(row, 0), shown(row, 1), other, cut]
        print("| " + " | ".join(cells) + " |")
    print("\nWorst of the scenes, times as fast as Embree:\n")
    print("| sensor | cold: median over poses (scene) | warm | worst single pose, cold, warm |\n|---|---|---|---|")
    for sensor in dict.fromkeys(row["sensor"] for row in rows):
        mine = [row for row in rows if row["sensor"] == sensor]
        worst = [min((statistics.median(ratios(row, cold)), row["scene"]) for row in mine) for cold in (1, 0)]
        single = [min(min(ratios(row, cold)) for row in mine) for cold in (1, 0)]
        cells = [sensor, *(f"{ratio:.2f} ({scene})" for ratio, scene in worst), ", ".join(f"{s:.2f}" for s in single)]
        print("| " + " | ".join(cells) + " |")


def main():
    options = arguments()
    print(f"{time.strftime('%Y-%m-%d')}, {cpu_name()}, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    print(f"{options.poses} poses, the least of {options.repeat} frames at each\n")
    rows = []
    for scene in options.scenes.split(","):
        for threads in (1, 2):
            rows += measure(scene, threads, options)
            if options.json:
                options.json.write_text(json.dumps(rows, default=lambda a: a.tolist(), indent=1))
    print_tables(rows)


if __name__ == "__main__":
    main()
