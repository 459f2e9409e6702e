//! Keeps deadlines: says what cannot be done in time, when drawing has to stop, and learns from what was done.
//!
//! The clock that the engine stops by keeps the deadline. The unit costs decide three things only: whether even an image of nothing
//! would be late, how much time images take after the drawing, and which runs need not be begun because even a low estimate
//! of their time is too long.

mod cut;
mod features;
mod thinning;

use super::{CostModel, Forecast, Key, TimeEstimate, WorkCounts};
use crate::deadline::{Clock, DeadlineEngine, DegradationKind, DegradationStep, Priority, SystemClock, Watch};
use crate::plan::{CountName, FramePlan, Outputs, Pace, Run, Stats};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::sensor::{STRIDES, Sensor};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use thinning::Stopping;

/// Time for what no cost counts: learning, and the way back to the caller.
const MARGIN: Duration = Duration::from_micros(100);
/// Images that take so much longer than on average are planned for, whatever else is given up.
const SLOW: f64 = 1.25;
/// What is left of a doubted estimate after each refusal by it, and at least.
const DOUBT: f64 = 0.98;
const MOST_DOUBT: f64 = 0.25;
/// The same of estimates that nothing was learnt for: machines differ by as much.
const UNKNOWN_MACHINE: f64 = 0.125;

/// Keeps the deadlines of one engine.
#[derive(Debug)]
pub struct Controller {
    clock: Arc<dyn Clock>,
    pub costs: CostModel,
    /// By what factor estimates are doubted that refused the last frames: only frames that are tried can correct them.
    doubts: BTreeMap<Key, f64>,
    /// By stride.
    stopping: BTreeMap<Key, Stopping>,
}

/// A prediction with a deadline.
#[derive(Debug)]
pub struct DeadlineFrame {
    limit: Duration,
    watch: Watch,
    key: Key,
    priority: Priority,
    /// Images may be thinned and narrowed.
    draws_parts: bool,
    /// Width and height of an image, and how many images there are.
    size: [u32; 2],
    images: u64,
    /// Selection began and ended so long after the call, and images were there.
    begun: Duration,
    selected: Duration,
    images_made: Duration,
    /// What the drawing was to draw, before a cut.
    counts: WorkCounts,
    cut: Vec<DegradationStep>,
    /// Chosen after selection.
    stride: u32,
    /// The share of its estimated time that there was for the drawing.
    time: Option<f64>,
    first_estimate: Option<f64>,
    /// What was expected of features, before any was found.
    features: WorkCounts,
    /// Features that were found, and rising numbers of those left out.
    pub found: u64,
    pub left_out: Vec<u32>,
}

impl Default for Controller {
    fn default() -> Self {
        let clock = Arc::new(SystemClock::default());
        Self { clock, costs: CostModel::default(), doubts: BTreeMap::new(), stopping: BTreeMap::new() }
    }
}

impl Controller {
    /// Takes another clock.
    pub fn set_clock(&mut self, clock: Arc<dyn Clock>) {
        self.clock = clock;
    }

    /// Begins a prediction; `None` without a deadline, and `engine` if it cannot stop.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] for no time at all, and for an engine that cannot stop; [`ErrorKind::Deadline`] if not even an image
    /// of nothing can be made.
    pub fn begin(
        &mut self,
        deadline: Option<(Duration, &Priority)>,
        engine: Option<DeadlineEngine>,
        (sensor, outputs): (&Sensor, Outputs),
    ) -> Result<Option<DeadlineFrame>> {
        let Some((limit, priority)) = deadline else { return Ok(None) };
        let watch = Watch::start(self.clock.clone(), limit);
        if limit.is_zero() {
            return Err(Error::usage("a deadline of 0 ms", "give a time above 0, or no deadline"));
        }
        let Some(DeadlineEngine { name, adapter, threads, draws_parts }) = engine else {
            let what = "this engine cannot stop when its time is up, and keeps no deadline";
            return Err(Error::usage(what, "take the CPU engine (--backend cpu), or give no deadline"));
        };
        let key = Key::new(name, adapter.as_deref(), threads, sensor, outputs, Forecast::Images);
        let (size, images) = ([sensor.width(), sensor.height()], outputs.iter().count() as u64);
        let mut timed = DeadlineFrame::new(limit, watch, key, priority, (size, images));
        timed.draws_parts = draws_parts;
        let access = self.costs.estimate(&timed.key_of(Forecast::Access), &WorkCounts::default());
        let floor = [access, self.least_images(&timed)];
        let doubt = self.doubt(&timed.key);
        let believed = |e: &TimeEstimate| {
            if e.frames == 0 { e.mean * UNKNOWN_MACHINE } else { e.upper.min(SLOW * e.mean) * doubt }
        };
        let least = floor.iter().map(believed).sum::<f64>();
        if limit.as_secs_f64() < least {
            self.doubts.insert(timed.key, (doubt * DOUBT).max(MOST_DOUBT));
            return Err(impossible(limit, floor.iter().map(|e| e.upper).sum::<f64>() + MARGIN.as_secs_f64()));
        }
        Ok(Some(timed))
    }

    /// After selection: when drawing has to stop, and which runs need not be begun.
    ///
    /// # Errors
    /// [`ErrorKind::Deadline`] if the selection took so long that no image can be made in time.
    pub fn plan(&mut self, timed: &mut DeadlineFrame, plan: &mut FramePlan) -> Result<()> {
        timed.selected = timed.watch.elapsed();
        let access = timed.selected.saturating_sub(timed.begun);
        let least = self.least_images(timed);
        let left = timed.limit.saturating_sub(timed.selected);
        let doubt = self.doubt(&timed.key);
        let surely = if least.frames == 0 { least.mean * UNKNOWN_MACHINE } else { least.lower * doubt };
        if left.as_secs_f64() < surely {
            self.doubts.insert(timed.key.clone(), (doubt * DOUBT).max(MOST_DOUBT));
            self.learn(timed, (Forecast::Access, 1), &WorkCounts::default(), access);
            return Err(impossible(timed.limit, (timed.selected + MARGIN).as_secs_f64() + least.upper));
        }
        timed.counts = counts_of(&plan.runs);
        timed.stride = self.stride(timed, left);
        plan.part = thinning::part_of(&plan.sensor, timed.stride);
        let after = self.kept_for_images(timed, timed.stride, left);
        let features = self.reserve(timed, left.saturating_sub(after));
        timed.watch.stop_after(timed.limit.saturating_sub(after + features));
        let drawing = self.costs.estimate(&timed.key_of(Forecast::Selection), &timed.counts);
        let images = self.images(timed, 1);
        let is_known = drawing.frames > 0 && images.frames > 0;
        timed.first_estimate = is_known.then_some(timed.selected.as_secs_f64() + drawing.mean + images.mean);
        let drawing = self.at_stride(timed, (Forecast::Selection, &timed.counts), timed.stride);
        timed.time = is_known.then(|| timed.watch.left().as_secs_f64() / drawing.mean);
        self.cut(timed, plan)?;
        plan.watch = Some(timed.watch.clone());
        plan.pace = self.pace(timed, left, &plan.runs);
        Ok(())
    }

    /// What drawing takes, by what was learnt, where so much time was left after selection.
    fn pace(&self, timed: &DeadlineFrame, left: Duration, runs: &[Run]) -> Option<Pace> {
        let key = timed.key_of(Forecast::Wave);
        let estimate = |counts: WorkCounts| self.costs.estimate(&key, &counts);
        let (none, most) = (estimate(WorkCounts::default()), 1 << 20);
        let each = |counts| (estimate(counts).mean - none.mean).max(0.0) / most as f64;
        let drawing = self.at_stride(timed, (Forecast::Selection, &counts_of(runs)), timed.stride);
        let kept = |stride| self.kept_for_images(timed, stride, left).as_secs_f64();
        // Nothing is thinned where there is plenty.
        let saved = |stride| (kept(timed.stride) - kept(stride)).max(0.0);
        let saved = if self.has_plenty(timed, left) { [0.0; STRIDES.len()] } else { STRIDES.map(saved) };
        (none.frames > 0).then(|| Pace {
            wave: none.mean,
            polygon: each(WorkCounts { polygons: most, ..WorkCounts::default() }),
            sample: each(WorkCounts { samples_tested: most, ..WorkCounts::default() }),
            saved,
            drawing: if drawing.frames > 0 { drawing.mean } else { 0.0 },
        })
    }

    /// Images of nothing, thinned as far as the engine can.
    fn least_images(&self, timed: &DeadlineFrame) -> TimeEstimate {
        self.images(timed, timed.strides().next_back().unwrap_or(1))
    }

    /// Tells how the deadline was kept, and learns.
    pub fn end(&mut self, timed: &DeadlineFrame, stats: &mut Stats) {
        let took = timed.watch.elapsed().max(timed.images_made);
        let mut kept = stats.deadline.take().unwrap_or_default();
        (kept.deadline_ms, kept.images_ms) = (milliseconds(timed.limit), milliseconds(timed.images_made));
        if !timed.left_out.is_empty() {
            let given_up = kept.given_up.get_or_insert_default();
            given_up.features.clone_from(&timed.left_out);
            given_up.means.push(DegradationStep {
                means: DegradationKind::Features,
                at_ms: milliseconds(took),
                metres: None,
            });
        }
        if let Some(given_up) = &mut kept.given_up {
            given_up.means.splice(0..0, timed.cut.iter().cloned());
        }
        kept.first_estimate_ms = timed.first_estimate.map(|s| 1e3 * s).filter(|_| kept.given_up.is_none());
        let drawn = Duration::from_secs_f64(kept.drawn_ms.max(0.0) / 1e3).clamp(timed.selected, timed.images_made);
        self.doubts.remove(&timed.key);
        let access = timed.selected.saturating_sub(timed.begun);
        self.learn(timed, (Forecast::Access, 1), &WorkCounts::default(), access);
        let given_up = kept.given_up.as_ref();
        let stride = given_up.map_or(1, |given_up| given_up.stride);
        let has_all_columns = given_up.is_none_or(|given_up| given_up.opening.is_none());
        let is_whole = stride == 1 && has_all_columns;
        if has_all_columns {
            self.learn(timed, (Forecast::Images, stride), &timed.of_images(), timed.images_made - drawn);
        }
        let stopped = given_up.is_some_and(|g| g.means.iter().any(|m| m.means == DegradationKind::Clock));
        if let Some(time) = timed.time.filter(|_| has_all_columns && stride == timed.stride) {
            let there = 1.0 - given_up.map_or(0, |g| g.samples) as f64 / timed.pixels() as f64;
            let stopping = self.stopping.entry(Self::key_at(timed, Forecast::Selection, stride)).or_default();
            stopping.learn(time, (there / timed.share(stride)).min(1.0));
        }
        if timed.cut.is_empty() && has_all_columns && stride == timed.stride {
            let (took, key) = (drawn - timed.selected, Self::key_at(timed, Forecast::Selection, stride));
            // What was stopped would have taken longer.
            if !stopped || took.as_secs_f64() > self.costs.estimate(&key, &timed.counts).mean {
                self.learn(timed, (Forecast::Selection, stride), &timed.counts, took);
            }
        }
        if let Some(wave) = &kept.wave {
            let counts = WorkCounts { polygons: wave.polygons, samples_tested: wave.samples, ..WorkCounts::default() };
            self.learn(timed, (Forecast::Wave, 1), &counts, Duration::from_secs_f64(wave.time_ms.max(0.0) / 1e3));
        }
        let done = finished(stats, timed);
        if is_whole {
            kept.estimate_ms = 1e3 * self.costs.estimate(&timed.key_of(Forecast::Finished), &done).mean;
            self.learn(timed, (Forecast::Finished, 1), &done, timed.images_made);
        }
        if timed.found > 0 {
            self.learn(timed, (Forecast::Features, 1), &timed.of_features(timed.found), took - timed.images_made);
        }
        kept.time_ms = milliseconds(timed.watch.elapsed());
        stats.deadline = Some(kept);
    }

    /// By what factor estimates of the images are believed.
    fn doubt(&self, key: &Key) -> f64 {
        self.doubts.get(key).copied().unwrap_or(1.0)
    }

    /// Learns what a forecast of images of a stride should have said.
    fn learn(&mut self, timed: &DeadlineFrame, about: (Forecast, u32), counts: &WorkCounts, took: Duration) {
        // Times that cannot be, of a clock that jumps, teach nothing.
        let _ = self.costs.observe(&Self::key_at(timed, about.0, about.1), counts, took.as_secs_f64());
    }
}

impl DeadlineFrame {
    fn new(limit: Duration, watch: Watch, key: Key, priority: &Priority, (size, images): ([u32; 2], u64)) -> Self {
        let zero = Duration::ZERO;
        let (begun, selected, images_made) = (zero, zero, zero);
        let (counts, features, cut, first_estimate) = (WorkCounts::default(), WorkCounts::default(), Vec::new(), None);
        let (priority, found, left_out) = (priority.clone(), 0, Vec::new());
        Self {
            limit,
            watch,
            key,
            priority,
            draws_parts: true,
            size,
            images,
            begun,
            selected,
            images_made,
            counts,
            cut,
            stride: 1,
            time: None,
            first_estimate,
            features,
            found,
            left_out,
        }
    }

    /// Features are placed, with regions of interest if they are asked for, and selection begins.
    pub fn expect_features(&mut self, features: usize, regions: bool) {
        let features = features as u64;
        self.features = WorkCounts { features, regions: if regions { features } else { 0 }, ..WorkCounts::default() };
        self.begun = self.watch.elapsed();
    }

    /// Images are made, and features follow.
    pub fn images_are_made(&mut self) {
        // Also by a clock that was set back.
        self.images_made = self.watch.elapsed().max(self.selected);
    }

    /// Time left for features.
    fn left(&self) -> Duration {
        self.limit.saturating_sub(self.watch.elapsed() + MARGIN)
    }

    /// Of some of the features.
    fn of_features(&self, features: u64) -> WorkCounts {
        WorkCounts { features, regions: self.features.regions.min(features), ..WorkCounts::default() }
    }

    fn key_of(&self, forecast: Forecast) -> Key {
        Key { forecast, ..self.key.clone() }
    }

    fn pixels(&self) -> u64 {
        self.size.map(u64::from).iter().product()
    }

    fn of_images(&self) -> WorkCounts {
        WorkCounts { pixels_resolved: self.pixels() * self.images, ..WorkCounts::default() }
    }
}

fn impossible(limit: Duration, needed: f64) -> Error {
    let what = format!("nothing can be predicted within {:.3} ms", milliseconds(limit));
    Error::new(ErrorKind::Deadline, what, format!("give {:.3} ms or more, or ask for fewer images", 1e3 * needed))
}

/// A time that is kept free, with the margin.
fn seconds(s: f64) -> Duration {
    Duration::from_secs_f64(s.min(1e6)) + MARGIN
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

fn counts_of(runs: &[Run]) -> WorkCounts {
    let polygons = runs.iter().map(|r| u64::from(r.count)).sum();
    WorkCounts { runs: runs.len() as u64, polygons, ..WorkCounts::default() }
}

/// What a frame did, by its statistics.
fn finished(stats: &Stats, timed: &DeadlineFrame) -> WorkCounts {
    let of = |name| stats.count_of(name).unwrap_or(0);
    WorkCounts {
        runs: of(CountName::RunsSelected),
        polygons: stats.count_of(CountName::PolygonsSetUp).unwrap_or(of(CountName::PolygonsInView)),
        waves: of(CountName::Waves),
        samples_tested: of(CountName::SamplesTested),
        samples_written: of(CountName::SamplesWritten),
        pixels_resolved: timed.pixels() * timed.images,
        ..WorkCounts::default()
    }
}

#[cfg(test)]
mod tests;
