//! The first estimate (paper, section 3.3): the query region shrinks, first in radius, then in angle.

use super::control::Controller;
use super::frame::{DeadlineFrame, counts_of, milliseconds};
use crate::cost::Forecast;
use crate::deadline::{DegradationKind, DegradationStep};
use crate::plan::{FramePlan, Run};
use presight_model::error::Result;
use presight_model::sensor::ImagePart;

/// Minimum number of columns: the angle shrinks no further.
const MIN_COLUMNS: u32 = 8;

impl Controller {
    /// Leaves out runs that certainly cannot be drawn in time. Runs are sorted by distance, so a radius is a prefix of
    /// them. If even the minimum radius is too much, narrows the image to columns around the heading.
    pub(super) fn cut(&self, timed: &mut DeadlineFrame, plan: &mut FramePlan) -> Result<()> {
        let left = timed.watch.left().as_secs_f64();
        let low = |runs: &[Run]| {
            let estimate = self.at_stride(timed, Forecast::Selection, &counts_of(runs), timed.stride);
            // All runs stay until costs are learnt.
            if estimate.frames == 0 { 0.0 } else { estimate.lower }
        };
        if low(&plan.runs) <= left {
            return Ok(());
        }
        let min_radius = timed.priority.min_radius as f32;
        let least = plan.runs.partition_point(|run| run.nearest <= min_radius).max(1);
        let (mut fits, mut late) = (least, plan.runs.len());
        while late > fits + 1 {
            let middle = fits.midpoint(late);
            if low(&plan.runs[..middle]) <= left { fits = middle } else { late = middle }
        }
        plan.cut(fits);
        let needed = low(&plan.runs);
        let taken = |means, metres| DegradationStep { means, at_ms: milliseconds(timed.watch.elapsed()), metres };
        let mut cut = Vec::new();
        cut.extend(plan.radius().map(|radius| taken(DegradationKind::Radius, Some(f64::from(radius)))));
        // A narrowed image is selected again. On one-row scanners that takes longer than what narrowing saves.
        let again = timed.selected.saturating_sub(timed.begun).as_secs_f64();
        if needed > left && again < left && timed.draws_parts {
            let share = (left - again) / needed;
            let columns = ((f64::from(plan.sensor.width()) * share) as u32).max(MIN_COLUMNS * timed.stride);
            if let Some(part) = plan.sensor.columns_around(timed.priority.heading, columns) {
                plan.narrow(ImagePart { stride: timed.stride, ..part })?;
                cut.push(taken(DegradationKind::Angle, None));
            }
        }
        timed.cut = cut;
        Ok(())
    }
}
