//! Checks each reason for a hidden feature in scenes of a wall and a sensor.

use presight_testkit as common;

use common::scenes;
use glam::{DMat3, DVec3, Vec3};
use presight_features::{FeaturePrediction, FeatureSettings, PlacedFeature, Reason, SeenFeature, predict_features};
use presight_model::environment::{Appearance, Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::error::ErrorKind;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Angles, Geometry, RayTable, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_render::plan::{CountName, StageName};
use std::sync::Arc;

/// A wall at x = 3, from y = -1 to 1 and z = -1 to 1, with its normal towards the origin.
fn wall(appearance: Appearance, one_sided: bool) -> World {
    let mut environment = Environment::new();
    let mut material = Material::named("glass");
    material.one_sided = one_sided;
    material.appearance.insert("video".into(), appearance);
    let material = environment.add_material(material).unwrap();
    let corners = [[3.0, -1.0, -1.0], [3.0, -1.0, 1.0], [3.0, 1.0, 1.0], [3.0, 1.0, -1.0]].map(Vec3::from);
    let face = Polygon::new(vec![0, 1, 2, 3], material);
    let mesh = Mesh::new("wall", corners.to_vec(), vec![face], PolygonOrder::Given).unwrap();
    environment.insert(NewObject::new("hall/wall", Pose::IDENTITY, Arc::new(mesh))).unwrap();
    World::new(environment)
}

fn placed(id: u32, shape: FeatureShape, slots: &[u32]) -> PlacedFeature {
    let (existence, properties) = (Existence::default(), Properties::default());
    let feature = Feature { id, name: None, object: None, shape, existence, properties };
    PlacedFeature { feature: feature.into(), object: None, slots: slots.to_vec() }
}

fn point(at: [f64; 3]) -> FeatureShape {
    FeatureShape::Point { at: at.into(), covariance: DMat3::ZERO }
}

fn segment(a: [f64; 3], b: [f64; 3]) -> FeatureShape {
    FeatureShape::Segment { ends: [a.into(), b.into()], covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO }
}

fn predict(world: &World, sensor: &Sensor, pose: &Pose, placed: &[PlacedFeature]) -> FeaturePrediction {
    let images = common::reference(&common::plan(world, sensor, pose));
    let options = FeatureSettings { feature_id: true, ..FeatureSettings::default() };
    predict_features(world, sensor, pose, &images, placed, &options).unwrap()
}

fn one(world: &World, sensor: &Sensor, feature: PlacedFeature) -> SeenFeature {
    predict(world, sensor, &Pose::IDENTITY, &[feature]).features.remove(0)
}

fn reasons(seen: &SeenFeature) -> Vec<Reason> {
    seen.hidden.iter().map(|h| h.reason).collect()
}

fn row(beam_height_deg: f64) -> Sensor {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 0.5, count: 720 };
    let elevation = Angles::Uniform { start_deg: 0.0, step_deg: 0.0, count: 1 };
    let scanner = Scanner { azimuth, elevation, beam_height_deg: Some(beam_height_deg) };
    Sensor::new(SensorSpec::new("row", "video", Geometry::Scanner(scanner))).unwrap()
}

#[test]
fn outside_and_behind_come_in_order_along_a_segment() {
    let world = World::new(Environment::new());
    let seen = one(&world, &scenes::camera(100, 80), placed(1, segment([-2.0, 0.1, 0.0], [2.0, 0.1, 0.0]), &[]));
    assert_eq!(reasons(&seen), [Reason::BehindSensor, Reason::OutsideImage]);
    assert!((seen.hidden[0].t[1] - 0.5).abs() < 1e-12 && seen.hidden[0].t[0] == 0.0);
    // The image is 100 pixels wide with f = 100, so it ends where y / x = 0.5, at x = 0.2.
    assert!((seen.hidden[1].t[1] - 0.55).abs() < 1e-12, "{seen:?}");
    assert_eq!(seen.visible.len(), 1);
    assert!((seen.visible[0].t[0] - 0.55).abs() < 1e-12 && seen.visible[0].t[1] == 1.0);
    assert!((seen.visible[0].pixels[0].x + 0.5).abs() < 1e-9, "the left border");
    assert_eq!(seen.visible_fraction, 1.0);
}

#[test]
fn range_limits_are_not_part_of_the_share() {
    let mut spec = scenes::camera(100, 80).spec().clone();
    (spec.range_min, spec.range_max) = (2.0, 4.0);
    let sensor = Sensor::new(spec).unwrap();
    let world = World::new(Environment::new());
    let seen = one(&world, &sensor, placed(1, segment([1.0, 0.3, 0.0], [6.0, 0.3, 0.0]), &[]));
    assert_eq!(reasons(&seen), [Reason::BelowRangeMin, Reason::BeyondRangeMax]);
    assert!((seen.visible[0].t[0] - 0.2).abs() < 0.02 && (seen.visible[0].t[1] - 0.6).abs() < 0.1, "{seen:?}");
    assert_eq!(seen.visible_fraction, 1.0);
    assert!((seen.range.unwrap() - 2.0).abs() < 0.1);
}

#[test]
fn materials_hide_or_not() {
    let camera = scenes::camera(100, 80);
    let (on, behind) = (|| placed(1, point([3.0, 0.2, 0.2]), &[0]), || placed(2, point([4.0, 0.2, 0.2]), &[]));
    let opaque = wall(Appearance::Opaque, false);
    let seen = one(&opaque, &camera, on());
    assert_eq!((seen.visible_fraction, reasons(&seen)), (1.0, vec![]));
    assert!((seen.cos_incidence.unwrap() - 3.0 / seen.range.unwrap()).abs() < 1e-12);
    let hidden = one(&opaque, &camera, behind());
    assert_eq!(reasons(&hidden), [Reason::Occluded]);
    let by = hidden.hidden[0].by.unwrap();
    assert_eq!((by.slot, by.polygon_id, by.object), (0, 1, 0));
    assert_eq!((hidden.visible_fraction, hidden.range), (0.0, None));
    let invisible = wall(Appearance::Invisible, false);
    assert_eq!(reasons(&one(&invisible, &camera, on())), [Reason::Material]);
    assert_eq!(one(&invisible, &camera, behind()).visible_fraction, 1.0);
    let transparent = wall(Appearance::Transparent, false);
    assert_eq!(one(&transparent, &camera, on()).visible_fraction, 1.0);
    assert_eq!(one(&transparent, &camera, behind()).visible_fraction, 1.0);
}

#[test]
fn features_facing_away_are_not_seen() {
    let camera = scenes::camera(100, 80);
    let empty = World::new(Environment::new());
    let reflector = |normal: DVec3| {
        let mut p = placed(1, FeatureShape::Reflector { at: DVec3::X * 3.0, covariance: DMat3::ZERO }, &[]);
        Arc::make_mut(&mut p.feature).properties.normal = Some(normal);
        one(&empty, &camera, p)
    };
    assert_eq!(reflector(DVec3::NEG_X).visible_fraction, 1.0);
    assert_eq!(reasons(&reflector(DVec3::X)), [Reason::FacingAway]);
    // Clockwise from the top left as seen from the camera: left is +y.
    let marker = [[3.0, 0.2, 0.2], [3.0, -0.2, 0.2], [3.0, -0.2, -0.2], [3.0, 0.2, -0.2]].map(DVec3::from);
    let fiducial = |corners: [DVec3; 4]| {
        let shape = FeatureShape::Fiducial { corners, covariance: DMat3::ZERO, family: "DICT_4X4_50".into(), code: 1 };
        one(&empty, &camera, placed(1, shape, &[]))
    };
    assert_eq!(fiducial(marker).visible_fraction, 1.0);
    let [a, b, c, d] = marker;
    assert_eq!(reasons(&fiducial([a, d, c, b])), [Reason::FacingAway]);
    // A one-sided wall seen from its back.
    let world = wall(Appearance::Opaque, true);
    let back = Pose::from_xyz_rpy(DVec3::X * 6.0, 0.0, 0.0, std::f64::consts::PI);
    let edge = placed(1, segment([3.0, -0.5, 0.0], [3.0, 0.5, 0.0]), &[0]);
    let seen = predict(&world, &camera, &back, std::slice::from_ref(&edge)).features.remove(0);
    assert_eq!(reasons(&seen), [Reason::FacingAway]);
    assert_eq!(one(&world, &camera, edge).visible_fraction, 1.0);
}

/// A polygon whose warp is nearly as large as the sensor's distance from its plane hides the points beyond it, but its
/// range is undetermined.
#[test]
fn points_behind_a_polygon_of_unknown_range_are_undecided() {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    // 3.5 micrometres below the sensor, with corners alternately raised and lowered by one micrometre.
    let corners =
        [[1.0, -1.0, -2.5e-6], [2.0, -1.0, -4.5e-6], [2.0, 1.0, -2.5e-6], [1.0, 1.0, -4.5e-6]].map(Vec3::from);
    let mesh =
        Mesh::new("shelf", corners.to_vec(), vec![Polygon::new(vec![0, 1, 2, 3], 0)], PolygonOrder::Given).unwrap();
    environment.insert(NewObject::new("shelf", Pose::IDENTITY, Arc::new(mesh))).unwrap();
    let (world, camera) = (World::new(environment), scenes::camera(100, 80));
    let at = |z: f64| one(&world, &camera, placed(1, point([4.0, 0.0, z]), &[]));
    // The ray to this point passes the shelf's plane at x = 1.5.
    let covered = at(-9.3e-6);
    assert_eq!((covered.visible_fraction, reasons(&covered)), (0.0, vec![Reason::Undecided]));
    assert!(covered.hidden[0].by.is_none());
    assert_eq!(at(1e-3).visible_fraction, 1.0, "above the shelf nothing hides the point");
    let images = common::reference(&common::plan(&world, &camera, &Pose::IDENTITY));
    let both = [
        placed(1, point([4.0, 0.0, -9.3e-6]), &[]),
        placed(2, segment([4.0, -0.1, -9.3e-6], [4.0, 0.1, -9.3e-6]), &[]),
    ];
    let seen = predict_features(&world, &camera, &Pose::IDENTITY, &images, &both, &FeatureSettings::default()).unwrap();
    assert!(seen.features.iter().all(|f| reasons(f) == [Reason::Undecided]), "{seen:?}");
    assert!(seen.stats.undecided > 1 && seen.stats.visible == 0, "{:?}", seen.stats);
}

#[test]
fn flat_angles_are_oblique() {
    let mut spec = scenes::camera(100, 80).spec().clone();
    spec.max_incidence = Some(10f64.to_radians());
    let sensor = Sensor::new(spec).unwrap();
    let world = wall(Appearance::Opaque, false);
    let at = |y: f64| one(&world, &sensor, placed(1, point([3.0, y, 0.0]), &[0]));
    assert_eq!(at(0.5).visible_fraction, 1.0);
    assert_eq!(reasons(&at(0.6)), [Reason::Oblique]);
}

#[test]
fn a_single_row_sees_the_part_that_it_crosses() {
    let world = World::new(Environment::new());
    let upright = || placed(1, segment([2.0, 0.3, -1.0], [2.0, 0.3, 1.0]), &[]);
    let seen = one(&world, &row(0.0), upright());
    assert_eq!(seen.visible.len(), 1);
    assert!(seen.visible[0].t.iter().all(|t| (t - 0.5).abs() < 1e-12), "{seen:?}");
    assert_eq!(seen.visible_fraction, 1.0);
    assert_eq!(reasons(&seen), [Reason::OutsideImage, Reason::OutsideImage]);
    let seen = one(&world, &row(10.0), upright());
    let half = 5f64.to_radians().tan() * 2f64.hypot(0.3) / 2.0;
    assert!((seen.visible[0].t[0] - 0.5 + half).abs() < 1e-9 && (seen.visible[0].t[1] - 0.5 - half).abs() < 1e-9);
    assert_eq!(seen.visible_fraction, 1.0);
    // A one-row sensor sees a wall as a line.
    let corners = [[2.0, -1.0, -1.0], [2.0, 1.0, -1.0], [2.0, 1.0, 1.0], [2.0, -1.0, 1.0]].map(DVec3::from).to_vec();
    let patch = placed(1, FeatureShape::Patch { corners, covariance: DMat3::ZERO }, &[]);
    assert_eq!(one(&world, &row(0.0), patch).visible_fraction, 1.0);
    assert_eq!(reasons(&one(&world, &row(0.0), placed(1, point([2.0, 0.0, 0.1]), &[]))), [Reason::OutsideImage]);
}

#[test]
fn the_seam_does_not_cut() {
    let world = World::new(Environment::new());
    for sensor in [scenes::scanner(360, 91), row(0.0)] {
        let across = placed(1, segment([-2.0, -1.0, 0.0], [-2.0, 1.0, 0.0]), &[]);
        let seen = one(&world, &sensor, across);
        assert_eq!((seen.visible.len(), seen.visible[0].t), (1, [0.0, 1.0]), "{seen:?}");
        assert_eq!(seen.visible_fraction, 1.0);
        let marked =
            predict(&world, &sensor, &Pose::IDENTITY, &[placed(5, segment([-2.0, -1.0, 0.0], [-2.0, 1.0, 0.0]), &[])]);
        assert!(marked.feature_id.contains(&5));
    }
}

#[test]
fn points_lie_over_segments_over_patches() {
    let world = wall(Appearance::Opaque, false);
    let camera = scenes::camera(101, 81);
    let corners = [[3.0, -0.5, -0.5], [3.0, -0.5, 0.5], [3.0, 0.5, 0.5], [3.0, 0.5, -0.5]].map(DVec3::from).to_vec();
    let all = [
        placed(1, FeatureShape::Patch { corners, covariance: DMat3::ZERO }, &[0]),
        placed(9, segment([3.0, -0.3, 0.0], [3.0, 0.3, 0.0]), &[0]),
        placed(4, segment([3.0, 0.0, -0.3], [3.0, 0.0, 0.3]), &[0]),
        placed(7, point([3.0, 0.09, 0.0]), &[0]),
    ];
    let ids = predict(&world, &camera, &Pose::IDENTITY, &all).feature_id;
    let at = |c: usize, r: usize| ids[r * 101 + c];
    assert_eq!(at(50, 40), 4, "the lower number of two segments");
    assert_eq!((at(55, 40), at(47, 40), at(55, 45), at(5, 5)), (9, 7, 1, 0));
}

#[test]
fn features_that_cannot_be_placed_are_refused() {
    let world = wall(Appearance::Opaque, false);
    let camera = scenes::camera(20, 10);
    let images = common::reference(&common::plan(&world, &camera, &Pose::IDENTITY));
    let options = FeatureSettings::default();
    let bad = [placed(3, point([3.0, 0.0, 0.0]), &[8])];
    let e = predict_features(&world, &camera, &Pose::IDENTITY, &images, &bad, &options).unwrap_err();
    assert!(e.to_string().contains("feature 3"), "{e}");
    let good = [placed(3, point([3.0, 0.0, 0.0]), &[0])];
    let none = presight_render::plan::Images::default();
    let e = predict_features(&world, &camera, &Pose::IDENTITY, &none, &good, &options).unwrap_err();
    assert!(e.to_string().contains("polygon_id"), "{e}");
    let table = RayTable::new(1, 1, vec![DVec3::X]).unwrap();
    let lone = Sensor::new(SensorSpec::new("lone", "video", Geometry::Rays(table))).unwrap();
    let images = common::reference(&common::plan(&world, &lone, &Pose::IDENTITY));
    let e = predict_features(&world, &lone, &Pose::IDENTITY, &images, &good, &options).unwrap_err();
    assert!(e.to_string().contains("fewer than two rays"), "{e}");
}

/// A predictor computes features on its own number of threads, with the same results.
#[test]
fn a_predictor_predicts_features_on_its_own_threads() {
    use presight_features::{FeatureOptions, Hidden};
    use presight_predict::predict::{Backend, Options, Predictor};
    use presight_predict::request::Request;
    let (world, camera) = (wall(Appearance::Opaque, false), scenes::camera(101, 81));
    let features = [placed(3, point([3.0, 0.0, 0.0]), &[0]), placed(4, point([4.0, 0.1, 0.0]), &[])];
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(3)).unwrap();
    assert_eq!(predictor.on_threads(rayon::current_num_threads).unwrap(), 3);
    let seen = predictor.predict(&world, &camera, &SensorPose::IDENTITY, &Request::default()).unwrap();
    assert!(!seen.stats.stages_ms.iter().any(|(stage, _)| stage.name().contains("feature")), "unrequested features");
    let request = Request::default()
        .with_features(FeatureOptions::default().with_hidden(Hidden::Full).with_placed(features.to_vec()));
    let found = predictor.predict(&world, &camera, &SensorPose::IDENTITY, &request).unwrap();
    let options = FeatureSettings::default();
    let again = predict_features(&world, &camera, &Pose::IDENTITY, &seen.images, &features, &options).unwrap();
    assert_eq!(found.features, Some(again));
    assert!(found.stats.stages_ms.iter().any(|(stage, _)| *stage == StageName::Features));
    assert!(found.stats.counts.contains(&(CountName::FeatureSamples, 2)), "{:?}", found.stats.counts);
}

/// Finer sampling is more accurate. Invalid steps and steps over half a pixel are refused.
#[test]
fn the_sampling_step_is_limited() {
    let (world, sensor) = (wall(Appearance::Opaque, false), scenes::camera(64, 48));
    let images = common::reference(&common::plan(&world, &sensor, &Pose::IDENTITY));
    // The segment starts behind the wall and ends beyond its edge at y = 1, so only its end is visible.
    let across = [placed(1, segment([6.0, 1.0, 0.1], [6.0, 2.5, 0.1]), &[])];
    let seen = |step: f64| {
        let options = FeatureSettings { step, ..FeatureSettings::default() };
        predict_features(&world, &sensor, &Pose::IDENTITY, &images, &across, &options)
    };
    // The ray at y / x = 1 / 3 passes the edge and meets the segment at y = 2: 1 of 1.5 m is hidden.
    let off = |step: f64| (seen(step).unwrap().features[0].visible[0].t[0] - 2.0 / 3.0).abs();
    assert!(off(0.001) < 1e-3 && off(0.5) < 0.1, "{} {}", off(0.001), off(0.5));
    assert!(seen(0.001).unwrap().stats.samples > 400 * seen(0.5).unwrap().stats.samples);
    for step in [0.0, -1.0, 0.000_9, 0.500_1, f64::NAN, f64::INFINITY] {
        let e = seen(step).unwrap_err();
        assert!(e.kind() == ErrorKind::Usage && e.to_string().contains("0.001 to 0.5"), "{step}: {e}");
    }
}
