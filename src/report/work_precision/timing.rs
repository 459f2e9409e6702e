//! Times of a path: warmed up, repeated, by stage.

use super::{Effort, PathNotes};
use crate::error::Result;
use crate::plan::Stats;
use crate::report::median;
use std::time::Instant;

/// All runs of one path.
#[derive(Clone, Debug, Default)]
pub(super) struct Timing {
    times_ms: Vec<f64>,
    stats: Vec<Stats>,
}

impl Timing {
    /// Runs once without counting it, then as often as the effort asks for.
    pub fn measure(&mut self, effort: &Effort, mut run: impl FnMut() -> Result<Stats>) -> Result<()> {
        run()?;
        let began = Instant::now();
        for done in 0..effort.most_runs {
            if done >= effort.least_runs && began.elapsed() >= effort.patience {
                break;
            }
            let start = Instant::now();
            let stats = run()?;
            self.times_ms.push(start.elapsed().as_secs_f64() * 1e3);
            self.stats.push(stats);
        }
        Ok(())
    }

    pub fn runs(&self) -> usize {
        self.times_ms.len()
    }

    pub fn median(&self) -> f64 {
        median(self.times_ms.clone())
    }

    /// Nearest rank.
    pub fn p95(&self) -> f64 {
        let mut sorted = self.times_ms.clone();
        sorted.sort_by(f64::total_cmp);
        let rank = (sorted.len() * 95).div_ceil(100).max(1) - 1;
        sorted.get(rank).copied().unwrap_or(0.0)
    }

    /// The same times another `factor` long: of so many features instead of those that were there.
    pub fn scaled(mut self, factor: f64) -> Self {
        self.times_ms.iter_mut().for_each(|ms| *ms *= factor);
        self
    }

    /// Medians of stages; counts and what was left out of the last run.
    pub fn notes(&self, engine: String, variant: String) -> PathNotes {
        let last = self.stats.last().cloned().unwrap_or_default();
        let mut stages: Vec<String> = Vec::new();
        for (name, _) in &last.stages_ms {
            if !stages.contains(name) {
                stages.push(name.clone());
            }
        }
        let of_run = |stats: &Stats, stage: &str| -> f64 {
            stats.stages_ms.iter().filter(|(name, _)| name == stage).map(|(_, ms)| ms).sum()
        };
        let stage = |name: String| {
            let ms = median(self.stats.iter().map(|s| of_run(s, &name)).collect());
            (name, ms)
        };
        let stages_ms = stages.into_iter().map(stage).collect();
        PathNotes { engine, variant, stages_ms, counts: last.counts, left_out: last.left_out }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn the_first_run_is_not_counted() {
        let effort = Effort { least_runs: 3, most_runs: 5, patience: Duration::ZERO, ..Effort::QUICK };
        let (mut timing, mut ran) = (Timing::default(), 0);
        let run = || {
            ran += 1;
            Ok(Stats { stages_ms: vec![("a".into(), f64::from(ran)), ("a".into(), 1.0)], ..Stats::default() })
        };
        timing.measure(&effort, run).unwrap();
        assert_eq!((ran, timing.runs()), (4, 3));
        assert_eq!(timing.notes("e".into(), "v".into()).stages_ms, [("a".to_owned(), 4.0)]);
        let effort = Effort { patience: Duration::MAX, ..effort };
        timing.measure(&effort, || Ok(Stats::default())).unwrap();
        assert_eq!(timing.runs(), 8);
    }

    #[test]
    fn quantiles_are_by_nearest_rank() {
        let timing = Timing { times_ms: (1..=100).rev().map(f64::from).collect(), stats: Vec::new() };
        assert_eq!((timing.median(), timing.p95()), (50.5, 95.0));
        assert_eq!((Timing::default().median(), Timing::default().p95()), (0.0, 0.0));
    }
}
