"""How far the poses that come with the living room are off at the end of the flight, by Open3D's ICP on its noise-free depth images.

benches/peers/run.sh flight.py: the motion from the last pose of poses.txt to the pose by ICP, in body axes (x ahead, y left, z up), once
from the first frame straight to the last one, and once in steps of five frames. The two ways share no pair of frames. The poses of
poses.txt, which a pose graph made of such steps, are where ICP starts. The first frame's pose holds; frames 1 to 4, whose true poses are
known (poses_noisy.txt), show how far ICP is off.
"""

import os
from pathlib import Path

import numpy as np
import open3d as o3d

HERE = Path(__file__).resolve().parent
ROOM = Path(os.environ.get("PRESIGHT_DATA", HERE.parents[2] / "shared" / "data")) / "rgbd" / "livingroom"
CAMERA = o3d.camera.PinholeCameraIntrinsic(640, 480, 525.0, 525.0, 319.5, 239.5)
registration = o3d.pipelines.registration
BODY_FROM_IMAGE = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def poses(name):
    found = {}
    for line in (ROOM / name).read_text().splitlines():
        if not line.startswith("#"):
            frame, x, y, z, *quaternion = line.split()[:8]
            pose = np.eye(4)
            quaternion = np.roll([float(q) for q in quaternion], 1)
            pose[:3, :3] = o3d.geometry.get_rotation_matrix_from_quaternion(quaternion / np.linalg.norm(quaternion))
            pose[:3, 3] = float(x), float(y), float(z)
            found[int(frame)] = pose
    return found


def cloud(frame):
    depth = o3d.io.read_image(str(ROOM / "depth" / f"{frame:05d}.png"))
    points = o3d.geometry.PointCloud.create_from_depth_image(depth, CAMERA, np.eye(4), 1000, 10, 2).voxel_down_sample(0.01)
    points.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(0.05, 30))
    points.orient_normals_towards_camera_location()
    return points


def icp(first, second, start):
    """The pose of the second frame in the first."""
    a, b = cloud(first), cloud(second)
    criteria = registration.ICPConvergenceCriteria(1e-9, 1e-9, 100)
    for reach in (0.05, 0.02, 0.01):
        to_plane = registration.TransformationEstimationPointToPlane()
        start = registration.registration_icp(b, a, reach, start, to_plane, criteria).transformation
    return start


def motion(before, after):
    """Translation and rotation vector from one pose to another, in the body axes of the first."""
    between = np.linalg.inv(before) @ after
    turn = between[:3, :3]
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    angle = np.arcsin(min(1.0, np.linalg.norm(axis)))
    vector = axis * (angle / np.linalg.norm(axis)) if angle > 0 else axis
    return np.concatenate([BODY_FROM_IMAGE @ between[:3, 3], BODY_FROM_IMAGE @ vector])


def said(name, six):
    numbers = ", ".join(f"{number:.5f}" for number in six)
    degrees = np.degrees(np.linalg.norm(six[3:]))
    print(f"{name}: [{numbers}], {1e3 * np.linalg.norm(six[:3]):.1f} mm, {degrees:.3f} deg", flush=True)


def main():
    log, true = poses("poses.txt"), poses("poses_noisy.txt")
    last = max(log)
    between = lambda known, a, b: np.linalg.inv(known[a]) @ known[b]  # noqa: E731
    for frame in (2, 4):
        found = icp(0, frame, between(log, 0, frame))
        said(f"frame {frame}, ICP off the truth", motion(between(true, 0, frame), found))
    said(f"frame {last}, straight", motion(between(log, 0, last), icp(0, last, between(log, 0, last))))
    chain = np.eye(4)
    for frame in range(0, last, 5):
        chain = chain @ icp(frame, frame + 5, between(log, frame, frame + 5))
    said(f"frame {last}, in steps", motion(between(log, 0, last), chain))


if __name__ == "__main__":
    main()
