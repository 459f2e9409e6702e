//! The lens distortion models of OpenCV and ROS, with their inverses.
//!
//! Normalized coordinates are (x, y) = (X / Z, Y / Z), with r^2 = x^2 + y^2 and p = (p2, p1):
//! - `plumb_bob`, `rational_polynomial`: (xd, yd) = R(r^2) (x, y) + r^2 p + 2 (p . (x, y)) (x, y) + r^2 (s1, s3) +
//!   r^4 (s2, s4) with R(s) = (1 + k1 s + k2 s^2 + k3 s^3) / (1 + k4 s + k5 s^2 + k6 s^3). A tilted image sensor maps
//!   these coordinates to its own plane ([`super::undistort`]);
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
    /// k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 tauX tauY: rational radial function, tangential and thin prism terms, and
    /// the tilt of the image sensor about its x and y axes, radians.
    RationalPolynomial([f64; 14]),
    /// k1 k2 k3 k4: polynomial in the angle from the axis (Kannala-Brandt, OpenCV fisheye).
    Equidistant([f64; 4]),
}

impl Distortion {
    /// Makes a model from its name in ROS and in sensor files, and its coefficients in OpenCV's order: `none` (0),
    /// `plumb_bob` (4 or 5), `rational_polynomial` (8, 12 or 14), `equidistant` and its aliases `kannala_brandt` and
    /// `fisheye` (4). More zeros may follow.
    ///
    /// ```
    /// use presight::sensor::Distortion;
    /// let lens = Distortion::from_model("equidistant", &[0.1, -0.02, 0.0, 0.0, 0.0])?;
    /// assert_eq!(lens, Distortion::Equidistant([0.1, -0.02, 0.0, 0.0]));
    /// assert!(Distortion::from_model("equidistant", &[0.1, -0.02, 0.0, 0.0, 0.3]).is_err());
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] on an unknown name or another number of coefficients.
    pub fn from_model(model: &str, coefficients: &[f64]) -> Result<Self> {
        let (counts, names): (&[usize], _) = match model {
            "none" => (&[0], "none"),
            "plumb_bob" => (&[4, 5], "k1, k2, p1, p2, k3"),
            "rational_polynomial" => (&[8, 12, 14], "k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tauX, tauY"),
            "equidistant" | "kannala_brandt" | "fisheye" => (&[4], "k1, k2, k3, k4"),
            _ => {
                return Err(Error::invalid(
                    format!("distortion model {model:?} is unknown"),
                    "give none, plumb_bob, rational_polynomial or equidistant (also called fisheye, kannala_brandt)",
                ));
            }
        };
        // Drivers fill arrays of a fixed length with zeros.
        let fits = |count: &usize| coefficients.get(*count..).is_some_and(|rest| rest.iter().all(|c| *c == 0.0));
        if !counts.iter().any(fits) {
            return Err(wrong_count(model, coefficients.len(), counts, names));
        }
        Ok(match model {
            "none" => Self::None,
            "plumb_bob" => Self::PlumbBob(filled(coefficients)),
            "rational_polynomial" => Self::RationalPolynomial(filled(coefficients)),
            _ => Self::Equidistant(filled(coefficients)),
        })
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

    /// The coefficients in OpenCV's order, of `rational_polynomial` the first 8 or 12 if only zeros follow.
    pub fn coefficients(&self) -> &[f64] {
        match self {
            Self::None => &[],
            Self::PlumbBob(c) => c,
            Self::RationalPolynomial(c) => {
                let used = c.iter().rposition(|c| *c != 0.0).map_or(0, |last| last + 1);
                &c[..[8, 12].into_iter().find(|count| used <= *count).unwrap_or(14)]
            }
            Self::Equidistant(c) => c,
        }
    }

    /// True if straight lines stay straight, so that rays need no table. An equidistant lens bends lines even if all
    /// its coefficients are 0.
    pub fn is_none(&self) -> bool {
        !matches!(self, Self::Equidistant(_)) && self.coefficients().iter().all(|c| *c == 0.0)
    }

    /// # Errors
    /// [`crate::ErrorKind::Invalid`] on NaN, infinity, numbers whose powers would overflow, and a sensor tilted by a
    /// right angle or more.
    pub(super) fn check(&self) -> Result<()> {
        if let Some(i) = self.coefficients().iter().position(|c| !(c.abs() <= 1e9)) {
            return Err(Error::invalid(
                format!("distortion coefficient {i} is {}", self.coefficients()[i]),
                "give finite coefficients of at most 1e9",
            ));
        }
        match self {
            Self::RationalPolynomial([.., tau_x, tau_y]) if tau_x.abs().max(tau_y.abs()) > MAX_TILT => {
                let what = format!("an image sensor tilted by tauX = {tau_x}, tauY = {tau_y} rad");
                Err(Error::invalid(what, format!("give radians of at most {MAX_TILT}")))
            }
            _ => Ok(()),
        }
    }
}

/// Radians. At a right angle the image sensor is seen edge-on.
const MAX_TILT: f64 = 1.5;

/// The coefficients, with zeros after them.
fn filled<const N: usize>(coefficients: &[f64]) -> [f64; N] {
    std::array::from_fn(|i| coefficients.get(i).copied().unwrap_or(0.0))
}

/// The error of coefficients that a model does not have. Its remedy never leaves out a coefficient, which would move
/// the pixels.
fn wrong_count(model: &str, given: usize, counts: &[usize], names: &str) -> Error {
    let listed: Vec<String> = counts.iter().map(usize::to_string).collect();
    let listed = listed.join(" or ");
    if given > counts[counts.len() - 1] {
        let other = if model == "plumb_bob" { ", such as rational_polynomial for 8, 12 or 14" } else { "" };
        let what = format!("{given} coefficients for {model}, which has {names}");
        return Error::invalid(what, format!("name the model that they belong to{other}"));
    }
    let what = format!("{given} coefficients for {model}");
    Error::invalid(what, format!("give {listed}, in OpenCV's order with zeros at the end: {names}"))
}
