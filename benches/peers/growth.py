"""CPU time of an image in ever larger offices of which as much is visible: presight, Embree and parry on the same rays.

benches/peers/run.sh growth.py [--most 10000000] [--out FOLDER]: growth.csv and growth.svg, a log-log plot. The sensor stands in the
middle of a closed pair of rooms; what grows is what lies beyond their walls.
"""

import argparse
import csv
import statistics
import sys
import tempfile
from pathlib import Path

import matplotlib
import open3d as o3d

from embree import Embree
from peers import Presight
from scene import triangles

matplotlib.use("svg")
import matplotlib.pyplot as plt  # noqa: E402

SENSORS = ("video-camera", "microwave-radar-image", "laser-scanner")
COLOURS = {"presight": "tab:blue", "Embree": "tab:orange", "parry": "tab:green"}


def arguments():
    parser = argparse.ArgumentParser(prog="benches/peers/run.sh growth.py", description=__doc__)
    parser.add_argument("--most", type=int, default=10_000_000, help="triangles of the largest office")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--poses", type=int, default=5)
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--out", type=Path, default=Path())
    return parser.parse_args()


def measure(size, options):
    """Rows (triangles, sensor, engine, milliseconds) of one office."""
    for backend in ("cpu", "parry"):
        with tempfile.TemporaryDirectory() as folder:
            peer = Presight(f"office:{size}", options, backend, folder)
            embree = Embree(triangles(peer.glb), options.threads) if backend == "cpu" else None
            for number, sensor in enumerate(peer.sensors):
                if sensor["name"] not in SENSORS:
                    continue
                mine, theirs = [], []
                for pose in range(len(peer.poses)):
                    # Of parry the time on the clock is known, which is the same on one thread of an idle machine.
                    told = peer.cpu_ms(number, pose, options.repeat, False) or peer.predict(number, pose, options.repeat)[0]
                    mine.append(min(told))
                    if embree:
                        rays, _ = peer.rays(number, pose)
                        theirs.append(min(embree.cpu_ms(o3d.core.Tensor(rays), options.repeat)))
                engine = "presight" if backend == "cpu" else "parry"
                yield [peer.polygons, sensor["name"], engine, statistics.median(mine)]
                if theirs:
                    yield [peer.polygons, sensor["name"], "Embree", statistics.median(theirs)]
            peer.close()
    print(f"measured {size} triangles", file=sys.stderr)


def plot(rows, path):
    figure, axes = plt.subplots(1, len(SENSORS), figsize=(12, 4), sharey=True, layout="constrained")
    for ax, name in zip(axes, SENSORS):
        for engine, colour in COLOURS.items():
            mine = sorted((r[0], r[3]) for r in rows if r[1] == name and r[2] == engine)
            ax.loglog(*zip(*mine), marker="o", color=colour, label=engine)
        ax.set(title=name, xlabel="triangles of the model")
        ax.grid(which="major", alpha=0.4)
    axes[0].set_ylabel("ms of CPU time an image")
    axes[0].legend()
    figure.suptitle("Cost of an image when the model grows beyond the walls")
    figure.savefig(path, metadata={"Date": None})


def main():
    options = arguments()
    sizes = [10**k for k in range(3, 8) if 10**k <= options.most]
    rows = [row for size in sizes for row in measure(size, options)]
    options.out.mkdir(parents=True, exist_ok=True)
    with open(options.out / "growth.csv", "w", newline="") as file:
        csv.writer(file).writerows([["triangles", "sensor", "engine", "ms"], *rows])
    plot(rows, options.out / "growth.svg")


if __name__ == "__main__":
    main()
