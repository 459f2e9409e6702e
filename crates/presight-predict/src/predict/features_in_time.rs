//! Features of a prediction with a deadline, most important first, in groups: the next group starts only if it fits.

use super::Predictor;
use super::features::{FeatureTask, KnownTree, settings};
use presight_features::{
    BoxQuery, FeaturePrediction, FeatureSettings, Hidden, PlacedFeature, PreparedFeatures, SeenFeature, Vantage,
    add_boxes,
};
use presight_model::clock::Instant;
use presight_model::error::Result;
use presight_render::cost::DeadlineFrame;
use presight_render::deadline::Priority;
use presight_render::plan::{Images, Stats};
use std::collections::HashMap;

impl Predictor {
    /// Predicts as many features with their regions as time allows. The CPU does it, because a device cannot stop.
    pub(super) fn features_in_time(
        &mut self,
        task: &FeatureTask<'_>,
        images: &mut Images,
        stats: &mut Stats,
        timed: &mut DeadlineFrame,
    ) -> Result<FeaturePrediction> {
        let start = Instant::now();
        let FeatureTask { vantage, request, placed, regions } = task;
        let Vantage { world, sensor, world_from_sensor } = *vantage;
        let is_partial = stats.degradation().is_some_and(|given_up| given_up.samples > 0);
        let settings = FeatureSettings { is_partial, hidden: Hidden::Full, ..settings(request) };
        let all = &placed.features;
        let has_contours = all.iter().any(|p| p.feature.shape.is_contour());
        let tree = has_contours.then(|| self.known_tree(world, &sensor.spec().class, all)).transpose()?;
        let known = tree.as_deref().map(KnownTree::parts);
        let prepared = PreparedFeatures::new(vantage, images, all, known, &settings)?;
        let lengths = self.on_threads(|| prepared.image_lengths())?;
        let order = rank(all, &request.priority, &lengths);
        let (mut found, mut marks) = (FeaturePrediction::default(), prepared.marks());
        let mut groups = self.controller.feature_groups(timed);
        let mut done = 0;
        while done < order.len() {
            let rest = &order[done..];
            let which = &rest[..groups.next(timed, rest.len())];
            if which.is_empty() {
                break;
            }
            let mut group = self.on_threads(|| prepared.part(which, None, &mut marks))?;
            if let Some(options) = regions {
                self.on_threads(|| {
                    add_boxes(&mut group, &BoxQuery { placed: all, world, sensor, world_from_sensor, options })
                })??;
            }
            found.stats.add(&group.stats);
            found.features.append(&mut group.features);
            found.given.append(&mut group.given);
            done += which.len();
            groups.took(timed, which.len());
        }
        images.feature_id = marks.into_image();
        // Restores the given order.
        let mut seen: Vec<(u32, SeenFeature)> = found.given.into_iter().zip(found.features).collect();
        seen.sort_by_key(|(given, _)| *given);
        (found.given, found.features) = seen.into_iter().unzip();
        if found.given.iter().copied().eq(0..order.len() as u32) {
            found.given = Vec::new();
        }
        timed.found = done as u64;
        timed.left_out = order[done..].iter().map(|i| all[*i].feature.id).collect();
        timed.left_out.sort_unstable();
        stats.stage(presight_render::plan::StageName::Features, start);
        for (name, n) in found.stats.counts() {
            stats.count(name, n);
        }
        Ok(found)
    }
}

/// Indices of features: first the ranked ones, then the others, longest image first.
fn rank(placed: &[PlacedFeature], priority: &Priority, lengths: &[f64]) -> Vec<usize> {
    // If a number occurs twice, its first rank counts.
    let ranks: HashMap<u32, usize> = priority.features.iter().enumerate().rev().map(|(rank, id)| (*id, rank)).collect();
    let rank = |i: &usize| ranks.get(&placed[*i].feature.id).copied().unwrap_or(usize::MAX);
    let mut order: Vec<usize> = (0..placed.len()).collect();
    order.sort_by(|a, b| rank(a).cmp(&rank(b)).then(lengths[*b].total_cmp(&lengths[*a])));
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::request::Request;
    use crate::{Backend, Options};
    use glam::{DVec3, Vec3};
    use presight_features::generate::{FeatureKind, GenerateOptions, generate};
    use presight_features::{FeatureOptions, place};
    use presight_model::environment::NewObject;
    use presight_model::geometry::{Pose, SensorPose};
    use presight_model::world::World;
    use presight_testkit::scenes;
    use std::sync::Arc;
    use std::time::Duration;

    /// An upright prism of 24 sides, which has contours, 4 m ahead.
    fn post() -> World {
        let corner = |side: u32, z: f64| {
            let (sin, cos) = (std::f64::consts::TAU / 24.0 * f64::from(side % 24)).sin_cos();
            DVec3::new(0.3 * cos, 0.3 * sin, z).as_vec3()
        };
        let side = |k: u32| vec![corner(k, 0.0), corner(k + 1, 0.0), corner(k + 1, 2.0), corner(k, 2.0)];
        let sides: Vec<Vec<Vec3>> = (0..24).map(side).collect();
        let mut environment = scenes::empty();
        let pose = Pose { translation: DVec3::new(4.0, 0.0, -1.0), ..Pose::IDENTITY };
        environment.insert(NewObject::new("post", pose, Arc::new(scenes::mesh(&sides)))).unwrap();
        World::new(environment)
    }

    /// Contours and their tree take long to build, which must not happen within every deadline.
    #[test]
    fn contours_are_built_once_for_predictions_with_a_deadline() {
        let world = post();
        let options = GenerateOptions { kinds: vec![FeatureKind::Contour], ..GenerateOptions::default() };
        let placed = place(&world, &generate(world.environment(), "video", &options).unwrap().layer).unwrap();
        assert!(placed.iter().any(|p| p.feature.shape.is_contour()));
        let request = Request::default()
            .with_features(FeatureOptions::default().with_placed(placed))
            .with_deadline(Duration::from_secs(3600));
        let mut predictor = Predictor::new(Options::new(Backend::Cpu)).unwrap();
        let mut tree_after = || {
            predictor.predict(&world, &scenes::camera(64, 48), &SensorPose::IDENTITY, &request).unwrap();
            predictor.tree.clone().expect("the tree is kept")
        };
        assert!(Arc::ptr_eq(&tree_after(), &tree_after()));
    }
}
