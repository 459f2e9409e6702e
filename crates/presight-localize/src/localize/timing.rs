//! Time in a step: scans that take time are moved to one moment, poses are given for the time of the stamp, and the difference
//! of motion and odometry is watched.

use super::residuals::Residuals;
use super::turning::check;
use super::velocity::{Stamps, Velocity, twist_of};
use super::{Localizer, Phase, State, Step};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::measured::{Frame, ScanMotion};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use std::borrow::Cow;

/// A larger share of frames that contradict the odometry gives a warning: with the stated noise the share is 1 in 10,000.
const CONTRADICTING: f64 = 0.02;

/// Most pixels of an image while the robot is lost.
const SEARCH_PIXELS: u64 = 2_000;

/// The times of the frames so far, and the residuals of their motions.
#[derive(Clone, Debug, Default)]
pub(super) struct Timing {
    /// Stamp of the first frame, seconds.
    first: Option<f64>,
    /// Frames since.
    count: usize,
    residuals: Option<Residuals>,
    /// Where the robot was tracked at the frame before, and when.
    before: Option<(f64, Pose)>,
}

/// Seconds from the stamp to the middle of a scan, and half of the scan's duration.
pub(super) fn middle_of(sensor: &Sensor) -> (f64, f64) {
    let [first, last] = sensor.scan_interval();
    (0.5 * (first + last), 0.5 * (last - first))
}

/// How the times of a frame's sensor are known: its scans count as measured in their middle.
pub(super) fn stamps_of(frame: &Frame) -> Stamps {
    Stamps { sigma: frame.sensor().spec().noise.stamp_sigma, late: middle_of(frame.sensor()).0 }
}

impl Localizer {
    /// Takes in the next frame, with frames that other sensors of the robot took at the same time. Stamp and odometry come from the
    /// first. A search of the whole map and hypotheses use the first alone. A scan that takes time is moved to the middle of its turn
    /// by the robot's own motion; the pose is given for its stamp.
    ///
    /// # Errors
    /// Those of [`Localizer::step`].
    pub fn step_together(&mut self, world: &World, frame: &Frame, beside: &[&Frame]) -> Result<Step> {
        let (middle, half) = if frame.deskewed_by().is_some() { (0.0, 0.0) } else { middle_of(frame.sensor()) };
        let stamp_sigma = frame.sensor().spec().noise.stamp_sigma;
        check(frame, frame.stamp - *self.timing.first.get_or_insert(frame.stamp), self.timing.count as f64)?;
        let thin = self.thinned_for_search(frame)?;
        let whole = thin.as_ref().unwrap_or(frame);
        let still = if half > 0.0 { Some(self.put_to_middle(world, whole)?) } else { None };
        let (still, motion) = still.unzip();
        // Rays that start beside the sensor's origin.
        let still = if still.is_none() && !whole.has_one_pose() { Some(whole.deskewed(0.0)?) } else { still };
        let others = self.beside_at(beside, motion.as_ref(), frame.stamp + middle)?;
        let others: Vec<&Frame> = others.iter().map(|other| &**other).collect();
        let step = self.step_at_once(world, still.as_ref().unwrap_or(whole), &others);
        self.estimator.set_twist_error([[0.0; 6]; 6]);
        let mut step = step?;
        if let Some(thin) = &thin {
            // Verdicts of these pixels would not fit the frame.
            step.estimate.verdicts.clear();
            if step.phase == Phase::Tracking {
                // Few pixels find a pose; a whole frame has to prove it.
                (step.phase, self.phase) = (Phase::Candidates, Phase::Candidates);
                if let State::Following(own) = &mut self.state {
                    own.odds.unproven = true;
                }
            }
            let size = (thin.sensor().width(), thin.sensor().height());
            step.reason += &format!("; looked for with {} x {} of the frame's pixels", size.0, size.1);
        }
        self.timing.count += 1;
        self.watch(&step, frame);
        if half > 0.0 || stamp_sigma > 0.0 {
            let (freedom, then) = (self.estimator.options.freedom, step.pose.world_from_robot);
            step.pose = self.velocity.before(&step.pose, middle, stamp_sigma, freedom);
            step.stamp = frame.stamp;
            let stamp_from_middle = step.pose.world_from_robot.inverse() * then;
            let intervals = std::iter::once(&frame).chain(beside).map(|frame| frame.sensor().scan_interval());
            let interval = intervals.fold([0.0f64; 2], |[a, b], [c, d]| [a.min(c), b.max(d)]);
            let through = |motion: &ScanMotion| through(motion, (middle, stamp_from_middle), interval);
            step.scan_motion = motion.as_ref().map(through).transpose()?;
        }
        Ok(step)
    }

    /// Fewer pixels of an image, for a lost robot until one pose is found: with many starts each pixel costs many times as much as for a robot that is
    /// followed.
    fn thinned_for_search(&self, frame: &Frame) -> Result<Option<Frame>> {
        let pixels = u64::from(frame.sensor().width()) * u64::from(frame.sensor().height());
        let is_image = frame.sensor().height() > 1 && frame.grey().is_none() && frame.intensities().is_none();
        let is_lost = matches!(self.state, State::Lookout(_));
        // A search of the whole map thins frames itself.
        if !(is_image && is_lost) || self.search.is_some() || pixels <= SEARCH_PIXELS {
            return Ok(None);
        }
        let stride = (pixels as f64 / SEARCH_PIXELS as f64).sqrt().ceil() as u32;
        frame.thinned(stride).map(Some)
    }

    /// Warnings about the robot itself, one line each: a mount or a clock that is not as stated, and odometry that contradicts the
    /// frames.
    pub fn warnings(&self) -> Vec<String> {
        let mut lines = self.timing.residuals.as_ref().map(Residuals::warnings).unwrap_or_default();
        let (far, all) = self.velocity.contradicted();
        if far > 2 && far as f64 > CONTRADICTING * all as f64 {
            lines.push(format!(
                "the odometry contradicts {far} of {all} frames: it freezes, jumps, runs backwards, or errs by more than stated; \
                 leave it out of the log or state a larger `OdometryNoise`"
            ));
        }
        lines.extend(self.frozen.warning());
        lines
    }

    /// A scan as from the middle of its turn. The motion of the turn is not known before the scan is matched: it is matched once with the
    /// last motion, and then put right with the one that this leads to. The estimator then receives the covariance of the remaining error.
    fn put_to_middle(&mut self, world: &World, frame: &Frame) -> Result<(Frame, ScanMotion)> {
        let (freedom, (middle, half)) = (self.estimator.options.freedom, middle_of(frame.sensor()));
        let (Some(stamp), Some(belief)) = (self.stamp, self.followed_pose()) else {
            return self.undone(frame, &self.velocity.clone(), half);
        };
        let seconds = frame.stamp + middle - stamp;
        if !(seconds > 0.0) {
            return self.undone(frame, &self.velocity.clone(), half);
        }
        let mut velocity = self.velocity.clone();
        let (_, prior) = velocity.carry(&belief, seconds, frame.motion.as_ref(), stamps_of(frame), freedom);
        let first = self.undone(frame, &velocity, half)?;
        let estimate = self.estimator.refine(world, &first.0, &prior)?;
        if !estimate.is_determined() {
            return Ok(first);
        }
        velocity.learn(&prior, &estimate.pose, freedom);
        self.undone(frame, &velocity, half)
    }

    /// A scan without the motion of its turn, half a turn before and after the time that the velocity holds for.
    fn undone(&mut self, frame: &Frame, velocity: &Velocity, half: f64) -> Result<(Frame, ScanMotion)> {
        let (twist, covariance) = velocity.within(-half, half);
        self.estimator.set_twist_error(covariance);
        let motion = ScanMotion::Twist(twist_of(&twist));
        let still = frame.clone().with_scan_motion(motion.clone()).deskewed(middle_of(frame.sensor()).0)?;
        Ok((still, motion))
    }

    /// The frames of other sensors, at the moment to which the scan was moved if they take time.
    fn beside_at<'a>(
        &self,
        beside: &[&'a Frame],
        motion: Option<&ScanMotion>,
        moment: f64,
    ) -> Result<Vec<Cow<'a, Frame>>> {
        let own = || ScanMotion::Twist(twist_of(self.velocity.twist()));
        let still = |other: &&'a Frame| {
            let takes_time = !other.sensor().spec().times.is_at_once() || other.sensor().has_origins();
            if !takes_time || other.deskewed_by().is_some() || other.grey().is_some() {
                return Ok(Cow::Borrowed(*other));
            }
            let moving = (*other).clone().with_scan_motion(motion.cloned().unwrap_or_else(own));
            moving.deskewed(moment - other.stamp).map(Cow::Owned)
        };
        beside.iter().map(still).collect()
    }

    /// Compares the motion between two frames in a row that were tracked with the odometry.
    fn watch(&mut self, step: &Step, frame: &Frame) {
        let now = (step.phase == Phase::Tracking).then_some((step.stamp, step.pose.world_from_robot));
        let (middle, _) = middle_of(frame.sensor());
        let residuals = self.timing.residuals.get_or_insert_with(|| Residuals::new(middle));
        match (self.timing.before, now, &frame.motion) {
            (Some((then, before)), Some((stamp, now)), Some(odometry)) => {
                residuals.add(&(before.inverse() * now), odometry, stamp - then);
            }
            _ => residuals.interrupt(),
        }
        self.timing.before = now;
    }
}

/// Pieces of the path of a scan: in 0.1 s, a robot at 2 m/s and 2 rad/s leaves the straight lines by 0.02 mm.
const PIECES: usize = 16;

/// The motion during a scan, adjusted so that it leads exactly from the pose at the stamp to the pose at the middle.
/// The pose at the stamp follows from the speed before the middle, which differs from the mean speed of the scan if the
/// robot accelerates.
fn through(
    motion: &ScanMotion,
    (middle, stamp_from_middle): (f64, Pose),
    [first, last]: [f64; 2],
) -> Result<ScanMotion> {
    let at = |seconds: f64| motion.at(seconds).unwrap_or(Pose::IDENTITY);
    let stamp_from = stamp_from_middle * at(middle).inverse();
    let time = |k: usize| first + (last - first) * k as f64 / PIECES as f64;
    ScanMotion::path((0..=PIECES).map(time).map(|t| (t, stamp_from * at(t))).collect())
}
