//! How far a frame with a deadline has come, band by band.
//!
//! A band draws one batch of a wave after the other, nearest first, and looks at the clock before each. Where it stops,
//! everything nearer than the first batch left out has been drawn: samples nearer than that are final. What was drawn beyond
//! it is not final and is not shown.

use super::FIRST_WAVE;
use crate::deadline::{DeadlineOutcome, Degradation, DegradationKind, DegradationStep, Watch};
use crate::plan::{FramePlan, Stats};
use std::time::Duration;

/// Least size of a wave, which the time left may ask for.
const LEAST_WAVE: usize = FIRST_WAVE / 4;

/// How far a band has come.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Band {
    /// Metres: everything nearer has been drawn.
    pub complete_to: f32,
    /// It stopped before all of its polygons were drawn.
    pub has_stopped: bool,
    /// Samples tested against a polygon's depth.
    pub tested: u64,
    /// Samples that show a polygon; counted only with a deadline.
    pub written: u64,
    /// Samples given up.
    pub given_up: u64,
    /// Time for its images, with a deadline.
    pub resolving: Duration,
}

/// How far a frame has come.
pub(super) struct FrameProgress<'a> {
    plan: &'a FramePlan,
    pub bands: Vec<Band>,
    /// Drawing began so long after the call.
    begun: Duration,
    /// The time was up before all runs were drawn, at this time after the call.
    stopped_at: Option<Duration>,
    pub has_stopped: bool,
}

impl<'a> FrameProgress<'a> {
    pub fn new(plan: &'a FramePlan, bands: usize) -> Self {
        let begun = plan.watch.as_ref().map_or(Duration::ZERO, Watch::elapsed);
        Self { plan, bands: vec![Band::default(); bands], begun, stopped_at: None, has_stopped: false }
    }

    /// True when the images have to be made of what there is.
    pub fn is_over(&mut self) -> bool {
        let Some(watch) = &self.plan.watch else { return false };
        self.has_stopped = self.bands.iter().any(|band| band.has_stopped) || watch.is_over();
        if self.has_stopped {
            self.stopped_at = Some(watch.elapsed());
        }
        self.has_stopped
    }

    /// Polygons of the next wave at most: by what those of the first `done` runs took, as many as there is time for.
    pub fn most_polygons(&self, done: usize) -> usize {
        let Some(watch) = self.plan.watch.as_ref().filter(|_| done > 0) else { return usize::MAX };
        let polygons: usize = self.plan.runs[..done].iter().map(|r| r.count as usize).sum();
        let spent = watch.elapsed().saturating_sub(self.begun).as_secs_f64().max(1e-9);
        ((watch.left().as_secs_f64() / spent * polygons as f64) as usize).max(LEAST_WAVE)
    }

    /// Tells counts and, with a deadline, what was given up.
    pub fn tell(&self, stats: &mut Stats) {
        let sum = |of: fn(&Band) -> u64| self.bands.iter().map(of).sum::<u64>();
        stats.count("samples tested", sum(|band| band.tested) as usize);
        let Some(watch) = &self.plan.watch else { return };
        stats.count("samples written", sum(|band| band.written) as usize);
        let resolving = self.bands.iter().map(|band| band.resolving).sum::<Duration>() / stats.threads.max(1) as u32;
        let drawn = self.stopped_at.unwrap_or_else(|| watch.elapsed().saturating_sub(resolving));
        let drawn_ms = drawn.as_secs_f64() * 1e3;
        let complete_to = f64::from(self.bands.iter().map(|band| band.complete_to).fold(f32::INFINITY, f32::min));
        let samples = sum(|band| band.given_up);
        let stopped = DegradationStep { means: DegradationKind::Clock, at_ms: drawn_ms, metres: complete_to };
        let by_clock = self.plan.radius.is_none_or(|radius| complete_to < f64::from(radius));
        let means = by_clock.then_some(stopped).into_iter().collect();
        let given_up = (samples > 0).then_some(Degradation { complete_to, samples, means });
        stats.deadline = Some(DeadlineOutcome { drawn_ms, given_up, ..DeadlineOutcome::default() });
    }
}

/// Metres: no polygon beyond the first `done` runs is nearer.
pub(super) fn nearest_after(plan: &FramePlan, done: usize) -> f32 {
    match plan.runs.get(done) {
        Some(run) => run.nearest_below(),
        None => plan.radius.unwrap_or(f32::INFINITY),
    }
}
