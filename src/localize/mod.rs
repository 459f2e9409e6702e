//! Where the robot is, from frame to frame: a state machine around the estimator.
//!
//! A [`Localizer`] starts at a pose that is known about. Each frame moves the belief by odometry, or on with the motion of the frame before,
//! and updates it with one estimate. It says [`Phase::Lost`] with its reason instead of a pose that it does not know, and looks
//! around the last pose it knew until several frames in a row agree.

mod cusum;

pub use cusum::Cusum;

use crate::error::{Error, Result};
use crate::estimate::{Estimate, EstimateState, Estimator, Prior};
use crate::frame::Frame;
use crate::geometry::Pose;
use crate::matrix::{Matrix, add_to, sandwich};
use crate::motion::turn;
use crate::world::World;

/// What a localizer knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Not where the robot is; it looks around where it was last.
    Unknown,
    /// A pose explains a frame; the next ones have to agree.
    Candidates,
    /// Where the robot is.
    Tracking,
    /// No longer where the robot is.
    Lost,
}

impl Phase {
    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Candidates => "candidates",
            Self::Tracking => "tracking",
            Self::Lost => "lost",
        }
    }
}

/// What became of one frame.
#[derive(Clone, Debug)]
pub struct Step {
    /// The frame's, seconds.
    pub stamp: f64,
    /// What is known now.
    pub phase: Phase,
    /// Why, with numbers.
    pub reason: String,
    /// world_from_robot: where the robot is believed to be.
    pub pose: Pose,
    /// Of the pose: x y z, then rotation about fixed x y z, world axes; metres and radians.
    pub covariance: Matrix,
    /// What the estimator said of the frame.
    pub estimate: Estimate,
}

/// How a [`Localizer`] works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalizeOptions {
    /// Without odometry: how much the motion may change from one frame to the next, one standard deviation, metres.
    pub drift: f64,
    /// Likewise, radians.
    pub turn_drift: f64,
    /// How far off a lost robot is looked for around where it was last, one standard deviation, metres.
    pub search: f64,
    /// Likewise, radians.
    pub search_turn: f64,
    /// Frames in a row that have to agree before a pose counts as found.
    pub agreeing: usize,
    /// Mean number of frames between false alarms of being lost.
    pub frames_per_false_alarm: f64,
}

impl Default for LocalizeOptions {
    fn default() -> Self {
        Self {
            drift: 0.02,
            turn_drift: 0.015,
            search: 0.5,
            search_turn: 0.3,
            agreeing: 3,
            frames_per_false_alarm: 30_000.0,
        }
    }
}

/// Follows a robot through the frames of its sensor.
pub struct Localizer {
    estimator: Estimator,
    options: LocalizeOptions,
    belief: Prior,
    phase: Phase,
    /// Of the frame before, in the robot's frame of then.
    motion: Pose,
    agreed: usize,
    explained: Cusum,
    stamp: Option<f64>,
}

impl Localizer {
    /// Starts at a pose that is known as well as the prior says.
    pub fn new(estimator: Estimator, prior: Prior, options: LocalizeOptions) -> Self {
        Self {
            estimator,
            options,
            belief: prior,
            phase: Phase::Candidates,
            motion: Pose::IDENTITY,
            agreed: 0,
            explained: Cusum::new(options.frames_per_false_alarm),
            stamp: None,
        }
    }

    /// What is known now.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Takes in the next frame.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the frame is not later than the one before, or if its motion is none; those of
    /// [`Estimator::estimate`].
    pub fn step(&mut self, world: &World, frame: &Frame) -> Result<Step> {
        check(self.stamp, frame)?;
        let first = self.stamp.replace(frame.stamp).is_none();
        let before = self.belief.pose;
        if !first {
            self.move_on(frame);
        }
        let prior = match self.phase {
            Phase::Tracking | Phase::Candidates => self.belief,
            Phase::Unknown | Phase::Lost => widened(&self.belief, &self.options),
        };
        let estimate = self.estimator.estimate(world, &[frame], &prior)?;
        let reason = self.decide(&estimate);
        if estimate.is_determined() {
            if !first {
                self.motion = before.inverse() * estimate.pose;
            }
            self.belief = Prior { pose: estimate.pose, covariance: estimate.covariance };
        } else if matches!(self.phase, Phase::Unknown | Phase::Lost) {
            // Going on with a motion that nobody saw would only lead away.
            self.motion = Pose::IDENTITY;
        }
        Ok(Step {
            stamp: frame.stamp,
            phase: self.phase,
            reason,
            pose: self.belief.pose,
            covariance: self.belief.covariance,
            estimate,
        })
    }

    /// The belief after the motion that the frame tells, or after the last one again.
    fn move_on(&mut self, frame: &Frame) {
        let (motion, own) = match &frame.motion {
            Some(m) => (m.previous_from_current, m.covariance),
            None => {
                let sigma = |i: usize| if i < 3 { self.options.drift } else { self.options.turn_drift };
                (
                    self.motion,
                    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { sigma(i).powi(2) } else { 0.0 })),
                )
            }
        };
        let from = self.belief.pose;
        let to = from * motion;
        // A rotation of the robot then moves where it is now: t + r cross (to - from).
        let arm = to.translation - from.translation;
        let mut lever = [[0.0; 6]; 6];
        (0..6).for_each(|i| lever[i][i] = 1.0);
        (lever[0][4], lever[0][5]) = (arm.z, -arm.y);
        (lever[1][3], lever[1][5]) = (-arm.z, arm.x);
        (lever[2][3], lever[2][4]) = (arm.y, -arm.x);
        let mut covariance = sandwich(&lever, &self.belief.covariance);
        add_to(&mut covariance, &sandwich(&turn(from.rotation), &own));
        self.belief = Prior { pose: to, covariance };
    }

    /// The next phase, and why.
    fn decide(&mut self, estimate: &Estimate) -> String {
        let share = format!("{:.0} % explained", 100.0 * estimate.explained);
        let why = match &estimate.state {
            EstimateState::Determined => share,
            EstimateState::Undetermined(why) => why.clone(),
        };
        match self.phase {
            Phase::Tracking => {
                let alarm = self.explained.add(estimate.explained);
                if alarm {
                    self.phase = Phase::Lost;
                    self.agreed = 0;
                    return format!(
                        "{why}; the share of explained points has left its distribution ({})",
                        self.explained
                    );
                }
                why
            }
            Phase::Lost | Phase::Unknown | Phase::Candidates if estimate.is_determined() => {
                self.agreed += 1;
                if self.agreed >= self.options.agreeing {
                    self.phase = Phase::Tracking;
                    self.explained.restart();
                    return format!("{why}; {} frames in a row agree", self.agreed);
                }
                self.phase = Phase::Candidates;
                format!("{why}; {} of {} frames agree", self.agreed, self.options.agreeing)
            }
            Phase::Lost | Phase::Unknown | Phase::Candidates => {
                self.agreed = 0;
                self.phase = Phase::Unknown;
                why
            }
        }
    }
}

/// At least as wide as a lost robot is looked for.
fn widened(belief: &Prior, options: &LocalizeOptions) -> Prior {
    let wide = Prior::of_sigmas(belief.pose, options.search, options.search_turn);
    Prior { pose: belief.pose, covariance: wide.covariance }
}

fn check(before: Option<f64>, frame: &Frame) -> Result<()> {
    if let Some(before) = before
        && !(frame.stamp > before)
    {
        let what = format!("a frame at {} s after one at {before} s", frame.stamp);
        return Err(Error::invalid(what, "give the frames in the order of time, each once"));
    }
    let Some(motion) = &frame.motion else { return Ok(()) };
    if let Err(e) = motion.previous_from_current.check() {
        return Err(Error::invalid(format!("the odometry: {e}"), "give a rigid motion in metres"));
    }
    let sound = motion.covariance.as_flattened().iter().all(|x| x.is_finite());
    if !sound || (0..6).any(|i| motion.covariance[i][i] < 0.0) {
        return Err(Error::invalid(
            "the covariance of the odometry is none",
            "give finite numbers, variances of at least 0",
        ));
    }
    Ok(())
}
