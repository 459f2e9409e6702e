//! The distances to which the rays of a frame are free.

use super::rays::SensorRays;
use super::state::UnseenReason;
use presight_localize::verdict::{ExpectedImage, Verdict, Verdicts};
use presight_model::measured::{Frame, RangeNoise};
use presight_model::statistics::NOISE_BOUND;

/// A frame compared with its prediction.
pub struct Comparison {
    pub expected: ExpectedImage,
    pub verdicts: Verdicts,
    /// True for pixels without a prediction because of a deadline; empty without such pixels.
    pub given_up: Vec<bool>,
}

impl Comparison {
    /// The verdict of a pixel on the prediction; `None` without a prediction because of a deadline.
    pub fn verdict(&self, at: usize) -> Option<Verdict> {
        (!self.given_up.get(at).copied().unwrap_or(false)).then(|| self.verdicts.pixels[at])
    }
}

/// The readings of a frame.
pub struct Readings {
    /// Distance to which each ray is certainly free, metres; 0 if unknown.
    pub through: Vec<f32>,
    /// Measured free distance of each ray, metres; 0 if unknown.
    pub measured: Vec<f32>,
    /// The reason why each ray sees no farther.
    pub behind: Vec<UnseenReason>,
}

impl Readings {
    pub fn new(rays: &SensorRays, frame: &Frame, comparison: Option<&Comparison>) -> Self {
        let noise = RangeNoise::of(&rays.sensor);
        let reach = rays.sensor.spec().range_max as f32;
        let ranges = frame.ranges();
        let count = ranges.len();
        let mut readings =
            Self { through: vec![0.0; count], measured: vec![0.0; count], behind: Vec::with_capacity(count) };
        for (i, z) in ranges.iter().enumerate() {
            let verdict = comparison.map(|c| c.verdict(i));
            readings.behind.push(match verdict {
                _ if rays.rays[i].is_nan() => UnseenReason::OutOfView,
                // No surface is expected within reach, so a missing return does not indicate a black surface.
                Some(Some(Verdict::Beyond)) if *z == f32::INFINITY => UnseenReason::OutOfView,
                _ if z.is_nan() || *z == f32::INFINITY => UnseenReason::NoReturn,
                Some(None) => UnseenReason::Deadline,
                Some(Some(Verdict::Confirmed | Verdict::Undecidable)) => UnseenReason::BehindKnown,
                _ => UnseenReason::BehindUnknown,
            });
            if z.is_finite() {
                readings.measured[i] = *z;
                readings.through[i] = z - (NOISE_BOUND * noise.range_sigma(f64::from(*z))) as f32;
            } else if readings.behind[i] == UnseenReason::OutOfView && *z == f32::INFINITY {
                (readings.measured[i], readings.through[i]) = (reach, reach);
            }
        }
        readings.distrust_edges(rays);
        readings
    }

    /// A pixel at the edge of an unknown object may mix its distance with that of the background. Therefore a ray is
    /// certainly free only inside a region of unknown pixels, and no farther than its neighbours.
    fn distrust_edges(&mut self, rays: &SensorRays) {
        let trusted = self.through.clone();
        for at in (0..trusted.len()).filter(|at| self.behind[*at] == UnseenReason::BehindUnknown) {
            self.through[at] = rays.around(at).fold(trusted[at], |nearest, next| {
                if self.behind[next] == UnseenReason::BehindUnknown { nearest.min(trusted[next]) } else { 0.0 }
            });
        }
    }
}
