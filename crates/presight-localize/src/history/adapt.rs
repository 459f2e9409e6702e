//! Learns the noise level from innovations and detects changes of motion.

use super::unaided::{MOST_UNAIDED, UnaidedSquares};
use super::window::BoxLevel;
use presight_model::statistics::tail;

/// Time constant of the learnt noise scale, frames.
const SCALE_FRAMES: f64 = 20.0;
/// Time constant of the learnt errors of predictions without corrections, frames.
const UNAIDED_FRAMES: f64 = 4.0;
/// Largest inflation of variances in the table.
const MOST_INFLATION: f64 = 64.0;
/// Limit on the inflation after one frame. Larger values are often outliers.
const MOST_CHANGE: f64 = 4.0;
/// Limit on the inflation when features are displaced from their windows.
const MOST_DISPLACEMENT: f64 = 9.0;
/// Largest inflation that is learnt as normal.
const MOST_USUAL: f64 = 3.0;
/// A frame's inflation means a change of motion if it is more than this many standard deviations above 1.
const SIGNIFICANT: f64 = 4.0;

/// Innovations of all tracks in one frame.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct FrameInnovations {
    /// Sum of squared innovations, each divided by its predicted variance.
    pub squares: f64,
    /// Number of coordinates in the sum.
    pub coordinates: u32,
    /// Number of tracks that should be detected.
    pub wanted: u32,
    /// Number of these tracks that were detected.
    pub seen: u32,
    /// Detections in windows that belong to no track.
    pub clutter: u32,
    /// Total area of the windows, pixels squared.
    pub area: f64,
}

/// Inflation of variances after a change of motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MotionChange {
    /// Factor by which the variance exceeds its prediction; 1 if the motion did not change.
    pub inflation: f64,
    /// Variance factor that explains the missed tracks by a displacement from their windows; 1 if there is none.
    pub displacement: f64,
}

/// Noise learnt from the innovations of past frames.
#[derive(Clone, Debug)]
pub(super) struct Adaptation {
    /// Factor by which the variance exceeds that of detections and process noise; at least 1.
    pub scale: f64,
    /// Clutter detections per pixel squared.
    pub clutter: f64,
    /// Mean seconds between frames; 0 before the first.
    pub interval: f64,
    /// Share of tracks that are detected.
    pub hit_rate: f64,
    /// Variance of a frame's inflation beyond chance, because all features shake with the sensor.
    unrest: f64,
    /// Factor by which the variance of predictions without the last corrections exceeds that of the model, by their
    /// number from 1; at least 1.
    unaided: [f64; MOST_UNAIDED],
    /// Table from the mean squared innovation within windows to the inflation of the variance.
    truncation: Truncation,
}

impl Adaptation {
    pub fn new(level: &BoxLevel, clutter: f64, hit_rate: f64) -> Self {
        let truncation = Truncation::new(level.deviations());
        Self { scale: 1.0, clutter, interval: 0.0, hit_rate, unrest: 0.0, unaided: [1.0; MOST_UNAIDED], truncation }
    }

    /// Updates the mean time between frames.
    pub fn pass(&mut self, interval: f64) {
        self.interval = if self.interval > 0.0 { self.interval + 0.2 * (interval - self.interval) } else { interval };
    }

    /// Learns from a frame.
    pub fn observe(&mut self, frame: &FrameInnovations) -> MotionChange {
        if frame.area > 0.0 {
            let density = f64::from(frame.clutter) / frame.area;
            self.clutter += 0.1 * (density - self.clutter);
            self.clutter = self.clutter.clamp(1e-7, 10.0);
        }
        let mut inflation: f64 = 1.0;
        if frame.coordinates > 0 {
            let n = f64::from(frame.coordinates);
            let found = self.truncation.inflation(frame.squares / n);
            let deviation = (2.0 / n + self.unrest).sqrt();
            if found > 1.0 + SIGNIFICANT * deviation {
                inflation = found.min(MOST_CHANGE);
            }
            let usual = found.min(MOST_USUAL);
            let excess = ((usual - 1.0).powi(2) - 2.0 / n).max(0.0);
            self.unrest += (excess - self.unrest) / SCALE_FRAMES;
            if inflation == 1.0 {
                let step = (found - 1.0).clamp(-1.0, 1.0) / SCALE_FRAMES;
                self.scale = (self.scale * step.exp()).clamp(1.0, 100.0);
            }
        }
        MotionChange { inflation, displacement: self.observe_misses(frame).min(MOST_DISPLACEMENT) }
    }

    /// Learns how far off predictions without the last corrections are.
    pub fn observe_unaided(&mut self, squares: &UnaidedSquares) {
        for (factor, (sum, coordinates)) in self.unaided.iter_mut().zip(squares) {
            if *coordinates > 0 {
                let found = sum / f64::from(*coordinates);
                *factor = (*factor + (found - *factor) / UNAIDED_FRAMES).clamp(1.0, MOST_INFLATION);
            }
        }
    }

    /// Factor on the variance of a track without a detection in the last `misses` frames.
    pub fn unaided(&self, misses: u32) -> f64 {
        misses.checked_sub(1).map_or(1.0, |age| self.unaided[(age as usize).min(MOST_UNAIDED - 1)])
    }

    /// If far fewer tracks are detected than normal, the windows are in the wrong place.
    fn observe_misses(&mut self, frame: &FrameInnovations) -> f64 {
        if frame.wanted == 0 {
            return 1.0;
        }
        let n = f64::from(frame.wanted);
        let share = f64::from(frame.seen) / n;
        let deviation = (self.hit_rate * (1.0 - self.hit_rate) / n).sqrt();
        if share < self.hit_rate - 4.0 * deviation - 0.1 {
            return self.truncation.inflation_of_share(share / self.hit_rate);
        }
        self.hit_rate = (self.hit_rate + 0.05 * (share - self.hit_rate)).clamp(0.3, 0.99);
        1.0
    }
}

/// Innovations outside a window are never measured. This table derives the full variance from the innovations inside.
#[derive(Clone, Debug)]
struct Truncation {
    /// Half widths of windows, standard deviations.
    deviations: f64,
    /// Mean squared innovation within the window, for logarithms of the inflation in steps of 1/8.
    means: Vec<f64>,
}

/// Table steps per unit of the natural logarithm.
const STEPS: f64 = 8.0;

impl Truncation {
    fn new(deviations: f64) -> Self {
        let rows = (MOST_INFLATION.ln() * STEPS).ceil() as usize;
        let means = (0..=2 * rows).map(|i| mean_within(deviations, ((i as f64 - rows as f64) / STEPS).exp())).collect();
        Self { deviations, means }
    }

    /// Variance factor at which squared innovations within the window have this mean.
    fn inflation(&self, mean: f64) -> f64 {
        let i = self.means.partition_point(|m| *m < mean);
        let zero = (self.means.len() / 2) as f64;
        if i == 0 {
            return (-zero / STEPS).exp();
        }
        let Some(above) = self.means.get(i) else { return MOST_INFLATION };
        let below = self.means[i - 1];
        let at = (i - 1) as f64 + (mean - below) / (above - below);
        ((at - zero) / STEPS).exp()
    }

    /// Variance factor at which this share of points stays within the windows.
    fn inflation_of_share(&self, share: f64) -> f64 {
        let of = |inflation: f64| (1.0 - 2.0 * tail(self.deviations / inflation.sqrt())).powi(2);
        let (mut low, mut high) = (1.0, MOST_INFLATION);
        for _ in 0..30 {
            let middle = 0.5 * (low + high);
            if of(middle) > share { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }
}

/// Mean square of a normal variable with variance `inflation`, given that its absolute value is below `k`.
fn mean_within(k: f64, inflation: f64) -> f64 {
    let a = k / inflation.sqrt();
    let density = (-0.5 * a * a).exp() / std::f64::consts::TAU.sqrt();
    inflation * (1.0 - 2.0 * a * density / (1.0 - 2.0 * tail(a)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adaptation() -> Adaptation {
        Adaptation::new(&BoxLevel::new(0.99), 1e-4, 0.9)
    }

    fn frame(mean: f64) -> FrameInnovations {
        FrameInnovations { squares: 200.0 * mean, coordinates: 200, wanted: 110, seen: 100, clutter: 0, area: 1.0 }
    }

    #[test]
    fn truncated_squares_tell_the_variance() {
        // A standard normal variable within 2.807: 1 - 2 k phi(k) / (2 Phi(k) - 1) = 0.9564.
        assert!((mean_within(2.807, 1.0) - 0.9564).abs() < 1e-3);
        let t = Truncation::new(2.807);
        for inflation in [0.5, 1.0, 2.0, 10.0] {
            assert!((t.inflation(mean_within(2.807, inflation)) / inflation - 1.0).abs() < 0.01);
        }
        // A uniform distribution over the window has the mean square k^2 / 3.
        assert_eq!(t.inflation(2.807 * 2.807 / 3.0), MOST_INFLATION);
        assert!((t.inflation_of_share(0.99) - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_jump_of_all_innovations_is_a_manoeuvre_and_a_slow_rise_is_noise() {
        let mut a = adaptation();
        for _ in 0..50 {
            assert_eq!(a.observe(&frame(0.956)).inflation, 1.0);
        }
        assert!((a.scale - 1.0).abs() < 0.02);
        assert!(a.observe(&frame(1.8)).inflation > 2.0);
        let mut slow = adaptation();
        for i in 0..300 {
            let mean = 0.956 + 0.3 * (f64::from(i) / 20.0).min(1.0) / slow.scale;
            assert_eq!(slow.observe(&frame(mean)).inflation, 1.0, "{i}");
        }
        assert!(slow.scale > 1.05);
    }

    #[test]
    fn hidden_tracks_have_the_errors_of_predictions_as_old() {
        let mut a = adaptation();
        let mut squares = UnaidedSquares::default();
        (squares[0], squares[1], squares[2]) = ((80.0, 20), (180.0, 20), (10.0, 20));
        (0..60).for_each(|_| a.observe_unaided(&squares));
        let factors = [0, 1, 2, 3, 4].map(|misses| a.unaided(misses));
        for (factor, expected) in factors.into_iter().zip([1.0, 4.0, 9.0, 1.0, 1.0]) {
            assert!((factor - expected).abs() < 1e-3, "{factors:?}");
        }
    }

    #[test]
    fn when_nearly_all_are_missed_windows_are_at_the_wrong_place() {
        let mut a = adaptation();
        let missed = FrameInnovations { wanted: 100, seen: 20, ..FrameInnovations::default() };
        assert!(a.observe(&missed).displacement > 4.0);
        let usual = FrameInnovations { wanted: 100, seen: 84, ..FrameInnovations::default() };
        assert_eq!(a.observe(&usual).displacement, 1.0);
    }
}
