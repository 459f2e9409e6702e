#!/usr/bin/env python3
"""Makes room.glb, the furnished room of the README. Standard library only, the same bytes on every run.

    python3 scenes/make_room.py [scenes/room.glb]

Modelled in metres with z up; the one root node turns that into glTF's y up. The shell is 6.0 x 4.5 x 2.6 m with the
origin in a corner of the floor. It holds on purpose what importers have to cope with: shared meshes, non-uniform
scale (the unit box), a mirrored instance (the right sofa arm), several primitives to a mesh, nested nodes.
"""

import json
import math
import struct
import sys
from pathlib import Path

# name: (linear RGB, extras.presight). Sensor classes that are not named see a material opaque.
MATERIALS = {
    "plaster": ((0.85, 0.84, 0.80), {"reflection": 0.7}),
    "floor_oak": ((0.55, 0.38, 0.22), {"reflection": 0.5}),
    "ceiling_white": ((0.95, 0.95, 0.95), {"reflection": 0.8}),
    "wood": ((0.45, 0.28, 0.14), {"reflection": 0.45}),
    "painted_wood": ((0.90, 0.90, 0.88), {"reflection": 0.6}),
    "fabric": ((0.20, 0.30, 0.45), {"reflection": 0.25}),
    "cardboard": ((0.60, 0.45, 0.28), {"reflection": 0.4}),
    "metal": ((0.60, 0.61, 0.63), {"reflection": 0.95}),
    "concrete": ((0.55, 0.55, 0.54), {"reflection": 0.5}),
    "ceramic": ((0.80, 0.35, 0.22), {"reflection": 0.35}),
    "leaf": ((0.12, 0.40, 0.12), {"reflection": 0.3}),
    "glass": (
        (0.75, 0.88, 0.90),
        {"reflection": 0.08, "classes": {"laser": "transparent", "video": "transparent"}},
    ),
    "curtain": ((0.85, 0.55, 0.40), {"reflection": 0.2, "classes": {"radar": "invisible"}}),
}


class Mesh:
    """Polygons by material; corners counter-clockwise seen from outside."""

    def __init__(self):
        self.polygons = {}

    def polygon(self, material, corners):
        self.polygons.setdefault(material, []).append([tuple(map(float, c)) for c in corners])
        return self

    def box(self, material, low, high):
        (x0, y0, z0), (x1, y1, z1) = low, high
        p = [(x, y, z) for z in (z0, z1) for y in (y0, y1) for x in (x0, x1)]
        for a, b, c, d in ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)):
            self.polygon(material, (p[a], p[b], p[c], p[d]))
        return self

    def lathe(self, material, profile, sides):
        """Turns a profile of (radius, z), from bottom to top, about the z axis; radius 0 closes it."""

        def ring(radius, z):
            turns = (2 * math.pi * k / sides for k in range(sides))
            return [(radius * math.cos(t), radius * math.sin(t), z) for t in turns]

        for (r0, z0), (r1, z1) in zip(profile, profile[1:]):
            low, high = ring(r0, z0), ring(r1, z1)
            if r0 == 0.0 and z0 == z1:
                self.polygon(material, high[::-1])
                continue
            if r1 == 0.0 and z0 == z1:
                self.polygon(material, low)
                continue
            for k in range(sides):
                n = (k + 1) % sides
                corners = [low[k], low[n], high[n], high[k]]
                self.polygon(material, list(dict.fromkeys(corners)))
        return self

    def wall(self, material, length, height, thickness, hole):
        """A wall along +x with its inner face at y = 0 and a hole (x0, z0, x1, z1) through it."""
        hx0, hz0, hx1, hz1 = hole
        xs, zs = (0.0, hx0, hx1, length), sorted({0.0, hz0, hz1, height})
        for y, order in ((0.0, 1), (thickness, -1)):
            for x0, x1 in zip(xs, xs[1:]):
                for z0, z1 in zip(zs, zs[1:]):
                    if x0 >= hx0 and x1 <= hx1 and z0 >= hz0 and z1 <= hz1:
                        continue
                    face = ((x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1))
                    self.polygon(material, face[::order])
        t = thickness
        self.polygon(material, ((hx0, 0, hz0), (hx0, 0, hz1), (hx0, t, hz1), (hx0, t, hz0))[::-1])
        self.polygon(material, ((hx1, 0, hz0), (hx1, 0, hz1), (hx1, t, hz1), (hx1, t, hz0)))
        self.polygon(material, ((hx0, 0, hz1), (hx1, 0, hz1), (hx1, t, hz1), (hx0, t, hz1))[::-1])
        if hz0 > 0.0:
            self.polygon(material, ((hx0, 0, hz0), (hx1, 0, hz0), (hx1, t, hz0), (hx0, t, hz0)))
        return self


def meshes():
    m = {f"box_{name}": Mesh().box(name, (0, 0, 0), (1, 1, 1)) for name in MATERIALS}
    m["floor"] = Mesh().polygon("floor_oak", ((0, 0, 0), (6, 0, 0), (6, 4.5, 0), (0, 4.5, 0)))
    m["ceiling"] = Mesh().polygon("ceiling_white", ((0, 0, 2.6), (0, 4.5, 2.6), (6, 4.5, 2.6), (6, 0, 2.6)))
    m["wall_south"] = Mesh().polygon("plaster", ((0, 0, 0), (0, 0, 2.6), (6, 0, 2.6), (6, 0, 0)))
    m["wall_west"] = Mesh().polygon("plaster", ((0, 0, 0), (0, 4.5, 0), (0, 4.5, 2.6), (0, 0, 2.6)))
    m["wall_north"] = Mesh().wall("plaster", 6.0, 2.6, 0.12, (2.75, 0.0, 3.65, 2.05))
    m["wall_east"] = Mesh().wall("plaster", 4.5, 2.6, 0.25, (0.75, 0.9, 2.45, 2.1))
    m["corridor"] = (
        Mesh()
        .polygon("floor_oak", ((1.5, 4.62, 0), (4.9, 4.62, 0), (4.9, 6.0, 0), (1.5, 6.0, 0)))
        .polygon("floor_oak", ((2.75, 4.5, 0), (3.65, 4.5, 0), (3.65, 4.62, 0), (2.75, 4.62, 0)))
        .polygon("plaster", ((1.5, 6.0, 0), (4.9, 6.0, 0), (4.9, 6.0, 2.6), (1.5, 6.0, 2.6)))
        .polygon("ceiling_white", ((1.5, 4.62, 2.6), (1.5, 6.0, 2.6), (4.9, 6.0, 2.6), (4.9, 4.62, 2.6)))
    )
    m["column"] = Mesh().lathe("concrete", ((0, 0), (0.24, 0), (0.24, 0.12), (0.17, 0.2), (0.17, 2.6), (0, 2.6)), 24)
    m["door_leaf"] = (
        Mesh()
        .box("wood", (0, 0, 0.01), (0.86, 0.04, 2.02))
        .box("metal", (0.74, -0.06, 1.0), (0.80, 0.10, 1.03))
        .box("metal", (0.66, -0.07, 0.995), (0.80, -0.05, 1.035))
        .box("metal", (0.66, 0.09, 0.995), (0.80, 0.11, 1.035))
    )
    chair = Mesh().box("fabric", (-0.21, -0.21, 0.43), (0.21, 0.21, 0.48))
    for x in (-0.20, 0.16):
        for y in (-0.20, 0.16):
            chair.box("wood", (x, y, 0), (x + 0.04, y + 0.04, 0.43 if x > 0 else 0.92))
    for z in (0.58, 0.70, 0.82):
        chair.box("wood", (-0.195, -0.16, z), (-0.17, 0.16, z + 0.07))
    m["chair"] = chair
    m["mug"] = Mesh().lathe("ceramic", ((0, 0), (0.04, 0), (0.04, 0.1), (0.034, 0.1), (0.034, 0.01), (0, 0.01)), 12)
    m["bowl"] = Mesh().lathe("ceramic", ((0, 0), (0.06, 0), (0.15, 0.08), (0.14, 0.08), (0.05, 0.01), (0, 0.01)), 16)
    m["lamp"] = (
        Mesh()
        .lathe("metal", ((0, 0.14), (0.008, 0.14), (0.008, 0.75), (0, 0.75)), 6)
        .lathe("metal", ((0.24, -0.12), (0.09, 0.14), (0, 0.14)), 16)
        .lathe("glass", ((0, -0.08), (0.04, -0.06), (0.06, 0.0), (0.04, 0.06), (0, 0.08)), 10)
    )
    pot = ((0, 0), (0.13, 0), (0.18, 0.32), (0.16, 0.32), (0.15, 0.26), (0, 0.26))
    plant = Mesh().lathe("ceramic", pot, 14).lathe("wood", ((0.015, 0.26), (0.012, 0.9)), 6)
    for k in range(14):
        turn, lift = 2.399963 * k, 0.45 + 0.045 * k  # the golden angle spreads the leaves
        c, s, reach = math.cos(turn), math.sin(turn), 0.42 - 0.012 * k
        tip, mid = lift + 0.22, lift + 0.14
        left = (0.5 * reach * c - 0.07 * s, 0.5 * reach * s + 0.07 * c, mid)
        right = (0.5 * reach * c + 0.07 * s, 0.5 * reach * s - 0.07 * c, mid)
        plant.polygon("leaf", ((0, 0, lift), right, left)).polygon("leaf", (left, right, (reach * c, reach * s, tip)))
    m["plant"] = plant
    arm = Mesh().box("fabric", (0, 0, 0.08), (0.85, 0.18, 0.62))
    m["sofa_arm"] = arm.polygon("fabric", ((0, 0, 0.62), (0.85, 0, 0.62), (0.85, 0.06, 0.68), (0, 0.06, 0.68)))
    folds = [(0.055 * k, 0.05 * (k % 2)) for k in range(9)]
    curtain = Mesh()
    for (a0, b0), (a1, b1) in zip(folds, folds[1:]):
        curtain.polygon("curtain", ((b0, a0, 0.15), (b1, a1, 0.15), (b1, a1, 2.3), (b0, a0, 2.3)))
    m["curtain"] = curtain
    return m


def node(name, mesh=None, at=(0, 0, 0), turn_deg=0.0, scale=None, children=()):
    """A node turned about z; `matrix` where it is mirrored, translation, rotation and scale elsewhere."""
    n = {"name": name}
    if mesh:
        n["mesh"] = mesh
    if any(at):
        n["translation"] = list(map(float, at))
    if turn_deg:
        half = math.radians(turn_deg) / 2
        n["rotation"] = [0.0, 0.0, round(math.sin(half), 9), round(math.cos(half), 9)]
    if scale:
        n["scale"] = list(map(float, scale))
    if children:
        n["children"] = list(children)
    return n


def block(name, material, low, high):
    """The unit box stretched to a place: one mesh to a material, non-uniform scale."""
    size = [round(b - a, 6) for a, b in zip(low, high)]
    return node(name, f"box_{material}", low, scale=size)


def shelf():
    parts = [block("side_left", "wood", (0, 0, 0), (0.03, 0.32, 1.9))]
    parts.append(block("side_right", "wood", (1.27, 0, 0), (1.3, 0.32, 1.9)))
    for k, z in enumerate((0.05, 0.42, 0.79, 1.16, 1.53, 1.87)):
        parts.append(block(f"board_{k}", "wood", (0.03, 0, z), (1.27, 0.32, z + 0.03)))
    boxes = ((0.08, 0, 0.5, 0.26), (0.66, 0, 0.5, 0.2), (0.1, 1, 0.34, 0.24), (0.5, 1, 0.3, 0.3), (0.86, 1, 0.34, 0.18))
    boxes += ((0.75, 2, 0.42, 0.27), (0.08, 3, 0.42, 0.22), (0.1, 5, 0.4, 0.25))
    floors = (0.08, 0.45, 0.82, 1.19, 1.56, 1.90)
    for k, (x, level, width, height) in enumerate(boxes):
        z = floors[level]
        parts.append(block(f"box_{k}", "cardboard", (x, 0.03, z), (x + width, 0.29, z + height)))
    for row, (level, x, count) in enumerate(((2, 0.06, 11), (3, 0.62, 13), (4, 0.08, 16))):
        for k in range(count):
            height, width = 0.2 + 0.03 * ((5 * k + row) % 4), 0.025 + 0.01 * ((3 * k + row) % 3)
            material = ("fabric", "ceramic", "painted_wood", "leaf")[(k * k + row) % 4]
            low, high = (x, 0.07, floors[level]), (x + width, 0.27, floors[level] + height)
            parts.append(block(f"book_{row}_{k}", material, low, high))
            x = round(x + width + 0.004, 6)
    return node("shelf", at=(4.1, 4.16, 0), children=parts)


def table():
    parts = [block("top", "wood", (-0.75, -0.45, 0.71), (0.75, 0.45, 0.75))]
    for k, (x, y) in enumerate(((-0.7, -0.4), (0.64, -0.4), (-0.7, 0.34), (0.64, 0.34))):
        parts.append(block(f"leg_{k}", "wood", (x, y, 0), (x + 0.06, y + 0.06, 0.71)))
    laptop = [
        block("base", "metal", (-0.17, -0.12, 0), (0.17, 0.12, 0.018)),
        block("lid", "metal", (-0.17, 0.12, 0.018), (0.17, 0.13, 0.24)),
    ]
    parts.append(node("laptop", at=(0.3, 0.05, 0.75), turn_deg=-55, children=laptop))
    parts.append(node("mug", "mug", (-0.1, 0.25, 0.75)))
    parts.append(node("bowl", "bowl", (-0.35, -0.08, 0.75)))
    return node("table", at=(3.45, 2.15, 0), turn_deg=8, children=parts)


def door():
    frame = [
        block("jamb_left", "painted_wood", (2.69, 4.47, 0), (2.77, 4.65, 2.03)),
        block("jamb_right", "painted_wood", (3.63, 4.47, 0), (3.71, 4.65, 2.03)),
        block("lintel", "painted_wood", (2.69, 4.47, 2.03), (3.71, 4.65, 2.11)),
    ]
    # Hinged on the right jamb and opened by 38 degrees into the room.
    return node("door", children=[node("frame", children=frame), node("leaf", "door_leaf", (3.63, 4.47, 0), 218)])


def window():
    parts = []
    for name, low, high in (
        ("frame_bottom", (6.08, 2.05, 0.9), (6.14, 3.75, 0.97)),
        ("frame_top", (6.08, 2.05, 2.03), (6.14, 3.75, 2.1)),
        ("frame_left", (6.08, 3.68, 0.97), (6.14, 3.75, 2.03)),
        ("frame_right", (6.08, 2.05, 0.97), (6.14, 2.12, 2.03)),
        ("mullion", (6.08, 2.87, 0.97), (6.14, 2.93, 2.03)),
        ("sill", (5.92, 2.0, 0.86), (6.08, 3.8, 0.9)),
    ):
        parts.append(block(name, "painted_wood", low, high))
    parts.append(block("pane_left", "glass", (6.105, 2.93, 0.97), (6.115, 3.68, 2.03)))
    parts.append(block("pane_right", "glass", (6.105, 2.12, 0.97), (6.115, 2.87, 2.03)))
    parts.append(node("curtain", "curtain", (5.9, 3.72, 0)))
    fins = [block(f"fin_{k}", "metal", (5.86, 2.2 + 0.1 * k, 0.15), (5.97, 2.26 + 0.1 * k, 0.75)) for k in range(14)]
    parts.append(node("radiator", children=fins))
    return node("window", children=parts)


def sofa():
    parts = [
        block("seat", "fabric", (0, 0.18, 0.08), (0.85, 1.62, 0.42)),
        block("back", "fabric", (0, 0.18, 0.42), (0.22, 1.62, 0.85)),
        node("arm_left", "sofa_arm"),
        {
            "name": "arm_right",
            "mesh": "sofa_arm",
            "matrix": [1.0, 0, 0, 0, 0, -1.0, 0, 0, 0, 0, 1.0, 0, 0, 1.8, 0, 1.0],
        },
    ]
    return node("sofa", at=(2.9, 0.05, 0), turn_deg=90, children=parts)


def scene():
    shell = [node(n, n) for n in ("floor", "ceiling", "wall_south", "wall_west", "corridor")]
    shell.append(node("wall_north", "wall_north", (0, 4.5, 0)))
    shell.append(node("wall_east", "wall_east", (6, 4.5, 0), -90))
    shell.append(node("column", "column", (5.1, 1.72, 0)))
    shell.append(block("beam", "wood", (0, 2.1, 2.42), (6, 2.28, 2.6)))
    seats = (((3.0, 1.45, 0), 85), ((4.0, 1.5, 0), 110), ((3.1, 2.95, 0), -80), ((4.55, 2.4, 0), 188))
    chairs = [node(f"chair_{k}", "chair", at, turn) for k, (at, turn) in enumerate(seats)]
    picture = [
        block("frame", "wood", (1.55, 4.46, 1.2), (2.3, 4.5, 1.8)),
        block("canvas", "fabric", (1.6, 4.455, 1.25), (2.25, 4.46, 1.75)),
    ]
    return node(
        "room",
        children=[
            node("building", children=shell),
            door(),
            window(),
            table(),
            *chairs,
            block("rug", "fabric", (2.2, 1.2, 0.0), (4.9, 3.2, 0.012)),
            shelf(),
            sofa(),
            node("lamp", "lamp", (3.4, 2.45, 1.85)),
            node("plant", "plant", (5.62, 1.2, 0)),
            node("picture", children=picture),
            block("parcel", "cardboard", (1.75, 3.5, 0), (2.3, 3.9, 0.38)),
        ],
    )


def pad(data, fill):
    return data + fill * (-len(data) % 4)


def glb(root, mesh_table):
    """Writes nodes depth-first, meshes in the order of their first use."""
    gltf = {
        "asset": {"version": "2.0", "generator": "presight scenes/make_room.py"},
        "scene": 0,
        "scenes": [{"name": "room", "nodes": [0]}],
        "nodes": [],
        "meshes": [],
        "materials": [],
        "accessors": [],
        "bufferViews": [],
    }
    binary, mesh_index, material_index = bytearray(), {}, {}

    def view(data, target):
        gltf["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), "target": target}
        )
        binary.extend(pad(data, b"\0"))
        return len(gltf["bufferViews"]) - 1

    def material(name):
        if name not in material_index:
            material_index[name] = len(gltf["materials"])
            color, extras = MATERIALS[name]
            pbr = {"baseColorFactor": [*color, 0.3 if name == "glass" else 1.0], "metallicFactor": 0.0}
            entry = {"name": name, "pbrMetallicRoughness": pbr, "doubleSided": True}
            if name == "glass":
                entry["alphaMode"] = "BLEND"
            gltf["materials"].append({**entry, "extras": {"presight": extras}})
        return material_index[name]

    def primitive(name, polygons):
        corners, indices = {}, []
        for polygon in polygons:
            ids = [corners.setdefault(struct.pack("<3f", *c), len(corners)) for c in polygon]
            for k in range(1, len(ids) - 1):
                indices += [ids[0], ids[k], ids[k + 1]]
        points = [struct.unpack("<3f", c) for c in corners]
        low, high = [min(axis) for axis in zip(*points)], [max(axis) for axis in zip(*points)]
        positions = {"bufferView": view(b"".join(corners), 34962), "componentType": 5126, "count": len(points)}
        gltf["accessors"].append({**positions, "type": "VEC3", "min": low, "max": high})
        packed = struct.pack(f"<{len(indices)}H", *indices)
        indexing = {"bufferView": view(packed, 34963), "componentType": 5123, "count": len(indices)}
        gltf["accessors"].append({**indexing, "type": "SCALAR"})
        last = len(gltf["accessors"]) - 1
        return {"attributes": {"POSITION": last - 1}, "indices": last, "material": material(name)}

    def add_mesh(name):
        if name not in mesh_index:
            mesh_index[name] = len(gltf["meshes"])
            primitives = [primitive(m, p) for m, p in mesh_table[name].polygons.items()]
            gltf["meshes"].append({"name": name, "primitives": primitives})
        return mesh_index[name]

    def add_node(n):
        index = len(gltf["nodes"])
        gltf["nodes"].append({k: v for k, v in n.items() if k != "children"})
        if "mesh" in n:
            gltf["nodes"][index]["mesh"] = add_mesh(n["mesh"])
        if "children" in n:
            gltf["nodes"][index]["children"] = [add_node(child) for child in n["children"]]
        return index

    # z-up to y-up, column-major: x to x, y to -z, z to y.
    add_node({"matrix": [1.0, 0, 0, 0, 0, 0, -1.0, 0, 0, 1.0, 0, 0, 0, 0, 0, 1.0], **root})
    gltf["buffers"] = [{"byteLength": len(binary)}]
    text = pad(json.dumps(gltf, separators=(",", ":")).encode(), b" ")
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def main():
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).with_name("room.glb")
    out.write_bytes(glb(scene(), meshes()))
    print(f"{out}: {out.stat().st_size} bytes")


if __name__ == "__main__":
    main()
