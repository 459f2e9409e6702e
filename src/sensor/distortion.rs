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

    /// The model of this name, as ROS and our files write it, with its coefficients in OpenCV's order: `none` (0),
    /// `plumb_bob` (4 or 5), `rational_polynomial` (8), `equidistant` and its alias `kannala_brandt` (4).
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] on an unknown name or another number of coefficients.
    pub fn from_model(model: &str, coefficients: &[f64]) -> Result<Self> {
        let count = |expected: &str| {
            Error::invalid(
                format!("{} coefficients for {model}", coefficients.len()),
                format!("give {expected}, in OpenCV's order"),
            )
        };
        match (model, coefficients) {
            ("none", []) => Ok(Self::None),
            ("none", _) => Err(count("none")),
            ("plumb_bob", &[k1, k2, p1, p2]) => Ok(Self::PlumbBob([k1, k2, p1, p2, 0.0])),
            ("plumb_bob", &[k1, k2, p1, p2, k3]) => Ok(Self::PlumbBob([k1, k2, p1, p2, k3])),
            ("plumb_bob", _) => Err(count("4 or 5: k1, k2, p1, p2, k3")),
            ("rational_polynomial", c) => {
                Ok(Self::RationalPolynomial(c.try_into().map_err(|_| count("8: k1, k2, p1, p2, k3, k4, k5, k6"))?))
            }
            ("equidistant" | "kannala_brandt", c) => {
                Ok(Self::Equidistant(c.try_into().map_err(|_| count("4: k1, k2, k3, k4"))?))
            }
            _ => Err(Error::invalid(
                format!("distortion model {model:?} is unknown"),
                "give none, plumb_bob, rational_polynomial, equidistant or kannala_brandt",
            )),
        }
    }

    pub(super) fn check(&self) -> Result<()> {
        if self.is_none() {
            return Ok(());
        }
        if self.is_none() {
            return Ok(());
        }
        Err(Error::invalid("lens distortion is not there yet", ""))
    }

    /// The ray (not normalized, z may be 0 or negative for fisheyes) that is imaged at distorted normalized
    /// coordinates, or `None` where the model folds over.
    pub fn undistort(&self, xd: f64, yd: f64) -> Option<DVec3> {
        Some(DVec3::new(xd, yd, 1.0))
    }
}
