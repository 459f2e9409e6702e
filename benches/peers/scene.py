"""Reads the triangles of a .glb, apart from presight: JSON, struct and numpy."""

import json
import struct

import numpy as np

COMPONENT = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTH = {"SCALAR": 1, "VEC3": 3}
Z_UP_FROM_Y_UP = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]], dtype=np.float64)


def read_chunks(path):
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    if magic != b"glTF" or version != 2 or length > len(data):
        raise SystemExit(f"{path}: not a whole glTF 2.0 binary")
    chunks, at = {}, 12
    while at < length:
        size, kind = struct.unpack_from("<I4s", data, at)
        chunks[kind] = data[at + 8 : at + 8 + size]
        at += 8 + size
    return json.loads(chunks[b"JSON"]), chunks[b"BIN\0"]


def accessor(gltf, binary, index):
    a = gltf["accessors"][index]
    if "sparse" in a or a.get("normalized"):
        raise SystemExit("this small reader knows neither sparse nor normalized accessors")
    view = gltf["bufferViews"][a["bufferView"]]
    kind, width = np.dtype(COMPONENT[a["componentType"]]), WIDTH[a["type"]]
    start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
    stride = view.get("byteStride", kind.itemsize * width)
    shape, strides = (a["count"], width), (stride, kind.itemsize)
    return np.ndarray(shape, kind, binary, start, strides).copy()


def local_matrix(node):
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    m = np.eye(4)
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    m[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    m[:3, :3] *= np.array(node.get("scale", (1, 1, 1)), dtype=np.float64)
    m[:3, 3] = node.get("translation", (0, 0, 0))
    return m


def triangles(path):
    """All triangles, z-up, f64, shape (n, 3, 3), in the order that `source` ids number them."""
    gltf, binary = read_chunks(path)
    cache, out = {}, []

    def mesh(index):
        if index not in cache:
            parts = []
            for p in gltf["meshes"][index]["primitives"]:
                if p.get("mode", 4) != 4:
                    raise SystemExit("this small reader knows triangle lists only")
                points = accessor(gltf, binary, p["attributes"]["POSITION"]).astype(np.float64)
                corners = accessor(gltf, binary, p["indices"])[:, 0] if "indices" in p else np.arange(len(points))
                parts.append(points[corners.astype(np.int64)].reshape(-1, 3, 3))
            cache[index] = np.concatenate(parts)
        return cache[index]

    def walk(index, world_from_parent):
        node = gltf["nodes"][index]
        world_from_node = world_from_parent @ local_matrix(node)
        if "mesh" in node:
            points = mesh(node["mesh"]) @ world_from_node[:3, :3].T + world_from_node[:3, 3]
            out.append(points @ Z_UP_FROM_Y_UP.T)
        for child in node.get("children", ()):
            walk(child, world_from_node)

    for root in gltf["scenes"][gltf.get("scene", 0)]["nodes"]:
        walk(root, np.eye(4))
    return np.concatenate(out)
