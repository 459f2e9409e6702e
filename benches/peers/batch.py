"""Embree at the poses of `cargo bench --bench batch -- FOLDER`: milliseconds a pose, all poses of a chunk in one call.

Run by the Python of benches/peers/run.sh: benches/peers/.venv/bin/python benches/peers/batch.py FOLDER [--threads N]
Only rays are traced; what presight does besides, weighing the image, is left out.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import open3d as o3d

from embree import Embree
from peers import scene_file
from scene import triangles
from sensors import SENSORS

CHUNK = 100


def rotations(quaternions):
    x, y, z, w = quaternions.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def rays(body_rays, poses):
    directions = np.einsum("pij,rj->pri", rotations(poses[:, 3:]), body_rays.reshape(-1, 3))
    origins = np.broadcast_to(poses[:, None, :3], directions.shape)
    return o3d.core.Tensor(np.concatenate([origins, directions], axis=-1).astype(np.float32))


def level(poses):
    """The same headings, upright, all at the first height: for scanners of one row."""
    turned = poses.copy()
    turned[:, 2] = poses[0, 2]
    x, y, z, w = poses[:, 3:].T
    yaw = np.arctan2(2 * (x * y + z * w), 1 - 2 * (y * y + z * z))
    turned[:, 3:] = np.stack([0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1)
    return turned


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    print("| scene | sensor | poses | Embree, ms a pose |\n|---|---|---|---|")
    for scene in ("hospital", "factory_hall"):
        embree = Embree(triangles(scene_file(scene)), options.threads)
        poses = np.loadtxt(options.folder / f"{scene}.tum")[:, 1:]
        for sensor in ("laser-range-camera", "laser-scanner", "microwave-radar-scan"):
            body_rays, _ = SENSORS[sensor]()
            used = poses if sensor == "laser-range-camera" else level(poses)
            chunks = [rays(body_rays, used[i : i + CHUNK]) for i in range(0, len(used), CHUNK)]
            best = float("inf")
            for _ in range(4):
                start = time.perf_counter()
                for chunk in chunks:
                    embree.scene.cast_rays(chunk, nthreads=options.threads)
                best = min(best, time.perf_counter() - start)
            print(f"| {scene} | {sensor} | {len(poses)} | {best * 1e3 / len(poses):.4f} |")


if __name__ == "__main__":
    main()
