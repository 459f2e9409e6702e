//! Tiles and rows in the plane: frames that are drawn as a whole, because they cannot stop at a distance. They are used
//! if they are certainly in time: 99 of 100 learnt times of the sensor are less than the time left, or, before any is
//! learnt, a bound by the number of rays is.

use super::control::Controller;
use super::frame::{DeadlineFrame, MARGIN, milliseconds};
use crate::cost::{Forecast, WorkCounts};
use crate::deadline::DeadlineOutcome;
use crate::plan::{FramePlan, Stats, TimeLimit, Way};
use std::time::Duration;

/// Bound of the time without learnt costs: for a frame, and for each ray. No measured frame of a sensor with more than
/// 1,000 rays took more than a sixth of it on one thread.
const FRAME: Duration = Duration::from_millis(1);
const RAY: Duration = Duration::from_micros(2);

/// Time to return after a frame that takes a few microseconds and teaches one number.
const RETURN: Duration = Duration::from_micros(20);

impl Controller {
    /// True if a frame as a whole is certainly in time after other work that takes `before`.
    pub fn is_surely_in_time(&self, timed: &DeadlineFrame, whole: Forecast, before: Duration) -> bool {
        let left = timed.limit.saturating_sub(timed.watch.elapsed());
        let features = self.reserve(timed, left);
        before + self.max_time(timed, whole) + features <= left
    }

    /// Time within which a frame as a whole is certainly drawn.
    pub(super) fn max_time(&self, timed: &DeadlineFrame, whole: Forecast) -> Duration {
        let margin = if whole == Forecast::Row { RETURN } else { MARGIN };
        let learnt = self.costs.estimate(&timed.key_of(whole), &WorkCounts::default());
        margin
            + match learnt.frames {
                0 => FRAME + RAY * u32::try_from(timed.pixels()).unwrap_or(u32::MAX),
                _ => Duration::from_secs_f64(learnt.upper.min(1e6)),
            }
    }

    /// True if a limit suffices for a frame as a whole, by learnt times, whatever images by the raster take.
    pub(super) fn may_be_whole(&self, timed: &DeadlineFrame) -> bool {
        [Forecast::Tiles, Forecast::Row].into_iter().any(|whole| {
            let is_known = self.costs.estimate(&timed.key_of(whole), &WorkCounts::default()).frames > 0;
            is_known && self.max_time(timed, whole) <= timed.limit
        })
    }

    /// Plans a frame as a whole. Tiles stop when the time is up, and then give up their unfinished bands.
    pub(super) fn plan_whole(&self, timed: &mut DeadlineFrame, plan: &mut FramePlan, whole: Forecast) {
        timed.selected = timed.watch.elapsed();
        let features = self.reserve(timed, timed.limit.saturating_sub(timed.selected));
        timed.watch.stop_after(timed.limit.saturating_sub(MARGIN + features));
        let learnt = self.costs.estimate(&timed.key_of(whole), &WorkCounts::default());
        timed.first_estimate = (learnt.frames > 0).then_some(timed.selected.as_secs_f64() + learnt.mean);
        timed.whole = Some(whole);
        plan.limit = Some(TimeLimit::new(timed.watch.clone()));
    }

    /// Learns from a frame that was drawn as a whole, from its beginning or after a first wave. Frames that the raster
    /// drew instead are ignored.
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
        // A stopped frame would have taken longer.
        if kept.given_up.is_none() || took.as_secs_f64() > mean {
            self.learn(timed, whole, 1, &WorkCounts::default(), took);
        }
    }
}
