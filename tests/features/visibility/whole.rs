//! Segments that are visible or hidden as a whole, which a scanner does not sample: their results equal those of
//! samples. A feature image needs the samples, so requesting one forces them.

use super::common::{Random, data, plan, reference, scenes};
use super::counted::same;
use super::edges;
use glam::DVec3;
use presight_features::{FeaturePrediction, FeatureSettings, Hidden, PlacedFeature, SeenFeature, predict_features};
use presight_files::preset;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;

/// Features with different results: visible ones are compared bit by bit.
fn differing(with: &[SeenFeature], without: &[SeenFeature]) -> usize {
    assert_eq!(with.len(), without.len());
    with.iter().zip(without).filter(|(a, b)| !same(a, b)).count()
}

fn seen(all: &FeaturePrediction) -> Vec<SeenFeature> {
    all.features.iter().filter(|f| !f.visible.is_empty()).cloned().collect()
}

/// The number of samples with a feature image and without.
fn compare(name: &str, world: &World, sensor: &Sensor, pose: &Pose, placed: &[PlacedFeature]) -> [usize; 2] {
    let images = reference(&plan(world, sensor, pose));
    let ask = |feature_id: bool, hidden: Hidden| {
        let options = FeatureSettings { feature_id, hidden, ..FeatureSettings::default() };
        predict_features(world, sensor, pose, &images, placed, &options).unwrap()
    };
    let (with, without) = (ask(true, Hidden::Full), ask(false, Hidden::Full));
    assert_eq!(differing(&with.features, &without.features), 0, "{name}");
    let counted = ask(false, Hidden::Count);
    assert_eq!(differing(&seen(&with), &seen(&counted)), 0, "{name}: counted");
    // Planted fault: a visible feature is nearer than its nearest sample.
    let mut planted = counted.features.clone();
    if let Some(range) = planted.first_mut().and_then(|f| f.range.as_mut()) {
        *range *= 1.0 - 1e-12;
        assert_eq!(differing(&seen(&with), &planted), 1, "{name}: planted");
    }
    [with.stats.samples, without.stats.samples]
}

fn sensors() -> [Sensor; 2] {
    [scenes::scanner(360, 91), preset("microwave-radar-image").unwrap()]
}

#[test]
fn segments_without_samples_equal_sampled_ones() {
    let mut random = Random(7);
    let mut sums = [0; 2];
    for boxes in [5, 40, 80] {
        let world = scenes::room_world(random.bits(), boxes);
        let placed = edges(world.environment(), 400, &mut random);
        for _ in 0..3 {
            let at = DVec3::new(random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6), random.uniform(0.8, 1.8));
            let pose = Pose::from_xyz_rpy(at, 0.1, random.uniform(-0.2, 0.2), random.uniform(-3.0, 3.0));
            for sensor in &sensors() {
                let both = compare(&format!("{boxes} boxes"), &world, sensor, &pose, &placed);
                (0..2).for_each(|k| sums[k] += both[k]);
            }
        }
    }
    assert!(sums[0] > sums[1] + 5000, "{sums:?}: few are decided as a whole");
}

#[test]
fn in_real_scenes_too() {
    for name in ["warehouse_small", "office_willowgarage"] {
        let Some(world) = data::scene(name, true) else { return };
        let placed = edges(world.environment(), 1500, &mut Random(3));
        for pose in data::poses(&world, 3, 5) {
            for sensor in &sensors() {
                compare(name, &world, sensor, &pose, &placed);
            }
        }
    }
}
