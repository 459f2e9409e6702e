"""The fields of a cloud, in their order."""
import sys

import pypcd4
import trimesh

path, wanted = sys.argv[1:]
if path.endswith(".pcd"):
    found = pypcd4.PointCloud.from_path(path).fields
else:
    found = trimesh.load(path).metadata["_ply_raw"]["vertex"]["data"].dtype.names
assert " ".join(found) == wanted, found
