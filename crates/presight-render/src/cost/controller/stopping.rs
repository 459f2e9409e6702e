//! The share of the samples that a stopped drawing reaches, learnt from frames.

/// Number of frames after which an average forgets, and the weight of its initial value in frames.
const REMEMBERED: f64 = 50.0;
const FIRST_VALUE: f64 = 4.0;
/// Bins up to the estimated time, and in total.
const STEPS: f64 = 8.0;
const BINS: usize = 13;

/// Expected share of the drawn samples when drawing stops, by the ratio of available to estimated time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stopping([(f64, f64); BINS]);

impl Default for Stopping {
    /// The samples of far polygons come last: a square, and estimates are off by about 10 %.
    fn default() -> Self {
        Self(std::array::from_fn(|i| ((0.85 * (i as f64 / STEPS).powi(2)).min(1.0), FIRST_VALUE)))
    }
}

impl Stopping {
    /// Returns the expected share.
    pub fn there(&self, time: f64) -> f64 {
        let at = (time * STEPS).clamp(0.0, (BINS - 1) as f64);
        let first = (at as usize).min(BINS - 2);
        let [low, high] = [self.0[first].0, self.0[first + 1].0];
        low + (high - low) * (at - first as f64)
    }

    /// Learns from a frame. The curve stays monotonic in time.
    pub fn learn(&mut self, time: f64, there: f64) {
        let at = (time * STEPS).round().clamp(0.0, (BINS - 1) as f64) as usize;
        let (mean, frames) = &mut self.0[at];
        *frames = (*frames + 1.0).min(REMEMBERED);
        *mean += (there - *mean) / *frames;
        let mean = *mean;
        self.0[..at].iter_mut().for_each(|(lower, _)| *lower = lower.min(mean));
        self.0[at..].iter_mut().for_each(|(higher, _)| *higher = higher.max(mean));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_follow_what_was_seen() {
        let mut stopping = Stopping::default();
        assert_eq!((stopping.there(0.0), stopping.there(9.0)), (0.0, 1.0));
        // By hand, from 0.2125 at a half: (4 x 0.2125 + 0.7125) / 5 = 0.3125, above the curve's value at a quarter.
        stopping.learn(0.5, 0.7125);
        assert!((stopping.there(0.5) - 0.3125).abs() < 1e-12);
        assert!((stopping.there(0.25) - 0.053125).abs() < 1e-12);
        // Repeated zeros at the full time also pull down shorter times.
        (0..200).for_each(|_| stopping.learn(1.0, 0.0));
        assert!(stopping.there(0.5) < 0.05 && stopping.there(1.0) < 0.05, "{stopping:?}");
        let grows = (0..150).map(|i| stopping.there(0.01 * f64::from(i))).is_sorted();
        assert!(grows, "{stopping:?}");
    }
}
