//! Regions of interest: the image box in which a feature will be found with a stated probability (paper section 3.2,
//! Fig. 10).
//!
//! The errors of the sensor's pose, the object's pose and the feature form one standard normal vector, mapped through
//! square roots of their covariances (`errors`). The feature passes a side of the box when a linear function of that
//! vector exceeds a threshold. All thresholds are at the same number k of standard deviations, chosen so that any side
//! is passed with probability at most 1 - confidence (`exceedance`). For events `A_i` with tails `P(A_i)`:
//!
//! ```text
//! P(A_1 or .. or A_n) <= sum_i P(A_i) - sum_(i,j in T) P(A_i and A_j)
//! ```
//!
//! holds for any spanning tree T (Hunter 1976, "An upper bound for the probability of a union", J. Appl. Prob. 13;
//! Worsley 1982, "An improved Bonferroni inequality and applications", Biometrika 69). The maximum spanning tree gives
//! the tightest bound, which is nearly exact for few events. Joint tails are tabulated by Owen's function (Owen 1956;
//! Genz 2004, "Numerical computation of rectangular bivariate and trivariate normal and t probabilities", Stat. Comput.
//! 14, compares methods).
//!
//! If the projection is strongly curved over the range of the errors, neither derivatives nor second-order terms give a
//! bound. Then samples of the errors with the required probability are projected one at a time (`set`).
//!
//! # The paper's Fig. 10
//!
//! A robot knows its position to 3 cm in x and y, and its heading to 1 degree. In which columns will it find a vertical
//! line 4 m ahead that is known to 1 cm? Position errors are divided by the distance; the heading error is not:
//!
//! ```
//! use glam::{DMat3, DVec3};
//! use presight_model::environment::FeatureShape;
//! use presight_model::geometry::{Pose, PoseCovariance};
//! use presight_features::roi::{BodyPoint, FeatureErrorModel, Projection, RoiFlag, roi};
//!
//! /// A pinhole camera of 640 x 480 pixels, body axes: x forward, y left, z up.
//! struct Camera;
//! impl Projection for Camera {
//!     fn project(&self, p: DVec3) -> Option<[f64; 2]> {
//!         (p.x > 0.0).then(|| [319.5 - 500.0 * p.y / p.x, 239.5 - 500.0 * p.z / p.x])
//!     }
//!     fn lever(&self, p: DVec3) -> f64 {
//!         p.x
//!     }
//!     fn size(&self) -> (u32, u32) {
//!         (640, 480)
//!     }
//!     fn turn(&self) -> Option<f64> {
//!         None
//!     }
//! }
//!
//! let (xy, heading, line) = (0.03, 1f64.to_radians(), 0.01);
//! let robot = PoseCovariance::from_sigmas([xy, xy, 0.0, 0.0, 0.0, heading]);
//! let ends = [DVec3::new(4.0, 0.0, -0.6), DVec3::new(4.0, 0.0, 0.6)];
//! let covariances = [DMat3::from_diagonal(DVec3::splat(line * line)); 2];
//! let shape = FeatureShape::Segment { ends, covariances, cross: DMat3::ZERO };
//! let uncertain = FeatureErrorModel::new(&Pose::IDENTITY, &robot, &Pose::IDENTITY, None, &shape)?;
//! let points = [0.0, 1.0].map(|t| BodyPoint::on_segment(&ends, t));
//! let found = roi(&Camera, &uncertain, &points, 0.99).expect("it is before the camera");
//!
//! let sigma = 500.0 * ((xy * xy + line * line) / 16.0 + heading * heading).sqrt();
//! let [left, _, right, _] = found.bounds;
//! // One side alone needs 2.58 sigma. Two ends, top and bottom add a little.
//! let deviations = 0.5 * (right - left) / sigma;
//! assert!(2.58 < deviations && deviations < 3.1, "{deviations}");
//! assert!((0.5 * (left + right) - 319.5).abs() < 0.1);
//! assert_eq!(found.flag, RoiFlag::Linear);
//! # Ok::<(), presight_model::Error>(())
//! ```
//!
//! `docs/region_of_interest.svg` shows the widths at other distances.

mod errors;
mod exceedance;
mod image_point;
mod linear;
mod set;

pub use errors::{BodyPoint, FeatureErrorModel, PoseErrors, Viewpoint};
pub use exceedance::Level;
pub use image_point::differences;

// Constants that the shader shares.
pub use exceedance::{EVENTS, MAX_SIDE_POINTS};
pub use {
    errors::{ERRORS, KIND},
    image_point::MARGIN,
    linear::{SLIGHT, SLIGHTLY},
};

use crate::BoxMethod;
use exceedance::Exceedance;
use glam::DVec3;
use image_point::{ImagePoint, PointDerivatives, dot, rough, see};
use linear::{bent_bounds, linear_bounds};
use set::set_bounds;

presight_model::words! {
    /// Method by which a box was found.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum RoiFlag {
        /// The derivative of the projection propagated the errors.
        Linear = "linear",
        /// The projection is not linear over the errors, so samples of the errors were projected.
        Set = "set",
        /// The feature may be behind the sensor, or anywhere in over half of the image.
        WholeImage = "whole_image",
    }
}

/// A box in continuous pixel coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roi {
    /// x0, y0, x1, y1. Across the seam of a full circle x1 exceeds the width.
    pub bounds: [f64; 4],
    /// Method by which it was found.
    pub flag: RoiFlag,
}

/// A projection from the sensor's body frame to its image.
pub trait Projection: Sync {
    /// Continuous pixel coordinates of a point in the body frame, inside or outside the image. Returns `None` if the
    /// point has no image (behind a camera, in the centre of a scanner).
    fn project(&self, p_in_body: DVec3) -> Option<[f64; 2]>;

    /// Distance of the point from the singularity: depth in front of a camera, distance from a scanner's axis.
    fn lever(&self, p_in_body: DVec3) -> f64;

    /// Distance of the point from the places without an image: depth in front of a camera, distance from a scanner's
    /// centre. Defaults to the lever.
    fn clearance(&self, p_in_body: DVec3) -> f64 {
        self.lever(p_in_body)
    }

    /// Number of columns and rows.
    fn size(&self) -> (u32, u32);

    /// Columns of a full turn, for an image that covers 360 degrees: columns are then modulo this number.
    fn turn(&self) -> Option<f64>;

    /// The row of the pole, where all columns meet, if a row is nearer to it than to the horizon. Defaults to `None`.
    fn pole_near(&self, _row: f64) -> Option<f64> {
        None
    }

    /// The point between two points of a straight line at which its row is extreme, if not an end. Defaults to
    /// `None`.
    fn culmination(&self, _from: DVec3, _to: DVec3) -> Option<DVec3> {
        None
    }

    /// Derivatives of column and row with respect to a point with image `at`. Defaults to finite differences.
    fn gradient(&self, p_in_body: DVec3, at: [f64; 2]) -> Option<[DVec3; 2]> {
        differences(self, p_in_body, at)
    }

    /// Derivative of the clearance with respect to the point.
    fn clearance_gradient(&self, p_in_body: DVec3) -> DVec3 {
        let step = 1e-6 * p_in_body.length().max(1e-6);
        let at = |shift: DVec3| self.clearance(p_in_body + shift);
        DVec3::from_array(DVec3::AXES.map(|axis| (at(axis * step) - at(-axis * step)) / (2.0 * step)))
    }
}

/// The four sides: coordinate, and direction +1 or -1.
const SIDES: [Side; 4] = [
    Side { axis: 0, sign: 1.0 },
    Side { axis: 0, sign: -1.0 },
    Side { axis: 1, sign: 1.0 },
    Side { axis: 1, sign: -1.0 },
];

/// A side of a box.
#[derive(Clone, Copy, Debug)]
struct Side {
    /// 0 for columns, 1 for rows.
    axis: usize,
    /// 1 towards larger coordinates, -1 towards smaller ones.
    sign: f64,
}

/// A point is lost if its clearance falls to this share.
pub(crate) const GRAZING: f64 = 0.05;

/// The projection is treated as linear if errors move a point by at most this share of its lever.
pub const BENT: f64 = 0.02;

/// Beyond this share of the lever, the errors at the sides do not show all of the curvature.
pub const MUCH: f64 = 0.35;

/// Finds the boxes of features and reuses its memory.
#[derive(Default)]
pub(crate) struct BoxFinder {
    rough: Vec<ImagePoint>,
    seen: Vec<PointDerivatives>,
    /// The points of `seen`; empty unless `seen` has all points.
    whole: Vec<BodyPoint>,
    passing: Exceedance,
}

impl BoxFinder {
    /// Returns the covariances in the image, pixels squared, of a feature's defining points; `None` if one has no
    /// image. The next call of [`Self::find`] must be for the same feature.
    pub fn covariances(
        &mut self,
        projection: &impl Projection,
        uncertain: &FeatureErrorModel,
        points: &[BodyPoint],
    ) -> Option<Vec<[[f64; 2]; 2]>> {
        self.whole.clear();
        rough(projection, uncertain, points, &mut self.rough);
        if self.rough.len() < points.len() || self.rough.iter().any(|r| r.lever == 0.0) {
            return None;
        }
        self.seen.clear();
        self.seen.extend(self.rough.iter().map(|rough| PointDerivatives::new(uncertain, rough)));
        self.whole.extend_from_slice(points);
        Some(self.seen.iter().map(PointDerivatives::covariance).collect())
    }

    /// See [`roi`].
    pub fn find(
        &mut self,
        projection: &impl Projection,
        uncertain: &FeatureErrorModel,
        points: &[BodyPoint],
        level: &Level,
        method: BoxMethod,
    ) -> Option<Roi> {
        // The points of a fully visible feature, which is the common case, are already prepared.
        if self.whole.is_empty() || self.whole != points {
            rough(projection, uncertain, points, &mut self.rough);
            see(uncertain, &self.rough, level.first, &mut self.seen);
        }
        self.whole.clear();
        if self.rough.is_empty() {
            return None;
        }
        let k = self.passing.common_deviation(&self.seen, level);
        // No box holds a set that reaches behind the sensor or surrounds its axis.
        if self.rough.iter().any(|r| is_lost(projection, uncertain, r, k)) {
            return Some(Roi { bounds: whole(projection), flag: RoiFlag::WholeImage });
        }
        let linear = linear_bounds(&self.seen, k);
        let within = |share: f64| self.rough.iter().all(|r| k * r.spread <= share * r.lever);
        let bounds = match method {
            BoxMethod::Linear => Some(linear),
            BoxMethod::AsNeeded if within(BENT) => Some(linear),
            BoxMethod::AsNeeded if within(MUCH) => bent_bounds(projection, uncertain, &self.seen, linear, k),
            BoxMethod::AsNeeded | BoxMethod::Set => None,
        };
        let (bounds, flag) = match bounds {
            Some(bounds) => (bounds, RoiFlag::Linear),
            None => match set_bounds(projection, uncertain, &self.rough, level, k) {
                Some(bounds) => (bounds, RoiFlag::Set),
                None => (whole(projection), RoiFlag::WholeImage),
            },
        };
        Some(clip(projection, bounds, flag))
    }
}

/// Returns the box that holds all given points of a feature (those visible at the nominal pose) with probability
/// `confidence`. It is clipped to the image and at least one pixel in size. Returns `None` if no point has an image.
pub fn roi(
    projection: &impl Projection,
    uncertain: &FeatureErrorModel,
    points: &[BodyPoint],
    confidence: f64,
) -> Option<Roi> {
    BoxFinder::default().find(projection, uncertain, points, &Level::new(confidence), BoxMethod::AsNeeded)
}

/// Returns true if errors of `k` standard deviations may bring a point near or beyond the places without an image.
fn is_lost(projection: &impl Projection, uncertain: &FeatureErrorModel, rough: &ImagePoint, k: f64) -> bool {
    let left = (1.0 - GRAZING) * rough.clearance;
    if k * rough.spread < left {
        return false;
    }
    let slopes = uncertain.slopes(&rough.point, projection.clearance_gradient(rough.point.p));
    k * dot(&slopes, &slopes).sqrt() >= left
}

/// The whole image.
fn whole(projection: &impl Projection) -> [f64; 4] {
    let (w, h) = projection.size();
    [-0.5, -0.5, f64::from(w) - 0.5, f64::from(h) - 0.5]
}

/// Clips a box to the image, with at least one pixel per side. Across a full circle's seam x1 exceeds the width.
fn clip(projection: &impl Projection, [x0, y0, x1, y1]: [f64; 4], flag: RoiFlag) -> Roi {
    let (w, h) = projection.size();
    let (w, h) = (f64::from(w), f64::from(h));
    let widen = |low: f64, high: f64| {
        let short = (1.0 - (high - low)).max(0.0) / 2.0;
        (low - short, high + short)
    };
    let within = |low: f64, high: f64, size: f64| {
        let (low, high) = widen(low, high);
        let (low, high) = (low.clamp(-0.5, size - 1.5), high.clamp(0.5, size - 0.5));
        (low, high)
    };
    let (y0, y1) = within(y0, y1, h);
    let (x0, x1) = match projection.turn() {
        Some(turn) if x1 - x0 >= turn => (-0.5, w - 0.5),
        Some(turn) => {
            let (x0, x1) = widen(x0, x1);
            let back = turn * ((x0 + 0.5) / turn).floor();
            (x0 - back, x1 - back)
        }
        None => within(x0, x1, w),
    };
    let large = (x1 - x0) * (y1 - y0) > 0.5 * w * h;
    if large && flag != RoiFlag::Linear {
        return Roi { bounds: whole(projection), flag: RoiFlag::WholeImage };
    }
    Roi { bounds: [x0, y0, x1, y1], flag }
}

#[cfg(test)]
mod tests;
