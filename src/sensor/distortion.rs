//! Lens distortion models of OpenCV and ROS.

use crate::error::{Error, Result};
use glam::DVec3;

/// Lens distortion, coefficients in OpenCV's order.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Distortion {
    /// Pinhole.
    #[default]
    None,
    /// k1 k2 p1 p2 k3: radial polynomial and tangential terms.
    PlumbBob([f64; 5]),
    /// k1 k2 p1 p2 k3 k4 k5 k6: rational radial function and tangential terms.
    RationalPolynomial([f64; 8]),
    /// k1 k2 k3 k4: polynomial in the angle from the axis (Kannala-Brandt, OpenCV fisheye).
    Equidistant([f64; 4]),
}

impl Distortion {
    /// True if rays need no table.
    pub fn is_none(&self) -> bool {
        *self == Self::None
    }

    pub(super) fn check(&self) -> Result<()> {
        Err(Error::invalid("lens distortion is not there yet", ""))
    }

    /// The ray (not normalized, z may be 0 or negative for fisheyes) that is imaged at distorted normalized
    /// coordinates, or `None` where the model folds over.
    pub fn undistort(&self, xd: f64, yd: f64) -> Option<DVec3> {
        Some(DVec3::new(xd, yd, 1.0))
    }
}
