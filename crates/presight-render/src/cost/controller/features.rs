//! Features with a deadline, in groups: the next group starts only if it fits.

use super::control::Controller;
use super::frame::DeadlineFrame;
use crate::cost::Forecast;
use std::time::Duration;

/// Size of the first group before costs are learnt.
const FIRST_GROUP: usize = 64;
/// Minimum size of a group, unless fewer features are left.
const MIN_GROUP: usize = 4;

/// Decides how many features fit.
pub struct FeatureGroups {
    /// Seconds per feature, a high estimate.
    pace: f64,
    /// Start time of the group.
    since: Duration,
    /// Maximum size of the next group.
    most: usize,
}

impl Controller {
    /// Time reserved for features: at most half of the time that images leave.
    pub(super) fn reserve(&self, timed: &DeadlineFrame, left: Duration) -> Duration {
        if timed.features.features == 0 {
            return Duration::ZERO;
        }
        let estimate = self.costs.estimate(&timed.key_of(Forecast::Features), &timed.features);
        Duration::from_secs_f64(estimate.upper.min(1e6)).min(left / 2)
    }

    /// Starts finding features.
    pub fn feature_groups(&self, timed: &DeadlineFrame) -> FeatureGroups {
        let estimate = self.costs.estimate(&timed.key_of(Forecast::Features), &timed.features);
        let pace = estimate.upper / timed.features.features.max(1) as f64;
        let most = if estimate.frames == 0 { FIRST_GROUP } else { usize::MAX };
        FeatureGroups { pace, since: timed.watch.elapsed(), most }
    }
}

impl FeatureGroups {
    /// Returns the size of the next group; 0 if the time is up. A group that is not the last takes at most half of the
    /// time left, and its measured time corrects the pace.
    pub fn next(&mut self, timed: &DeadlineFrame, rest: usize) -> usize {
        self.since = timed.watch.elapsed();
        let all = (timed.left().as_secs_f64() / self.pace) as usize;
        let rest = rest.min(self.most);
        match all / 2 {
            half if half >= rest => rest,
            half if half >= MIN_GROUP => half,
            _ if all >= rest => rest,
            _ => 0,
        }
    }

    /// Records that a group of this size was found.
    pub fn took(&mut self, timed: &DeadlineFrame, features: usize) {
        let took = timed.watch.elapsed().saturating_sub(self.since).as_secs_f64();
        // A margin, because groups differ.
        self.pace = (1.25 * took / features.max(1) as f64).max(1e-9);
        self.most = usize::MAX;
    }
}
