"""Points of PLY and PCD, as Open3D, trimesh and pypcd4 read them, are rays times ranges, with all that the images say."""
import sys

import numpy
import open3d
import pypcd4
import trimesh
from numpy.testing import assert_allclose, assert_array_equal

in_world = sys.argv[1] == "world"
images = {name: numpy.load(f"{name}.npy") for name in ["range", "echo", "cos_incidence", "object_id", "polygon_id"]}
rays = numpy.load("rays.npy")
rows, columns = images["range"].shape
ring = numpy.repeat(numpy.arange(rows), columns)
scanner = rows == 16
seen = numpy.isfinite(images["range"]).ravel()
assert 0 < seen.sum(), "nothing is seen"
flat = {name: image.ravel() for name, image in images.items()}

# The pose of the test: rotation about the fixed axes x, then y, then z.
roll, pitch, yaw = numpy.radians([3, 5, 40])
c, s = numpy.cos, numpy.sin
about_x = numpy.array([[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]])
about_y = numpy.array([[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]])
about_z = numpy.array([[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]])
turn, place = (about_z @ about_y @ about_x, [1.2, 1.4, 0.9]) if in_world else (numpy.eye(3), [0, 0, 0])
directions = rays.reshape(-1, 3) @ turn.T
with numpy.errstate(invalid="ignore"):
    positions = directions * flat["range"][:, None].astype(float) + place


def check(points, normals, fields, mask):
    assert_allclose(points, positions[mask], atol=2e-6)
    # Towards the sensor, at the angle of incidence that the image holds.
    assert_allclose(-(normals * directions[mask]).sum(axis=1), flat["cos_incidence"][mask], atol=1e-5)
    assert_allclose(numpy.linalg.norm(normals, axis=1), 1, atol=1e-6)
    wanted = {"range": "range", "intensity": "echo", "object_id": "object_id", "polygon_id": "polygon_id"}
    assert set(fields) == set(wanted) | ({"ring"} if scanner else set()), fields.keys()
    for field, name in wanted.items():
        assert_array_equal(fields[field], flat[name][mask], field)
    if scanner:
        assert_array_equal(fields["ring"], ring[mask])


cloud = open3d.t.io.read_point_cloud("cloud.ply")
parts = {name: cloud.point[name].numpy() for name in cloud.point}
points, normals = parts.pop("positions"), parts.pop("normals")
check(points, normals, {name: part.ravel() for name, part in parts.items()}, seen)
plain = open3d.io.read_point_cloud("cloud.ply")
assert_allclose(numpy.asarray(plain.points), points, atol=1e-7)
assert_allclose(numpy.asarray(plain.normals), normals)

mesh = trimesh.load("cloud.ply")
vertex = mesh.metadata["_ply_raw"]["vertex"]["data"]
normals = numpy.stack([vertex[name].ravel() for name in ["nx", "ny", "nz"]], axis=1)
names = [name for name in vertex.dtype.names if name not in ("x", "y", "z", "nx", "ny", "nz")]
check(mesh.vertices, normals, {name: vertex[name].ravel() for name in names}, seen)

# Organized as PCL has it: one point a pixel. Its types: float coordinates and intensity, 16-bit rings.
cloud = pypcd4.PointCloud.from_path("cloud.pcd")
assert (cloud.metadata.width, cloud.metadata.height) == (columns, rows), cloud.metadata
types = dict(zip(cloud.fields, cloud.types))
for name in ["x", "y", "z", "normal_x", "normal_y", "normal_z", "range", "intensity"]:
    assert types[name] == numpy.float32, (name, types[name])
assert types.get("ring", numpy.uint16) == numpy.uint16
data = {name: cloud.pc_data[name] for name in cloud.fields}
points, normals = ([data.pop(n) for n in names] for names in (("x", "y", "z"), ("normal_x", "normal_y", "normal_z")))
points, normals = numpy.stack(points, axis=1), numpy.stack(normals, axis=1)
assert_array_equal(numpy.isnan(points).all(axis=1), ~seen)
check(points[seen], normals[seen], {name: part[seen] for name, part in data.items()}, seen)
plain = open3d.io.read_point_cloud("cloud.pcd", remove_nan_points=True)
assert_allclose(numpy.asarray(plain.points), points[seen], atol=1e-7)
assert_allclose(numpy.asarray(plain.normals), normals[seen])
