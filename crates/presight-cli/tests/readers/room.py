"""A furnished room as trimesh exports it: z up, y up, and z up in millimetres."""
import numpy
import trimesh

room = trimesh.Scene()
for name, size, place in [
    ("floor", [8, 6, 0.1], [4, 3, -0.05]),
    ("north", [8, 0.1, 3], [4, 6.05, 1.5]),
    ("east", [0.1, 6, 3], [8.05, 3, 1.5]),
    ("table", [1.6, 0.8, 0.05], [5, 2, 0.75]),
]:
    room.add_geometry(trimesh.creation.box(extents=size).apply_translation(place), geom_name=name, node_name=name)
turn = trimesh.transformations.rotation_matrix(0.3, [0.2, 0.5, 1])
turn[:3, 3] = [4.5, 3.5, 0.8]
room.add_geometry(trimesh.creation.icosphere(radius=0.6), geom_name="ball", node_name="ball", transform=turn)
room.export("z.glb")
y_up_from_z_up = numpy.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
for name, transform in [("y", y_up_from_z_up), ("mm", numpy.diag([1000, 1000, 1000, 1.0]))]:
    other = trimesh.Scene()
    for node in room.graph.nodes_geometry:
        placed, geometry = room.graph[node]
        mesh = room.geometry[geometry].copy().apply_transform(transform @ placed)
        other.add_geometry(mesh, geom_name=node, node_name=node)
    other.export(f"{name}.glb")
