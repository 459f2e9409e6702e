//! The region around the measured points of a voxel.

use glam::{DMat3, DVec3};

/// Evenly spread points reach this number of standard deviations from their mean, squared.
pub(crate) const REACH_SQUARED: f64 = 3.0;

/// The region around the measured points of a voxel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spot {
    /// World, metres.
    pub mean: DVec3,
    /// Inverse of the covariance of its points.
    pub sharpness: DMat3,
}

impl Spot {
    /// A spot of unknown shape in a cube. Points of a surface are equally likely anywhere in it, and most rays that
    /// come this near to its middle cross it.
    pub fn cube(mean: DVec3, size: f64) -> Self {
        Self { mean, sharpness: DMat3::from_diagonal(DVec3::splat(REACH_SQUARED / (0.7 * size).powi(2))) }
    }

    /// True if a point at this offset from the mean is in the spot.
    pub fn holds(&self, offset: DVec3) -> bool {
        offset.dot(self.sharpness * offset) <= REACH_SQUARED
    }
}
