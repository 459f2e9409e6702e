//! What each pixel of a frame says of its ray.

use super::rays::SensorRays;
use super::report::UnseenReason;
use presight_localize::verdict::{ExpectedImage, Verdict, Verdicts};
use presight_model::measured::{Frame, RangeNoise};

/// Deviates within which a measurement is taken to lie: 1 of 1,000 Gaussian ones does not.
pub const BOUND: f64 = 3.3;

/// A frame compared with its prediction.
pub struct Comparison {
    pub expected: ExpectedImage,
    pub verdicts: Verdicts,
    /// Pixels without a prediction because of a deadline; empty if there are none.
    pub given_up: Vec<bool>,
}

impl Comparison {
    /// What a pixel says of the prediction; `None` if there is nothing to compare with because of a deadline.
    pub fn verdict(&self, at: usize) -> Option<Verdict> {
        (!self.given_up.get(at).copied().unwrap_or(false)).then(|| self.verdicts.pixels[at])
    }
}

/// The readings of a frame.
pub struct Readings {
    /// Metres to which each ray passed for sure; 0 if that is not known.
    pub through: Vec<f32>,
    /// Metres to which each ray passed as measured; 0 if that is not known.
    pub measured: Vec<f32>,
    /// Why what lies farther along each ray is not seen.
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
                // Nothing was expected within reach, so that no return does not mean a black surface.
                Some(Some(Verdict::Beyond)) if *z == f32::INFINITY => UnseenReason::OutOfView,
                _ if z.is_nan() || *z == f32::INFINITY => UnseenReason::NoReturn,
                Some(None) => UnseenReason::Deadline,
                Some(Some(Verdict::Confirmed | Verdict::Undecidable)) => UnseenReason::BehindKnown,
                _ => UnseenReason::BehindUnknown,
            });
            if z.is_finite() {
                readings.measured[i] = *z;
                readings.through[i] = z - (BOUND * noise.range_sigma(f64::from(*z))) as f32;
            } else if readings.behind[i] == UnseenReason::OutOfView && *z == f32::INFINITY {
                (readings.measured[i], readings.through[i]) = (reach, reach);
            }
        }
        readings.distrust_edges(rays);
        readings
    }

    /// A pixel at the edge of something unknown may mix its distance with that of what lies behind it. Only inside of a
    /// region of unknown pixels is a ray surely seen through, and no farther than its neighbours.
    fn distrust_edges(&mut self, rays: &SensorRays) {
        let trusted = self.through.clone();
        for at in (0..trusted.len()).filter(|at| self.behind[*at] == UnseenReason::BehindUnknown) {
            self.through[at] = rays.around(at).fold(trusted[at], |least, next| {
                if self.behind[next] == UnseenReason::BehindUnknown { least.min(trusted[next]) } else { 0.0 }
            });
        }
    }
}
