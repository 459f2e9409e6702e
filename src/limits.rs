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
