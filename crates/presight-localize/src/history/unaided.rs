//! How wrong predictions are without detections, learnt from tracks that have some.
//!
//! A hidden track moves on without corrections. Each seen track also carries a state without its last corrections, and
//! its next detection shows the error of that state.

use super::motion::PointMotion;
use super::sightings::{Sighting, squares};

/// Most corrections left out. Errors after more of them count as those after this many.
pub(super) const MOST_UNAIDED: usize = 8;

/// A track's first point without the corrections of the last frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Unaided {
    /// Its state is the sum of the corrections left out, its covariance the one without them. `None` before the first
    /// detection.
    motion: Option<PointMotion>,
    /// Number of corrections left out.
    age: usize,
}

/// Sums of squares over predicted variances, and coordinates, by the number of corrections left out, from 1.
pub(super) type UnaidedSquares = [(f64, u32); MOST_UNAIDED];

impl Unaided {
    /// Moves on by `interval` seconds with the process noise `jerk` and an acceleration that adds `variance`.
    pub fn pass(&mut self, interval: f64, jerk: f64, variance: f64) {
        if let Some(motion) = &mut self.motion {
            motion.advance(interval, jerk);
            motion.change_acceleration(variance, interval);
        }
    }

    /// Adds an unknown change of acceleration `interval` seconds ago.
    pub fn change(&mut self, variance: f64, interval: f64) {
        if let Some(motion) = &mut self.motion {
            motion.change_acceleration(variance, interval);
        }
    }

    /// Compares with a detection, before it corrects the track.
    pub fn compare(&self, seen: &[Sighting], scale: f64, into: &mut UnaidedSquares) {
        if let (Some(motion), [first, ..], 1..=MOST_UNAIDED) = (&self.motion, seen, self.age) {
            let first = Sighting { innovation: first.innovation + motion.position, ..*first };
            let (sum, coordinates) = squares(&[first], std::slice::from_ref(motion), scale);
            let into = &mut into[self.age - 1];
            *into = (into.0 + sum, into.1 + coordinates);
        }
    }

    /// Leaves out one more correction, which moved the first point from `before` to `after`. Begins again beyond `most`.
    pub fn leave_out(&mut self, before: &PointMotion, after: &PointMotion, most: usize) {
        match &mut self.motion {
            Some(motion) if self.age < most => {
                motion.position += after.position - before.position;
                motion.speed += after.speed - before.speed;
                motion.acceleration += after.acceleration - before.acceleration;
                self.age += 1;
            }
            _ => {
                let (position, speed, acceleration) = Default::default();
                *self = Self { motion: Some(PointMotion { position, speed, acceleration, ..*after }), age: 0 };
            }
        }
    }
}
