//! Progress of a frame with a deadline, band by band.
//!
//! A band draws one batch of a wave after the other, nearest first, and reads the clock before each. When it stops, all
//! polygons nearer than the first batch left out have been drawn: samples nearer than that batch are final. Samples
//! beyond it are not final, and the image leaves them out.

use super::batch::Batch;
use super::thinning;
use crate::deadline::{DeadlineOutcome, Degradation, DegradationKind, DegradationStep, Opening, PLENTY, Wave};
use crate::plan::{CountName, FramePlan, Run, StageName, Stats};
use presight_model::sensor::ImagePart;
use std::ops::{Range, RangeInclusive};
use std::time::Duration;

/// Minimum and maximum number of polygons of the first wave. Every further wave has as many polygons as all waves
/// before it together.
pub(super) const FIRST_WAVE: RangeInclusive<usize> = 256..=4096;

/// Minimum number of polygons in a wave, whatever time is left.
const MIN_WAVE: usize = *FIRST_WAVE.end() / 4;

/// Progress of a band.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Band {
    /// Metres: all polygons nearer than this have been drawn.
    pub complete_to: f32,
    /// True if it stopped before all of its polygons were drawn.
    pub has_stopped: bool,
    /// True if it drew samples since the tiles' farthest depths were measured.
    pub stale: bool,
    /// Samples tested against a polygon's depth.
    pub tested: u64,
    /// Intervals, or tiles, that hold these samples.
    pub spans: u64,
    /// Tested samples since the last reading of the clock.
    pub unwatched: u64,
    /// Samples that show a polygon; counted only with a deadline.
    pub written: u64,
    /// Samples given up.
    pub given_up: u64,
    /// Time for its images, with a deadline.
    pub resolving: Duration,
}

/// Records the times of culling, setup and drawing.
pub(super) fn record_stages(times: [Duration; 3], waves: usize, stats: &mut Stats) {
    let [hiding, setting_up, drawing] = times.map(|time| time.as_secs_f64() * 1e3);
    if waves > 1 {
        stats.stages_ms.push((StageName::Hidden, hiding));
    } else {
        stats.leave_out(StageName::Hidden, "the polygons are drawn in one wave");
    }
    stats.stages_ms.push((StageName::Setup, if waves > 1 { setting_up } else { hiding + setting_up }));
    stats.stages_ms.push((StageName::Rasterization, drawing));
}

/// The runs to draw next: as many polygons as all runs before them, at least `min` and at most `max`.
pub(super) fn next_wave(runs: &[Run], start: usize, min: usize, max: usize) -> Range<usize> {
    let before: usize = runs[..start].iter().map(|r| r.count as usize).sum();
    let wanted = before.max(min).min(max);
    let mut polygons = 0;
    let mut end = start;
    while end < runs.len() && polygons < wanted {
        polygons += runs[end].count as usize;
        end += 1;
    }
    start..end
}

/// Progress of a frame.
pub(super) struct FrameProgress<'a> {
    plan: &'a FramePlan,
    pub bands: Vec<Band>,
    /// Time from the call to the beginning of drawing.
    begun: Duration,
    /// Time after the call at which drawing stopped before all runs were drawn.
    stopped_at: Option<Duration>,
    pub has_stopped: bool,
    /// True if the drawing may be stopped, so that bands must keep the same progress.
    pub in_step: bool,
    /// True if the time left exceeds the expected drawing time by [`PLENTY`]: bands draw a wave without reading the
    /// clock.
    pub has_plenty: bool,
    /// The first wave, with a deadline: the time when its drawing began, and its record.
    wave: Option<(Duration, Wave)>,
}

impl<'a> FrameProgress<'a> {
    pub fn new(plan: &'a FramePlan, bands: usize) -> Self {
        Self {
            plan,
            bands: vec![Band::default(); bands],
            begun: plan.elapsed(),
            stopped_at: None,
            has_stopped: false,
            in_step: false,
            has_plenty: false,
            wave: None,
        }
    }

    /// Records the first wave, made of the first `done` runs, after its setup, which took `set_up`. `beyond` is the
    /// nearest distance of the runs that follow. Returns the stride at which the largest number of samples is expected
    /// in time.
    pub fn begin_wave(&mut self, batches: &[Batch], done: usize, beyond: f32, set_up: Duration) -> u32 {
        let Some(watch) = self.plan.watch() else { return 1 };
        let polygons = batches.iter().map(|batch| batch.polygons.len() as u64).sum();
        let samples = batches.iter().map(|batch| batch.pixels).sum();
        let estimate = self.plan.pace().map_or(0.0, |pace| thinning::seconds(pace, polygons, samples, 1));
        let now = watch.elapsed();
        self.wave = Some((now, Wave { polygons, samples, estimate_ms: 1e3 * estimate, time_ms: 0.0 }));
        let left = watch.left().as_secs_f64();
        match self.plan.pace() {
            Some(pace) => {
                let set_up = set_up.as_secs_f64();
                let rest = (pace.drawing - set_up - estimate).max(0.0);
                let (grid, radius) = (self.plan.sensor.grid(), self.plan.nearest_after(usize::MAX));
                let later = &self.plan.runs[done..];
                let frame = thinning::Frame { batches, later, rest, beyond, radius, grid, pace, left, set_up };
                self.in_step = estimate + rest > left;
                self.has_plenty = PLENTY * (estimate + rest) < left;
                let is_thinned = self.plan.sensor.part_stride() > 1;
                if self.in_step && !is_thinned { thinning::stride(&frame) } else { 1 }
            }
            None => {
                self.in_step = true;
                1
            }
        }
    }

    /// Stops all bands once one band has stopped; each is complete as far as it has drawn. Returns true if they have
    /// stopped.
    pub fn stop_together(&mut self) -> bool {
        let stopped = self.bands.iter().any(|band| band.has_stopped);
        if stopped {
            self.bands.iter_mut().for_each(|band| band.has_stopped = true);
        }
        stopped
    }

    /// Records the end of the first wave, unless the time was up before. The record covers drawing alone, without
    /// images.
    pub fn end_wave(&mut self, waves: usize, last: bool) {
        if waves > 1 {
            return;
        }
        // A wave that was not set up is not recorded either.
        let stopped = self.bands.iter().any(|band| band.has_stopped) || self.wave.is_some_and(|(_, w)| w.polygons == 0);
        let (Some(watch), Some((begun, wave))) = (self.plan.watch(), &mut self.wave) else { return };
        let threads = rayon::current_num_threads().max(1) as u32;
        let resolving = self.bands.iter().map(|band| band.resolving).sum::<Duration>() / threads;
        let images = if last { resolving } else { Duration::ZERO };
        wave.time_ms = watch.elapsed().saturating_sub(*begun).saturating_sub(images).as_secs_f64() * 1e3;
        if stopped {
            self.wave = None;
        }
    }

    /// True when the images have to be made from the polygons drawn so far.
    pub fn is_over(&mut self) -> bool {
        let Some(watch) = self.plan.watch() else { return false };
        self.has_stopped = self.bands.iter().any(|band| band.has_stopped) || watch.is_over();
        if self.has_stopped {
            self.stopped_at = Some(watch.elapsed());
        }
        self.has_stopped
    }

    /// Maximum number of polygons in the next wave: as many as the time left allows, by the time that the first `done`
    /// runs took.
    pub fn max_polygons(&self, done: usize) -> usize {
        let Some(watch) = self.plan.watch().filter(|_| done > 0) else { return usize::MAX };
        let polygons: usize = self.plan.runs[..done].iter().map(|r| r.count as usize).sum();
        let spent = watch.elapsed().saturating_sub(self.begun).as_secs_f64().max(1e-9);
        ((watch.left().as_secs_f64() / spent * polygons as f64) as usize).max(MIN_WAVE)
    }

    /// Records counts and, with a deadline, how many samples were given up.
    pub fn record(&self, stats: &mut Stats) {
        let sum = |of: fn(&Band) -> u64| self.bands.iter().map(of).sum::<u64>();
        stats.count(CountName::Spans, sum(|band| band.spans) as usize);
        stats.count(CountName::SamplesTested, sum(|band| band.tested) as usize);
        let Some(watch) = self.plan.watch() else { return };
        stats.count(CountName::SamplesWritten, sum(|band| band.written) as usize);
        let resolving = self.bands.iter().map(|band| band.resolving).sum::<Duration>() / stats.threads.max(1) as u32;
        let drawn = self.stopped_at.unwrap_or_else(|| watch.elapsed().saturating_sub(resolving));
        let drawn_ms = drawn.as_secs_f64() * 1e3;
        let complete_to = f64::from(self.bands.iter().map(|band| band.complete_to).fold(f32::INFINITY, f32::min));
        let samples = sum(|band| band.given_up);
        let stopped = DegradationStep { means: DegradationKind::Clock, at_ms: drawn_ms, metres: Some(complete_to) };
        let by_clock = self.plan.radius().is_none_or(|radius| complete_to < f64::from(radius));
        let means = by_clock.then_some(stopped).into_iter().collect();
        let given_up = (samples > 0).then_some(Degradation { complete_to, samples, means, ..Degradation::default() });
        let wave = self.wave.as_ref().map(|(_, wave)| *wave);
        stats.deadline = Some(DeadlineOutcome { drawn_ms, given_up, wave, ..DeadlineOutcome::default() });
    }
}

/// Records that a part of the image was drawn, beginning at some time after the call, and the number of rays left out.
pub(super) fn record_part(plan: &FramePlan, part: &ImagePart, since: Duration, left_out: u64, stats: &mut Stats) {
    let kept = stats.deadline.get_or_insert_default();
    if left_out == 0 {
        return;
    }
    let given_up = kept.given_up.get_or_insert_default();
    given_up.samples += left_out;
    let all = plan.sensor.whole();
    if (part.first_column, part.end_column) != (all.first_column, all.end_column) {
        let [heading_deg, opening_deg] = plan.sensor.opening_of(part);
        given_up.opening = Some(Opening { heading_deg, opening_deg });
    }
    if part.stride > 1 {
        given_up.stride = part.stride;
        let at_ms = since.as_secs_f64() * 1e3;
        given_up.means.insert(0, DegradationStep { means: DegradationKind::Stride, at_ms, metres: None });
    }
}
