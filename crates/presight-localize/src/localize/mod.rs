//! Where the robot is, from frame to frame: a state machine around the estimator.
//!
//! A [`Localizer`] starts at a pose that is known about, or without one: a [`Search`] weighs a scan at all headings of all free
//! places, and the best places are carried on until one of them leads and explains enough. Each frame moves the belief by odometry, or on with the motion of the frame before,
//! and updates it with one estimate. It says [`Phase::Lost`] with its reason instead of a pose that it does not know, and looks
//! around the last pose it knew, or in the whole map, until several frames in a row agree.

mod cusum;
mod decide;
mod doubt;
mod hypotheses;
mod likelihood;
mod reflectors;
mod residuals;
mod round;
mod search;
mod timing;
mod turning;
mod unknown;
mod velocity;

pub use cusum::Cusum;
use hypotheses::Hypotheses;
pub use residuals::{Figure, Misfit, Residuals};
pub use search::{Candidate, Search, SearchOptions};
use timing::Timing;
pub use turning::at_once;
pub use velocity::{MotionNoise, Velocity, along, rate};

use crate::estimate::{Estimate, Estimator, Freedom};
use crate::motion::{motion_between, moved};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate};
use presight_model::matrix::{add_to, restricted, sandwich, turn};
use presight_model::measured::{Frame, Motion};
use presight_model::sensor::Sensor;

use presight_model::world::World;

/// A model that is off by so much, metres, always explains points by the wrong surfaces, too.
const COARSE: f64 = 0.1;

/// What a localizer knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// Not where the robot is; it is looked for in the whole map, or without a [`Search`] around where it was last.
    Unknown,
    /// One pose or several explain a frame; the next ones have to agree, and to tell which.
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
    /// Where the robot is believed to be.
    pub pose: PoseEstimate,
    /// What the estimator said of the frame.
    pub estimate: Estimate,
    /// Where the robot may be after an unknown start, the likeliest first. Empty while one pose is followed.
    pub candidates: Vec<Candidate>,
}

impl Step {
    /// True if one pose is followed: it was given at the start, or it was found.
    pub fn is_known(&self) -> bool {
        self.phase == Phase::Tracking || (self.phase == Phase::Candidates && self.candidates.is_empty())
    }
}

/// How a [`Localizer`] works.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct LocalizeOptions {
    /// How the robot's speed may change.
    pub motion_noise: MotionNoise,
    /// How far off a lost robot is looked for around where it was last, one standard deviation, metres.
    pub search: f64,
    /// Likewise, radians.
    pub search_turn: f64,
    /// Frames in a row that have to agree before a pose that was given counts as tracked. One that is found anew takes
    /// [`LocalizeOptions::least_frames`].
    pub agreeing: usize,
    /// In these frames: of the surfaces that are decided on, the share that has to be where the map has it. Elsewhere in the map beams pass
    /// through walls, however little is known of what stands before them.
    pub least_standing: f64,
    /// In each of these frames: the share of the measured points that has to be explained.
    pub least_agreeing: f64,
    /// Mean number of frames between false alarms of being lost.
    pub frames_per_false_alarm: f64,
    /// Where a level scanner's map explains less than this share, or two places explain as much, hypotheses take over from one
    /// Gaussian.
    pub little: f64,
    /// How many hypotheses.
    pub hypotheses: usize,
    /// How many beams tell them as much as one independent beam, for a sensor that states 1.
    pub beam_dependence: f64,
    /// How far hypotheses may be spread for their mean to count as known, one standard deviation, metres.
    pub spread: f64,
    /// After an unknown start: by how much the likeliest candidate has to lead, natural logarithm of the odds.
    pub lead: f64,
    /// Likewise: the share of the measured points that it has to explain, in the mean over the frames. A pose around the last known one
    /// that is found anew has to explain as much, or what was usual before.
    pub least_found: f64,
    /// Likewise: frames that it takes at least.
    pub least_frames: usize,
    /// Likewise: frames after which candidates that do not explain as much are given up.
    pub patience: usize,
}

impl Default for LocalizeOptions {
    fn default() -> Self {
        Self {
            motion_noise: MotionNoise::default(),
            search: 0.5,
            search_turn: 0.3,
            agreeing: 3,
            least_standing: 0.9,
            least_agreeing: 0.3,
            frames_per_false_alarm: 30_000.0,
            little: 0.6,
            hypotheses: 150,
            beam_dependence: 60.0,
            spread: 0.4,
            lead: 7.0,
            least_found: 0.73,
            least_frames: 5,
            patience: 8,
        }
    }
}

presight_model::with_options!(
    LocalizeOptions:
    with_motion_noise motion_noise: MotionNoise,
    with_search search: f64,
    with_search_turn search_turn: f64,
    with_agreeing agreeing: usize,
    with_least_standing least_standing: f64,
    with_least_agreeing least_agreeing: f64,
    with_frames_per_false_alarm frames_per_false_alarm: f64,
    with_little little: f64,
    with_hypotheses hypotheses: usize,
    with_beam_dependence beam_dependence: f64,
    with_spread spread: f64,
    with_lead lead: f64,
    with_least_found least_found: f64,
    with_least_frames least_frames: usize,
    with_patience patience: usize,
);

/// Follows a robot through the frames of its sensor.
pub struct Localizer {
    estimator: Estimator,
    options: LocalizeOptions,
    belief: PoseEstimate,
    phase: Phase,
    velocity: Velocity,
    timing: Timing,
    agreed: usize,
    /// Sum of the shares that they explain.
    agreed_shares: f64,
    /// Frames that spoke against the pose since it was given.
    disagreed: usize,
    /// Nothing speaks for the pose but the frames that agree: it is not the one that was given, nor carried on from it.
    is_anew: bool,
    /// Confirmed, and all that is decided on, in the frames that agree.
    agreed_points: (usize, usize),
    explained: Cusum,
    /// Of the surfaces that are decided on, the share that is where it should be.
    standing: Cusum,
    stamp: Option<f64>,
    search: Option<Search>,
    candidates: Vec<Candidate>,
    /// Frames since the robot was found or given.
    tracked: usize,
    /// Where a robot that is lost would be if it were not, carried on by its odometry.
    followed: Option<PoseEstimate>,
    /// In place of one Gaussian, where that would settle too soon.
    hypotheses: Option<Hypotheses>,
    /// Frames in a row that explain enough for one Gaussian.
    agreed_again: usize,
}

impl Localizer {
    /// Starts at a pose that is known as well as the prior says.
    pub fn new(estimator: Estimator, prior: PoseEstimate, options: LocalizeOptions) -> Self {
        let standing = Cusum::new(2.0 * options.frames_per_false_alarm);
        let coarse = estimator.options.model_sigma >= COARSE;
        Self {
            estimator,
            options,
            belief: prior,
            phase: Phase::Candidates,
            velocity: Velocity::new(options.motion_noise),
            timing: Timing::default(),
            agreed: 0,
            agreed_shares: 0.0,
            disagreed: 0,
            is_anew: false,
            agreed_points: (0, 0),
            // Two tests, each with half of the false alarms.
            explained: Cusum::new(2.0 * options.frames_per_false_alarm),
            standing: if coarse { standing.with_least_sigma(0.12) } else { standing },
            stamp: None,
            search: None,
            candidates: Vec::new(),
            tracked: 0,
            followed: None,
            hypotheses: None,
            agreed_again: 0,
        }
    }

    /// Starts without a pose: `search` looks for the robot in the whole map.
    pub fn unknown(estimator: Estimator, search: Search, options: LocalizeOptions) -> Self {
        let nowhere = PoseEstimate::of_sigmas(Pose::IDENTITY, options.search, options.search_turn);
        Self { phase: Phase::Unknown, search: Some(search), ..Self::new(estimator, nowhere, options) }
    }

    /// From now on a robot that is lost is looked for in the whole map, not only around where it was last.
    ///
    /// # Errors
    /// Those of [`Search::new`].
    pub fn search_everywhere(&mut self, world: &World, sensor: &Sensor, options: SearchOptions) -> Result<()> {
        self.search = Some(Search::new(&mut self.estimator, world, sensor, options)?);
        Ok(())
    }

    /// What is known now.
    pub fn phase(&self) -> Phase {
        self.phase
    }

    /// Takes in the next frame.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the frame is not later than the one before, or if its motion is none;
    /// those of [`Estimator::estimate`].
    pub fn step(&mut self, world: &World, frame: &Frame) -> Result<Step> {
        self.step_together(world, frame, &[])
    }

    /// A frame whose pixels were all measured at its stamp.
    fn step_at_once(&mut self, world: &World, frame: &Frame, beside: &[&Frame]) -> Result<Step> {
        check(self.stamp, frame)?;
        let freedom = self.estimator.options.freedom;
        let seconds = self.stamp.replace(frame.stamp).map(|before| frame.stamp - before);
        let first = seconds.is_none();
        let stamp_sigma = frame.sensor().spec().noise.stamp_sigma;
        let odometry = frame.motion.as_ref();
        let carried = seconds.map(|s| self.velocity.carry(&self.belief, s, odometry, stamp_sigma, freedom));
        let motion = carried.map(|(motion, _)| motion);
        if self.is_searched() {
            return self.search_on(world, frame, motion.as_ref());
        }
        if let Some((_, carried)) = carried {
            self.belief = carried;
        }
        if self.hypotheses.is_some() {
            return self.follow_hypotheses(world, frame, motion.as_ref());
        }
        let mut prior = match self.phase {
            Phase::Tracking | Phase::Candidates => self.belief,
            Phase::Unknown | Phase::Lost => widened(&self.belief, &self.options),
        };
        let frames: Vec<&Frame> = std::iter::once(frame).chain(beside.iter().copied()).collect();
        let mut estimate = self.estimator.estimate(world, &frames, &prior)?;
        if self.may_have_started(frame, first, &estimate) {
            prior = widened(&self.belief, &self.options);
            estimate = self.estimator.estimate(world, &frames, &prior)?;
        }
        if self.is_doubtful(frame, &estimate) {
            self.doubt(world, frame, &prior)?;
            return self.follow_hypotheses(world, frame, None);
        }
        let reason = self.decide(&estimate);
        if estimate.is_determined() {
            if prior == self.belief {
                self.velocity.learn(&prior, &estimate.pose, freedom);
            } else {
                self.velocity.restart();
            }
            self.belief = estimate.pose;
        } else if matches!(self.phase, Phase::Unknown | Phase::Lost) {
            // Going on with a motion that nobody saw would only lead away.
            self.velocity.restart();
        }
        Ok(self.told(frame, reason, estimate))
    }

    /// The pose, while one is followed.
    fn followed_pose(&self) -> Option<PoseEstimate> {
        let followed = matches!(self.phase, Phase::Tracking | Phase::Candidates) && self.candidates.is_empty();
        followed.then_some(self.belief)
    }

    /// Without odometry a robot that stood still and now moves is not where it was, nor where its last motion leads.
    fn may_have_started(&self, frame: &Frame, first: bool, estimate: &Estimate) -> bool {
        let followed = matches!(self.phase, Phase::Tracking | Phase::Candidates);
        let unexplained = estimate.predictions > 0 && !estimate.is_determined();
        followed && !first && frame.motion.is_none() && unexplained
    }

    fn told(&self, frame: &Frame, reason: String, estimate: Estimate) -> Step {
        Step {
            stamp: frame.stamp,
            phase: self.phase,
            reason,
            pose: self.belief,
            estimate,
            candidates: self.candidates.clone(),
        }
    }
}

/// A robot on a level floor neither rises nor tilts, whatever its odometry says, and if it leans it goes on leaning: at 40 m a tilt of a
/// milliradian is 4 cm.
fn on_the_floor(from: &Pose, motion: &Motion) -> Motion {
    let (axes, off) = (Freedom::Planar.axes(), motion_between(from, &(*from * motion.previous_from_current)));
    let level = std::array::from_fn(|i| if axes.contains(&i) { off[i] } else { 0.0 });
    let in_world = restricted(motion.covariance.in_world(from).as_rows(), axes);
    Motion {
        previous_from_current: from.inverse() * moved(from, &level),
        covariance: PoseCovariance::from_rows(sandwich(&turn(from.rotation.conjugate()), &in_world)),
    }
}

/// What is known of a pose after a motion.
fn carried(belief: &PoseEstimate, motion: &Motion, freedom: Freedom) -> PoseEstimate {
    let motion = if freedom == Freedom::Planar { on_the_floor(&belief.world_from_robot, motion) } else { *motion };
    let from = belief.world_from_robot;
    let to = from * motion.previous_from_current;
    // A rotation of the robot then moves where it is now: t + r cross (to - from).
    let arm = to.translation - from.translation;
    let mut lever = [[0.0; 6]; 6];
    (0..6).for_each(|i| lever[i][i] = 1.0);
    (lever[0][4], lever[0][5]) = (arm.z, -arm.y);
    (lever[1][3], lever[1][5]) = (-arm.z, arm.x);
    (lever[2][3], lever[2][4]) = (arm.y, -arm.x);
    let mut covariance = sandwich(&lever, belief.covariance.as_rows());
    add_to(&mut covariance, motion.covariance.in_world(&from).as_rows());
    // Turning a covariance there and back leaves rounding on the axes that do not move.
    PoseEstimate::new(to, PoseCovariance::from_rows(restricted(&covariance, freedom.axes())))
}

/// At least as wide as a lost robot is looked for.
fn widened(belief: &PoseEstimate, options: &LocalizeOptions) -> PoseEstimate {
    PoseEstimate::of_sigmas(belief.world_from_robot, options.search, options.search_turn)
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
    let sound = motion.covariance.as_rows().as_flattened().iter().all(|x| x.is_finite());
    if !sound || (0..6).any(|i| motion.covariance[i][i] < 0.0) {
        return Err(Error::invalid(
            "the covariance of the odometry is none",
            "give finite numbers, variances of at least 0",
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// By hand: a robot that leans and goes 0.5 m to its left on a level floor is there, as high and leaning as before; so it is if its
    /// odometry rises by 2 cm and tilts by 0.01 besides, of which nothing is left in the covariance. With all six it would be higher.
    #[test]
    fn a_robot_that_leans_stays_on_its_floor() {
        let at = |x: f64, y: f64, yaw: f64| Pose::from_xyz_rpy(DVec3::new(x, y, 1.2), 0.1, 0.25, yaw);
        let (from, to) = (at(3.0, -2.0, 0.7), at(3.0 - 0.5 * 0.7f64.sin(), -2.0 + 0.5 * 0.7f64.cos(), 1.0));
        let belief = PoseEstimate::of_sigmas(from, 0.0, 0.0);
        let covariance = PoseCovariance::from_sigmas([1e-2; 6]);
        let tilt = Pose::from_xyz_rpy(DVec3::ZERO, 0.01, -0.01, 0.0).rotation;
        let rising = Pose { translation: to.translation + DVec3::Z * 0.02, rotation: tilt * to.rotation };
        for (end, turned) in [(to, 1e-9), (rising, 1e-3)] {
            let motion = Motion { previous_from_current: from.inverse() * end, covariance };
            let found = carried(&belief, &motion, Freedom::Planar);
            let [x, y, z, rx, ry, rz] = motion_between(&to, &found.world_from_robot);
            assert!(
                [x, y, z, rx, ry].iter().all(|off| off.abs() < 1e-9) && rz.abs() < turned,
                "{x} {y} {z} {rx} {ry} {rz}"
            );
            assert!([2, 3, 4].iter().all(|i| found.covariance[*i][*i].abs() < 1e-15));
            assert!([0, 1, 5].iter().all(|i| (found.covariance[*i][*i] - 1e-4).abs() < 1e-12));
            let full = carried(&belief, &motion, Freedom::Full);
            assert!(
                (full.world_from_robot.translation.z - end.translation.z).abs() < 1e-9 && full.covariance[2][2] > 5e-5,
                "planted"
            );
        }
    }
}
