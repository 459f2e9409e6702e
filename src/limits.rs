//! A limit on everything: no input may ask for unbounded memory or time.

/// Longest image side, in pixels.
pub const MAX_IMAGE_SIDE: u32 = 16_384;
/// Most pixels of one image.
pub const MAX_PIXELS: u64 = 1 << 26;
/// Most polygons of one environment; ids are 32 bits and 0 is nothing.
pub const MAX_POLYGONS: u64 = 1 << 28;
/// Most objects of one environment.
pub const MAX_OBJECTS: usize = 1 << 22;
/// Most corners of one polygon.
pub const MAX_CORNERS: usize = 64;
/// Largest file read into memory, in bytes.
pub const MAX_FILE_BYTES: u64 = 4 << 30;
/// Polygons of one mesh cluster: the unit that selection keeps or drops.
pub const CLUSTER_POLYGONS: usize = 64;
/// Largest finite coordinate or range accepted, in metres: beyond it squares overflow f32.
pub const MAX_COORDINATE: f64 = 1e12;
/// Most triangles stored in one scene file, instances counted once.
pub const MAX_STORED_TRIANGLES: u64 = 1 << 25;
/// Most elements of an accessor that has no data behind it (zeros, replaced by a sparse part).
pub const MAX_ZERO_FILLED: u64 = 1 << 20;
/// Deepest nesting of nodes.
pub const MAX_NODE_DEPTH: usize = 1024;
/// Longest full node path, in bytes.
pub const MAX_NAME_BYTES: usize = 4096;
/// Problems of one kind that are listed with their place; the others are counted.
pub const LISTED_PROBLEMS: usize = 20;
/// Largest tolerance for merging triangles, relative to the size of the mesh.
pub const MAX_MERGE_TOLERANCE: f64 = 1e-3;
/// Longest line of a file of changes, in bytes.
pub const MAX_LINE_BYTES: u64 = 64 << 20;
