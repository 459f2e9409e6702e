//! Making environments: merging imported triangles into convex polygons.
