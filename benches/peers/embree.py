"""Embree 4 through Open3D."""

import time

import numpy as np
import open3d as o3d

from sensors import rotation


class Embree:
    def __init__(self, triangles, threads):
        self.threads = threads
        self.triangles = triangles
        points = o3d.core.Tensor(triangles.reshape(-1, 3).astype(np.float32))
        corners = np.arange(len(triangles) * 3, dtype=np.uint32).reshape(-1, 3)
        self.scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
        self.scene.add_triangles(points, o3d.core.Tensor(corners))

    def rays(self, body_rays, pose):
        directions = body_rays @ rotation(*pose[3:]).T
        origins = np.broadcast_to(np.array(pose[:3]), directions.shape)
        return o3d.core.Tensor(np.concatenate([origins, directions], axis=-1).astype(np.float32))

    def time_ms(self, rays, repeat):
        """Milliseconds of each of `repeat` traces, after one to warm up and to build the BVH."""
        self.scene.cast_rays(rays, nthreads=self.threads)
        times = []
        for _ in range(repeat):
            start = time.perf_counter()
            self.scene.cast_rays(rays, nthreads=self.threads)
            times.append((time.perf_counter() - start) * 1e3)
        return times

    def cpu_ms(self, rays, repeat, others=None):
        """Milliseconds of CPU time of each of `repeat` traces; `others` is written before each."""
        times = []
        for _ in range(repeat):
            if others is not None:
                others[::8] += 1
            start = time.process_time()
            self.scene.cast_rays(rays, nthreads=self.threads)
            times.append((time.process_time() - start) * 1e3)
        return times

    def images(self, rays, range_max):
        """Range (inf for none or beyond the limit) and source id (triangle number + 1, 0 for none)."""
        hit = self.scene.cast_rays(rays, nthreads=self.threads)
        ranges = hit["t_hit"].numpy()
        ids = hit["primitive_ids"].numpy().astype(np.uint32) + np.uint32(1)
        seen = ranges <= range_max
        return np.where(seen, ranges, np.inf), np.where(seen, ids, 0)

    def distance(self, point):
        query = o3d.core.Tensor(np.array([point], dtype=np.float32))
        return float(self.scene.compute_distance(query, nthreads=self.threads).numpy()[0])


def free_poses(embree, count, seed, height=1.2):
    """Seeded poses at `height`, at least 0.3 m from any polygon, over a floor, at least 60 % of rays hitting."""
    rng = np.random.default_rng(seed)
    corners = embree.triangles.reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    sphere = rng.normal(size=(1024, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    probes = np.concatenate([sphere, [[0, 0, -1]]])
    poses = []
    for _ in range(100_000):
        if len(poses) == count:
            return poses
        x, y = (round(float(v), 3) for v in rng.uniform(low[:2], high[:2]))
        pose = [x, y, height, 0.0, 0.0, round(float(rng.uniform(-180, 180)), 1)]
        if embree.distance(pose[:3]) < 0.3:
            continue
        ranges, _ = embree.images(embree.rays(probes, pose), np.inf)
        over_floor = abs(ranges[-1] - height) < 0.15
        if over_floor and np.isfinite(ranges[:-1]).mean() >= 0.6 and np.median(ranges[:-1]) >= 1.0:
            poses.append(pose)
    raise SystemExit(f"only {len(poses)} of {count} free poses found")
