//! One estimate under way: what is compared, what was known before, and where iterations came to rest.

use super::answer::Hypothesis;
use super::normal::Normal;
use super::range::MeasuredPoint;
use super::solve::length;
use crate::extract::FeatureFindings;
use crate::motion::{Vector, motion_between, moved};
use crate::verdict::ExpectedImage;
use presight_model::geometry::{Pose, PoseEstimate, RobotPose};
use presight_model::matrix::{Matrix, quadratic};
use presight_model::measured::{Frame, RangeNoise};
use presight_model::world::World;
use std::sync::Arc;

/// The best pose has to explain more of the points than any other by this share.
pub(super) const LEAD: f64 = 0.05;

/// A frame of ranges as the iteration needs it.
pub(super) struct FrameMeasurement<'a> {
    pub(super) frame: &'a Frame,
    pub(super) points: Vec<MeasuredPoint>,
    pub(super) noise: RangeNoise,
}

/// What one prediction expects of the frames.
#[derive(Default)]
pub(super) struct Expectation {
    /// Of each frame of ranges.
    pub(super) images: Vec<ExpectedImage>,
    /// What each grey image, and each scan with intensities, shows of the features that were predicted.
    pub(super) findings: Vec<FeatureFindings>,
}

/// Where an iteration came to rest.
#[derive(Clone)]
pub(super) struct Minimum {
    pub(super) pose: Pose,
    /// What was expected in the prediction that it was found with.
    pub(super) expected: Arc<Expectation>,
    pub(super) normal: Normal,
    pub(super) spread: f64,
    /// The correction of the twist during the scan, if it is estimated: world axes, metres and radians per second.
    pub(super) twist: Vector,
}

/// Where an iteration starts.
#[derive(Clone, Copy)]
pub(super) struct Start {
    pub(super) pose: Pose,
    pub(super) twist: Vector,
}

impl From<Pose> for Start {
    fn from(pose: Pose) -> Self {
        Self { pose, twist: [0.0; 6] }
    }
}

impl From<&Minimum> for Start {
    fn from(minimum: &Minimum) -> Self {
        Self { pose: minimum.pose, twist: minimum.twist }
    }
}

impl Minimum {
    pub(super) fn hypothesis(&self) -> Hypothesis {
        let n = self.normal.measured.max(1) as f64;
        Hypothesis {
            pose: RobotPose::new(self.pose),
            explained: self.normal.explained_share(),
            cost: self.normal.chi2 / n,
        }
    }
}

/// One estimate under way.
pub(super) struct Run<'a> {
    pub(super) world: &'a World,
    pub(super) measured: Vec<FrameMeasurement<'a>>,
    /// Frames in which features are looked for: grey images, and scans with intensities.
    pub(super) looked: Vec<&'a Frame>,
    pub(super) model_sigma: f64,
    /// It is learnt, not stated.
    pub(super) learns_sigma: bool,
    /// Standard deviation of the offsets of polygons, as far as it was learnt, metres.
    pub(super) offset_sigma: f64,
    pub(super) prior: PoseEstimate,
    pub(super) prior_information: Matrix,
    /// Most squared deviations from the prior that are to be expected.
    pub(super) unlikely: f64,
    /// Metres and radians that the pose may be off.
    pub(super) extent: (f64, f64),
    /// The object whose surfaces count.
    pub(super) only: Option<u32>,
    /// How far away points are measured, root of the mean square, metres.
    pub(super) reach: f64,
    /// What was found at the prior's pose: a second look, where that is known better, does not find what was moved.
    pub(super) first: Option<Arc<Expectation>>,
    /// Information of the prior of the twist during the scan, if it is estimated: world axes.
    pub(super) twist_prior: Option<Matrix>,
    /// Full predictions so far.
    pub(super) predictions: usize,
}

impl Run<'_> {
    /// True if no frame says anything.
    pub(super) fn is_blind(&self) -> bool {
        self.has_greys_only() && self.looked.iter().all(|frame| frame.grey().is_none())
    }

    /// True if the pose rests on grey images alone.
    pub(super) fn has_greys_only(&self) -> bool {
        self.measured.iter().all(|m| m.points.is_empty())
    }

    /// Squared deviations of a pose from the prior.
    pub(super) fn deviations_squared(&self, pose: &Pose) -> f64 {
        quadratic(&self.prior_information, &motion_between(&self.prior.world_from_robot, pose))
    }

    /// True if the robot hardly is at a pose, by what was known before.
    pub(super) fn is_unlikely(&self, pose: &Pose) -> bool {
        self.deviations_squared(pose) > self.unlikely
    }

    /// The pose, or the one on the way to it from the prior as far as the robot may be: a wide search leads far off where things repeat.
    pub(super) fn within_reach(&self, pose: &Pose) -> Pose {
        let most = (self.unlikely / self.deviations_squared(pose)).sqrt();
        if most >= 1.0 {
            return *pose;
        }
        moved(&self.prior.world_from_robot, &motion_between(&self.prior.world_from_robot, pose).map(|x| most * x))
    }

    /// The share of the points that a minimum explains, less what another may lead by if it is an unlikely one.
    pub(super) fn merit(&self, minimum: &Minimum) -> f64 {
        minimum.normal.explained_share() - if self.is_unlikely(&minimum.pose) { LEAD } else { 0.0 }
    }

    /// True if two minima differ by no more than an estimate errs.
    pub(super) fn is_same(&self, a: &Pose, b: &Pose, offset_sigma: f64) -> bool {
        let off = motion_between(a, b);
        let (metres, radians) = (length(&off[..3]), length(&off[3..]));
        metres < 0.1 * self.extent.0 + 3.0 * offset_sigma && radians < 0.1 * self.extent.1
    }
}
