//! A pose from sources that need no new prediction: features that were matched in images, alone or together.

use super::answer::{covariance, weak_directions};
use super::normal::{CommonError, Freedom, Normal};
use super::{Gate, Kernel, Residuals, WeakDirection, prior};
use crate::motion::{motion_between, moved};
use presight_model::error::Result;
use presight_model::geometry::{PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::inverse;

/// A pose, and how well it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// The pose. Each residual counts with an error of its own.
    pub pose: PoseEstimate,
    /// Directions in which the sources say less than was known before.
    pub weak: Vec<WeakDirection>,
    /// Residuals that the pose explains, of those measured.
    pub explained: (usize, usize),
}

/// Steps, and the first of them that give outliers no weight.
const STEPS: (usize, usize) = (20, 8);
/// Metres at which a turn counts like a shift of as much, for naming weak directions.
const REACH: f64 = 3.0;
/// A direction is weak where the sources alone are looser, metres.
const LOOSEST: f64 = 0.5;

/// The pose that fits the sources and the prior best: Gauss and Newton, wide at first, outliers without weight at last.
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] for a prior whose covariance is none.
pub fn fit(sources: &[&dyn Residuals], known: &PoseEstimate, freedom: Freedom) -> Result<Fit> {
    prior::check(known, freedom)?;
    let axes = freedom.axes();
    let covariance_before = known.covariance.as_rows();
    let information = inverse(covariance_before, axes);
    let sigma =
        |from: usize| axes.iter().filter(|i| **i / 3 == from).map(|i| known.covariance[*i][*i]).sum::<f64>().sqrt();
    let (mut pose, mut factor, mut spread) = (known.world_from_robot, 1.0, 1.0f64);
    for k in 0..STEPS.0 {
        let last = k + 1 == STEPS.0;
        let kernel = if k < STEPS.1 { Kernel::Wide } else { Kernel::Redescending { spread } };
        let (translation, rotation) = (factor * sigma(0), factor * sigma(1));
        let gate = Gate { translation, rotation, kernel, points: usize::MAX, finally: last };
        let mut normal = Normal::default();
        sources.iter().for_each(|s| normal.add(&s.linearize(&pose, &gate)));
        spread = (1.4826 * normal.spread).clamp(1.0, 3.0);
        if last {
            let none = |_: CommonError| [[0.0; 6]; 6];
            let rows = covariance(&normal, Some(&information), freedom, spread, &none);
            return Ok(Fit {
                pose: PoseEstimate::new(RobotPose::new(pose), PoseCovariance::from_rows(rows)),
                weak: weak_directions(&normal, Some(covariance_before), freedom, REACH, spread, LOOSEST, &none),
                explained: (normal.explained, normal.measured),
            });
        }
        let off = motion_between(&known.world_from_robot, &pose);
        pose = moved(&pose, &normal.equations().step(&information, &off, axes).0);
        factor = (0.7 * factor).max(0.1);
    }
    unreachable!("the last step returns")
}
