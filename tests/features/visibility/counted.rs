//! Hidden features that are only counted: visible ones get the same results as if all were sampled.

use super::common::{Random, data, env_number, plan, reference, scenes};
use super::patches::patches_and_points;
use super::{edges, sensors};
use glam::{DMat3, DVec3, Vec3};
use presight_features::{
    FeatureOptions, FeaturePrediction, FeatureSettings, Hidden, PlacedFeature, Reason, SeenFeature, predict_features,
};
use presight_model::environment::NewObject;
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::{Output, Outputs};
use std::sync::Arc;

fn ask(world: &World, sensor: &Sensor, pose: &Pose, placed: &[PlacedFeature], hidden: Hidden) -> FeaturePrediction {
    let images = reference(&plan(world, sensor, pose));
    let options = FeatureSettings { feature_id: true, hidden, ..FeatureSettings::default() };
    predict_features(world, sensor, pose, &images, placed, &options).unwrap()
}

/// The hidden share of a feature for each reason. If two polygons hide the same place, either may be named.
fn shares(seen: &SeenFeature) -> Vec<(Reason, f64)> {
    let share = |reason: Reason| {
        let of = seen.hidden.iter().filter(|h| h.reason == reason);
        (reason, of.map(|h| h.t[1] - h.t[0]).sum::<f64>())
    };
    Reason::ALL.into_iter().map(share).collect()
}

pub(super) fn same(a: &SeenFeature, b: &SeenFeature) -> bool {
    let near = |(a, b): ((Reason, f64), (Reason, f64))| (a.1 - b.1).abs() < 1e-9;
    let shown = |seen: &SeenFeature| SeenFeature { hidden: Vec::new(), ..seen.clone() };
    shown(a) == shown(b) && shares(a).into_iter().zip(shares(b)).all(near)
}

/// Features whose results differ in the second prediction, or that it lacks wrongly.
fn differing(all: &FeaturePrediction, counted: &FeaturePrediction) -> usize {
    let right = |i: usize| {
        let number = counted.given_at(i);
        all.features.get(number).is_some_and(|f| !f.visible.is_empty() && same(f, &counted.features[i]))
    };
    let seen = all.features.iter().filter(|f| !f.visible.is_empty()).count();
    let right = (0..counted.features.len()).filter(|i| right(*i)).count();
    seen.max(counted.features.len()) - right
}

fn agree(name: &str, world: &World, sensor: &Sensor, pose: &Pose, placed: &[PlacedFeature]) -> [usize; 2] {
    let all = ask(world, sensor, pose, placed, Hidden::Full);
    let counted = ask(world, sensor, pose, placed, Hidden::Count);
    assert_eq!(differing(&all, &counted), 0, "{name}");
    assert!(counted.given.windows(2).all(|pair| pair[0] < pair[1]), "{name}: the order in which they were given");
    assert_eq!(all.feature_id, counted.feature_id, "{name}");
    assert_eq!((all.stats.features, counted.stats.features), (placed.len(), placed.len()), "{name}");
    out_of_view(name, world, sensor, pose, (placed, &all));
    [counted.stats.asked, counted.features.len()]
}

/// Compares a predictor's report of features out of view with a test of each one; returns how many it reports without a
/// test.
fn out_of_view(
    name: &str,
    world: &World,
    sensor: &Sensor,
    pose: &Pose,
    (placed, all): (&[PlacedFeature], &FeaturePrediction),
) -> usize {
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let options = FeatureOptions::default().with_placed(placed.to_vec()).with_hidden(Hidden::Full);
    let request = Request::of(Outputs::of(&[Output::PolygonId])).with_features(options);
    let mut told = predictor.predict(world, sensor, &SensorPose::new(*pose), &request).unwrap().features.unwrap();
    let apart = told.out_of_view.clone();
    assert_eq!((apart.len() + told.features.len(), told.stats.features), (placed.len(), placed.len()), "{name}");
    assert_eq!(told.stats.asked, told.features.len(), "{name}");
    told.spell_out(world.environment(), placed);
    assert!(told.given.is_empty() && told.out_of_view.is_empty(), "{name}");
    for (number, reason) in &apart {
        let number = *number as usize;
        assert_eq!(told.features[number], all.features[number], "{name}");
        assert_eq!(told.features[number].hidden[0].reason, *reason, "{name}");
    }
    apart.len()
}

#[test]
fn features_out_of_view_are_reported_without_a_test() {
    let world = halves([70.5, 70.5]);
    let shifted = |id: u32, by: DVec3| {
        let mut placed = edge();
        let feature = Arc::make_mut(&mut placed.feature);
        feature.id = id;
        if let FeatureShape::Segment { ends, .. } = &mut feature.shape {
            ends.iter_mut().for_each(|p| *p += by);
        }
        placed
    };
    // In turn behind the camera, in view, and next to the image.
    let by = |k: u32| [DVec3::X * -10.0, DVec3::ZERO, DVec3::Y * 40.0][k as usize % 3];
    let placed: Vec<PlacedFeature> = (0..300).map(|k| shifted(k + 1, by(k))).collect();
    for (sensor, count) in [(scenes::camera(200, 150), 200), (scenes::scanner(180, 31), 0), (scenes::lens(64, 48), 0)] {
        let all = ask(&world, &sensor, &Pose::IDENTITY, &placed, Hidden::Full);
        let told = out_of_view("three places", &world, &sensor, &Pose::IDENTITY, (&placed, &all));
        assert!(10 * told >= 9 * count, "{told}");
    }
}

#[test]
fn counting_hidden_features_does_not_change_visible_ones() {
    let mut random = Random(env_number("PRESIGHT_SEED", 1));
    let (mut features, mut asked, mut seen) = (0, 0, 0);
    for boxes in [5, 40] {
        let world = scenes::room_world(random.bits(), boxes);
        let mut placed = edges(world.environment(), 200, &mut random);
        placed.extend(patches_and_points(world.environment(), &mut random));
        let at = DVec3::new(random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6), random.uniform(0.8, 1.8));
        let pose = Pose::from_xyz_rpy(at, 0.1, random.uniform(-0.2, 0.2), random.uniform(-3.0, 3.0));
        for (i, sensor) in sensors().iter().enumerate() {
            let name = format!("{boxes} boxes, {i} {}", sensor.spec().name);
            let [some, shown] = agree(&name, &world, sensor, &pose, &placed);
            (features, asked, seen) = (features + placed.len(), asked + some, seen + shown);
        }
    }
    assert!(seen > 200 && asked < features * 2 / 3, "{seen} seen, {asked} sampled of {features}");
}

#[test]
fn in_real_scenes_too() {
    for name in ["warehouse_small", "office_willowgarage"] {
        let Some(world) = data::scene(name, true) else { return };
        let mut random = Random(3);
        let placed = edges(world.environment(), 1500, &mut random);
        for pose in data::poses(&world, 2, 5) {
            for sensor in [scenes::camera(200, 150), scenes::scanner(360, 91)] {
                agree(name, &world, &sensor, &pose, &placed);
            }
        }
    }
}

#[test]
fn planted_faults_are_caught() {
    let world = scenes::room_world(7, 15);
    let placed = edges(world.environment(), 200, &mut Random(2));
    let (sensor, pose) = (scenes::camera(200, 150), Pose::from_xyz_rpy(DVec3::new(0.0, 0.0, 1.2), 0.0, 0.0, 0.3));
    let all = ask(&world, &sensor, &pose, &placed, Hidden::Full);
    let counted = ask(&world, &sensor, &pose, &placed, Hidden::Count);
    let with = |change: &dyn Fn(&mut FeaturePrediction)| {
        let mut faulty = counted.clone();
        change(&mut faulty);
        differing(&all, &faulty)
    };
    assert_eq!(with(&|_| ()), 0);
    assert_eq!(with(&|p| (p.features.pop(), p.given.pop()).1.map_or((), |_| ())), 1);
    assert_eq!(with(&|p| p.features[0].visible[0].t[1] *= 0.5), 1);
    assert!(with(&|p| p.given.swap(0, 1)) > 0);
    let hidden = all.features.iter().position(|f| f.visible.is_empty()).unwrap();
    assert_eq!(with(&|p| (p.features.push(all.features[hidden].clone()), p.given.push(hidden as u32)).1), 1);
}

/// A horizontal edge 5 m ahead, from y = 1 to -1, on no polygon.
fn edge() -> PlacedFeature {
    let ends = [DVec3::new(5.0, 1.0, 0.1), DVec3::new(5.0, -1.0, 0.1)];
    let shape = FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
    let (existence, properties) = (Existence::default(), Properties::default());
    let feature = Feature { id: 1, name: None, object: None, shape, existence, properties };
    PlacedFeature { feature: feature.into(), object: None, slots: vec![] }
}

/// A wall 2 m ahead in two halves, with a gap between these pixel columns (the camera's focal length is 200 pixels).
fn halves(gap: [f32; 2]) -> World {
    let y = |column: f32| (99.5 - column) * 2.0 / 200.0;
    let half = |from: f32, to: f32| vec![[from, -3.0], [to, -3.0], [to, 3.0], [from, 3.0]];
    let at = |p: [f32; 2]| Vec3::new(2.0, p[0], p[1]);
    let walls = [half(-3.0, y(gap[1])), half(y(gap[0]), 3.0)].map(|wall| wall.into_iter().map(at).collect::<Vec<_>>());
    let mut environment = scenes::empty();
    environment.insert(NewObject::new("walls", Pose::IDENTITY, Arc::new(scenes::mesh(&walls)))).unwrap();
    World::new(environment)
}

/// A gap of 0.6 pixels between two columns of pixel centres: no image shows it, and only one or two of the edge's 160
/// samples (half a pixel each) are visible through it. Without a gap the halves hide the edge together, and neither
/// does alone.
#[test]
fn a_gap_that_no_pixel_shows_is_not_hidden() {
    let camera = scenes::camera(200, 150);
    let open = halves([70.2, 70.8]);
    let images = reference(&plan(&open, &camera, &Pose::IDENTITY));
    assert!(images.polygon_id.iter().all(|id| *id != 0), "the image shows the gap");
    let seen = ask(&open, &camera, &Pose::IDENTITY, &[edge()], Hidden::Count);
    let [f] = &seen.features[..] else { panic!("{} features", seen.features.len()) };
    let samples = 160.0 * f.visible_fraction;
    assert!((samples - 1.0).abs() < 1e-6 || (samples - 2.0).abs() < 1e-6, "{samples}");
    let closed = ask(&halves([70.5, 70.5]), &camera, &Pose::IDENTITY, &[edge()], Hidden::Count);
    assert_eq!((closed.features.len(), closed.stats.asked, closed.stats.features), (0, 0, 1));
}

/// From 400 m away, looking elsewhere, no feature is sampled; after turning round, some are.
#[test]
fn features_out_of_view_are_not_sampled() {
    let world = scenes::room_world(3, 40);
    let some = edges(world.environment(), usize::MAX, &mut Random(3));
    let many: Vec<PlacedFeature> = some.iter().cycle().take(20_000).cloned().collect();
    let [away, back] = [std::f64::consts::PI, 0.0].map(|yaw| {
        let pose = Pose::from_xyz_rpy(DVec3::new(-400.0, 0.0, 1.0), 0.0, 0.0, yaw);
        let told = ask(&world, &scenes::camera(64, 48), &pose, &many, Hidden::Count);
        assert_eq!(told.stats.features, many.len());
        (told.stats.asked, told.features.len())
    });
    assert_eq!(away, (0, 0));
    assert!(back.0 > 0 && back.1 > 0, "{back:?}");
}

/// Features that are out of view or hidden have one part and one reason.
#[test]
fn reasons_alone() {
    let (camera, pose) = (scenes::camera(200, 150), Pose::IDENTITY);
    let shifted = |by: DVec3| {
        let mut placed = edge();
        if let FeatureShape::Segment { ends, .. } = &mut Arc::make_mut(&mut placed.feature).shape {
            ends.iter_mut().for_each(|p| *p += by);
        }
        placed
    };
    let placed = [
        edge(),
        shifted(DVec3::X * -10.0),
        shifted(DVec3::Y * 20.0),
        shifted(DVec3::X * -4.0),
        shifted(DVec3::Y * 2.5),
    ];
    let world = halves([70.5, 70.5]);
    let told = ask(&world, &camera, &pose, &placed, Hidden::Reason);
    let reasons: Vec<Vec<Reason>> = told.features.iter().map(|f| f.hidden.iter().map(|h| h.reason).collect()).collect();
    use Reason::{BehindSensor, Occluded, OutsideImage};
    // The fourth is in front of the wall and extends beyond the image on both sides; the last is behind it and partly
    // outside.
    let expected: [&[Reason]; 5] =
        [&[Occluded], &[BehindSensor], &[OutsideImage], &[OutsideImage, OutsideImage], &[Occluded]];
    assert_eq!(reasons, expected);
    assert!(told.features.iter().all(|f| !f.visible.is_empty() || f.hidden[0].t == [0.0, 1.0]));
    assert!(told.given.is_empty());
}

/// The library's default, through a predictor: its feature tree adapts to a moved object, and to another layer.
#[test]
fn a_predictor_adapts_to_changes() {
    let mut world = halves([70.5, 70.5]);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let mut on_wall = edge();
    on_wall.object = Some(0);
    Arc::make_mut(&mut on_wall.feature).object = Some("walls".into());
    let one: presight_features::PlacedFeatures = vec![edge(), on_wall].into();
    let camera = scenes::camera(200, 150);
    let mut count = |world: &World, placed: &presight_features::PlacedFeatures| {
        let features = FeatureOptions::default().with_placed(placed.clone());
        let request = Request::of(Outputs::of(&[Output::PolygonId])).with_features(features);
        predictor.predict(world, &camera, &SensorPose::IDENTITY, &request).map(|p| p.features.unwrap().given)
    };
    assert_eq!(count(&world, &one).unwrap(), [] as [u32; 0]);
    // 4 m further ahead, the sensor is past the wall and in front of the edge.
    let near = Pose::from_xyz_rpy(DVec3::X * -4.0, 0.0, 0.0, 0.0);
    world.apply(presight_model::change::Change::MoveObject { name: "walls".into(), world_from_object: near }).unwrap();
    assert_eq!(count(&world, &one).unwrap(), [0, 1]);
    let other: presight_features::PlacedFeatures = vec![edge()].into();
    assert_eq!(count(&world, &other).unwrap(), [0]);
    // Another world does not have this object.
    let empty = World::new(scenes::empty());
    assert!(count(&empty, &one).unwrap_err().to_string().contains("does not exist"));
}
