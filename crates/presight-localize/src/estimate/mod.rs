//! Where the robot is, by what its sensors measured: one iterated robust Gauss-Newton for all of them.
//!
//! An [`Estimator`] predicts at the pose that was known before, compares, moves, and predicts once more. The prior is a residual like
//! all others (the form of an iterated extended Kalman filter). The covariance knows that beams share the errors of surfaces, and
//! directions that the measurement leaves open are named. See `docs/design/localization.md` for the maths.

mod answer;
mod descent;
mod deviation;
mod findings;
mod fit;
mod image;
mod normal;
mod offsets;
mod options;
mod prior;
mod range;
mod reflectors;
mod run;
mod scan_twist;
mod solve;
mod starts;

pub use crate::motion::{Vector, motion_between, moved, nees};
pub use answer::{Estimate, EstimateState, Hypothesis, WeakDirection};
pub use deviation::SeenDeviation;
pub use fit::{Fit, fit};
pub use image::{ImageSource, SeenPoint, SeenSegment};
pub use normal::{CommonError, Freedom, GroupSum, Normal};
pub use options::EstimateOptions;
pub use range::{MeasuredPoint, RangeSource, measured_points};
pub use scan_twist::LateSums;
pub(crate) use scan_twist::{ScanError, ScanTwist};
pub use solve::Estimator;
pub use starts::drawn;

use presight_model::geometry::Pose;

/// How residuals are weighed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kernel {
    /// As wide as the gate: far residuals pull, too.
    Wide,
    /// Residuals of more than some standard deviations have no weight (Tukey's biweight).
    Redescending {
        /// By how much residuals are wider than stated; at least 1.
        spread: f64,
    },
}

/// How far from the prediction a measurement may be, and how it is weighed then.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gate {
    /// Metres that the robot may be off.
    pub translation: f64,
    /// Radians that it may be turned.
    pub rotation: f64,
    /// How residuals are weighed.
    pub kernel: Kernel,
    /// Most residuals that a source looks at.
    pub points: usize,
    /// Whether the parts of a covariance are asked for.
    pub finally: bool,
}

/// A source of residuals: what one measurement says about the pose of the robot.
pub trait Residuals {
    /// What the measurement says about a small motion of the robot from this pose.
    fn linearize(&self, world_from_robot: &Pose, gate: &Gate) -> Normal;
}
