//! Times of paths and their stages, with warm-up, in interleaved runs.

use super::path::PathName;
use super::results::{PathNotes, StageTime};
use super::setup::Effort;
use crate::median;
use presight_model::error::Result;
use presight_model::statistics;
use presight_render::plan::{StageName, Stats};
use std::time::{Duration, Instant};

/// A run longer than this is hardly affected by what other paths left in the caches.
const SHORT: Duration = Duration::from_millis(10);

/// The runs of one path.
#[derive(Clone, Debug, Default)]
pub(super) struct Timing {
    times_ms: Vec<f64>,
    /// The median of each turn; NaN for a turn without a counted run. Turns of one number are neighbours in time.
    turns_ms: Vec<f64>,
    stats: Vec<Stats>,
    /// Time of the last run, counted or not.
    last: Duration,
}

/// A path with its times.
pub(super) struct TimedPath<T> {
    pub what: T,
    pub timing: Timing,
}

impl<T> TimedPath<T> {
    pub fn new(what: T) -> Self {
        Self { what, timing: Timing::default() }
    }
}

/// Runs all paths in turns, so that changes in the machine's speed or load affect all paths alike. In each round, each
/// path runs until it has its share of runs or of time. All paths must have been warmed up ([`Timing::warm`]). A short
/// path begins its turn with an uncounted run, because other paths have evicted its data from the caches.
pub(super) fn by_turns<T>(
    effort: &Effort,
    all: &mut [TimedPath<T>],
    mut run: impl FnMut(&mut T) -> Result<Stats>,
    mut round_begins: impl FnMut(usize),
) -> Result<()> {
    let mut done = vec![(0, Duration::ZERO); all.len()];
    for round in 1..=effort.rounds {
        round_begins(round);
        let share = |of: usize| (of * round).div_ceil(effort.rounds);
        let until = effort.patience.mul_f64(round as f64 / effort.rounds as f64);
        for (one, (runs, spent)) in all.iter_mut().zip(&mut done) {
            let more =
                |runs: usize, spent| runs < share(effort.min_runs) || runs < share(effort.max_runs) && spent < until;
            if more(*runs, *spent) && one.timing.last < SHORT {
                one.timing.warm(|| run(&mut one.what))?;
            }
            let before = one.timing.runs();
            while more(*runs, *spent) {
                one.timing.count(|| run(&mut one.what))?;
                (*runs, *spent) = (*runs + 1, *spent + one.timing.last);
            }
            one.timing.end_turn(before);
        }
    }
    Ok(())
}

/// The quantile by nearest rank; 0 for no values.
fn quantile(values: &[f64], share: f64) -> f64 {
    statistics::quantile(&mut values.to_vec(), share).unwrap_or(0.0)
}

impl Timing {
    /// Runs once without counting the time.
    pub fn warm(&mut self, run: impl FnOnce() -> Result<Stats>) -> Result<Stats> {
        let start = Instant::now();
        let stats = run()?;
        self.last = start.elapsed();
        Ok(stats)
    }

    fn count(&mut self, run: impl FnOnce() -> Result<Stats>) -> Result<()> {
        let stats = self.warm(run)?;
        self.times_ms.push(self.last.as_secs_f64() * 1e3);
        self.stats.push(stats);
        Ok(())
    }

    /// Notes the median of the runs since run `before`.
    fn end_turn(&mut self, before: usize) {
        let runs = &self.times_ms[before..];
        self.turns_ms.push(if runs.is_empty() { f64::NAN } else { median(runs.to_vec()) });
    }

    /// The median of each turn, NaN for a turn without a run.
    pub fn turns(&self) -> Vec<f64> {
        self.turns_ms.clone()
    }

    pub fn runs(&self) -> usize {
        self.times_ms.len()
    }

    pub fn median(&self) -> f64 {
        median(self.times_ms.clone())
    }

    /// First and third quartile of the times.
    pub fn quartiles(&self) -> [f64; 2] {
        [0.25, 0.75].map(|share| quantile(&self.times_ms, share))
    }

    pub fn p95(&self) -> f64 {
        quantile(&self.times_ms, 0.95)
    }

    /// Multiplies all times by `factor`, to scale them to another number of features.
    pub fn scaled(mut self, factor: f64) -> Self {
        self.times_ms.iter_mut().chain(&mut self.turns_ms).for_each(|ms| *ms *= factor);
        self
    }

    /// Times of stages, and the counts and skipped stages of the last run.
    pub fn notes(&self, named: &PathName) -> PathNotes {
        let last = self.stats.last().cloned().unwrap_or_default();
        let mut names: Vec<StageName> = Vec::new();
        for (name, _) in &last.stages_ms {
            if !names.contains(name) {
                names.push(*name);
            }
        }
        let stage = |stage: StageName| {
            let times: Vec<f64> = self.stats.iter().map(|s| s.stage_ms(stage).unwrap_or(0.0)).collect();
            StageTime { stage, p95_ms: quantile(&times, 0.95), median_ms: median(times) }
        };
        PathNotes {
            engine: named.engine.to_owned(),
            variant: named.variant.clone(),
            how: named.how.clone(),
            default: named.default,
            runs: self.runs(),
            stages: names.into_iter().map(stage).collect(),
            counts: last.counts,
            left_out: last.left_out,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs paths that sleep. Returns their indices in the order of the runs, and the numbers of counted runs and of
    /// turns with such runs of each.
    fn ran(effort: &Effort, sleeps: &[u64]) -> (Vec<usize>, Vec<usize>, Vec<usize>) {
        let mut order = Vec::new();
        let mut all: Vec<_> = (0..sleeps.len()).map(TimedPath::new).collect();
        let mut run = |i: &mut usize| {
            order.push(*i);
            std::thread::sleep(Duration::from_millis(sleeps[*i]));
            Ok(Stats::default())
        };
        for one in &mut all {
            one.timing.warm(|| run(&mut one.what)).unwrap();
        }
        by_turns(effort, &mut all, run, |_| ()).unwrap();
        let turns = |one: &TimedPath<usize>| one.timing.turns().iter().filter(|ms| ms.is_finite()).count();
        (order, all.iter().map(|one| one.timing.runs()).collect(), all.iter().map(turns).collect())
    }

    #[test]
    fn paths_take_turns_and_first_runs_are_not_counted() {
        let effort = Effort { rounds: 2, min_runs: 2, max_runs: 4, patience: Duration::from_secs(9), ..Effort::QUICK };
        let (mut order, counted, turns) = ran(&effort, &[0, 0]);
        assert_eq!((counted, turns), (vec![4, 4], vec![2, 2]));
        assert!(order.len() > 2 + 8, "short paths are warmed up again in each turn: {order:?}");
        order.dedup();
        assert_eq!(order, [0, 1, 0, 1, 0, 1]);
        // Only the minimum runs without patience; a long path needs no additional warm-up.
        let effort = Effort { patience: Duration::ZERO, ..effort };
        let (order, counted, _) = ran(&effort, &[0, 12]);
        assert_eq!(counted, [2, 2]);
        assert_eq!(order.iter().filter(|i| **i == 1).count(), 1 + 2, "{order:?}");
    }

    #[test]
    fn quantiles_of_times_have_the_nearest_rank() {
        let timing = Timing { times_ms: (1..=100).rev().map(f64::from).collect(), ..Timing::default() };
        assert_eq!((timing.median(), timing.p95(), timing.quartiles()), (50.5, 95.0, [25.0, 75.0]));
        assert_eq!((Timing::default().median(), Timing::default().p95()), (0.0, 0.0));
    }

    #[test]
    fn stages_of_one_name_are_added_and_told_with_their_spread() {
        let run =
            |ms: f64| Stats { stages_ms: vec![(StageName::Setup, ms), (StageName::Setup, 1.0)], ..Stats::default() };
        let timing = Timing { stats: [1.0, 2.0, 9.0].map(run).to_vec(), ..Timing::default() };
        let told = timing.notes(&PathName::default()).stages;
        assert_eq!(told, [StageTime { stage: StageName::Setup, median_ms: 3.0, p95_ms: 10.0 }]);
    }
}
