//! One estimator of the robot's pose for all sensors: iterated robust Gauss-Newton.
mod answer;
mod normal;
mod range;
mod solve;

pub use crate::motion::{Vector, motion_between, moved};
pub use answer::{Estimate, Hypothesis, State, WeakDirection};
pub use normal::{Freedom, GroupSum, Normal, Shared};
pub use range::{MeasuredPoint, RangeSource, measured_points};
pub use solve::{EstimateOptions, Estimator, Prior};

use crate::geometry::Pose;

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
