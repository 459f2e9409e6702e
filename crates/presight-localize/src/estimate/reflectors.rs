//! Reflectors in an estimate: which of them a pose explains, and what that means for it.

use super::descent::{SEARCH, SETTLE, descend, images};
use super::normal::Freedom;
use super::run::{Expectation, LEAD, Minimum, Run};
use crate::extract::FeatureFindings;
use crate::motion::{Vector, motion_between};
use presight_model::geometry::Pose;
use std::collections::BTreeSet;
use std::sync::Arc;

/// So many reflectors that agree tell a pose by themselves, whatever the ranges explain: two would fit in some pose by chance.
const FEWEST: usize = 3;

/// Matched reflectors, by the numbers of their features.
pub(super) struct MatchedReflectors {
    explained: BTreeSet<u32>,
    others: BTreeSet<u32>,
}

impl MatchedReflectors {
    /// Those of a prediction, at a pose.
    pub(super) fn at(run: &Run<'_>, expected: &Expectation, pose: &Pose) -> Self {
        let told: Vec<(u32, bool)> = images(run, expected).iter().flat_map(|source| source.ranged(pose)).collect();
        let of = |fits: bool| told.iter().filter(|(_, f)| *f == fits).map(|(id, _)| *id).collect();
        Self { explained: of(true), others: of(false) }
    }

    /// How many the pose explains, and how many were matched.
    pub(super) fn counts(&self) -> (usize, usize) {
        (self.explained.len(), self.explained.len() + self.others.len())
    }
}

/// True if a pose may rest on its reflectors: there are enough, and nearly all agree.
pub(super) fn hold(counts: (usize, usize)) -> bool {
    let (explained, matched) = counts;
    explained >= FEWEST && explained > 2 * (matched - explained)
}

/// What was found, as if these reflectors had not been matched.
fn without(expected: &Expectation, ids: &BTreeSet<u32>) -> Arc<Expectation> {
    let less = |f: &FeatureFindings| ids.iter().fold(f.clone(), |f, id| f.without(*id));
    Arc::new(Expectation { images: expected.images.clone(), findings: expected.findings.iter().map(less).collect() })
}

/// The motion to where the reflectors lead that a pose does not explain, if they are as many there as it has, and the ranges are explained
/// as well: some were moved, and nobody knows which.
pub(super) fn other_camp(run: &Run<'_>, best: &Minimum, freedom: Freedom) -> Option<Vector> {
    if best.expected.findings.is_empty() || run.has_greys_only() {
        return None;
    }
    let first = run.first.as_ref().map_or(&best.expected, |first| first);
    let all = Expectation { images: best.expected.images.clone(), findings: first.findings.clone() };
    let matched = MatchedReflectors::at(run, &all, &best.pose);
    if matched.others.is_empty() || matched.others.len() < matched.explained.len() {
        return None;
    }
    let others = without(&all, &matched.explained);
    let found = descend(run, &others, best.pose, &SEARCH, freedom, |_| false);
    let there = descend(run, &others, found.pose, &SETTLE, freedom, |_| false);
    let agree = MatchedReflectors::at(run, &all, &there.pose).counts().0;
    let fits = there.normal.explained_share() >= best.normal.explained_share() - LEAD;
    (agree > 0 && agree >= matched.counts().0 && fits).then(|| motion_between(&best.pose, &there.pose))
}
