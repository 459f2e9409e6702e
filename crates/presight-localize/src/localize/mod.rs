//! Where the robot is, from frame to frame: states, and one comparison of odds that leads from each to the next.
//!
//! A [`Localizer`] starts at a pose that is known about, or without one: a [`Search`] weighs a scan at all headings of all
//! free places. Each frame moves the belief by odometry, or on with the motion of the frame before, and says how much
//! likelier a pose is than its rivals: other places of this map, neighbouring minima, and nothing of this map. These odds add
//! up over the way; all decisions compare them with stated error rates ([`ErrorRates`]). See
//! `docs/design/localization.md` for the derivation.

mod beside;
mod drift;
mod evidence;
mod follow;
mod frozen;
mod hypotheses;
mod likelihood;
mod lookout;
mod odds;
mod reflectors;
mod residuals;
mod rivals;
mod round;
mod scan;
mod scan_time;
mod search;
mod timing;
mod turning;
mod velocity;

use follow::{Followed, way_of};
use frozen::Frozen;
use hypotheses::Hypotheses;
use lookout::Lookout;
pub use odds::ErrorRates;
use odds::Odds;
pub use residuals::{Figure, Misfit, Residuals};
use rivals::Rivals;
pub use search::{Candidate, Search, SearchOptions};
use timing::{Timing, stamps_of};
pub use velocity::{MotionNoise, Stamps, Velocity, along, rate};

use crate::estimate::{Estimate, Estimator, Freedom};
use crate::motion::{motion_between, moved};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::{add_to, restricted, sandwich, turn};
use presight_model::measured::{Frame, Motion, ScanMotion};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use std::borrow::Cow;

/// What a localizer knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The pose is unknown: the whole map is searched, or without a [`Search`] the surroundings of the last pose.
    Unknown,
    /// Several places may explain the frames: [`Step::candidates`].
    Candidates,
    /// One pose is followed without sufficient evidence; [`Step::reason`] names the missing evidence.
    Kept,
    /// One pose is followed and proven: it is wrong at most as often as [`ErrorRates::wrong`] allows.
    Tracking,
    /// The pose that was followed is refuted.
    Lost,
}

impl Phase {
    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Unknown => "unknown",
            Self::Candidates => "candidates",
            Self::Kept => "kept",
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
    /// Natural logarithm of the odds of the pose against other places of the map and against none of this map.
    pub odds: f64,
    /// Natural logarithm of the odds of the pose against its neighbouring minima; `None` until they are searched. The covariance
    /// covers the likeliest of them.
    pub fit_odds: Option<f64>,
    /// True if the frame had no evidence for the pose, which was carried on by odometry or the last motion.
    pub carried: bool,
    /// The motion of the robot during the scan, as the estimate has it; `None` if all rays are measured at once. With it
    /// [`Step::moving`] and [`Frame::at_one_moment`] repeat what the localizer did with the frame.
    pub scan_motion: Option<ScanMotion>,
}

impl Step {
    /// True if one pose is followed: it was given at the start, or it was found.
    pub fn is_known(&self) -> bool {
        matches!(self.phase, Phase::Tracking | Phase::Kept)
    }

    /// A frame of this step with the motion that was found for its scan, if it takes time.
    pub fn moving<'a>(&self, frame: &'a Frame) -> Cow<'a, Frame> {
        match &self.scan_motion {
            Some(motion) if frame.deskewed_by().is_none() => Cow::Owned(frame.clone().with_scan_motion(motion.clone())),
            _ => Cow::Borrowed(frame),
        }
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
    /// Frames that it takes at least before a pose is tracked: a single one may be wrong in a way of its own.
    pub agreeing: usize,
    /// The errors that are accepted: the odds of all decisions follow from them.
    pub rates: ErrorRates,
    /// How many hypotheses follow a level scanner where no place is singled out.
    pub hypotheses: usize,
    /// How many beams have as much evidence as one independent beam in hypotheses, for a sensor that states 1.
    pub beam_dependence: f64,
    /// How far a pose may be spread to count as known, one standard deviation, metres.
    pub spread: f64,
    /// The same for the rotation, radians.
    pub spread_turn: f64,
    /// Starts that one frame of a lost robot draws around its last pose. The next frame goes on with others, so this number
    /// bounds what a frame costs: about 5 ms each.
    pub search_starts: usize,
}

impl Default for LocalizeOptions {
    fn default() -> Self {
        Self {
            motion_noise: MotionNoise::default(),
            search: 0.5,
            search_turn: 0.3,
            agreeing: 3,
            rates: ErrorRates::default(),
            hypotheses: 150,
            beam_dependence: 60.0,
            spread: 0.4,
            // One in 1,000 poses is then more than 5 degrees off.
            spread_turn: 5f64.to_radians() / 3.29,
            search_starts: 16,
        }
    }
}

presight_model::with_options!(
    LocalizeOptions:
    with_motion_noise motion_noise: MotionNoise,
    with_search search: f64,
    with_search_turn search_turn: f64,
    with_agreeing agreeing: usize,
    with_rates rates: ErrorRates,
    with_hypotheses hypotheses: usize,
    with_beam_dependence beam_dependence: f64,
    with_spread spread: f64,
    with_spread_turn spread_turn: f64,
    with_search_starts search_starts: usize,
);

/// The state of the search or of the track. Each has the data that it needs, and no other.
#[derive(Clone, Debug)]
enum State {
    /// The robot is searched: in the whole map with a [`Search`], otherwise around its last pose.
    Lookout(Lookout),
    /// One pose is followed.
    Following(Followed),
    /// Many poses are, because no frame singles out one.
    Hypotheses(Followed, Hypotheses),
}

/// Follows a robot through the frames of its sensor.
pub struct Localizer {
    estimator: Estimator,
    options: LocalizeOptions,
    /// The given start, or anything.
    start: PoseEstimate,
    state: State,
    phase: Phase,
    velocity: Velocity,
    timing: Timing,
    stamp: Option<f64>,
    search: Option<Search>,
    rivals: Option<Rivals>,
    /// Those of frames with more or fewer pixels.
    spare: Option<Rivals>,
    frozen: Frozen,
}

impl Localizer {
    /// Starts at a pose that is known as well as the prior says.
    pub fn new(estimator: Estimator, prior: PoseEstimate, options: LocalizeOptions) -> Self {
        let odds = Odds::given(options.rates.given());
        Self {
            estimator,
            options,
            start: prior,
            state: State::Following(Followed { is_given: true, ..Followed::new(prior, odds) }),
            phase: Phase::Kept,
            velocity: Velocity::new(options.motion_noise),
            timing: Timing::default(),
            stamp: None,
            search: None,
            rivals: None,
            spare: None,
            frozen: Frozen::default(),
        }
    }

    /// Starts without a pose: `search` looks for the robot in the whole map.
    pub fn unknown(estimator: Estimator, search: Search, options: LocalizeOptions) -> Self {
        let nowhere = PoseEstimate::of_sigmas(RobotPose::IDENTITY, options.search, options.search_turn);
        let state = State::Lookout(Lookout::default());
        Self { phase: Phase::Unknown, search: Some(search), state, ..Self::new(estimator, nowhere, options) }
    }

    /// From now on a robot that is lost is looked for in the whole map, not only around where it was last.
    ///
    /// # Errors
    /// Those of [`Search::new`].
    pub fn search_everywhere(&mut self, world: &World, sensor: &Sensor, options: SearchOptions) -> Result<()> {
        self.search_everywhere_watched(world, sensor, options, &mut |_, _| ())
    }

    /// The same, which says how many places were looked round at, and of how many, as it goes on.
    ///
    /// # Errors
    /// Those of [`Search::new`].
    pub fn search_everywhere_watched(
        &mut self,
        world: &World,
        sensor: &Sensor,
        options: SearchOptions,
        watch: &mut dyn FnMut(usize, usize),
    ) -> Result<()> {
        self.search = Some(Search::watched(&mut self.estimator, world, sensor, options, watch)?);
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
        self.frozen.see(frame);
        let seconds = self.stamp.replace(frame.stamp).map(|before| frame.stamp - before);
        let frames: Vec<&Frame> = std::iter::once(frame).chain(beside.iter().copied()).collect();
        let carried = seconds.map(|seconds| self.carry(frame, seconds));
        let (motion, belief) = (carried.as_ref().map(|(motion, _)| motion), carried.as_ref().map(|(_, to)| *to));
        // An error leaves the robot where it started.
        let state = std::mem::replace(&mut self.state, State::Lookout(Lookout::default()));
        match state {
            State::Lookout(lookout) => self.look_out(world, &frames, lookout, motion),
            State::Following(mut own) => {
                own.belief = belief.unwrap_or(own.belief);
                motion.iter().for_each(|motion| own.beside.carry(motion, self.estimator.options.freedom));
                self.follow(world, &frames, own, way_of(motion))
            }
            State::Hypotheses(own, hypotheses) => {
                self.follow_hypotheses(world, &frames, own, hypotheses, motion, way_of(motion))
            }
        }
    }

    /// The motion since the frame before, and where a robot that is followed is then.
    fn carry(&mut self, frame: &Frame, seconds: f64) -> (Motion, PoseEstimate) {
        let (freedom, odometry) = (self.estimator.options.freedom, frame.motion.as_ref());
        let followed = self.followed_pose();
        if followed.is_none() && odometry.is_none() {
            // Going on with a motion that nobody saw would only lead away.
            self.velocity.restart();
        }
        let stamps = stamps_of(frame);
        self.velocity.carry(&followed.unwrap_or(self.start), seconds, odometry, stamps, freedom)
    }

    /// The pose, while one is followed.
    fn followed_pose(&self) -> Option<PoseEstimate> {
        match &self.state {
            State::Following(own) | State::Hypotheses(own, _) => Some(own.belief),
            State::Lookout(_) => None,
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
    PoseEstimate::new(RobotPose::new(to), PoseCovariance::from_rows(restricted(&covariance, freedom.axes())))
}

/// At least as wide as a lost robot is looked for.
fn widened(belief: &PoseEstimate, options: &LocalizeOptions) -> PoseEstimate {
    PoseEstimate::of_sigmas(belief.robot(), options.search, options.search_turn)
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
        let belief = PoseEstimate::of_sigmas(RobotPose::new(from), 0.0, 0.0);
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
