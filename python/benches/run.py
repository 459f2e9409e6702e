"""Measures presight for Python and writes a table: python python/benches/run.py [OUT.md]

Needs the installed wheel (of a release build) and the shared data; Open3D and Ray, where they are installed, for their rows. All
figures are ratios of medians taken in one process, in turns.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

import presight
from presight import _presight

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("PRESIGHT_DATA", ROOT.parent / "shared" / "data"))
POSE = [12.0, -10.0, 1.2, 0, 0, 30]
rows: list[tuple[str, str, str, str]] = []


def row(what, against, least, found, reached):
    rows.append((what, against, least, f"{found}" if reached else f"**{found}**"))
    print(f"{what} | {against} | {least} | {found}{'' if reached else ' MISSED'}", flush=True)


def timed(work, n):
    times = []
    for _ in range(n):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def inside(scene, n, rng):
    """Level poses inside, where something is near in all directions."""
    low, high = map(np.array, scene.bounds)
    found, predictor = [], presight.Predictor("cpu")
    while len(found) < n:
        poses = np.zeros((200, 6))
        poses[:, :2], poses[:, 2], poses[:, 5] = rng.uniform(low[:2], high[:2], (200, 2)), 1.2, rng.uniform(-180, 180, 200)
        ranges = predictor.predict_many(scene, "laser-scanner", poses)["range"]
        found += [pose for pose, r in zip(poses, ranges) if np.isfinite(r).mean() > 0.9 and r.min() > 0.3]
    return np.array(found[:n])


def single(hospital, poses):
    predictor = presight.Predictor("cpu")
    for sensor, most in [("vlp-16", 1.05), ("laser-scanner", 1.3)]:
        given = presight.Sensor.load(sensor)
        calls, own = [], []
        for i in range(300):
            start = time.perf_counter()
            out = predictor.predict(hospital, given, poses[i % len(poses)])
            calls.append(time.perf_counter() - start)
            own.append(json.loads(out.json())["prediction_ms"] / 1e3)
        ratio, more = statistics.median(calls) / statistics.median(own), 1e6 * (statistics.median(calls) - statistics.median(own))
        limit = f"at most {most} x" + (", or 15 us more" if most > 1.1 else "")
        row(f"`predict`, `{sensor}`, hospital, CPU", "the library's own time for it", limit, f"{ratio:.3f} x, {more:.0f} us more",
            ratio <= most or (most > 1.1 and more <= 15))


def many(hospital, poses):
    predictor, sensor = presight.Predictor("cpu"), presight.Sensor.load("vlp-16")
    mine, filled, own = [], [], []
    out = predictor.predict_many(hospital, sensor, poses)
    for _ in range(5):
        mine.append(timed(lambda: predictor.predict_many(hospital, sensor, poses), 1))
        filled.append(timed(lambda: predictor.predict_many(hospital, sensor, poses, out=out), 1))
        own.append(_presight._batch_seconds(predictor, hospital, sensor, poses))
    # Least times: on a busy machine, medians tell of the others.
    for name, times in [("", filled), (", new arrays", mine)]:
        rate = min(own) / min(times)
        row(f"`predict_many`, 1,000 poses of `vlp-16`{name or ', `out=`'}", "`Predictor::batch`", "0.95 of its rate", f"{rate:.2f}", rate >= 0.95)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "h.presight"
        presight.Store.create(path, hospital).close()

        def command(i=[0]):
            pose = ",".join(repr(float(x)) for x in poses[i[0]])
            i[0] += 1
            out = Path(folder) / f"{i[0]}.npy"
            subprocess.run([Path(sys.executable).parent / "presight", "predict", path, "--sensor", "vlp-16", "--pose", pose,
                            "--outputs", "range", "--npy", out], check=True, stdout=subprocess.DEVNULL)

        one = timed(command, 15)
    times = one / (statistics.median(mine) / len(poses))
    row("the same", "a command per pose, from a store", "20 x", f"{times:.0f} x", times >= 20)


def likelihood(hospital, poses):
    predictor = presight.Predictor("cpu")
    sensor = presight.Sensor.load("laser-scanner").replace(range_sigma=0.02)
    particles = np.repeat(poses[:100], 100, 0) + np.random.default_rng(2).normal(0, [0.2, 0.2, 0, 0, 0, 5], (10_000, 6))
    sensed = predictor.predict(hospital, sensor, poses[0]).range
    mine, own = [], []
    for _ in range(3):
        mine.append(timed(lambda: predictor.likelihood(hospital, sensor, sensed, particles), 1))
        own.append(_presight._batch_seconds(predictor, hospital, sensor, particles, sensed))
    rate = statistics.median(own) / statistics.median(mine)
    row("`likelihood`, 10,000 poses of 361 beams", "`Predictor::batch`", "0.95 of its rate", f"{rate:.2f}", rate >= 0.95)


def open3d(path, hospital, poses):
    try:
        import open3d as o3d
        import trimesh
    except ImportError:
        print("no Open3D or trimesh: its rows are left out")
        return
    sensor, predictor = presight.Sensor.load("video-camera"), presight.Predictor("cpu", 2)
    mesh = trimesh.load(path, force="mesh")
    vertices = np.asarray(mesh.vertices) @ np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])  # glTF's y-up to z-up
    caster = o3d.t.geometry.RaycastingScene(nthreads=2)
    caster.add_triangles(vertices.astype("f4"), np.asarray(mesh.faces, "u4"))
    rays, mine, theirs, off, edges = sensor.rays(), [], [], [], []
    for pose in poses[:20]:
        yaw = np.radians(pose[5])
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        directions = rays @ turn.T
        packed = o3d.core.Tensor(np.concatenate([np.broadcast_to(pose[:3], rays.shape), directions], -1).astype("f4"))
        hit = caster.cast_rays(packed)["t_hit"].numpy()
        out = predictor.predict(hospital, sensor, pose, outputs=("range",))
        theirs.append(timed(lambda: caster.cast_rays(packed), 3))
        mine.append(timed(lambda: predictor.predict(hospital, sensor, pose, outputs=("range",)), 3))
        both = np.isfinite(hit) & np.isfinite(out.range)
        # Where neighbouring pixels differ, a ray may meet another surface in the other precision.
        steep = np.zeros(hit.shape, bool)
        for axis in (0, 1):
            jump = np.abs(np.diff(out.range, axis=axis)) > 0.02
            pad = [(0, 0), (0, 0)]
            pad[axis] = (0, 1)
            steep |= np.pad(jump, pad) | np.roll(np.pad(jump, pad), 1, axis)
        with np.errstate(invalid="ignore"):
            differ = ~(both | (np.isinf(hit) & np.isinf(out.range))) | (np.abs(hit - out.range) > 1e-3)
        edges.append(differ[~steep].mean())
        off.append(np.median(np.abs(hit[both] - out.range[both])))
    times = statistics.median(theirs) / statistics.median(mine)
    row("`predict`, `video-camera`, hospital, 2 threads", f"Open3D {o3d.__version__} `cast_rays`, same rays", "8 x", f"{times:.1f} x", times >= 8)
    row("ranges off the edges", "the same", "all within 1 mm",
        f"{100 * np.mean(edges):.3f} % of the pixels differ by more; the median is {1e6 * np.median(off):.1f} um", np.mean(edges) < 1e-3)


def counting(hospital, poses):
    predictor, sensor, stop = presight.Predictor("cpu", 1), presight.Sensor.load("vlp-16"), threading.Event()

    def count(to):
        n = 0
        while not stop.is_set():
            n += 1
        to.append(n)

    found = {}
    for busy in (False, True, False, True):
        to = found.setdefault(busy, [])
        stop.clear()
        thread = threading.Thread(target=count, args=(to,))
        thread.start()
        end = time.perf_counter() + 2
        while time.perf_counter() < end:
            if busy:
                predictor.predict(hospital, sensor, poses[0])
            else:
                time.sleep(0.01)
        stop.set()
        thread.join()
    share = sum(found[True]) / sum(found[False])
    row("a thread that counts while another predicts on one thread", "the same thread alone", "0.5", f"{share:.2f}", share >= 0.5)


def on_ray(hospital, poses):
    try:
        import ray
        from ray.cluster_utils import Cluster

        import presight.ray
    except ImportError:
        print("no Ray: its rows are left out")
        return
    sensor, one = presight.Sensor.load("vlp-16"), presight.Predictor("cpu", 2)
    right = one.predict_many(hospital, sensor, poses)["range"]
    ray.init(address="local", num_cpus=2, logging_level="error")
    same = np.array_equal(presight.ray.predict_many(hospital, sensor, poses, threads=1)["range"], right)
    theirs, alone = [], []
    for _ in range(5):
        theirs.append(timed(lambda: presight.ray.predict_many(hospital, sensor, poses, threads=1), 1))
        alone.append(timed(lambda: one.predict_many(hospital, sensor, poses), 1))
    rate = min(alone) / min(theirs)
    ray.shutdown()
    row("Ray, two workers of one thread, 1,000 poses", "one process of two threads", "0.8 of its rate",
        f"{rate:.2f}, {'the same bits' if same else 'OTHER BITS'}", same and rate >= 0.8)
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    second = cluster.add_node(num_cpus=1)
    ray.init(address=cluster.address, logging_level="error")
    removed = []

    def remove():
        cluster.remove_node(second, allow_graceful=False)
        removed.append(time.perf_counter())

    timer = threading.Timer(1.0, remove)
    timer.start()
    found = presight.ray.predict_many(hospital, sensor, np.tile(poses, (8, 1)), threads=1)["range"]
    ended = time.perf_counter()
    timer.join()
    same = np.array_equal(found, np.tile(right, (8, 1, 1)))
    ray.shutdown()
    cluster.shutdown()
    row("Ray, two nodes, one removed in mid-run", "one machine", "the same arrays",
        f"{'the same' if same else 'others'}; removed {ended - removed[0]:.1f} s before the end", same and removed[0] < ended)


def imports():
    def load(what):
        return timed(lambda: subprocess.run([sys.executable, "-c", f"import {what}"], check=True), 15)

    empty = load("sys")
    numpy, mine = load("numpy"), load("presight, numpy")
    ratio = (mine - empty) / (numpy - empty)
    row("`import presight` with NumPy", "`import numpy`", "at most 1.5 x", f"{ratio:.2f} x", ratio <= 1.5)


def main():
    path = DATA / "env" / "hospital.glb"
    hospital = presight.Scene.open(path)
    poses = inside(hospital, 1000, np.random.default_rng(1))
    imports()
    single(hospital, poses[:50])
    many(hospital, poses)
    likelihood(hospital, poses)
    counting(hospital, poses)
    open3d(path, hospital, poses)
    on_ray(hospital, poses)
    lines = ["| what | against | at least | found |", "|---|---|---|---|", *("| " + " | ".join(r) + " |" for r in rows)]
    if len(sys.argv) > 1:
        machine = f"Python {sys.version.split()[0]}, NumPy {np.__version__}, {os.cpu_count()} cores"
        head = "# presight for Python\n\n`python python/benches/run.py`, " + machine + ". Bold: missed.\n\n"
        Path(sys.argv[1]).write_text(head + "\n".join(lines) + "\n")


if __name__ == "__main__":
    import warnings

    warnings.simplefilter("ignore", presight.Notice)
    main()
