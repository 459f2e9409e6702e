"""Frames a second of Open3D's TSDF integration of the living room, and of `presight explore`'s library, on the same frames and pixels.

benches/peers/run.sh tsdf.py [--voxel 0.02] [--repeat 3]: a Markdown table, by the clock and by CPU time of all threads. Both sides get
every fourth pixel of all 211 frames at the poses of the log. Open3D integrates depth; decoding files is not counted on either side, and
neither is the extraction of its mesh. presight's rate includes its polygons. Open3D keeps blocks of 16^3 voxels, 8 m, truncation 8 voxels.
"""

import argparse
import os
import subprocess
import time
from pathlib import Path

import numpy as np
import open3d as o3d

core = o3d.core
STRIDE, FOCAL, CENTRE = 4, 525.0, (319.5, 239.5)
HERE = Path(__file__).resolve().parent
DATA = Path(os.environ.get("PRESIGHT_DATA", HERE.parents[2] / "shared" / "data"))


def arguments():
    parser = argparse.ArgumentParser(prog="benches/peers/run.sh tsdf.py", description=__doc__)
    parser.add_argument("--voxel", type=float, default=0.02, help="metres")
    parser.add_argument("--repeat", type=int, default=3, help="runs of each side, in turns; the fastest counts")
    parser.add_argument("--bench", type=Path, help="the program of `cargo bench --bench explore`")
    return parser.parse_args()


def frames():
    """Depth images and camera_from_world."""
    log = DATA / "rgbd" / "livingroom"
    for line in (log / "poses.txt").read_text().splitlines():
        if line.startswith("#"):
            continue
        name, *numbers = line.split()[:8]
        x, y, z, *quaternion = (float(number) for number in numbers)
        depth = np.asarray(o3d.io.read_image(str(log / "depth" / f"{name}.png")))[::STRIDE, ::STRIDE].copy()
        pose = np.eye(4)
        pose[:3, :3] = o3d.geometry.get_rotation_matrix_from_quaternion(np.roll(quaternion, 1))
        pose[:3, 3] = x, y, z
        yield o3d.t.geometry.Image(depth), core.Tensor(np.linalg.inv(pose))


def integrate(images, voxel):
    """Seconds by the clock and of CPU for all frames."""
    # Half a pixel, because the integration cuts pixel coordinates off and does not round.
    u, v = (c / STRIDE + 0.5 for c in CENTRE)
    camera = core.Tensor(np.array([[FOCAL / STRIDE, 0, u], [0, FOCAL / STRIDE, v], [0, 0, 1]]))
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight"), (core.float32, core.float32), ((1,), (1,)), voxel, 16, 20000, core.Device("CPU:0")
    )
    clock, cpu = time.perf_counter(), time.process_time()
    for depth, pose in images:
        blocks = grid.compute_unique_block_coordinates(depth, camera, pose, 1000.0, 8.0, 8.0)
        grid.integrate(blocks, depth, camera, pose, 1000.0, 8.0, 8.0)
    return time.perf_counter() - clock, time.process_time() - cpu


def explore(bench, count):
    """The same of presight, from the last row of the bench's table."""
    said = subprocess.run([str(bench), str(count)], check=True, capture_output=True, text=True).stdout
    _, _, by_clock, by_cpu = said.splitlines()[-1].strip("| ").split(" | ")
    return count / float(by_clock), count / float(by_cpu)


def main():
    options = arguments()
    images = list(frames())
    theirs, mine = [], []
    for _ in range(options.repeat):
        theirs.append(integrate(images, options.voxel))
        if options.bench:
            mine.append(explore(options.bench, len(images)))
    print(f"{len(images)} frames, {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n")
    print("| | frames/s | frames per second of CPU |\n|---|---|---|")
    best = [[len(images) / min(run[k] for run in runs) for k in (0, 1)] for runs in (theirs, mine) if runs]
    for name, (clock, cpu) in zip((f"Open3D, TSDF of {100 * options.voxel:g} cm", "presight"), best):
        print(f"| {name} | {clock:.1f} | {cpu:.1f} |")
    if mine:
        print("| ratio | " + " | ".join(f"{b / a:.2f}" for a, b in zip(*best)) + " |")


if __name__ == "__main__":
    main()
