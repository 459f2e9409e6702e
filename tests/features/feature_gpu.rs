//! Compares features by the GPU engine, where the images' proposals are made on the device, with proposals from the
//! CPU's images. The results are equal bit by bit, because both are confirmed in f64. The device searches around every
//! sample and the CPU around some of them, so the device proposes no fewer, except for ties.
#![cfg(feature = "gpu")]
#![expect(clippy::print_stderr, reason = "counts are worth reading")]

use presight_testkit as common;

use common::skip::no_adapter;
use common::{Random, data, hard, scenes};
use glam::{DMat3, DVec3};
use presight_features::{
    FeatureOptions, FeaturePrediction, FeatureSettings, FeatureStats, Hidden, PlacedFeature, SeenFeature,
    predict_features,
};
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};

use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::gpu::DeviceOptions;
use presight_predict::gpu::testing;
use presight_predict::gpu::testing::Setup;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::StageName;
use presight_render::plan::{Images, Output, Outputs, Stats};
use proptest::strategy::{Strategy, ValueTree};
use proptest::test_runner::TestRunner;

fn predictor() -> Option<Predictor> {
    match testing::open(DeviceOptions::default(), Setup::ALL_ON_DEVICE) {
        Ok(engine) => {
            let options = Options::new(Backend::Gpu).with_threads(2);
            Some(Predictor::with_engine(options, Box::new(engine.with_threads(2))))
        }
        Err(e) => {
            no_adapter(e);
            None
        }
    }
}

fn request() -> Request {
    Request::of(Outputs::of(&[Output::PolygonId]))
}

/// Edges, corners and faces of some polygons of a world.
fn features(world: &World, most: usize, random: &mut Random) -> Vec<PlacedFeature> {
    let slots = world.environment().slot_count() as usize;
    let mut all = Vec::new();
    while all.len() < most {
        let slot = random.below(slots) as u32;
        let corners = world.environment().polygon_in_world(slot).unwrap_or_default();
        if corners.len() < 3 {
            continue;
        }
        let id = all.len() as u32 + 1;
        let shape = match id % 8 {
            0 => FeatureShape::Patch { corners, covariance: DMat3::ZERO },
            1 => FeatureShape::Point { at: corners[0], covariance: DMat3::ZERO },
            k => {
                let k = k as usize % corners.len();
                let ends = [corners[k], corners[(k + 1) % corners.len()]];
                FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO }
            }
        };
        let (existence, properties) = (Existence::default(), Properties::default());
        let feature = Feature { id, name: None, object: None, shape, existence, properties };
        all.push(PlacedFeature { feature: feature.into(), object: None, slots: vec![slot] });
    }
    all
}

/// The result without occluders: of several occluders each side may find a different one.
fn shown(f: &SeenFeature) -> SeenFeature {
    let mut f = f.clone();
    f.hidden.iter_mut().for_each(|h| h.by = None);
    // Merges adjacent parts that different polygons hide.
    f.hidden.dedup_by(|b, a| {
        let same = a.reason == b.reason && a.t[1] == b.t[0];
        a.t[1] = if same { b.t[1] } else { a.t[1] };
        same
    });
    f
}

/// Features that differ between the two.
fn differing(device: &FeaturePrediction, host: &FeaturePrediction) -> usize {
    assert_eq!(device.features.len(), host.features.len());
    device.features.iter().zip(&host.features).filter(|(a, b)| shown(a) != shown(b)).count()
}

fn agree(name: &str, device: &FeaturePrediction, host: &FeaturePrediction) {
    assert_eq!(differing(device, host), 0, "{name}");
    assert_eq!(device.feature_id, host.feature_id, "{name}");
    assert_eq!((device.stats.samples, device.stats.visible), (host.stats.samples, host.stats.visible), "{name}");
    // Planted fault: one visible interval is dropped.
    let mut less = device.clone();
    if let Some(seen) = less.features.iter_mut().find(|f| !f.visible.is_empty()) {
        seen.visible.pop();
        assert_eq!(differing(&less, host), 1, "{name}");
    }
}

fn on_device(
    predictor: &mut Predictor,
    world: &World,
    sensor: &Sensor,
    pose: &Pose,
    placed: &[PlacedFeature],
) -> (FeaturePrediction, Images, Stats) {
    let outputs = Outputs::of(&[Output::PolygonId, Output::FeatureId]);
    let request = Request::of(outputs)
        .with_features(FeatureOptions::default().with_hidden(Hidden::Full).with_placed(placed.to_vec()));
    let mut seen = predictor.predict(world, sensor, &SensorPose::new(*pose), &request).unwrap();
    let mut found = seen.features.unwrap();
    found.spell_out(world.environment(), placed);
    found.feature_id = std::mem::take(&mut seen.images.feature_id);
    (found, seen.images, seen.stats)
}

fn check(
    name: &str,
    predictor: &mut Predictor,
    world: &World,
    sensor: &Sensor,
    pose: &Pose,
    placed: &[PlacedFeature],
) -> [FeatureStats; 2] {
    let (device, images, stats) = on_device(predictor, world, sensor, pose, placed);
    let asked = stats.stages_ms.iter().any(|(stage, _)| *stage == StageName::FeaturesOnDevice);
    // Omitted only if nothing is in view or no sample is undecided.
    let needless = stats.left_out.iter().any(|l| l.what.to_string().ends_with("on the device"));
    assert!(asked != needless, "{name}: {:?}", stats.left_out);
    let options = FeatureSettings { feature_id: true, ..FeatureSettings::default() };
    let host = predict_features(world, sensor, pose, &images, placed, &options).unwrap();
    agree(name, &device, &host);
    [device.stats, host.stats]
}

/// The device proposes all hidden samples that the CPU finds in the same images, except for ties.
fn proposes_as_much(name: &str, [device, host]: [FeatureStats; 2]) {
    eprintln!(
        "{name}: {} of {} samples hidden, {} on the host",
        device.hidden_by_neighbours, device.samples, host.hidden_by_neighbours
    );
    let is_enough = |proposed: usize| 50 * proposed >= 49 * host.hidden_by_neighbours;
    assert!(host.hidden_by_neighbours > 500 && is_enough(device.hidden_by_neighbours), "{name}: {device:?} {host:?}");
    // Planted fault: a tenth is not proposed.
    assert!(!is_enough(host.hidden_by_neighbours / 10 * 9), "{name}");
}

#[test]
fn real_scenes_give_equal_features() {
    let Some(mut predictor) = predictor() else { return };
    let mut random = Random(3);
    for scene in ["factory_hall", "office_willowgarage"] {
        let Some(world) = data::scene(scene, true) else { return };
        let placed = features(&world, 800, &mut random);
        for pose in data::poses(&world, 2, 5) {
            let mut sums = [FeatureStats::default(); 2];
            for sensor in [scenes::camera(320, 240), scenes::scanner(360, 91)] {
                let both = check(scene, &mut predictor, &world, &sensor, &pose, &placed);
                sums.iter_mut().zip(both).for_each(|(sum, stats)| sum.add(&stats));
            }
            proposes_as_much(scene, sums);
        }
    }
}

#[test]
fn rooms_and_hard_scenes_give_equal_features() {
    let Some(mut predictor) = predictor() else { return };
    let mut random = Random(4);
    let mut sums = [FeatureStats::default(); 2];
    for scene in 0..3 {
        let world = scenes::room_world(random.bits(), [5, 30, 80][scene]);
        let placed = features(&world, 150, &mut random);
        let pose = Pose::from_xyz_rpy(DVec3::new(0.2, -0.1, 1.4), 0.1, 0.1, random.uniform(-3.0, 3.0));
        let scanners = [scenes::scanner(360, 31), scenes::closed(361, 31), scenes::fan(), scenes::all_round(144, 73)];
        for sensor in [scenes::camera(200, 150)].into_iter().chain(scanners) {
            let both = check("rooms", &mut predictor, &world, &sensor, &pose, &placed);
            sums.iter_mut().zip(both).for_each(|(sum, stats)| sum.add(&stats));
        }
    }
    proposes_as_much("rooms", sums);
    let mut runner = TestRunner::deterministic();
    for _ in 0..12 {
        let case = hard::grazing().new_tree(&mut runner).unwrap().current();
        let (world, pose, sensors) = case.build();
        let placed = features(&world, 40, &mut random);
        for sensor in &sensors {
            check("hard", &mut predictor, &world, sensor, &pose, &placed);
        }
    }
}

/// A second round allocates nothing, and without features no stage runs.
#[test]
fn steady_state_allocates_nothing_and_no_features_cost_nothing() {
    let Some(mut predictor) = predictor() else { return };
    let world = scenes::room_world(7, 30);
    let placed = features(&world, 200, &mut Random(1));
    let sensors = [scenes::camera(200, 150), scenes::scanner(180, 31)];
    let pose = |i: usize| Pose::from_xyz_rpy(DVec3::new(0.1 * i as f64, 0.0, 1.4), 0.0, 0.0, i as f64);
    let plain = |predictor: &mut Predictor| {
        let seen = predictor.predict(&world, &sensors[0], &SensorPose::new(pose(0)), &request()).unwrap();
        assert!(!seen.stats.stages_ms.iter().any(|(stage, _)| stage.name().contains("feature")));
    };
    plain(&mut predictor);
    let before = testing::allocations(predictor.engine()).unwrap();
    plain(&mut predictor);
    let nothing = request().with_features(FeatureOptions::default().with_placed(Vec::new()));
    let none = predictor.predict(&world, &sensors[0], &SensorPose::new(pose(0)), &nothing).unwrap().features.unwrap();
    assert!(none.features.is_empty() && none.stats == FeatureStats::default());
    assert_eq!(testing::allocations(predictor.engine()).unwrap(), before, "without features");
    let round = |predictor: &mut Predictor| {
        for i in 0..4 {
            on_device(predictor, &world, &sensors[i % 2], &pose(i), &placed);
        }
        testing::allocations(predictor.engine()).unwrap()
    };
    let first = round(&mut predictor);
    assert!(first.pipelines > before.pipelines && first.buffers > before.buffers);
    assert_eq!(round(&mut predictor), first);
}

/// On a software adapter the CPU does features and regions, and reports that.
#[test]
fn stages_that_stay_on_the_cpu_are_reported() {
    use presight_features::BoxOptions;
    let mut predictor = match Predictor::new(Options::new(Backend::Gpu).with_threads(2)) {
        Ok(predictor) => predictor,
        Err(e) => return no_adapter(e),
    };
    let (world, sensor) = (scenes::room_world(1, 6), scenes::camera(64, 48));
    let placed = features(&world, 20, &mut Random(5));
    let pose = Pose::IDENTITY;
    let request =
        request().with_features(FeatureOptions::default().with_placed(placed)).with_regions(BoxOptions::default());
    let stats = predictor.predict(&world, &sensor, &SensorPose::new(pose), &request).unwrap().stats;
    let software = stats.left_out.iter().any(|l| l.what == StageName::ResolveOnDevice.into());
    for stage in ["features on the device", "regions of interest on the device"] {
        let said =
            stats.left_out.iter().find(|l| l.what.to_string() == stage).map(|l| l.why.contains("done on the CPU"));
        assert_eq!(said == Some(true), software, "{stage}: {:?}", stats.left_out);
    }
}
