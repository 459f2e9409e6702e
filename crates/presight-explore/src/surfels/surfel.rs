//! Surfels, and the limits of surfels on one plane.

use glam::DVec3;

/// Maximum distance of a surfel from the plane of its region, in sizes of the surfel.
pub(crate) const NEAR: f64 = 0.25;
/// Minimum cosine between normals on one plane: 25 degrees.
pub(crate) const SIMILAR: f64 = 0.906;

/// A small piece of a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surfel {
    /// Relative to the base of the views, metres.
    pub at: DVec3,
    /// Unit normal towards the sensor.
    pub normal: DVec3,
    /// Sum of the weights of its pixels.
    pub weight: f64,
    /// Side of its cube, metres.
    pub size: f64,
}
