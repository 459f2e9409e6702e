//! Odometry that stands still while the robot moves: the same pose again and again, while most readings change.

use presight_model::geometry::Pose;
use presight_model::measured::{Frame, RangeNoise};
use presight_model::statistics::median;

/// A robot stands still if its odometry moves by less, metres and radians: one tick of an encoder is more.
const STILL: f64 = 1e-6;
/// Readings of a frame that are compared.
const READINGS: usize = 1000;
/// Fewest readings that can be compared.
const LEAST_READINGS: usize = 20;
/// Least deviation of a reading, metres: that of a usual scanner, where the sensor states less.
const LEAST_SIGMA: f64 = 0.01;
/// A robot moves if half of the readings change by more than this, in deviations of their difference: while it stands still, half of
/// them change by 0.67, and by less than 2.7 with four times the stated noise.
const CHANGED: f64 = 3.0;
/// Least frames that have to say so, and more than half of the run: somebody may walk past right before the sensor.
const LEAST_FRAMES: usize = 5;

/// Frames in a row without a motion of the odometry.
#[derive(Clone, Debug, Default)]
struct Run {
    /// Stamps of the frame before the first of them, and of the last one, seconds.
    stamps: [f64; 2],
    /// Some readings of the frame before the first of them, metres.
    ranges: Vec<f32>,
    frames: usize,
    /// The last of them, in a row, most of whose readings have changed: a person walks on, a robot stays where it is.
    changed: usize,
    /// The most that half of the readings have changed by, metres.
    by: f64,
}

impl Run {
    /// True if the robot moved.
    fn is_frozen(&self) -> bool {
        self.changed >= LEAST_FRAMES && 2 * self.changed > self.frames
    }
}

/// Watches for frozen odometry.
#[derive(Clone, Debug, Default)]
pub(super) struct Frozen {
    run: Run,
    /// The longest run in which the robot moved.
    found: Option<Run>,
}

impl Frozen {
    /// Takes in the next frame.
    pub fn see(&mut self, frame: &Frame) {
        if frame.grey().is_some() {
            return;
        }
        let every = frame.ranges().len().div_ceil(READINGS).max(1);
        let ranges: Vec<f32> = frame.ranges().iter().step_by(every).copied().collect();
        let still = frame.motion.as_ref().is_some_and(|motion| is_none(&motion.previous_from_current));
        if !still || ranges.len() != self.run.ranges.len() {
            let next = Run { stamps: [frame.stamp; 2], ranges, ..Run::default() };
            let run = std::mem::replace(&mut self.run, next);
            if run.is_frozen() && self.found.as_ref().is_none_or(|found| found.frames < run.frames) {
                self.found = Some(run);
            }
            return;
        }
        let (run, noise) = (&mut self.run, RangeNoise::of(frame.sensor()));
        let both = run.ranges.iter().zip(&ranges).filter(|(a, b)| a.is_finite() && b.is_finite());
        let change = |(a, b): (&f32, &f32)| {
            let (a, b) = (f64::from(*a), f64::from(*b));
            ((a - b).abs(), noise.range_sigma(a.max(b)).max(LEAST_SIGMA) * 2f64.sqrt())
        };
        let (mut metres, mut deviations): (Vec<f64>, Vec<f64>) =
            both.map(change).map(|(off, sigma)| (off, off / sigma)).unzip();
        (run.frames, run.stamps[1]) = (run.frames + 1, frame.stamp);
        if metres.len() >= LEAST_READINGS && median(&mut deviations).is_some_and(|off| off > CHANGED) {
            run.changed += 1;
            run.by = run.by.max(median(&mut metres).unwrap_or(0.0));
        } else {
            run.changed = 0;
        }
    }

    /// One line, if the robot moved while its odometry did not.
    pub fn warning(&self) -> Option<String> {
        let runs = self.found.iter().chain(Some(&self.run).filter(|run| run.is_frozen()));
        let Run { stamps: [from, to], frames, by, .. } = runs.max_by_key(|run| run.frames)?;
        Some(format!(
            "the odometry stands still in {frames} frames from {from:.1} to {to:.1} s, while half of the readings change by {by:.2} m: \
             it is frozen, or the robot was carried; leave `odometry` out of these frames"
        ))
    }
}

fn is_none(motion: &Pose) -> bool {
    motion.translation.length() < STILL && motion.rotation.angle_between(glam::DQuat::IDENTITY) < STILL
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::measured::{Measurement, Motion, OdometryNoise};
    use presight_model::random::SplitMix64;
    use presight_model::sensor::{Angles, Geometry, Scanner, Sensor, SensorSpec};

    /// 100 beams with 1 cm of noise see a wall at `range(frame)`, but a person at 1 m with `before(frame)` of them. Each frame after
    /// the first has this motion along x.
    fn watched(range: impl Fn(usize) -> f64, before: impl Fn(usize) -> usize, motion: f64) -> Option<String> {
        let azimuth = Angles::Uniform { start_deg: 0.0, step_deg: 1.0, count: 100 };
        let geometry =
            Geometry::Scanner(Scanner { azimuth, elevation: Angles::Listed(vec![0.0]), beam_height_deg: None });
        let mut spec = SensorSpec::new("scanner", "laser", geometry);
        spec.noise.range_sigma = 0.01;
        let (sensor, mut random, mut frozen) = (Sensor::new(spec).unwrap(), SplitMix64(3), Frozen::default());
        for k in 0..20 {
            let reading = |i| if i < before(k) { 1.0 } else { (range(k) + random.normal(0.01)) as f32 };
            let ranges = (0..100).map(reading).collect();
            let mut frame = Frame::new(0.1 * k as f64, sensor.clone(), Measurement::Range(ranges)).unwrap();
            let along = Pose { translation: glam::DVec3::X * motion, ..Pose::IDENTITY };
            frame.motion = (k > 0).then(|| Motion::of_odometry(along, &OdometryNoise::default()));
            frozen.see(&frame);
        }
        frozen.warning()
    }

    /// By hand: 7 cm nearer in each frame, the wall is 19 x 7 cm = 1.33 m nearer at the last of 20 frames, 1.9 s after the first.
    #[test]
    fn odometry_that_stands_still_before_a_wall_that_comes_nearer_is_frozen() {
        let line = watched(|k| 5.0 - 0.07 * k as f64, |_| 0, 0.0).expect("a warning");
        assert!(line.contains("in 19 frames from 0.0 to 1.9 s, while half of the readings change by 1.33 m"), "{line}");
        assert_eq!(watched(|k| 5.0 - 0.07 * k as f64, |_| 0, 0.07), None);
    }

    /// A robot that stands still has no warning, nor has one before which a person stops: before 40 of 100 beams all the time,
    /// and before 90 of them in 8 of 19 frames.
    #[test]
    fn a_robot_that_stands_still_is_not_frozen() {
        assert_eq!(watched(|_| 5.0, |_| 0, 0.0), None);
        assert_eq!(watched(|_| 5.0, |k| if k > 0 { 40 } else { 0 }, 0.0), None);
        assert_eq!(watched(|_| 5.0, |k| if (6..14).contains(&k) { 90 } else { 0 }, 0.0), None);
    }
}
