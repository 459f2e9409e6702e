//! Time in a step: scans that take time are moved to one moment, poses are given for the time of the stamp, and the difference
//! of motion and odometry is watched.

use super::residuals::Residuals;
use super::scan_time::ScanTime;
use super::turning::check;
use super::velocity::{Stamps, twist_of};
use super::{Localizer, Phase, State, Step};
use crate::estimate::ScanError;
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::measured::{Frame, ScanMotion};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use std::borrow::Cow;

/// A larger share of frames that contradict the odometry gives a warning: with the stated noise the share is 1 in 10,000.
const CONTRADICTING: f64 = 0.02;

/// Minimum number of motions for an estimate of the place of the stamp in a scan; its deviation then decides.
const MIN_MOTIONS: usize = 10;

/// Most pixels of an image while the robot is lost.
const SEARCH_PIXELS: u64 = 2_000;

/// The times of the frames so far, and the residuals of their motions.
#[derive(Clone, Debug, Default)]
pub(super) struct Timing {
    /// Stamp of the first frame, seconds.
    first: Option<f64>,
    /// Frames since.
    pub count: usize,
    residuals: Option<Residuals>,
    pub scan_time: ScanTime,
    /// When and where the robot was tracked at the frame before, and by a scan with its motion.
    before: Option<(f64, Pose, Option<Pose>)>,
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
        let motion = still.as_ref().map(|still| still.motion.clone());
        // Rays with origins of their own.
        let centred = if still.is_none() && !whole.has_one_pose() { Some(whole.deskewed(0.0)?) } else { None };
        let others = self.beside_at(beside, motion.as_ref(), frame.stamp + middle)?;
        let others: Vec<&Frame> = others.iter().map(|other| &**other).collect();
        let at_once = still.as_ref().map(|still| &still.frame).or(centred.as_ref());
        let step = self.step_at_once(world, at_once.unwrap_or(whole), &others);
        self.estimator.set_scan_error(ScanError::default());
        let mut step = step?;
        if let Some(thin) = &thin {
            // Verdicts of these pixels would not fit the frame.
            step.estimate.verdicts.clear();
            if step.phase == Phase::Tracking {
                // Few pixels find a pose; a whole frame has to prove it.
                (step.phase, self.phase) = (Phase::Kept, Phase::Kept);
                if let State::Following(own) = &mut self.state {
                    own.odds.unproven = true;
                }
            }
            let size = (thin.sensor().width(), thin.sensor().height());
            step.reason += &format!("; looked for with {} x {} of the frame's pixels", size.0, size.1);
        }
        let (moved, pose) = self.learn_scan_time(world, whole, &step, still.as_ref())?;
        self.timing.count += 1;
        self.watch(&step, frame, pose);
        if let Some(moved) = moved {
            step.pose = self.widened_by_turn(&step.pose, &moved);
        }
        if half > 0.0 || stamp_sigma > 0.0 {
            let then = step.pose.world_from_robot;
            if let Some(still) = &still {
                self.velocity.learn_scan(&still.during);
            }
            step.pose = self.at_stamp(&step.pose, (middle, stamp_sigma), still.as_ref().map(|still| &still.during));
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
        let residuals = self.timing.residuals.as_ref();
        let scan = self.timing.scan_time.warning(residuals.and_then(|r| r.after_stamp(MIN_MOTIONS)));
        let is_explained = scan.as_ref().is_some_and(|(_, is_explained)| *is_explained);
        let mut lines: Vec<String> = scan.into_iter().map(|(line, _)| line).collect();
        lines.extend(residuals.map(|r| r.warnings_but(is_explained)).unwrap_or_default());
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
    /// `moving` is the pose with the motion of a scan whose times nobody states.
    fn watch(&mut self, step: &Step, frame: &Frame, moving: Option<Pose>) {
        let now = (step.phase == Phase::Tracking).then_some((step.stamp, step.pose.world_from_robot, moving));
        let (middle, _) = middle_of(frame.sensor());
        let residuals = self.timing.residuals.get_or_insert_with(|| Residuals::new(middle));
        match (self.timing.before, now, &frame.motion) {
            (Some((then, before, was_moving)), Some((stamp, now, moving)), Some(odometry)) => {
                // Poses of either kind err alike.
                let (before, now) = was_moving.zip(moving).unwrap_or((before, now));
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
