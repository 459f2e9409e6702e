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


def arguments():
    parser = argparse.ArgumentParser(prog="benches/peers/run.sh", description=__doc__)
    parser.add_argument("--scenes", default="hospital,factory_hall", help="names in the data folder")
    parser.add_argument("--sensors", default=",".join(SENSORS), help="presets to compare")
    parser.add_argument("--backends", default="cpu,gpu", help="presight's: cpu, gpu")
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="for both sides")
    parser.add_argument("--repeat", type=int, default=15, help="predictions and traces at each pose")
    parser.add_argument("--poses", type=int, default=10, help="poses of poses.json to use")
    parser.add_argument("--json", type=Path, help="write every figure there")
    parser.add_argument("--embree-only", action="store_true", help="leave presight out")
    parser.add_argument("--make-poses", action="store_true", help="write poses.json anew, and nothing else")
    return parser.parse_args()


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


def run_presight(args):
    """Seconds, peak resident MB (NaN without GNU time) and (status, messages) of one run of the command."""
    # A child of this process would count this process's own memory, for it starts as its copy: GNU time is small.
    timer = Path("/usr/bin/time")
    with tempfile.TemporaryFile() as messages, tempfile.NamedTemporaryFile("r") as kib:
        measured = [str(timer), "-f", "%M", "-o", kib.name] if timer.exists() else []
        start = time.perf_counter()
        done = subprocess.run([*measured, os.environ["PRESIGHT"], *args], stdout=messages, stderr=subprocess.STDOUT)
        seconds = time.perf_counter() - start
        messages.seek(0)
        said = messages.read().decode(errors="replace").strip()
        lines = kib.read().split()
    megabytes = int(lines[-1]) * 1024 / 1e6 if lines else float("nan")
    return seconds, megabytes, done.returncode, said


def must(args):
    seconds, megabytes, status, said = run_presight(args)
    if status != 0:
        raise RuntimeError(f"presight {' '.join(map(str, args))}: exit status {status}: {said}")
    return seconds, megabytes


def pose_text(pose):
    return ",".join(repr(float(v)) for v in pose)


def time_presight(scene, sensor, pose, backend, options, folder):
    stats = Path(folder) / "stats.json"
    args = ["predict", str(scene), "--sensor", sensor, f"--pose={pose_text(pose)}", "--backend", backend]
    args += ["--threads", str(options.threads), "--repeat", str(options.repeat), "--stats", str(stats)]
    must(args)
    return json.loads(stats.read_text())


def compare(scene, sensor, pose, backend, oracle, folder):
    """Pixels, those of another range, those of another id at another range, and those of another id at the same."""
    import OpenEXR

    out = Path(folder) / "ids.exr"
    args = ["predict", str(scene), "--sensor", sensor, f"--pose={pose_text(pose)}", "--backend", backend]
    must([*args, "--ids", "source", "--outputs", "range,polygon_id", "--out", str(out)])
    with OpenEXR.File(str(out), separate_channels=True) as file:
        channels = file.channels()
        ours = {name: np.array(channels[name].pixels) for name in ("range", "polygon_id")}
    ranges, ids = oracle
    if ours["range"].shape != ranges.shape:
        raise RuntimeError(f"{sensor}: presight's image is {ours['range'].shape}, the rays here are {ranges.shape}")
    # Embree works in f32 in world coordinates: 1e-4 of the range holds its error on flat surfaces.
    same_range = np.isclose(ours["range"], ranges, rtol=1e-4, atol=1e-4)
    other_id = ours["polygon_id"] != ids
    return np.array([ranges.size, (~same_range).sum(), (other_id & ~same_range).sum(), (other_id & same_range).sum()])


def measure(name, options, folder, problems):
    scene = scene_file(name)
    embree = Embree(triangles(scene), options.threads)
    poses = json.loads(POSES_FILE.read_text())["scenes"][name][: options.poses]
    backends = [] if options.embree_only else options.backends.split(",")
    for sensor in options.sensors.split(","):
        body_rays, range_max = SENSORS[sensor]()
        row = {"scene": name, "triangles": len(embree.triangles), "sensor": sensor}
        row["size"] = f"{body_rays.shape[1]} x {body_rays.shape[0]}"
        row |= {"embree_ms": [], "embree_best_ms": [], "presight": {}}
        for pose in poses:
            rays = embree.rays(body_rays, pose)
            half = max(1, options.repeat // 2)
            times = embree.time_ms(rays, half)
            for backend in backends:
                try:
                    stats = time_presight(scene, sensor, pose, backend, options, folder)
                    differ = compare(scene, sensor, pose, backend, embree.images(rays, range_max), folder)
                except RuntimeError as problem:
                    problems.append(str(problem))
                    backends = [b for b in backends if b != backend]
                    continue
                empty = {"ms": [], "best_ms": [], "differ": np.zeros(4, dtype=np.int64)}
                mine = row["presight"].setdefault(backend, empty)
                mine["ms"].append(stats["prediction_ms"]["median"])
                mine["best_ms"].append(stats["prediction_ms"]["min"])
                mine["differ"] += differ
                mine["adapter"] = stats.get("adapter")
            times += embree.time_ms(rays, half)
            row["embree_ms"].append(statistics.median(times))
            row["embree_best_ms"].append(min(times))
        yield row


def cell(row, backend):
    mine = row["presight"].get(backend)
    if not mine or len(mine["ms"]) != len(row["embree_ms"]):
        return ["-", "-", "-", "-"]
    ratio, best = (
        statistics.median(e / m for e, m in zip(row[f"embree_{key}"], mine[key])) for key in ("ms", "best_ms")
    )
    pixels, ranges, _, coincident = (int(n) for n in mine["differ"])
    return [
        f"{statistics.median(mine['ms']):.2f}",
        f"{ratio:.2f} x ({best:.2f} x)",
        f"{100 * ranges / pixels:.4f} %",
        f"{100 * coincident / pixels:.4f} %",
    ]


def print_table(rows, backends):
    head = ["scene", "sensor", "pixels", "Embree ms (best runs)"]
    for backend in backends:
        head += [f"{backend} ms", f"{backend} vs Embree (best runs)", "other range", "other id, same range"]
    print("| " + " | ".join(head) + " |")
    print("|---" * len(head) + "|")
    for row in rows:
        e = row["embree_ms"]
        cells = [f"{row['scene']} ({row['triangles']:,})", row["sensor"], row["size"]]
        cells.append(f"{statistics.median(e):.2f} ({statistics.median(row['embree_best_ms']):.2f})")
        for backend in backends:
            cells += cell(row, backend)
        print("| " + " | ".join(cells) + " |")


def whole_process(folder, problems):
    """The command from start to a written EXR, on the hospital."""
    scene = scene_file("hospital")
    pose = json.loads(POSES_FILE.read_text())["scenes"]["hospital"][0]
    for sensor in ("microwave-radar-image", "video-camera"):
        args = ["predict", str(scene), "--sensor", sensor, f"--pose={pose_text(pose)}", "--backend", "cpu"]
        try:
            runs = [must([*args, "--out", str(Path(folder) / "out.exr")]) for _ in range(7)]
        except RuntimeError as problem:
            problems.append(str(problem))
            return
        seconds = sorted(s for s, _ in runs)
        print(
            f"Whole process, hospital, {sensor}, cpu, EXR written: median {seconds[3]:.3f} s "
            f"({seconds[0]:.3f}-{seconds[-1]:.3f}), peak {max(m for _, m in runs):.0f} MB"
        )


def make_poses(options):
    scenes = {}
    for name in options.scenes.split(","):
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
    versions = {p: metadata.version(p) for p in ("open3d-cpu", "numpy", "OpenEXR")}
    backends = [] if options.embree_only else options.backends.split(",")
    rows, problems = [], []
    print(f"{time.strftime('%Y-%m-%d')}, {cpu_name()}, {options.threads} threads for both sides")
    print("Embree 4 through " + ", ".join(f"{p} {v}" for p, v in versions.items()))
    print(f"{options.poses} free poses, median over poses of the median of {options.repeat} at each, in turns")
    with tempfile.TemporaryDirectory() as folder:
        for name in options.scenes.split(","):
            for row in measure(name, options, folder, problems):
                print(f"measured {name} {row['sensor']}", file=sys.stderr)
                rows.append(row)
        adapters = {m.get("adapter") for r in rows for m in r["presight"].values()} - {None}
        for adapter in sorted(map(str, adapters)):
            print(f"gpu: {adapter}")
        print()
        print_table(rows, backends)
        print()
        if "cpu" in backends:
            whole_process(folder, problems)
    if options.json:
        options.json.write_text(json.dumps({"rows": rows}, default=lambda a: a.tolist(), indent=1))
    for problem in dict.fromkeys(problems):
        print(f"NOT MEASURED: {problem}", file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
