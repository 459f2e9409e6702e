//! Where the robot is, by what its sensors measured: one iterated robust Gauss-Newton for all of them.
//!
//! An [`Estimator`] predicts at the pose that was known before, compares, moves, and predicts once more. The prior is a residual like
//! all others (the form of an iterated extended Kalman filter). The covariance knows that beams share the errors of surfaces, and
//! directions that the measurement leaves open are named. See `docs/design/localization.md` for the maths.
//!
//! # Examples
//! A scanner at the origin has a corner before it: walls at x = 3 and y = 2. It stands 2 cm farther forward than it believes.
//! ```
//! use presight::estimate::{EstimateOptions, Estimator, Freedom};
//! use presight::geometry::PoseEstimate;
//! use presight::simulate::{Disturbances, Simulator};
//! use presight::{Environment, Options, Pose, Predictor, World};
//! use glam::DVec3;
//!
//! let mut environment = Environment::new();
//! let at = |x, y| Pose::from_xyz_rpy(DVec3::new(x, y, 1.0), 0.0, 0.0, 0.0);
//! environment.add_cuboid("ahead", at(3.05, -1.0), DVec3::new(0.1, 6.0, 2.0))?;
//! environment.add_cuboid("left", at(-0.5, 2.05), DVec3::new(7.0, 0.1, 2.0))?;
//! let world = World::new(environment);
//! let scanner = presight::preset("laser-scanner")?;
//! let predictor = || Predictor::new(Options::default());
//!
//! let truth = Pose::from_xyz_rpy(DVec3::new(0.02, 0.0, 0.5), 0.0, 0.0, 0.01);
//! let frame = Simulator::new(predictor()?, scanner, Disturbances::default(), 1)?.frame(&world, 0.0, &truth)?;
//! let believed = Pose::from_xyz_rpy(DVec3::new(0.0, 0.0, 0.5), 0.0, 0.0, 0.0);
//! let options = EstimateOptions::default().with_freedom(Freedom::Planar);
//! let found = Estimator::new(predictor()?, options).estimate(&world, &[&frame], &PoseEstimate::of_sigmas(believed, 0.05, 0.03))?;
//! assert!(found.is_determined() && found.weak.is_empty());
//! assert!((found.pose.world_from_robot.translation.x - 0.02).abs() < 4.0 * found.pose.covariance[0][0].sqrt());
//! # Ok::<(), presight::Error>(())
//! ```

mod answer;
mod descent;
mod findings;
mod fit;
mod image;
mod normal;
mod offsets;
mod prior;
mod range;
mod reflectors;
mod run;
mod solve;
mod surface;

pub use crate::motion::{Vector, motion_between, moved, nees};
pub use answer::{Estimate, EstimateState, Hypothesis, WeakDirection};
pub use fit::{Fit, fit};
pub use image::{ImageSource, SeenPoint, SeenSegment};
pub use normal::{CommonError, Freedom, GroupSum, Normal};
pub use range::{MeasuredPoint, RangeSource, measured_points};
pub use solve::drawn;
pub use solve::{EstimateOptions, Estimator};
pub use surface::{SeenSurface, SurfaceSource};

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
