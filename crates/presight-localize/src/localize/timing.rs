//! Time in a step: scans that take time are moved to one moment, poses are given for the time of the stamp, and the difference
//! of motion and odometry is watched.

use super::residuals::Residuals;
use super::turning::{at_once, check};
use super::{Localizer, Phase, Step};
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::measured::Frame;
use presight_model::world::World;

/// A larger share of frames that contradict the odometry gives a warning: with the stated noise the share is 1 in 10,000.
const CONTRADICTING: f64 = 0.02;

/// Most pixels of an image while the robot is lost.
const SEARCH_PIXELS: u64 = 5_000;

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

impl Localizer {
    /// Takes in the next frame, with frames that other sensors of the robot took at the same time. Stamp and odometry come from the
    /// first. A search of the whole map and hypotheses use the first alone. A scan that takes time is moved to the middle of its turn
    /// by the robot's own motion; the pose is given for its stamp.
    ///
    /// # Errors
    /// Those of [`Localizer::step`].
    pub fn step_together(&mut self, world: &World, frame: &Frame, beside: &[&Frame]) -> Result<Step> {
        let spec = frame.sensor().spec();
        let (turn_s, stamp_sigma) = (spec.turn_s.abs(), spec.noise.stamp_sigma);
        check(frame, frame.stamp - *self.timing.first.get_or_insert(frame.stamp), self.timing.count as f64)?;
        let thin = self.thinned_for_search(frame)?;
        let whole = thin.as_ref().unwrap_or(frame);
        let still = if turn_s > 0.0 { Some(self.put_to_middle(world, whole)?) } else { None };
        let mut step = self.step_at_once(world, still.as_ref().unwrap_or(whole), beside)?;
        if let Some(thin) = &thin {
            // Verdicts of these pixels would not fit the frame.
            step.estimate.verdicts.clear();
            let size = (thin.sensor().width(), thin.sensor().height());
            step.reason += &format!("; looked for with {} x {} of the frame's pixels", size.0, size.1);
        }
        self.timing.count += 1;
        self.watch(&step, frame);
        if turn_s > 0.0 || stamp_sigma > 0.0 {
            let freedom = self.estimator.options.freedom;
            step.pose = self.velocity.before(&step.pose, 0.5 * turn_s, stamp_sigma, freedom);
            step.stamp = frame.stamp;
        }
        Ok(step)
    }

    /// Fewer pixels of an image, for a lost robot: with many starts each pixel costs many times as much as for a robot that is
    /// followed.
    fn thinned_for_search(&self, frame: &Frame) -> Result<Option<Frame>> {
        let pixels = u64::from(frame.sensor().width()) * u64::from(frame.sensor().height());
        let is_image = frame.sensor().height() > 1 && frame.grey().is_none() && frame.intensities().is_none();
        let is_lost = matches!(self.phase(), Phase::Lost | Phase::Unknown);
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
    /// last motion, and then put right with the one that this leads to, half an interval on.
    fn put_to_middle(&mut self, world: &World, frame: &Frame) -> Result<Frame> {
        let (freedom, sigma) = (self.estimator.options.freedom, frame.sensor().spec().noise.stamp_sigma);
        let (Some(stamp), Some(belief)) = (self.stamp, self.followed_pose()) else {
            return at_once(frame, self.velocity.twist());
        };
        let seconds = frame.stamp + 0.5 * frame.sensor().spec().turn_s.abs() - stamp;
        if !(seconds > 0.0) {
            return at_once(frame, self.velocity.twist());
        }
        let last = *self.velocity.twist();
        let mut velocity = self.velocity.clone();
        let (_, prior) = velocity.carry(&belief, seconds, frame.motion.as_ref(), sigma, freedom);
        let first = at_once(frame, velocity.twist())?;
        let estimate = self.estimator.refine(world, &first, &prior)?;
        if !estimate.is_determined() {
            return Ok(first);
        }
        velocity.learn(&prior, &estimate.pose, freedom);
        let now = velocity.twist();
        at_once(frame, &std::array::from_fn(|i| now[i] + 0.5 * (now[i] - last[i])))
    }

    /// Compares the motion between two frames in a row that were tracked with the odometry.
    fn watch(&mut self, step: &Step, frame: &Frame) {
        let now = (step.phase == Phase::Tracking).then_some((step.stamp, step.pose.world_from_robot));
        let half_turn = 0.5 * frame.sensor().spec().turn_s.abs();
        let residuals = self.timing.residuals.get_or_insert_with(|| Residuals::new(half_turn));
        match (self.timing.before, now, &frame.motion) {
            (Some((then, before)), Some((stamp, now)), Some(odometry)) => {
                residuals.add(&(before.inverse() * now), odometry, stamp - then);
            }
            _ => residuals.interrupt(),
        }
        self.timing.before = now;
    }
}
