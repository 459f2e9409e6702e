//! Keeps deadlines: says what cannot be done in time, when drawing has to stop, and learns from what was done.
//!
//! The clock that the engine stops by keeps the deadline. The unit costs decide three things only: whether even an image of nothing
//! would be late, how much time images take after the drawing, and which runs need not be begun because even a low estimate
//! of their time is too long.

mod cut;
mod features;

use super::{CostModel, Forecast, Key, TimeEstimate, WorkCounts};
use crate::deadline::{Clock, DeadlineEngine, DegradationKind, DegradationStep, Priority, SystemClock, Watch};
use crate::error::{Error, ErrorKind, Result};
use crate::plan::{CountName, FramePlan, Outputs, Pace, Run, Stats};
use crate::sensor::Sensor;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

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
pub(crate) struct Controller {
    clock: Arc<dyn Clock>,
    pub costs: CostModel,
    /// By what factor estimates are doubted that refused the last frames: only frames that are tried can correct them.
    doubts: BTreeMap<Key, f64>,
}

/// A prediction with a deadline.
#[derive(Debug)]
pub(crate) struct DeadlineFrame {
    limit: Duration,
    watch: Watch,
    key: Key,
    priority: Priority,
    /// The angle may shrink.
    may_narrow: bool,
    pixels: u64,
    images: u64,
    /// Selection began and ended so long after the call, and images were there.
    begun: Duration,
    selected: Duration,
    images_made: Duration,
    /// What the drawing was to draw, before a cut.
    counts: WorkCounts,
    cut: Vec<DegradationStep>,
    first_estimate: Option<f64>,
    /// What was expected of features, before any was found.
    features: WorkCounts,
    /// Features that were found, and rising numbers of those left out.
    pub found: u64,
    pub left_out: Vec<u32>,
}

impl Default for Controller {
    fn default() -> Self {
        Self { clock: Arc::new(SystemClock::default()), costs: CostModel::default(), doubts: BTreeMap::new() }
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
        let pixels = u64::from(sensor.width()) * u64::from(sensor.height());
        let images = outputs.iter().count() as u64;
        let mut timed = DeadlineFrame::new(limit, watch, key, priority, (pixels, images));
        timed.may_narrow = draws_parts;
        let floor = [self.estimate(&timed, Forecast::Access), self.estimate(&timed, Forecast::Images)];
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
        let images = self.estimate(timed, Forecast::Images);
        let left = timed.limit.saturating_sub(timed.selected);
        let doubt = self.doubt(&timed.key);
        let surely = if images.frames == 0 { images.mean * UNKNOWN_MACHINE } else { images.lower * doubt };
        if left.as_secs_f64() < surely {
            self.doubts.insert(timed.key.clone(), (doubt * DOUBT).max(MOST_DOUBT));
            self.learn(timed, Forecast::Access, &WorkCounts::default(), access);
            return Err(impossible(timed.limit, (timed.selected + MARGIN).as_secs_f64() + images.upper));
        }
        // Half of the time is kept for the images at most, unless they take longer on average: a slow frame that may come is no reason
        // to give up all.
        let seconds = |s: f64| Duration::from_secs_f64(s.min(1e6)) + MARGIN;
        let mean = if images.frames == 0 { Duration::ZERO } else { seconds(SLOW * images.mean) };
        let after = seconds(images.upper).min(mean.max(left / 2));
        let features = self.reserve(timed, left.saturating_sub(after));
        timed.watch.stop_after(timed.limit.saturating_sub(after + features));
        timed.counts = counts_of(&plan.runs);
        let drawing = self.costs.estimate(&timed.key_of(Forecast::Selection), &timed.counts);
        let first_estimate = timed.selected.as_secs_f64() + drawing.mean + images.mean;
        timed.first_estimate = (drawing.frames > 0 && images.frames > 0).then_some(first_estimate);
        self.cut(timed, plan)?;
        plan.watch = Some(timed.watch.clone());
        plan.pace = self.pace(timed, after, &plan.runs);
        Ok(())
    }

    /// What drawing takes, by what was learnt, where so much is kept for the images.
    fn pace(&self, timed: &DeadlineFrame, images: Duration, runs: &[Run]) -> Option<Pace> {
        let key = timed.key_of(Forecast::Wave);
        let estimate = |counts: WorkCounts| self.costs.estimate(&key, &counts);
        let (none, most) = (estimate(WorkCounts::default()), 1 << 20);
        let each = |counts| (estimate(counts).mean - none.mean).max(0.0) / most as f64;
        let whole = self.costs.estimate(&timed.key_of(Forecast::Selection), &counts_of(runs));
        (none.frames > 0).then(|| Pace {
            wave: none.mean,
            polygon: each(WorkCounts { polygons: most, ..WorkCounts::default() }),
            sample: each(WorkCounts { samples_tested: most, ..WorkCounts::default() }),
            images: images.as_secs_f64(),
            drawing: if whole.frames > 0 { whole.mean } else { 0.0 },
        })
    }

    /// Tells how the deadline was kept, and learns.
    pub fn end(&mut self, timed: &DeadlineFrame, stats: &mut Stats) {
        let took = timed.watch.elapsed();
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
        self.learn(timed, Forecast::Access, &WorkCounts::default(), timed.selected.saturating_sub(timed.begun));
        let stride = kept.given_up.as_ref().map_or(1, |given_up| given_up.stride);
        let is_whole = stride == 1 && kept.given_up.as_ref().is_none_or(|given_up| given_up.opening.is_none());
        if is_whole {
            self.learn(timed, Forecast::Images, &timed.of_images(), timed.images_made - drawn);
        }
        let stopped = kept.given_up.as_ref().is_some_and(|g| g.means.iter().any(|m| m.means == DegradationKind::Clock));
        if timed.cut.is_empty() && !stopped && is_whole {
            self.learn(timed, Forecast::Selection, &timed.counts, drawn - timed.selected);
        }
        if let Some(wave) = &kept.wave {
            let counts = WorkCounts { polygons: wave.polygons, samples_tested: wave.samples, ..WorkCounts::default() };
            self.learn(timed, Forecast::Wave, &counts, Duration::from_secs_f64(wave.time_ms.max(0.0) / 1e3));
        }
        let done = finished(stats, timed);
        if is_whole {
            kept.estimate_ms = 1e3 * self.costs.estimate(&timed.key_of(Forecast::Finished), &done).mean;
            self.learn(timed, Forecast::Finished, &done, timed.images_made);
        }
        if timed.found > 0 {
            self.learn(timed, Forecast::Features, &timed.of_features(timed.found), took - timed.images_made);
        }
        kept.time_ms = milliseconds(timed.watch.elapsed());
        stats.deadline = Some(kept);
    }

    /// By what factor estimates of the images are believed.
    fn doubt(&self, key: &Key) -> f64 {
        self.doubts.get(key).copied().unwrap_or(1.0)
    }

    fn estimate(&self, timed: &DeadlineFrame, forecast: Forecast) -> TimeEstimate {
        let counts = if forecast == Forecast::Images { timed.of_images() } else { WorkCounts::default() };
        self.costs.estimate(&timed.key_of(forecast), &counts)
    }

    fn learn(&mut self, timed: &DeadlineFrame, forecast: Forecast, counts: &WorkCounts, took: Duration) {
        // Times that cannot be, of a clock that jumps, teach nothing.
        let _ = self.costs.observe(&timed.key_of(forecast), counts, took.as_secs_f64());
    }
}

impl DeadlineFrame {
    fn new(limit: Duration, watch: Watch, key: Key, priority: &Priority, (pixels, images): (u64, u64)) -> Self {
        let zero = Duration::ZERO;
        let (begun, selected, images_made) = (zero, zero, zero);
        let (counts, features, cut, first_estimate) = (WorkCounts::default(), WorkCounts::default(), Vec::new(), None);
        let (priority, found, left_out) = (priority.clone(), 0, Vec::new());
        Self {
            limit,
            watch,
            key,
            priority,
            may_narrow: true,
            pixels,
            images,
            begun,
            selected,
            images_made,
            counts,
            cut,
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
        self.images_made = self.watch.elapsed();
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

    fn of_images(&self) -> WorkCounts {
        WorkCounts { pixels_resolved: self.pixels * self.images, ..WorkCounts::default() }
    }
}

fn impossible(limit: Duration, needed: f64) -> Error {
    let what = format!("nothing can be predicted within {:.3} ms", milliseconds(limit));
    Error::new(ErrorKind::Deadline, what, format!("give {:.3} ms or more, or ask for fewer images", 1e3 * needed))
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
        pixels_resolved: timed.pixels * timed.images,
        ..WorkCounts::default()
    }
}

#[cfg(test)]
mod tests;
