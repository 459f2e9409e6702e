//! Features within a deadline, in groups: the next one only if it fits.

use super::{Controller, DeadlineFrame};
use crate::cost::Forecast;
use std::time::Duration;

/// Features of the first group where nothing was learnt.
const FIRST_GROUP: usize = 64;
/// Fewer than this are no group unless they are the last ones.
const LEAST_GROUP: usize = 4;

/// How many features fit.
pub struct FeatureGroups {
    /// Seconds for each feature, a high estimate.
    pace: f64,
    /// When the group began.
    since: Duration,
    /// Most features of the next group.
    most: usize,
}

impl Controller {
    /// Time to be kept for features, of what images leave: no more than half of it.
    pub(super) fn reserve(&self, timed: &DeadlineFrame, left: Duration) -> Duration {
        if timed.features.features == 0 {
            return Duration::ZERO;
        }
        let estimate = self.costs.estimate(&timed.key_of(Forecast::Features), &timed.features);
        Duration::from_secs_f64(estimate.upper.min(1e6)).min(left / 2)
    }

    /// Begins to find features.
    pub fn feature_groups(&self, timed: &DeadlineFrame) -> FeatureGroups {
        let estimate = self.costs.estimate(&timed.key_of(Forecast::Features), &timed.features);
        let pace = estimate.upper / timed.features.features.max(1) as f64;
        let most = if estimate.frames == 0 { FIRST_GROUP } else { usize::MAX };
        FeatureGroups { pace, since: timed.watch.elapsed(), most }
    }
}

impl FeatureGroups {
    /// How many of the rest to find next; 0 if the time is up. As long as more are to come, a group takes half of the time left at
    /// most: what is found out by then corrects the pace.
    pub fn next(&mut self, timed: &DeadlineFrame, rest: usize) -> usize {
        self.since = timed.watch.elapsed();
        let all = (timed.left().as_secs_f64() / self.pace) as usize;
        let rest = rest.min(self.most);
        match all / 2 {
            half if half >= rest => rest,
            half if half >= LEAST_GROUP => half,
            _ if all >= rest => rest,
            _ => 0,
        }
    }

    /// So many were found.
    pub fn took(&mut self, timed: &DeadlineFrame, features: usize) {
        let took = timed.watch.elapsed().saturating_sub(self.since).as_secs_f64();
        // A little more than it was: groups are not alike.
        self.pace = (1.25 * took / features.max(1) as f64).max(1e-9);
        self.most = usize::MAX;
    }
}
