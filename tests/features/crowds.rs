//! Very many features in one place or on one polygon, and smooth surfaces of very many facets. The work is proportional
//! to the input, and limits are reported. Counts serve as a measure of time, which `cargo bench --bench layers`
//! measures.

use super::contours::bodies::ball;
use glam::{DMat3, DVec3, Vec3};
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{
    FeatureOptions, FeaturePrediction, FeatureSettings, FeatureStats, Hidden, place, predict_features,
};
use presight_model::environment::NewObject;
use presight_model::environment::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::{Output, Outputs};
use presight_testkit::{plan, reference, scenes};
use std::sync::Arc;

fn feature(id: u32, shape: FeatureShape) -> Feature {
    Feature { id, name: None, object: None, shape, existence: Existence::default(), properties: Properties::default() }
}

fn layer(shapes: impl Iterator<Item = FeatureShape>) -> FeatureLayer {
    let features = (1..).zip(shapes).map(|(id, shape)| feature(id, shape).into()).collect();
    FeatureLayer { class: "video".into(), tolerance: 1e-3, features, ..FeatureLayer::default() }
}

/// A line on the wall, 5 m ahead, 1 m long.
fn line(y: f64, z: f64) -> FeatureShape {
    let ends = [DVec3::new(5.0, y, z), DVec3::new(5.0, y, z + 1.0)];
    FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO }
}

/// A square metre of the wall.
fn square(y: f64, z: f64) -> FeatureShape {
    let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(|[a, b]| DVec3::new(5.0, y + a, z + b));
    FeatureShape::Patch { corners: corners.to_vec(), covariance: DMat3::ZERO }
}

/// A wall of one polygon 5 m ahead, and a screen in front of its right half.
fn wall() -> World {
    let at = |x: f32, [y, z]: [f32; 2]| Vec3::new(x, y, z);
    let sheet = |x: f32, y: [f32; 2]| {
        let corners = [[y[0], -4.0], [y[1], -4.0], [y[1], 4.0], [y[0], 4.0]];
        scenes::mesh(&[corners.map(|c| at(x, c)).to_vec()])
    };
    let mut environment = scenes::empty();
    environment.insert(NewObject::new("wall", Pose::IDENTITY, Arc::new(sheet(5.0, [-8.0, 8.0])))).unwrap();
    environment.insert(NewObject::new("screen", Pose::IDENTITY, Arc::new(sheet(3.0, [-8.0, 0.0])))).unwrap();
    World::new(environment)
}

fn see(world: &World, pose: &Pose, layer: &FeatureLayer, hidden: Hidden) -> FeaturePrediction {
    let camera = scenes::camera(200, 150);
    let placed = place(world, layer).unwrap();
    let images = reference(&plan(world, &camera, pose));
    let settings = FeatureSettings { hidden, ..FeatureSettings::default() };
    predict_features(world, &camera, pose, &images, &placed, &settings).unwrap()
}

/// Checks that `count` features cost at most `count` times as much as one.
fn grows(one: &FeatureStats, many: &FeatureStats, count: usize) {
    let times = |n: usize| n * count;
    assert_eq!((many.features, many.asked, many.samples), (count, times(one.asked), times(one.samples)));
    assert_eq!((many.visible, many.hidden_by_neighbours), (times(one.visible), times(one.hidden_by_neighbours)));
}

#[test]
fn features_in_one_place_cost_the_same_each() {
    const COUNT: usize = 3000;
    let world = wall();
    for shape in [line(0.5, 0.0), square(0.3, -0.2)] {
        let one = see(&world, &Pose::IDENTITY, &layer([shape.clone()].into_iter()), Hidden::Count).stats;
        assert!(one.visible > 20, "{one:?}");
        let many = see(&world, &Pose::IDENTITY, &layer(std::iter::repeat_n(shape, COUNT)), Hidden::Count);
        grows(&one, &many.stats, COUNT);
        assert!(many.features.len() == COUNT && many.features.iter().all(|f| f.visible == many.features[0].visible));
    }
    // Behind the screen or the camera, no feature is sampled.
    let behind = layer(std::iter::repeat_n(line(-1.5, 0.0), COUNT));
    let away = Pose::from_xyz_rpy(DVec3::ZERO, 0.0, 0.0, std::f64::consts::PI);
    for (pose, hidden) in [(Pose::IDENTITY, "occluded"), (away, "behind_sensor")] {
        let counted = see(&world, &pose, &behind, Hidden::Count);
        assert_eq!((counted.stats.asked, counted.stats.features, counted.features.len()), (0, COUNT, 0));
        let told = see(&world, &pose, &behind, Hidden::Full);
        assert!(told.features.len() == COUNT && told.features.iter().all(|f| f.hidden[0].reason.name() == hidden));
    }
}

#[test]
fn features_on_one_polygon_cost_only_the_part_in_view() {
    let world = wall();
    // 16 m of wall, with 2 m next to the screen in view of the camera.
    let lines = |count: u32| layer((0..count).map(move |k| line(-7.9 + 15.8 * f64::from(k) / f64::from(count), 0.0)));
    let asked = |count: u32| {
        let placed = place(&world, &lines(count)).unwrap();
        assert!(placed.iter().all(|p| p.slots == [0]));
        let seen = see(&world, &Pose::IDENTITY, &lines(count), Hidden::Count);
        let all = see(&world, &Pose::IDENTITY, &lines(count), Hidden::Full);
        assert_eq!(seen.features.len(), all.features.iter().filter(|f| !f.visible.is_empty()).count());
        assert!(seen.stats.asked < seen.features.len() + seen.features.len() / 4 + 16, "{:?}", seen.stats);
        seen.stats.asked
    };
    let [some, more] = [asked(500), asked(2000)];
    assert!(some > 50 && more < 5 * some, "{some} and {more}");
}

#[test]
fn the_selection_works_on_a_crowd() {
    let world = wall();
    let crowd = place(&world, &layer((0..2000).map(|k| line(if k == 1234 { 1.0 } else { 0.5 }, 0.0)))).unwrap();
    let options = FeatureOptions::default().with_placed(crowd).with_max_features(2);
    let request = Request::of(Outputs::of(&[Output::PolygonId])).with_features(options);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let seen = predictor.predict(&world, &scenes::camera(200, 150), &SensorPose::IDENTITY, &request).unwrap();
    let ids: Vec<u32> = seen.features.unwrap().features.iter().map(|f| f.feature.id).collect();
    // The only feature elsewhere, and the first of all others.
    assert_eq!(ids, [1, 1235]);
}

/// A ball 4 m ahead whose edges are not features.
fn ball_ahead(columns: u32, rows: u32) -> World {
    let mut environment = scenes::empty();
    let at = Pose::from_xyz_rpy(DVec3::new(4.0, 0.0, 0.0), 0.0, 0.0, 0.0);
    environment.insert(NewObject::new("ball", at, Arc::new(ball(columns, rows, 0.5)))).unwrap();
    World::new(environment)
}

/// A silhouette goes once around the ball. Its cost is proportional to its length, although all facets are tested.
#[test]
fn balls_of_very_many_facets_have_one_contour() {
    let once = |columns: u32, rows: u32| {
        let world = ball_ahead(columns, rows);
        let made = generate(world.environment(), "video", &GenerateOptions::default()).unwrap().layer;
        assert_eq!(made.features.iter().map(|f| f.shape.kind()).collect::<Vec<_>>(), ["contour"]);
        let seen = see(&world, &Pose::IDENTITY, &made, Hidden::Full);
        assert_eq!(seen.features.len(), 1);
        let curve = &seen.features[0];
        assert_eq!(curve.points_world.first(), curve.points_world.last(), "closed");
        assert!(curve.visible_fraction > 0.999, "{}", curve.visible_fraction);
        [curve.points_world.len(), seen.stats.samples]
    };
    let (few, many) = (once(40, 20), once(320, 160));
    assert!(many[0] > 4 * few[0] && many[0] < 16 * few[0], "{few:?} {many:?}");
    assert!(many[1] < 16 * few[1], "{few:?} {many:?}");
}

#[test]
fn too_many_contours_of_large_surfaces_are_refused() {
    let world = ball_ahead(100, 50);
    let made = generate(world.environment(), "video", &GenerateOptions::default()).unwrap().layer;
    let facets = place(&world, &made).unwrap()[0].slots.len();
    let fits = (presight_model::limits::MAX_CONTOUR_FACETS as usize) / facets;
    let crowd = |count: usize| {
        let copy = |id: u32| Arc::new(Feature { id, ..Feature::clone(&made.features[0]) });
        let features = (1..=count as u32).map(copy).collect();
        place(&world, &FeatureLayer { features, ..made.clone() })
    };
    assert_eq!(crowd(3).unwrap().len(), 3);
    let refused = crowd(fits + 1).unwrap_err();
    let said = refused.to_string();
    assert!(said.starts_with(&format!("feature {} ", fits + 1)) && said.contains("over 4194304 polygons"), "{said}");
    assert_eq!(refused.kind(), presight_model::error::ErrorKind::Invalid);
    assert!(!refused.remedy().is_empty());
}
