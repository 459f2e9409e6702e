"""Poses from the same frames and priors: presight, small_gicp's GICP, and an ICP that casts rays; one Markdown table on stdout.

The ray-casting ICP is a plain twin of MICP-L: from each pose it casts the measured rays into the map (Embree through Open3D), takes the
plane of the triangle that each ray meets, and steps by point-to-plane least squares with a gate that narrows. Its rays are
Embree's and take their time natively; the rest is numpy, and is told apart.
"""

import argparse
import json
import statistics
import time
from pathlib import Path

import numpy as np
import open3d as o3d
import small_gicp

from scene import triangles

STEPS = 24
SPACING = 0.02


def arguments():
    parser = argparse.ArgumentParser(prog="benches/peers/localize.sh", description=__doc__)
    parser.add_argument("frames", type=Path, help="folder that the bench localize wrote")
    parser.add_argument("--threads", type=int, default=2, help="for all sides")
    return parser.parse_args()


def matrix(numbers):
    x, y, z, w = numbers[3:]
    m = np.eye(4)
    m[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    m[:3, 3] = numbers[:3]
    return m


def turned(r):
    angle = np.linalg.norm(r)
    if angle < 1e-12:
        return np.eye(3)
    k = r / angle
    c = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(angle) * c + (1 - np.cos(angle)) * c @ c


def sampled(corners, spacing):
    """Points spread over triangles, about one for each square of the spacing."""
    rng = np.random.default_rng(1)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    count = int(min(areas.sum() / spacing**2, 4e6))
    which = rng.choice(len(corners), size=count, p=areas / areas.sum())
    u, v = rng.random(count), rng.random(count)
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a[which] + u[:, None] * (b - a)[which] + v[:, None] * (c - a)[which]


class RayIcp:
    """MICP-L's way: correspondences are where the measured rays meet the map from the pose of this step."""

    def __init__(self, corners, threads):
        self.scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
        flat = corners.reshape(-1, 3).astype(np.float32)
        indices = np.arange(len(flat), dtype=np.uint32).reshape(-1, 3)
        self.scene.add_triangles(o3d.core.Tensor(flat), o3d.core.Tensor(indices))
        self.threads = threads

    def cast(self, pose, points, origin):
        start = pose[:3, :3] @ origin + pose[:3, 3]
        ends = points @ pose[:3, :3].T + pose[:3, 3]
        rays = ends - start
        ranges = np.linalg.norm(rays, axis=1)
        rays /= ranges[:, None]
        both = np.concatenate([np.broadcast_to(start, rays.shape), rays], axis=1).astype(np.float32)
        begin = time.perf_counter()
        hit = self.scene.cast_rays(o3d.core.Tensor(both), nthreads=self.threads)
        took = time.perf_counter() - begin
        ahead = hit["t_hit"].numpy()
        ahead[np.isinf(ahead)] = np.nan
        return ends, ranges, start + rays * ahead[:, None], hit["primitive_normals"].numpy(), took

    def residual(self, pose, points, origin):
        ends, _, hits, _, _ = self.cast(pose, points, origin)
        off = np.linalg.norm(ends - hits, axis=1)
        return np.median(off[np.isfinite(off)])

    def align(self, prior, points, origin, planar):
        pose, casting = prior.copy(), 0.0
        for step in range(STEPS):
            ends, _, hits, normals, took = self.cast(pose, points, origin)
            casting += took
            gate = max(0.3 * 0.8**step, 0.03)
            with np.errstate(invalid="ignore"):
                e = np.einsum("ij,ij->i", normals, ends - hits)
                near = np.isfinite(e) & (np.abs(e) < gate)
            n, p, e = normals[near], ends[near] - pose[:3, 3], e[near]
            j = np.concatenate([n, np.cross(p, n)], axis=1)
            if planar:
                j = j[:, [0, 1, 5]]
            weight = (1 - (e / gate) ** 2) ** 2
            x = -np.linalg.lstsq(j.T @ (weight[:, None] * j), j.T @ (weight * e), rcond=None)[0]
            t, r = (np.array([x[0], x[1], 0]), np.array([0, 0, x[2]])) if planar else (x[:3], x[3:])
            pose[:3, :3] = turned(r) @ pose[:3, :3]
            pose[:3, 3] += t
            if np.linalg.norm(t) < 1e-5 and np.linalg.norm(r) < 1e-5:
                break
        return pose, casting


class Gicp:
    """GICP against points spread over the map; a row of beams is stood on end, so that it has surfaces."""

    def __init__(self, corners, threads, planar):
        self.threads, self.planar = threads, planar
        if planar:
            # What a level row meets: the map is walls, so their points at one height do, and some above and below.
            corners = corners[np.abs(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2]) < 1e-6]
        points = sampled(corners, SPACING)
        self.target, self.tree = small_gicp.preprocess_points(points, downsampling_resolution=SPACING, num_threads=threads)

    def align(self, prior, points, origin, planar):
        if planar:
            points = np.concatenate([points + [0, 0, dz] for dz in (-0.05, 0.0, 0.05)])
        source, _ = small_gicp.preprocess_points(points, downsampling_resolution=0.01, num_threads=self.threads)
        found = small_gicp.align(
            self.target, source, self.tree, init_T_target_source=prior, max_correspondence_distance=0.3,
            num_threads=self.threads, max_iterations=STEPS,
        )
        return found.T_target_source, None


def off(pose, truth, planar):
    """Metres and degrees; of a robot on its floor x, y and yaw count, as presight and the ray-casting ICP look for no others."""
    if planar:
        angle = np.arctan2(pose[1, 0], pose[0, 0]) - np.arctan2(truth[1, 0], truth[0, 0])
        return np.linalg.norm(pose[:2, 3] - truth[:2, 3]), abs(np.degrees((angle + np.pi) % (2 * np.pi) - np.pi))
    turn = np.clip((np.trace(pose[:3, :3].T @ truth[:3, :3]) - 1) / 2, -1, 1)
    return np.linalg.norm(pose[:3, 3] - truth[:3, 3]), np.degrees(np.arccos(turn))


def row(name, found, frames, rays, planar):
    """`found`: pose, milliseconds, milliseconds of CPU time and milliseconds of ray casting, or None, of each frame."""
    errors = np.array([off(pose, f["truth"], planar) for (pose, *_), f in zip(found, frames)])
    residual = statistics.median(rays.residual(p, f["points"], f["origin"]) for (p, *_), f in zip(found, frames))
    ms = sorted(t for _, t, _, _ in found)
    cpu = statistics.median(t for _, _, t, _ in found)
    cast = [c for *_, c in found if c is not None]
    native = f" (rays {statistics.median(cast):.1f})" if cast else ""
    at = lambda share: ms[round(share * (len(ms) - 1))]
    return (
        f"| {name} | {1e3 * np.sqrt((errors[:, 0] ** 2).mean()):.1f} | {np.sqrt((errors[:, 1] ** 2).mean()):.3f} | "
        f"{1e3 * np.median(errors[:, 0]):.1f} | {1e3 * errors[:, 0].max():.0f} | {1e3 * residual:.2f} | "
        f"{at(0.5):.1f}{native} | {at(0.95):.1f} | {cpu:.1f} |"
    )


def timed(method, frames, planar):
    found = []
    for f in frames:
        start, cpu = time.perf_counter(), time.process_time()
        pose, casting = method.align(f["prior"], f["points"], f["origin"], planar)
        ms, cpu_ms = 1e3 * (time.perf_counter() - start), 1e3 * (time.process_time() - cpu)
        found.append((pose, ms, cpu_ms, None if casting is None else 1e3 * casting))
    return found


def main():
    options = arguments()
    print(f"small_gicp and Open3D {o3d.__version__}, {options.threads} threads for all sides")
    print("| frames, method | RMS mm | RMS deg | median mm | largest mm | median residual mm | p50 ms | p95 ms | CPU p50 ms |")
    print("|---|---|---|---|---|---|---|---|---|")
    for file in sorted(options.frames.glob("*.json")):
        case = json.loads(file.read_text())
        points = np.fromfile(file.with_suffix(".points"), dtype="<f4").reshape(-1, 3).astype(np.float64)
        frames, at = [], 0
        for f in case["frames"]:
            known = {key: matrix(f[key]) for key in ("prior", "truth", "found")}
            frames.append(known | {"points": points[at : at + f["points"]], "origin": np.array(f["origin"]), "ms": (f["ms"], f["cpu_ms"])})
            at += f["points"]
        corners, planar = triangles(Path(case["map"])), case["planar"]
        rays = RayIcp(corners, options.threads)
        own = [(f["found"], *f["ms"], None) for f in frames]
        print(row(f"{case['name']}: presight", own, frames, rays, planar), flush=True)
        for name, method in [
            ("GICP of small_gicp", Gicp(corners, options.threads, planar)),
            ("ray-casting ICP, twin of MICP-L", rays),
        ]:
            print(row(f"{case['name']}: {name}", timed(method, frames, planar), frames, rays, planar), flush=True)


if __name__ == "__main__":
    main()
