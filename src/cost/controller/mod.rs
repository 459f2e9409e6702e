//! Keeps deadlines: says what cannot be done in time, when drawing has to stop, and learns from what was done.
//!
//! The clock that the engine stops by keeps the deadline. The unit costs decide three things only: whether even an image of nothing
//! would be late, how much time images take after the drawing, and which runs need not be begun because even a low estimate
//! of their time is too long.

use super::{CostModel, Forecast, Key, TimeEstimate, WorkCounts};
use crate::deadline::{Clock, DegradationKind, DegradationStep, SystemClock, Watch};
use crate::error::{Error, ErrorKind, Result};
use crate::plan::{FramePlan, Outputs, Run, Stats};
use crate::sensor::Sensor;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// Metres: the radius is cut no shorter.
const LEAST_RADIUS: f32 = 2.0;
/// Time for what no cost counts: learning, and the way back to the caller.
const MARGIN: Duration = Duration::from_micros(100);
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
    pixels: u64,
    images: u64,
    selected: Duration,
    /// What the drawing was to draw, before a cut.
    counts: WorkCounts,
    cut: Option<DegradationStep>,
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

    /// Begins a prediction; `None` without a deadline. `threads` are those of an engine that can stop.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] for no time at all, and for an engine that cannot stop; [`ErrorKind::Deadline`] if not even an image
    /// of nothing can be made.
    pub fn begin(
        &mut self,
        deadline: Option<Duration>,
        threads: Option<usize>,
        (sensor, outputs): (&Sensor, Outputs),
    ) -> Result<Option<DeadlineFrame>> {
        let Some(limit) = deadline else { return Ok(None) };
        let watch = Watch::start(self.clock.clone(), limit);
        if limit.is_zero() {
            return Err(Error::usage("a deadline of 0 ms", "give a time above 0, or no deadline"));
        }
        let Some(threads) = threads else {
            let what = "this engine cannot stop when its time is up, and keeps no deadline";
            return Err(Error::usage(what, "take the CPU engine (--backend cpu), or give no deadline"));
        };
        let key = Key::new("cpu", None, threads, sensor, outputs, Forecast::Images);
        let pixels = u64::from(sensor.width()) * u64::from(sensor.height());
        let images = outputs.iter().count() as u64;
        let timed = DeadlineFrame {
            limit,
            watch,
            key,
            pixels,
            images,
            selected: Duration::ZERO,
            counts: WorkCounts::default(),
            cut: None,
        };
        let floor = [self.estimate(&timed, Forecast::Access), self.estimate(&timed, Forecast::Images)];
        let doubt = self.doubt(&timed.key);
        let believed =
            |e: &TimeEstimate| if e.frames == 0 { e.mean * UNKNOWN_MACHINE } else { e.upper.min(2.0 * e.mean) * doubt };
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
        let images = self.estimate(timed, Forecast::Images);
        let left = timed.limit.saturating_sub(timed.selected);
        let doubt = self.doubt(&timed.key);
        let surely = if images.frames == 0 { images.mean * UNKNOWN_MACHINE } else { images.lower * doubt };
        if left.as_secs_f64() < surely {
            self.doubts.insert(timed.key.clone(), (doubt * DOUBT).max(MOST_DOUBT));
            self.learn(timed, Forecast::Access, &WorkCounts::default(), timed.selected);
            return Err(impossible(timed.limit, (timed.selected + MARGIN).as_secs_f64() + images.upper));
        }
        // Where nothing was learnt yet, half of the time is kept for the images at most.
        let after = Duration::from_secs_f64(images.upper.min(1e6)) + MARGIN;
        let after = if images.frames == 0 { after.min(left / 2) } else { after };
        timed.watch.stop_after(timed.limit.saturating_sub(after));
        timed.counts = counts_of(&plan.runs);
        self.cut(timed, plan);
        plan.watch = Some(timed.watch.clone());
        Ok(())
    }

    /// The first estimate (paper, section 3.3): a radius is a prefix of the runs.
    fn cut(&self, timed: &mut DeadlineFrame, plan: &mut FramePlan) {
        let left = timed.watch.left().as_secs_f64();
        let low = |runs: &[Run]| {
            let key = timed.key_of(Forecast::Selection);
            let estimate = self.costs.estimate(&key, &counts_of(runs));
            // Nothing that was not learnt gives anything up.
            if estimate.frames == 0 { 0.0 } else { estimate.lower }
        };
        if low(&plan.runs) <= left {
            return;
        }
        let least = plan.runs.partition_point(|run| run.nearest <= LEAST_RADIUS).max(1);
        let (mut fits, mut late) = (least, plan.runs.len());
        while late > fits + 1 {
            let middle = fits.midpoint(late);
            if low(&plan.runs[..middle]) <= left { fits = middle } else { late = middle }
        }
        plan.cut(fits);
        let at_ms = milliseconds(timed.watch.elapsed());
        timed.cut =
            plan.radius.map(|radius| DegradationStep { means: DegradationKind::Radius, at_ms, metres: radius.into() });
    }

    /// Tells how the deadline was kept, and learns.
    pub fn end(&mut self, timed: &DeadlineFrame, stats: &mut Stats) {
        let took = timed.watch.elapsed();
        let mut kept = stats.deadline.take().unwrap_or_default();
        kept.deadline_ms = milliseconds(timed.limit);
        if let Some(given_up) = &mut kept.given_up {
            given_up.means.splice(0..0, timed.cut.clone());
        }
        let drawn = Duration::from_secs_f64(kept.drawn_ms.max(0.0) / 1e3).clamp(timed.selected, took);
        self.doubts.remove(&timed.key);
        self.learn(timed, Forecast::Access, &WorkCounts::default(), timed.selected);
        self.learn(timed, Forecast::Images, &timed.of_images(), took - drawn);
        let stopped = kept.given_up.as_ref().is_some_and(|g| g.means.iter().any(|m| m.means == DegradationKind::Clock));
        if timed.cut.is_none() && !stopped {
            self.learn(timed, Forecast::Selection, &timed.counts, drawn - timed.selected);
        }
        let done = finished(stats, timed);
        kept.estimate_ms = 1e3 * self.costs.estimate(&timed.key_of(Forecast::Finished), &done).mean;
        self.learn(timed, Forecast::Finished, &done, took);
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
    let of = |name: &str| stats.counts.iter().find(|(n, _)| n == name).map_or(0, |(_, n)| *n);
    WorkCounts {
        runs: of("runs selected"),
        polygons: of("polygons set up"),
        waves: of("waves"),
        samples_tested: of("samples tested"),
        samples_written: of("samples written"),
        pixels_resolved: timed.pixels * timed.images,
        ..WorkCounts::default()
    }
}

#[cfg(test)]
mod tests;
