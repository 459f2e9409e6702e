//! The controller.

use super::frame::{DeadlineFrame, MARGIN, counts_of, milliseconds, part_of};
use super::stopping::Stopping;
use crate::cost::{CostModel, Forecast, Key, TimeEstimate, WorkCounts};
use crate::deadline::{
    Clock, DeadlineEngine, DeadlineOutcome, DegradationKind, DegradationStep, Priority, SystemClock, Watch,
};
use crate::plan::{CountName, FramePlan, Outputs, Pace, Run, Stats, TimeLimit, Way};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::sensor::{STRIDES, Sensor};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// Images slower than the mean by this factor are always planned for, whatever must be given up.
pub(super) const SLOW: f64 = 1.25;
/// Each refusal multiplies the doubted estimate by the first factor, down to the second in total.
const DOUBT: f64 = 0.98;
const MAX_DOUBT: f64 = 0.25;

/// The deadline controller of one engine.
#[derive(Debug)]
pub struct Controller {
    pub(super) clock: Arc<dyn Clock>,
    /// The learnt costs.
    pub costs: CostModel,
    /// Factors on estimates that refused recent frames: without a frame that runs, they would never be corrected.
    pub(super) doubts: BTreeMap<Key, f64>,
    /// By key, which includes the stride.
    pub(super) stopping: BTreeMap<Key, Stopping>,
}

impl Default for Controller {
    fn default() -> Self {
        let clock = Arc::new(SystemClock::default());
        Self { clock, costs: CostModel::default(), doubts: BTreeMap::new(), stopping: BTreeMap::new() }
    }
}

impl Controller {
    /// Replaces the clock.
    pub fn set_clock(&mut self, clock: Arc<dyn Clock>) {
        self.clock = clock;
    }

    /// Begins a prediction; `None` without a deadline. `engine` is `None` if the engine cannot stop early.
    ///
    /// # Errors
    /// [`ErrorKind::Usage`] for a deadline of zero, or an engine that cannot stop early; [`ErrorKind::Deadline`] if, by
    /// the learnt costs, not even an empty image can be made in time.
    pub fn begin(
        &mut self,
        deadline: Option<(Duration, &Priority)>,
        engine: Option<DeadlineEngine>,
        sensor: &Sensor,
        outputs: Outputs,
    ) -> Result<Option<DeadlineFrame>> {
        let Some((limit, priority)) = deadline else { return Ok(None) };
        let watch = Watch::start(self.clock.clone(), limit);
        if limit.is_zero() {
            return Err(Error::usage("a deadline of 0 ms", "give a time above 0, or no deadline"));
        }
        let Some(DeadlineEngine { name, adapter, threads, draws_parts }) = engine else {
            let what = "this engine cannot stop early, so it does not support deadlines";
            return Err(Error::usage(what, "use the CPU engine (`Backend::Cpu`), or give no deadline"));
        };
        let key = Key::new(name, adapter.as_deref(), threads, sensor, outputs, Forecast::Images);
        let (size, images) = ([sensor.width(), sensor.height()], outputs.iter().count() as u64);
        let mut timed = DeadlineFrame::new(limit, watch, key, priority, size, images);
        timed.draws_parts = draws_parts;
        let access = self.costs.estimate(&timed.key_of(Forecast::Access), &WorkCounts::default());
        // Costs that were not learnt refuse no frame, because machines differ too much.
        let floor: Vec<TimeEstimate> = [access, self.min_images(&timed)].into_iter().filter(|e| e.frames > 0).collect();
        let doubt = self.doubt(&timed.key);
        let least = floor.iter().map(|e| e.upper.min(SLOW * e.mean) * doubt).sum::<f64>();
        if limit.as_secs_f64() < least && !self.may_be_whole(&timed) {
            self.doubts.insert(timed.key, (doubt * DOUBT).max(MAX_DOUBT));
            return Err(impossible(limit, floor.iter().map(|e| e.upper).sum::<f64>() + MARGIN.as_secs_f64()));
        }
        Ok(Some(timed))
    }

    /// After selection, decides when drawing must stop and which runs to skip.
    ///
    /// # Errors
    /// [`ErrorKind::Deadline`] if the selection took all the time, or if, by the learnt costs, the time left is too
    /// short for any image.
    pub fn plan(&mut self, timed: &mut DeadlineFrame, plan: &mut FramePlan) -> Result<()> {
        let whole = [(plan.cut.is_some(), Forecast::Row), (plan.way() == Way::Tiles, Forecast::Tiles)];
        if let Some((_, whole)) = whole.into_iter().find(|(is_planned, _)| *is_planned) {
            self.plan_whole(timed, plan, whole);
            return Ok(());
        }
        timed.selected = timed.watch.elapsed();
        let access = timed.selected.saturating_sub(timed.begun);
        let least = self.min_images(timed);
        let left = timed.limit.saturating_sub(timed.selected);
        let doubt = self.doubt(&timed.key);
        let is_known = least.frames > 0;
        if left.is_zero() || is_known && left.as_secs_f64() < least.lower * doubt {
            self.doubts.insert(timed.key.clone(), (doubt * DOUBT).max(MAX_DOUBT));
            self.learn(timed, Forecast::Access, 1, &WorkCounts::default(), access);
            // Twice the time of this selection suffices for the next one and leaves some for a first image.
            let images = if is_known { least.upper } else { timed.selected.as_secs_f64() };
            return Err(impossible(timed.limit, (timed.selected + MARGIN).as_secs_f64() + images));
        }
        timed.counts = counts_of(&plan.runs);
        timed.stride = self.stride(timed, left);
        let after = self.kept_for_images(timed, timed.stride, left);
        let features = self.reserve(timed, left.saturating_sub(after));
        timed.watch.stop_after(timed.limit.saturating_sub(after + features));
        let drawing = self.costs.estimate(&timed.key_of(Forecast::Selection), &timed.counts);
        let images = self.images(timed, 1);
        let is_known = drawing.frames > 0 && images.frames > 0;
        timed.first_estimate = is_known.then_some(timed.selected.as_secs_f64() + drawing.mean + images.mean);
        let drawing = self.at_stride(timed, Forecast::Selection, &timed.counts, timed.stride);
        timed.time = is_known.then(|| timed.watch.left().as_secs_f64() / drawing.mean);
        let part = part_of(&plan.sensor, timed.stride);
        plan.limit = Some(TimeLimit { part, ..TimeLimit::new(timed.watch.clone()) });
        self.cut(timed, plan)?;
        let pace = self.pace(timed, left, &plan.runs);
        let tiles = self.max_time(timed, Forecast::Tiles);
        plan.limit.iter_mut().for_each(|limit| (limit.pace, limit.tiles) = (pace, Some(tiles)));
        Ok(())
    }

    /// Learnt costs of drawing, for this much time left after selection.
    fn pace(&self, timed: &DeadlineFrame, left: Duration, runs: &[Run]) -> Option<Pace> {
        let key = timed.key_of(Forecast::Wave);
        let estimate = |counts: WorkCounts| self.costs.estimate(&key, &counts);
        let (none, most) = (estimate(WorkCounts::default()), 1 << 20);
        let each = |counts| (estimate(counts).mean - none.mean).max(0.0) / most as f64;
        let drawing = self.at_stride(timed, Forecast::Selection, &counts_of(runs), timed.stride);
        let kept = |stride| self.kept_for_images(timed, stride, left).as_secs_f64();
        // With plenty of time, the image is not thinned.
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

    /// Estimate for empty images, thinned as far as the engine can.
    fn min_images(&self, timed: &DeadlineFrame) -> TimeEstimate {
        self.images(timed, timed.strides().next_back().unwrap_or(1))
    }

    /// Reports how the deadline was kept, and learns.
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
        if timed.whole.is_none() {
            self.learn(timed, Forecast::Access, 1, &WorkCounts::default(), timed.selected.saturating_sub(timed.begun));
        }
        if timed.whole.is_some() || stats.way == Some(Way::Tiles) {
            self.learn_whole(timed, stats, &mut kept);
        } else {
            self.learn_drawing(timed, stats, &mut kept, drawn);
        }
        if timed.found > 0 {
            self.learn(timed, Forecast::Features, 1, &timed.of_features(timed.found), took - timed.images_made);
        }
        kept.time_ms = milliseconds(timed.watch.elapsed());
        stats.deadline = Some(kept);
    }

    /// Learns from a frame that the raster drew until `drawn` after the call.
    fn learn_drawing(&mut self, timed: &DeadlineFrame, stats: &Stats, kept: &mut DeadlineOutcome, drawn: Duration) {
        let given_up = kept.given_up.as_ref();
        let stride = given_up.map_or(1, |given_up| given_up.stride);
        let has_all_columns = given_up.is_none_or(|given_up| given_up.opening.is_none());
        let is_whole = stride == 1 && has_all_columns;
        if has_all_columns {
            self.learn(timed, Forecast::Images, stride, &timed.of_images(), timed.images_made - drawn);
        }
        let stopped = given_up.is_some_and(|g| g.means.iter().any(|m| m.means == DegradationKind::Clock));
        if let Some(time) = timed.time.filter(|_| has_all_columns && stride == timed.stride) {
            let there = 1.0 - given_up.map_or(0, |g| g.samples) as f64 / timed.pixels() as f64;
            let stopping = self.stopping.entry(Self::key_at(timed, Forecast::Selection, stride)).or_default();
            stopping.learn(time, (there / timed.share(stride)).min(1.0));
        }
        if timed.cut.is_empty() && has_all_columns && stride == timed.stride {
            let (took, key) = (drawn - timed.selected, Self::key_at(timed, Forecast::Selection, stride));
            // A stopped drawing would have taken longer, so only a time above the estimate is informative.
            if !stopped || took.as_secs_f64() > self.costs.estimate(&key, &timed.counts).mean {
                self.learn(timed, Forecast::Selection, stride, &timed.counts, took);
            }
        }
        if let Some(wave) = &kept.wave {
            let counts = WorkCounts { polygons: wave.polygons, samples_tested: wave.samples, ..WorkCounts::default() };
            self.learn(timed, Forecast::Wave, 1, &counts, Duration::from_secs_f64(wave.time_ms.max(0.0) / 1e3));
        }
        let done = finished(stats, timed);
        if is_whole {
            kept.estimate_ms = 1e3 * self.costs.estimate(&timed.key_of(Forecast::Finished), &done).mean;
            self.learn(timed, Forecast::Finished, 1, &done, timed.images_made);
        }
    }

    /// Factor on estimates that recent refusals put in doubt.
    fn doubt(&self, key: &Key) -> f64 {
        self.doubts.get(key).copied().unwrap_or(1.0)
    }

    /// Learns the time that a forecast at a stride should have predicted.
    pub(super) fn learn(
        &mut self,
        timed: &DeadlineFrame,
        about: Forecast,
        stride: u32,
        counts: &WorkCounts,
        took: Duration,
    ) {
        // Impossible times, from a clock that jumps, are ignored.
        let _ = self.costs.observe(&Self::key_at(timed, about, stride), counts, took.as_secs_f64());
    }
}

fn impossible(limit: Duration, needed: f64) -> Error {
    let what = format!("no prediction is possible within {:.3} ms", milliseconds(limit));
    Error::new(ErrorKind::Deadline, what, format!("give {:.3} ms or more, or request fewer images", 1e3 * needed))
}

/// The work of a frame, from its statistics.
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
