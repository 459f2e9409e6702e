//! Casts a ray through the index to every sample. Slow; the reference for the other strategies.

use super::samples::Samples;
use super::strategy::{Decision, FeatureQuery, Workspace};
use super::undecided::UndecidedSample;
use crate::FeatureStats;
use presight_model::index::Region;

/// Decides any feature.
pub(super) fn decide(query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<Decision> {
    let mut samples = Samples::of(query, workspace);
    samples.open.iter_mut().for_each(|sample| hide(sample, query, workspace));
    let stats = FeatureStats { features: 1, samples: samples.open.len(), ..FeatureStats::default() };
    let decision = samples.decision(query, stats);
    workspace.samples = samples;
    Some(decision)
}

/// Casts a ray from the sensor to a sample.
pub(super) fn hide(sample: &mut UndecidedSample, query: &FeatureQuery<'_>, workspace: &mut Workspace) {
    let FeatureQuery { frame, own, .. } = query;
    let Workspace { polygons, candidates, .. } = workspace;
    let direction = frame.image_from_world.transpose() * (sample.at / sample.range);
    let region = Region::ray(frame.world_from_sensor.translation, direction, sample.range * (1.0 + 1e-9));
    candidates.begin();
    candidates.add_in(frame, polygons, &region, own);
    for number in candidates.numbers() {
        sample.hide_by(polygons.get(*number), polygons, own.rounding());
    }
}
