//! Unit costs of one key, learnt online.

use super::{KINDS, WorkCounts};
use presight_model::statistics::ranked;
use std::collections::VecDeque;

/// Factor of a frame's weight after each further frame.
const FORGETTING: f64 = 0.98;
/// Number of ratios of measured to estimated time that are kept.
pub(crate) const RATIOS: usize = 200;
/// Quantile of the ratios that deadlines rely on.
const QUANTILE: f64 = 0.99;
/// Ratios are kept only after this many frames, when the costs are roughly known.
const FIRST: u64 = 5;
/// With fewer ratios than this, the upper factor is at least the default.
const ENOUGH: usize = 20;
/// Factor for estimates from defaults, which were measured on another machine.
const UNKNOWN: f64 = 3.0;
/// Weight of the defaults relative to one frame.
const PULL: f64 = 1e-3;
/// Maximum number of sweeps over the costs, and the change at which they stop. Each frame starts from the last
/// solution, so later frames complete what a few sweeps leave.
const SWEEPS: usize = 24;
const DONE: f64 = 1e-6;

/// Pessimistic defaults: seconds by kind of work on a slow current core.
const DEFAULTS: [f64; KINDS] = [1e-4, 5e-7, 5e-7, 2e-5, 2e-9, 2e-9, 5e-9, 2e-6, 5e-7, 1e-5];

/// Unit costs of one key.
#[derive(Clone, Debug, PartialEq)]
pub struct UnitCosts {
    /// Seconds by kind of work, never negative.
    pub seconds: [f64; KINDS],
    /// Sum of x x' over frames, with exponential forgetting; x is counts times default costs, divided by measured time.
    pub normal: [[f64; KINDS]; KINDS],
    /// Sum of x, with the same forgetting.
    pub right: [f64; KINDS],
    /// Ratios of measured to estimated time, oldest first.
    pub ratios: VecDeque<f64>,
    /// Factors that turn an estimate into its 1 % and 99 % quantile. Cached, because every frame reads them often.
    pub factors: [f64; 2],
    /// Frames learnt from.
    pub frames: u64,
}

impl Default for UnitCosts {
    fn default() -> Self {
        Self {
            seconds: DEFAULTS,
            normal: [[0.0; KINDS]; KINDS],
            right: [0.0; KINDS],
            ratios: VecDeque::new(),
            factors: Self::factors_of(&VecDeque::new()),
            frames: 0,
        }
    }
}

impl UnitCosts {
    /// Sum of counts times costs, in seconds; always above 0.
    pub fn mean(&self, counts: &WorkCounts) -> f64 {
        let sum: f64 = counts.by_kind().iter().zip(&self.seconds).map(|(n, c)| n * c).sum();
        sum.max(1e-9)
    }

    /// Computes [`UnitCosts::factors`] from ratios.
    pub fn factors_of(ratios: &VecDeque<f64>) -> [f64; 2] {
        let mut some: Vec<f64> = ratios.iter().copied().collect();
        let rank = (QUANTILE * some.len() as f64).ceil() as usize;
        // Selects two ranks instead of sorting, because every forecast needs them.
        let mut at = |i: usize| ranked(&mut some, i, f64::total_cmp).unwrap_or(1.0);
        let (low, high) = (at(ratios.len() - rank), at(rank.saturating_sub(1)));
        if ratios.len() < ENOUGH { [low.min(1.0 / UNKNOWN), high.max(UNKNOWN)] } else { [low, high] }
    }

    #[cfg(test)]
    fn factor(&self) -> f64 {
        self.factors[1]
    }

    /// Learns from a frame that took `seconds` (above 0).
    pub fn observe(&mut self, counts: &WorkCounts, seconds: f64) {
        // Ratios of the first frames would only measure the defaults.
        if self.frames >= FIRST {
            self.ratios.push_back((seconds / self.mean(counts)).clamp(1e-6, 1e6));
        }
        if self.ratios.len() > RATIOS {
            self.ratios.pop_front();
        }
        self.factors = Self::factors_of(&self.ratios);
        self.frames += 1;
        let n = counts.by_kind();
        let x: [f64; KINDS] = std::array::from_fn(|k| (n[k] * DEFAULTS[k] / seconds).min(1e6));
        for (row, x_row) in self.normal.iter_mut().zip(x) {
            for (cell, x) in row.iter_mut().zip(x) {
                *cell = FORGETTING * *cell + x_row * x;
            }
        }
        for (right, x) in self.right.iter_mut().zip(x) {
            *right = FORGETTING * *right + x;
        }
        self.solve();
    }

    /// Solves non-negative least squares by coordinate descent; the sum is convex.
    fn solve(&mut self) {
        // Kinds that were never counted keep their defaults and do not affect the others.
        let counted: Vec<usize> = (0..KINDS).filter(|k| self.normal[*k][*k] > 0.0).collect();
        let mut u = [1.0; KINDS];
        for &k in &counted {
            u[k] = self.seconds[k] / DEFAULTS[k];
        }
        for _ in 0..SWEEPS {
            let mut change: f64 = 0.0;
            for &k in &counted {
                // Terms of uncounted kinds are 0.
                let all: f64 = self.normal[k].iter().zip(&u).map(|(n, u)| n * u).sum();
                let others = all - self.normal[k][k] * u[k];
                let best = ((self.right[k] + PULL - others) / (self.normal[k][k] + PULL)).max(0.0);
                change = change.max((best - u[k]).abs());
                u[k] = best;
            }
            if change < DONE {
                break;
            }
        }
        self.seconds = std::array::from_fn(|k| u[k] * DEFAULTS[k]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;

    /// A random frame, and its time at these costs.
    fn frame(random: &mut SplitMix64, costs: &[f64; KINDS]) -> (WorkCounts, f64) {
        let mut many = |most: u64| (random.unit() * most as f64) as u64 + 1;
        let counts = WorkCounts {
            runs: many(2000),
            polygons: many(5000),
            waves: many(8),
            samples_tested: many(3_000_000),
            samples_written: many(1_000_000),
            pixels_resolved: 4 * 262_144,
            ..WorkCounts::default()
        };
        let seconds = counts.by_kind().iter().zip(costs).map(|(n, c)| n * c).sum();
        (counts, seconds)
    }

    const COSTS: [f64; KINDS] = [2e-4, 2e-7, 9e-7, 1e-5, 8e-10, 5e-9, 1e-9, 0.0, 0.0, 0.0];

    /// Median and 95 % quantile of the relative error, with each estimate made before its frame is learnt.
    fn errors(model: &mut UnitCosts, frames: usize, mut next: impl FnMut() -> (WorkCounts, f64)) -> [f64; 2] {
        let mut errors: Vec<f64> = (0..frames)
            .map(|_| {
                let (counts, seconds) = next();
                let error = (model.mean(&counts) / seconds - 1.0).abs();
                model.observe(&counts, seconds);
                error
            })
            .collect();
        errors.sort_unstable_by(f64::total_cmp);
        [errors[frames / 2], errors[frames * 95 / 100]]
    }

    #[test]
    fn costs_that_are_true_are_found() {
        let mut random = SplitMix64(1);
        let mut model = UnitCosts::default();
        errors(&mut model, 50, || frame(&mut random, &COSTS));
        let [median, p95] = errors(&mut model, 200, || frame(&mut random, &COSTS));
        assert!(median < 0.01 && p95 < 0.03, "{median} {p95}");
        assert!(model.factor() < 1.1, "{}", model.factor());
    }

    #[test]
    fn noise_is_not_costs_and_costs_are_not_negative() {
        let mut random = SplitMix64(2);
        let mut model = UnitCosts::default();
        let mut noisy = |model: &mut UnitCosts, frames: usize| {
            errors(model, frames, || {
                let (counts, seconds) = frame(&mut random, &COSTS);
                (counts, seconds * (0.9 + 0.2 * random.unit()))
            })
        };
        noisy(&mut model, 50);
        let [median, p95] = noisy(&mut model, 400);
        // Half of the noise is below 5 %, 95 % of it below 9.5 %; the learnt costs add some.
        assert!(median < 0.07 && p95 < 0.15, "{median} {p95}");
        assert!(model.seconds.iter().all(|c| *c >= 0.0 && c.is_finite()));
    }

    /// Three slow frames in 200 are enough for plans to expect more.
    #[test]
    fn a_machine_that_gets_busy_is_planned_for_in_a_few_frames() {
        let mut random = SplitMix64(3);
        let mut model = UnitCosts::default();
        errors(&mut model, 250, || frame(&mut random, &COSTS));
        let before = model.factor();
        errors(&mut model, 3, || {
            let (counts, seconds) = frame(&mut random, &COSTS);
            (counts, 3.0 * seconds)
        });
        assert!(before < 1.1 && model.factor() > 2.0, "{before} {}", model.factor());
        // The costs follow as older frames fade; relative errors weight a fast frame nine times as much as a slow one.
        // With a = 0.98^n / (1 - 0.98^n) after n slow frames, they have risen by (a + 1/3) / (a + 1/9) instead of 3,
        // which is too low by 39 % after 100, 9.3 % after 200 and 1.4 % after 300.
        let mut slow = |frames| {
            errors(&mut model, frames, || {
                let (counts, seconds) = frame(&mut random, &COSTS);
                (counts, 3.0 * seconds)
            })
        };
        slow(87);
        for (frames, off) in [(20, 0.387), (80, f64::NAN), (20, 0.093), (80, f64::NAN), (20, 0.014)] {
            let [median, _] = slow(frames);
            assert!(off.is_nan() || (0.6..1.5).contains(&(median / off)), "{median} and not {off}");
        }
    }

    #[test]
    fn without_frames_an_estimate_is_careful() {
        let model = UnitCosts::default();
        assert_eq!(model.factor(), UNKNOWN);
        assert!(model.mean(&WorkCounts::default()) > 0.0);
    }
}
