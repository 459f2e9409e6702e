"""Embree and presight on the same rays and triangles, in turns; one Markdown table on stdout."""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from importlib import metadata
from pathlib import Path

import numpy as np

from embree import Embree, free_poses
from scene import triangles
from sensors import SENSORS

HERE = Path(__file__).resolve().parent
POSES_FILE = HERE / "poses.json"
SEED = 1995
SCENES = "hospital,factory_hall,scenes/factory.rhai,city,open_hall"


def arguments():
    parser = argparse.ArgumentParser(prog="benches/peers/run.sh", description=__doc__)
    parser.add_argument("--scenes", default=SCENES, help="names in the data folder, paths in the repository, open_hall")
    parser.add_argument("--sensors", help="names, comma-separated; all at free poses if left out")
    parser.add_argument("--backends", default="cpu", help="presight's: cpu, gpu, or both with a comma")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="for both sides")
    parser.add_argument("--poses", type=int, default=20, help="free poses of each scene")
    parser.add_argument("--repeat", type=int, default=5, help="predictions at each pose; Embree traces as often")
    parser.add_argument("--quick", action="store_true", help="4 poses, 3 predictions at each: figures to look at")
    parser.add_argument("--json", type=Path, help="write every figure there")
    parser.add_argument("--make-poses", action="store_true", help="write poses.json anew, and nothing else")
    options = parser.parse_args()
    if options.quick:
        options.poses, options.repeat = 4, 3
    return options


def scene_file(name):
    data = Path(os.environ.get("PRESIGHT_DATA", HERE.parents[2] / "shared" / "data"))
    path = (data / "env" / f"{name}.glb").resolve()
    if not path.is_file():
        raise SystemExit(f"{path}: not there; set PRESIGHT_DATA to the folder that holds env/{name}.glb")
    return path


def cpu_name():
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


class Presight:
    """The program that `cargo bench --bench peer --no-run` builds, with one scene open."""

    def __init__(self, scene, options, backend, folder):
        self.folder = Path(folder)
        command = [os.environ["PRESIGHT_PEER"], scene, folder, str(options.poses), str(options.threads), backend]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        told = self.answer()
        self.glb, self.engine, self.polygons = Path(told["glb"]), told["engine"], told["polygons"]
        self.poses, self.sensors = np.array(told["poses"]), told["sensors"]

    def answer(self):
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"presight ended with status {self.process.wait()}; its message is above")
        return json.loads(line)

    def check_presets(self):
        """The presets' rays are those of their published definition, worked out apart from presight."""
        for name in {sensor["name"] for sensor in self.sensors} & set(SENSORS):
            body = np.fromfile(self.folder / f"{name}.f64").reshape(-1, 3)
            if not np.allclose(body, SENSORS[name]()[0].reshape(-1, 3), rtol=0, atol=1e-12):
                raise RuntimeError(f"{name}: presight's rays are not those of benches/peers/sensors.py")

    def predict(self, sensor, pose, repeat):
        """Milliseconds of each prediction, and the range image."""
        print(sensor, pose, repeat, file=self.process.stdin, flush=True)
        times, _ = self.answer()
        return times, np.fromfile(self.folder / "range.f32", dtype=np.float32)

    def cpu_ms(self, sensor, pose, repeat, cold):
        """Milliseconds of CPU time of each prediction, with 32 MB written before each if `cold`."""
        print(sensor, pose, repeat, "cold" if cold else "", file=self.process.stdin, flush=True)
        return self.answer()[1]

    def cut(self, sensor, pose):
        """Milliseconds of CPU time of a cut of the world at the sensor's height, and its segments."""
        print(sensor, pose, "cut", file=self.process.stdin, flush=True)
        return self.answer()

    def rays(self, sensor, pose):
        """Origins and directions in the world, f32, without pixels that have no ray, and which ones these are."""
        body = np.fromfile(self.folder / f"{self.sensors[sensor]['name']}.f64").reshape(-1, 3)
        there = ~np.isnan(body[:, 0])
        at = np.array(self.sensors[sensor].get("poses", self.poses))[pose]
        directions = body[there] @ at[:, :3].T
        origins = np.broadcast_to(at[:, 3], directions.shape)
        return np.concatenate([origins, directions], axis=1).astype(np.float32), there

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def differ(ranges, embree, there, range_max):
    """Rays, and those of another range. Embree works in f32 in world coordinates: 1e-4 of the range is its error on flat surfaces."""
    mine = ranges[there]
    theirs = np.where(embree <= min(range_max, np.finfo(np.float32).max), embree, np.inf)
    # What is too near is told as minus infinity by presight.
    same = np.isclose(mine, theirs, rtol=1e-4, atol=1e-4) | np.isneginf(mine)
    return np.array([mine.size, (~same).sum()])


def measure(scene, backend, options):
    """Rows of one scene; the pinhole's come first."""
    import open3d as o3d

    with tempfile.TemporaryDirectory() as folder:
        presight = Presight(scene, options, backend, folder)
        presight.check_presets()
        embree = Embree(triangles(presight.glb), options.threads)
        half = max(1, (options.repeat + 1) // 2)
        for number, sensor in enumerate(presight.sensors):
            name = sensor["name"]
            wanted = name in options.sensors.split(",") if options.sensors else "poses" not in sensor
            if not wanted and name != "pinhole":
                continue
            row = {"scene": scene, "triangles": len(embree.triangles), "backend": backend, "engine": presight.engine}
            row |= {"sensor": name, "size": sensor["size"], "table_bytes": sensor["table_bytes"]}
            row |= {"embree_ms": [], "presight_ms": [], "differ": np.zeros(2, dtype=np.int64)}
            for pose in range(len(presight.poses)):
                rays, there = presight.rays(number, pose)
                rays = o3d.core.Tensor(rays)
                before = embree.time_ms(rays, half)
                times, ranges = presight.predict(number, pose, options.repeat)
                after = embree.time_ms(rays, half)
                hits = embree.scene.cast_rays(rays, nthreads=options.threads)["t_hit"].numpy()
                row["embree_ms"].append(statistics.median(before + after))
                row["presight_ms"].append(statistics.median(times))
                row["differ"] += differ(ranges, hits, there, sensor["range_max"])
            print(f"measured {scene}, {name}, {backend}", file=sys.stderr)
            yield row
        presight.close()


def ratios(over, under):
    return statistics.median(a / b for a, b in zip(over, under))


LENSES = ("plumb-bob", "rational", "fisheye 60", "fisheye 120", "fisheye 200")


def print_table(rows):
    head = ["scene (triangles)", "sensor", "pixels", "tables MB", "engine", "Embree ms", "presight ms"]
    head += ["times as fast as Embree", "times the pinhole's time", "other range"]
    print("| " + " | ".join(head) + " |")
    print("|---" * len(head) + "|")
    for row in rows:
        pinhole = next(r for r in rows if (r["scene"], r["backend"]) == (row["scene"], row["backend"]))
        beside = f"{ratios(row['presight_ms'], pinhole['presight_ms']):.2f}" if row["sensor"] in LENSES else ""
        rays, other = (int(n) for n in row["differ"])
        cells = [f"{row['scene']} ({row['triangles']:,})", row["sensor"], "{} x {}".format(*row["size"])]
        cells += [f"{row['table_bytes'] * 1e-6:.1f}" if row["table_bytes"] else "", row["backend"]]
        cells += [f"{statistics.median(row['embree_ms']):.2f}", f"{statistics.median(row['presight_ms']):.2f}"]
        cells += [f"{ratios(row['embree_ms'], row['presight_ms']):.2f}", beside, f"{100 * other / rays:.4f} %"]
        print("| " + " | ".join(cells) + " |")


def print_worst(rows):
    """For each sensor the scene in which it does worst."""
    print("\nWorst of the scenes:\n")
    print("| sensor | engine | times as fast as Embree | times the pinhole's time |\n|---|---|---|---|")
    for sensor, backend in dict.fromkeys((r["sensor"], r["backend"]) for r in rows):
        mine = [r for r in rows if (r["sensor"], r["backend"]) == (sensor, backend)]
        slowest = min((ratios(r["embree_ms"], r["presight_ms"]), r["scene"]) for r in mine)
        cells = [sensor, backend, f"{slowest[0]:.2f} ({slowest[1]})", ""]
        if sensor in LENSES:
            flat = {r["scene"]: r for r in rows if (r["sensor"], r["backend"]) == ("pinhole", backend)}
            most = max((ratios(r["presight_ms"], flat[r["scene"]]["presight_ms"]), r["scene"]) for r in mine)
            cells[3] = f"{most[0]:.2f} ({most[1]})"
        print("| " + " | ".join(cells) + " |")


def make_poses(options):
    scenes = {}
    for name in ("hospital", "factory_hall"):
        embree = Embree(triangles(scene_file(name)), options.threads)
        scenes[name] = free_poses(embree, options.poses, SEED)
    about = "x, y, z in metres and roll, pitch, yaw in degrees of the sensor in the world; made by --make-poses"
    lines = [f'    "{n}": [\n      ' + ",\n      ".join(map(json.dumps, p)) + "\n    ]" for n, p in scenes.items()]
    body = ",\n".join(lines)
    POSES_FILE.write_text(f'{{\n  "about": "{about}",\n  "seed": {SEED},\n  "scenes": {{\n{body}\n  }}\n}}\n')


def main():
    options = arguments()
    if options.make_poses:
        return make_poses(options)
    start = time.monotonic()
    versions = {p: metadata.version(p) for p in ("open3d-cpu", "numpy")}
    print(f"{time.strftime('%Y-%m-%d')}, {cpu_name()}, {options.threads} threads for both sides")
    print("Embree 4 through " + ", ".join(f"{p} {v}" for p, v in versions.items()))
    print(f"{options.poses} free poses, median over poses of the median of {options.repeat} at each, in turns\n")
    rows, problems = [], []
    for backend in options.backends.split(","):
        for scene in options.scenes.split(","):
            try:
                rows += measure(scene, backend, options)
            except RuntimeError as problem:
                problems.append(f"{scene}, {backend}: {problem}")
    for engine in dict.fromkeys(row["engine"] for row in rows if row["backend"] == "gpu"):
        print(f"gpu: {engine}\n")
    print_table(rows)
    print_worst(rows)
    if options.json:
        options.json.write_text(json.dumps({"rows": rows}, default=lambda a: a.tolist(), indent=1))
    print(f"took {time.monotonic() - start:.0f} s", file=sys.stderr)
    for problem in problems:
        print(f"NOT MEASURED: {problem}", file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
