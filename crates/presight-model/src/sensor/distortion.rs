//! The lens distortion models of OpenCV and ROS, with their inverses.
//!
//! Normalized coordinates are (x, y) = (X / Z, Y / Z), with r^2 = x^2 + y^2 and p = (p2, p1):
//! - `plumb_bob`, `rational_polynomial`: (xd, yd) = R(r^2) (x, y) + r^2 p + 2 (p . (x, y)) (x, y) with
//!   R(s) = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3);
//! - `equidistant`: the image radius of a ray at angle theta from the axis is theta (1 + k1 theta^2 + k2 theta^4 +
//!   k3 theta^6 + k4 theta^8); theta may exceed 90 degrees.
//!
//! Source: OpenCV, modules `calib3d` and `fisheye`; ROS `sensor_msgs/CameraInfo`.

use crate::error::{Error, Result};

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
    /// Makes a model from its name in ROS and in sensor files, and its coefficients in OpenCV's order: `none` (0),
    /// `plumb_bob` (4 or 5), `rational_polynomial` (8), `equidistant` and its aliases `kannala_brandt` and `fisheye` (4).
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
            ("equidistant" | "kannala_brandt" | "fisheye", c) => {
                Ok(Self::Equidistant(c.try_into().map_err(|_| count("4: k1, k2, k3, k4"))?))
            }
            _ => Err(Error::invalid(
                format!("distortion model {model:?} is unknown"),
                "give none, plumb_bob, rational_polynomial or equidistant (also called fisheye, kannala_brandt)",
            )),
        }
    }

    /// The model's name in files; [`Distortion::from_model`] reads it.
    pub fn model(&self) -> &'static str {
        match self {
            Self::None => "none",
            Self::PlumbBob(_) => "plumb_bob",
            Self::RationalPolynomial(_) => "rational_polynomial",
            Self::Equidistant(_) => "equidistant",
        }
    }

    /// The coefficients in OpenCV's order.
    pub fn coefficients(&self) -> &[f64] {
        match self {
            Self::None => &[],
            Self::PlumbBob(c) => c,
            Self::RationalPolynomial(c) => c,
            Self::Equidistant(c) => c,
        }
    }

    /// True if straight lines stay straight, so that rays need no table. An equidistant lens bends lines even if all its
    /// coefficients are 0.
    pub fn is_none(&self) -> bool {
        !matches!(self, Self::Equidistant(_)) && self.coefficients().iter().all(|c| *c == 0.0)
    }

    /// # Errors
    /// [`crate::ErrorKind::Invalid`] on NaN, infinity, or numbers whose powers would overflow.
    pub(super) fn check(&self) -> Result<()> {
        match self.coefficients().iter().position(|c| !(c.abs() <= 1e9)) {
            None => Ok(()),
            Some(i) => Err(Error::invalid(
                format!("distortion coefficient {i} is {}", self.coefficients()[i]),
                "give finite coefficients of at most 1e9",
            )),
        }
    }
}
