//! Scans that take time are moved to their middle, where an error of the speed does least: half of the points are off
//! to one side and half to the other.
//!
//! The matcher needs the motion during a scan, and only the match reveals it. So the scan is first deskewed by a
//! prediction, from the motion before or from the frame itself. It is then matched with pose and twist free (see
//! `estimate::scan_twist`), and deskewed again by the corrected motion. The covariance of the pose includes the
//! remaining error.

use super::velocity::{Velocity, rate, twist_of};
use super::{Localizer, State, timing::middle_of, timing::stamps_of};
use crate::estimate::{Freedom, ScanError, ScanTwist};
use crate::motion::Vector;
use presight_model::error::Result;
use presight_model::geometry::{Pose, PoseEstimate};
use presight_model::matrix::{Matrix, add_to, apply, inverse};
use presight_model::measured::{Frame, Motion, OdometryNoise, ScanMotion};
use presight_model::world::World;

/// Rotation within half a scan, radians, below which one round suffices: the linearized twist then errs by half of
/// its square, 0.5 mm at 10 m.
const SMALL_TURN: f64 = 0.01;
/// Rounds after which an error of 1 rad would be below [`SMALL_TURN`]: each leaves half of the square.
const MAX_ROUNDS: usize = 4;
/// Number of pixels from which the twist of a scan is estimated: with 1 cm of noise each, to some mm/s and mrad/s.
const TWIST_PIXELS: f64 = 5000.0;
/// A component of the twist counts as measured by the scan if its variance is below this part of the variance by the
/// motion before.
const SEEN: f64 = 0.25;

/// The mean twist of the robot during a scan, in its axes: from half a scan before its middle until half a scan after
/// it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct DuringScan {
    /// Half of the scan's duration, seconds.
    pub half: f64,
    pub twist: Vector,
    pub covariance: Matrix,
    /// True for the components that the scan measures better than the motion before does.
    pub is_seen: [bool; 6],
    /// Mean twist between the stamp and the middle, if the frame gives its course.
    pub to_middle: Option<Vector>,
}

/// A scan as from its middle, and how the robot moved.
pub(super) struct Still {
    pub frame: Frame,
    pub motion: ScanMotion,
    pub during: DuringScan,
    /// The scan's own measurement of the twist.
    pub said: Option<ScanTwist>,
}

impl Localizer {
    /// Moves a scan to its middle by the motion of the robot, and gives the estimator the error of this motion.
    pub(super) fn put_to_middle(&mut self, world: &World, frame: &Frame) -> Result<Still> {
        let (freedom, (middle, half)) = (self.estimator.options.freedom, middle_of(frame.sensor()));
        let mut velocity = self.velocity.clone();
        let since = self.stamp.map(|stamp| frame.stamp + middle - stamp);
        let prior = self.followed_pose().filter(|_| since.is_none_or(|since| since > 0.0)).map(|belief| match since {
            Some(since) => velocity.carry(&belief, since, frame.motion.as_ref(), stamps_of(frame), freedom).1,
            None => velocity.before(&belief, -middle, 0.0, freedom),
        });
        let [first, last] = frame.sensor().scan_interval();
        let reaches = |motion: &&ScanMotion| motion.at(first).and(motion.at(last)).and(motion.at(0.0)).is_some();
        let given = frame.scan_motion().filter(reaches).map(|motion| (motion.clone(), error_of_given(frame, motion)));
        let (guess, known) = velocity.within(-half, half);
        let (motion, known) = given.clone().unwrap_or((ScanMotion::Twist(twist_of(&guess)), known));
        let Some(prior) = prior else { return self.undone(frame, (middle, half), motion, known, &velocity) };
        let thin = thinned(frame)?;
        let part = thin.as_ref().unwrap_or(frame);
        let mut still = self.undone(part, (middle, half), motion, known, &velocity)?;
        for _ in 0..MAX_ROUNDS {
            let (estimate, scan) = self.estimator.refine_with_twist(world, &still.frame, &prior, &known)?;
            if !estimate.is_determined() {
                break;
            }
            let mut moved = velocity.clone();
            if since.is_some() {
                moved.learn(&prior, &estimate.pose, freedom);
            }
            let (of_motion, covariance) = moved.within(-half, half);
            let mut sum = Known::default();
            sum.add(&of_motion, &covariance, &still.during.twist, freedom);
            if let Some((motion, covariance)) = &given {
                sum.add(&mean_twist(frame, motion), covariance, &still.during.twist, freedom);
            }
            let (change, covariance) = scan.with(&sum.information, &sum.pull, freedom);
            let (motion, said) = (corrected(&still.motion, &change, middle), scan.beyond(&still.during.twist));
            let is_seen = std::array::from_fn(|i| covariance[i][i] < SEEN * sum.covariance[i][i]);
            still = Still { said: Some(said), ..self.undone(part, (middle, half), motion, covariance, &moved)? };
            still.during.is_seen = is_seen;
            if half * change[3..].iter().map(|x| x * x).sum::<f64>().sqrt() < SMALL_TURN {
                break;
            }
        }
        if since.is_none() {
            self.begin(middle, &still.during);
        }
        match thin {
            Some(_) => {
                Ok(Still { frame: frame.clone().with_scan_motion(still.motion.clone()).deskewed(middle)?, ..still })
            }
            None => Ok(still),
        }
    }

    /// A scan without a motion, whose mean twist has this covariance.
    fn undone(
        &mut self,
        frame: &Frame,
        (middle, half): (f64, f64),
        motion: ScanMotion,
        known: Matrix,
        velocity: &Velocity,
    ) -> Result<Still> {
        let is_course = matches!(motion, ScanMotion::Path(_));
        let acceleration = if is_course { [[0.0; 6]; 6] } else { velocity.acceleration(half) };
        self.estimator.set_scan_error(ScanError { twist: known, acceleration });
        let to_middle = motion.at(middle).filter(|_| is_course && middle != 0.0).map(|to| rate(&to, middle));
        let during =
            DuringScan { half, twist: mean_twist(frame, &motion), covariance: known, is_seen: [false; 6], to_middle };
        Ok(Still {
            frame: frame.clone().with_scan_motion(motion.clone()).deskewed(middle)?,
            motion,
            during,
            said: None,
        })
    }

    /// The first scan: its twist is that of the robot, and where the robot started at the stamp it has gone on to the
    /// middle.
    fn begin(&mut self, middle: f64, during: &DuringScan) {
        self.velocity.begin(during);
        if let State::Following(own) | State::Hypotheses(own, _) = &mut self.state {
            own.belief =
                self.velocity.before_in_scan(&own.belief, -middle, 0.0, self.estimator.options.freedom, during);
        }
    }

    /// The pose at the stamp of a scan, by the one at its middle: seconds after the stamp, which errs by `sigma` seconds.
    pub(super) fn at_stamp(
        &self,
        pose: &PoseEstimate,
        (middle, sigma): (f64, f64),
        during: Option<&DuringScan>,
    ) -> PoseEstimate {
        let freedom = self.estimator.options.freedom;
        match during {
            Some(during) => self.velocity.before_in_scan(pose, middle, sigma, freedom, during),
            None => self.velocity.before(pose, middle, sigma, freedom),
        }
    }
}

/// Prior information about a correction of the twist: an information matrix, and its product with the correction.
#[derive(Default)]
struct Known {
    information: Matrix,
    pull: Vector,
    /// Covariance by the first source.
    covariance: Matrix,
}

impl Known {
    fn add(&mut self, twist: &Vector, covariance: &Matrix, from: &Vector, freedom: Freedom) {
        let information = inverse(covariance, freedom.axes());
        let pull = apply(&information, &std::array::from_fn(|i| twist[i] - from[i]));
        if self.covariance == Matrix::default() {
            self.covariance = *covariance;
        }
        add_to(&mut self.information, &information);
        (0..6).for_each(|i| self.pull[i] += pull[i]);
    }
}

/// A thinned copy of a large image, for the estimate of the twist alone.
fn thinned(frame: &Frame) -> Result<Option<Frame>> {
    let pixels = u64::from(frame.sensor().width()) * u64::from(frame.sensor().height());
    let stride = (pixels as f64 / TWIST_PIXELS).sqrt() as u32;
    if stride > 1 { frame.thinned(stride).map(Some) } else { Ok(None) }
}

/// The mean twist of a motion during a scan; 0 for a motion that does not reach over it, which deskewing refuses.
fn mean_twist(frame: &Frame, motion: &ScanMotion) -> Vector {
    let [first, last] = frame.sensor().scan_interval();
    let ends = motion.at(first).zip(motion.at(last));
    ends.map_or([0.0; 6], |(from, to)| rate(&(from.inverse() * to), last - first))
}

/// The covariance of the mean twist of a motion that a log gives: that of usual odometry over the scan.
fn error_of_given(frame: &Frame, motion: &ScanMotion) -> Matrix {
    let [first, last] = frame.sensor().scan_interval();
    let seconds = last - first;
    let way = motion.at(first).zip(motion.at(last)).map_or(Pose::IDENTITY, |(from, to)| from.inverse() * to);
    let covariance = Motion::of_odometry(way, &OdometryNoise::default()).covariance;
    covariance.as_rows().map(|row| row.map(|x| x / (seconds * seconds)))
}

/// A motion with another mean twist, the change in the robot's axes in the middle of the scan.
fn corrected(motion: &ScanMotion, change: &Vector, middle: f64) -> ScanMotion {
    let change = twist_of(change);
    match motion {
        ScanMotion::Twist(twist) => {
            let mut twist = *twist;
            (twist.linear, twist.angular) = (twist.linear + change.linear, twist.angular + change.angular);
            ScanMotion::Twist(twist)
        }
        ScanMotion::Path(poses) => {
            let from_middle = motion.at(middle).unwrap_or(Pose::IDENTITY).inverse();
            let moved = |seconds: f64, pose: &Pose| change.over(seconds - middle) * from_middle * *pose;
            let to_stamp = moved(0.0, &Pose::IDENTITY).inverse();
            ScanMotion::Path(poses.iter().map(|(t, pose)| (*t, to_stamp * moved(*t, pose))).collect())
        }
    }
}
