//! Tiles and rows in the plane: frames that are drawn as a whole, for they cannot stop at a distance. They are taken if they are surely
//! in time: 99 of 100 of the sensor's learnt ones took less than the time that is left, or, before any is learnt, a bound by the number of
//! rays is less. In less time the way with more samples in time wins: a whole frame has all of them or none, and what the raster has is
//! learnt.

use super::thinning::Stopping;
use super::{Controller, DeadlineFrame, milliseconds};
use crate::cost::{Forecast, WorkCounts};
use crate::deadline::DeadlineOutcome;
use crate::plan::{FramePlan, Stats, TimeLimit, Way};
use std::time::Duration;

/// Bound of the time without learnt costs: for a frame, and for each ray. No measured one of a sensor of more than 1,000 rays took over
/// a sixth of that on one thread.
const FRAME: Duration = Duration::from_millis(1);
const RAY: Duration = Duration::from_micros(2);

/// Time to return after a frame, and to mark a pixel as given up after tiles that were stopped.
const RETURN: Duration = Duration::from_micros(20);
const PIXEL: Duration = Duration::from_nanos(2);

/// Share of learnt frames that are in time: a frame is surely in time, or the call is not refused.
const SURELY: f64 = 0.99;
const LIKELY: f64 = 0.5;

impl Controller {
    /// True if a frame as a whole, after something that takes this long `before` it, is to be preferred to the raster.
    pub fn prefers_whole(&self, timed: &mut DeadlineFrame, whole: Forecast, before: Duration) -> bool {
        let left = timed.limit.saturating_sub(timed.watch.elapsed());
        let left = left.saturating_sub(before + self.reserve(timed, left));
        let share = self.share_in_time(timed, whole, left);
        if share >= SURELY {
            return true;
        }
        let learnt = self.costs.estimate(&timed.key_of(whole), &WorkCounts::default());
        if learnt.frames == 0 || !before.is_zero() {
            return false;
        }
        let time = left.as_secs_f64() / learnt.mean;
        let raster =
            self.stopping.get(&timed.key_of(whole)).map_or_else(|| Stopping::default().there(time), |s| s.there(time));
        timed.passed_over = (share < raster).then_some((whole, time));
        share >= raster
    }

    /// Share of frames as a whole that take less than this time.
    fn share_in_time(&self, timed: &DeadlineFrame, whole: Forecast, left: Duration) -> f64 {
        let most = left.saturating_sub(timed.margin(whole));
        match self.costs.models.get(&timed.key_of(whole)) {
            Some(costs) => costs.share_within(&WorkCounts::default(), most.as_secs_f64()),
            None => f64::from(timed.bound() <= most),
        }
    }

    /// Time within which tiles are surely drawn.
    pub(super) fn most_time(&self, timed: &DeadlineFrame) -> Duration {
        let learnt = self.costs.estimate(&timed.key_of(Forecast::Tiles), &WorkCounts::default());
        let most = if learnt.frames == 0 { timed.bound() } else { Duration::from_secs_f64(learnt.upper.min(1e6)) };
        most + timed.margin(Forecast::Tiles)
    }

    /// True if a frame as a whole is likely in time, whatever images by the raster take.
    pub(super) fn may_be_whole(&self, timed: &DeadlineFrame) -> bool {
        [Forecast::Tiles, Forecast::Row].into_iter().any(|whole| {
            let is_known = self.costs.models.contains_key(&timed.key_of(whole));
            is_known && self.share_in_time(timed, whole, timed.limit) >= LIKELY
        })
    }

    /// Plans a frame as a whole. Tiles stop when the time is up, and then give up the bands that they have not finished.
    pub(super) fn plan_whole(&self, timed: &mut DeadlineFrame, plan: &mut FramePlan, whole: Forecast) {
        timed.selected = timed.watch.elapsed();
        let features = self.reserve(timed, timed.limit.saturating_sub(timed.selected));
        timed.watch.stop_after(timed.limit.saturating_sub(timed.margin(whole) + features));
        let learnt = self.costs.estimate(&timed.key_of(whole), &WorkCounts::default());
        timed.first_estimate = (learnt.frames > 0).then_some(timed.selected.as_secs_f64() + learnt.mean);
        timed.whole = Some(whole);
        plan.limit = Some(TimeLimit::new(timed.watch.clone()));
    }

    /// Learns from a frame that was drawn as a whole, at once or after a first wave. What the raster drew in its place teaches nothing.
    pub(super) fn learn_whole(&mut self, timed: &DeadlineFrame, stats: &Stats, kept: &mut DeadlineOutcome) {
        let whole = match timed.whole {
            Some(Forecast::Row) => Forecast::Row,
            _ if stats.way == Some(Way::Tiles) => Forecast::Tiles,
            _ => return,
        };
        let took = timed.images_made - timed.selected;
        let mean = self.costs.estimate(&timed.key_of(whole), &WorkCounts::default()).mean;
        if kept.given_up.is_none() {
            kept.estimate_ms = milliseconds(timed.selected) + 1e3 * mean;
        }
        // One that was stopped would have taken longer.
        if kept.given_up.is_none() || took.as_secs_f64() > mean {
            self.learn(timed, whole, 1, &WorkCounts::default(), took);
        }
    }

    /// Learns which share of the samples the raster had in time where it was preferred to a frame as a whole.
    pub(super) fn learn_passed_over(&mut self, timed: &DeadlineFrame, kept: &DeadlineOutcome) {
        let Some((whole, time)) = timed.passed_over else { return };
        let lost = kept.given_up.as_ref().map_or(0, |given_up| given_up.samples);
        let there = if timed.watch.elapsed() > timed.limit { 0.0 } else { 1.0 - lost as f64 / timed.pixels() as f64 };
        self.stopping.entry(timed.key_of(whole)).or_default().learn(time, there);
    }
}

impl DeadlineFrame {
    /// Time without learnt costs.
    fn bound(&self) -> Duration {
        FRAME + RAY * u32::try_from(self.pixels()).unwrap_or(u32::MAX)
    }

    /// Time to keep after drawing.
    fn margin(&self, whole: Forecast) -> Duration {
        let pixels = if whole == Forecast::Tiles { self.pixels() } else { 0 };
        RETURN + PIXEL * u32::try_from(pixels).unwrap_or(u32::MAX)
    }
}
