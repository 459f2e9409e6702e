//! Compares contours with silhouettes calculated by hand, and with depths and normals along rays.

use presight_testkit as common;
pub mod bodies;
mod boxes;
mod layers;
mod picture;
mod plant;
mod truth;

use bodies::{ball, prism, sheet};
use common::scenes;
use glam::{DMat3, DVec2, DVec3};
use presight_features::{
    FeatureOptions, FeaturePrediction, Hidden, PlacedFeature, Reason, SeenFeature, Visibility, place,
};
use presight_model::environment::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
use presight_model::environment::{Mesh, NewObject};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Angles, Camera, Distortion, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::plan::{Output, Outputs};

fn pinhole() -> Sensor {
    let camera = Camera::pinhole(640, 480, 500.0, 500.0, 319.5, 239.5);
    Sensor::new(SensorSpec::new("pinhole", "video", Geometry::Camera(camera))).unwrap()
}

fn lens() -> Sensor {
    let distortion = Distortion::PlumbBob([-0.2, 0.05, 1e-3, 0.0, 0.0]);
    let camera = Camera { distortion, ..Camera::pinhole(640, 480, 500.0, 500.0, 319.5, 239.5) };
    Sensor::new(SensorSpec::new("lens", "video", Geometry::Camera(camera))).unwrap()
}

/// A sensor with a full circle; its seam is behind.
fn around() -> Sensor {
    let uniform = |start_deg, step_deg, count| Angles::Uniform { start_deg, step_deg, count };
    let (azimuth, elevation) = (uniform(-180.0, 0.25, 1440), uniform(-30.0, 0.5, 121));
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    Sensor::new(SensorSpec::new("around", "video", Geometry::Scanner(scanner))).unwrap()
}

fn world(objects: Vec<(&str, DVec3, Mesh)>) -> World {
    let mut environment = scenes::empty();
    for (name, at, mesh) in objects {
        environment.insert(NewObject::new(name, Pose { translation: at, ..Pose::IDENTITY }, mesh.into())).unwrap();
    }
    World::new(environment)
}

fn contour(id: u32, object: &str, anchor: DVec3) -> Feature {
    let shape = FeatureShape::Contour { anchor, crease_deg: 30.0, covariance: DMat3::ZERO };
    let (existence, properties) = (Existence::default(), Properties::default());
    Feature { id, name: None, object: Some(object.into()), shape, existence, properties }
}

fn layer(features: Vec<Feature>) -> FeatureLayer {
    FeatureLayer {
        class: "video".into(),
        tolerance: 1e-3,
        features: features.into_iter().map(Into::into).collect(),
        pose_covariances: Vec::new(),
    }
}

fn see_with(
    world: &World,
    sensor: &Sensor,
    pose: &Pose,
    placed: &[PlacedFeature],
    hidden: Hidden,
) -> FeaturePrediction {
    let options = FeatureOptions::default().with_placed(placed.to_vec()).with_hidden(hidden);
    let outputs = Outputs::of(&[Output::PolygonId, Output::FeatureId]);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let seen = predictor
        .predict(world, sensor, &SensorPose::new(*pose), &Request::of(outputs).with_features(options))
        .unwrap();
    let mut features = seen.features.unwrap();
    features.spell_out(world.environment(), placed);
    FeaturePrediction { feature_id: seen.images.feature_id, ..features }
}

fn see(world: &World, sensor: &Sensor, pose: &Pose, features: Vec<Feature>) -> FeaturePrediction {
    let placed = place(world, &layer(features)).unwrap();
    let all = see_with(world, sensor, pose, &placed, Hidden::Full);
    // In counting mode the result is the same except for hidden features.
    let counted = see_with(world, sensor, pose, &placed, Hidden::Count);
    let some: Vec<&SeenFeature> = all.features.iter().filter(|f| !f.visible.is_empty()).collect();
    assert_eq!(counted.features.iter().collect::<Vec<_>>(), some);
    assert_eq!(counted.feature_id, all.feature_id);
    all
}

fn side_of(radius: f64) -> DVec3 {
    // The centre of the first of 24 sides.
    let middle = 0.5 * std::f64::consts::TAU / 24.0;
    DVec3::new(middle.cos(), middle.sin(), 0.0) * (radius * middle.cos()) + DVec3::Z
}

/// An upright prism of 24 sides, radius 0.3 m, axis 4 m ahead. A side whose normal has the azimuth a faces the sensor
/// if -4 cos a > 0.3 cos 7.5 deg, a > 94.3 deg: the sides with normals from 97.5 deg on. So front and back meet at the
/// corners at 90 and 270 deg: 4 m ahead, 0.3 m to both sides. With f = 500 that is 37.5 pixels to both sides of the
/// centre.
#[test]
fn the_silhouette_of_a_prism_equals_the_calculation_by_hand() {
    let world = world(vec![("post", DVec3::new(4.0, 0.0, -1.0), prism(24, 0.3, 2.0, true))]);
    let placed = place(&world, &layer(vec![contour(7, "post", side_of(0.3))])).unwrap();
    assert_eq!(placed[0].slots.len(), 24, "the sides without the ends");
    let seen = see(&world, &pinhole(), &Pose::IDENTITY, vec![contour(7, "post", side_of(0.3))]);
    // The rims are not segments of this layer: four points where three edges meet, two lines, and two arcs twice.
    let lines: Vec<&SeenFeature> = seen.features.iter().filter(|f| f.points_world.len() == 2).collect();
    assert_eq!((lines.len(), seen.features.len()), (2, 6));
    for (line, u) in lines.iter().zip([282.0, 357.0]) {
        let mut ends = line.points_world.clone();
        ends.sort_by(|a, b| a.z.total_cmp(&b.z));
        let y = if u < 300.0 { 0.3 } else { -0.3 };
        for (end, z) in ends.iter().zip([-1.0, 1.0]) {
            assert!(end.distance(DVec3::new(4.0, y, z)) < 1e-6, "{end}");
        }
        assert_eq!((line.visible_fraction, line.visible.len(), line.hidden.len()), (1.0, 1, 0));
        let [a, b] = line.visible[0].pixels;
        // 1 m up and down at 4 m: 125 pixels to both sides of the centre.
        let (a, b) = if a.y < b.y { (a, b) } else { (b, a) };
        assert!(a.distance(DVec2::new(u, 114.5)) < 1e-3 && b.distance(DVec2::new(u, 364.5)) < 1e-3, "{a} {b}");
        assert!((line.range.unwrap() - 4f64.hypot(0.3)).abs() < 1e-3);
    }
    // The longest come first, and the post itself hides the arcs at the back.
    let branches: Vec<Option<u32>> = seen.features.iter().map(|f| f.branch).collect();
    assert_eq!(branches, (0..6).map(Some).collect::<Vec<_>>());
    assert!(seen.features.iter().all(|f| f.feature.id == 7));
    let hidden = seen.features.iter().filter(|f| f.visible.is_empty()).count();
    assert_eq!(hidden, 2);
    assert_eq!(seen.features.iter().filter(|f| f.visible_fraction == 1.0).count(), 4);
}

/// In a layer with the rims as segments two contour lines remain, and the feature image shows segments over contours.
#[test]
fn edges_that_are_segments_are_not_contours() {
    let post = prism(24, 0.3, 2.0, true);
    let world = world(vec![("post", DVec3::new(4.0, 0.0, -1.0), post)]);
    let options = presight_features::generate::GenerateOptions::default();
    let made = presight_features::generate::generate(world.environment(), "video", &options).unwrap();
    let placed = place(&world, &made.layer).unwrap();
    let seen = see_with(&world, &pinhole(), &Pose::IDENTITY, &placed, Hidden::Full);
    let curves: Vec<&SeenFeature> = seen.features.iter().filter(|f| f.branch.is_some()).collect();
    assert_eq!(curves.iter().map(|c| c.points_world.len()).collect::<Vec<_>>(), [2, 2]);
    assert_eq!(seen.features.len(), made.layer.features.len() + 1);
    let id = curves[0].feature.id;
    assert_eq!(id, made.layer.features.last().unwrap().id, "contours are numbered last");
    // The whole post is in front of patches, and contours cover these.
    assert!(seen.feature_id.iter().filter(|i| **i == id).count() > 450, "two lines of 250 pixels");
    let at = |u: usize, v: usize| seen.feature_id[v * 640 + u];
    assert_eq!((at(282, 240), at(357, 240)), (id, id));
    assert_ne!(at(320, 240), id);
}

/// A ball of radius 0.5 m, 4 m ahead, has one closed curve. Its corners lie on the ball and its chords are no deeper
/// than the facets: 48 x 24 facets of 7.5 degrees. Points of the silhouette are within half a facet's angle of the true
/// one.
#[test]
fn a_ball_has_a_closed_contour() {
    let anchor = |mesh: &Mesh| mesh.corners_of(60).sum::<DVec3>() / mesh.corners_of(60).len() as f64;
    for (sensor, at) in [
        (pinhole(), DVec3::new(4.0, 0.2, 0.1)),
        (lens(), DVec3::new(4.0, 0.2, 0.1)),
        (around(), DVec3::new(4.0, 0.2, 0.1)),
        (around(), DVec3::new(-4.0, 0.02, 0.1)),
    ] {
        let mesh = ball(48, 24, 0.5);
        let anchor = anchor(&mesh);
        let world = world(vec![("ball", at, mesh)]);
        let seen = see(&world, &sensor, &Pose::IDENTITY, vec![contour(3, "ball", anchor)]);
        assert_eq!(seen.features.len(), 1);
        let curve = &seen.features[0];
        assert_eq!(curve.points_world[0], *curve.points_world.last().unwrap(), "closed");
        assert_eq!((curve.visible_fraction, curve.branch), (1.0, Some(0)));
        assert_eq!((curve.visible.len(), curve.visible[0].t), (1, [0.0, 1.0]));
        let half = (0.5 / at.length()).asin();
        for p in &curve.points_world {
            assert!((p.distance(at) - 0.5).abs() < 1e-6);
            let off = p.angle_between(at) - half;
            // A facet further along, the chord is deeper by at most 1 - cos 7.5 deg.
            assert!(off < 1e-9 && off > -0.5 * (1.0 - 7.5f64.to_radians().cos()) / (at.length() - 0.5), "{off}");
        }
        let inside = at + DVec3::new(0.1, 0.0, 0.0);
        let pose = Pose { translation: inside, ..Pose::IDENTITY };
        assert!(see(&world, &sensor, &pose, vec![contour(3, "ball", anchor)]).features.is_empty(), "seen from inside");
    }
}

/// A wall half way hides the lower half of a post's silhouettes and is named as the occluder.
#[test]
fn walls_hide_contours_and_their_own_facets_do_not() {
    let wall = sheet([[2.0, -2.0, -2.0], [2.0, 2.0, -2.0], [2.0, 2.0, 0.0], [2.0, -2.0, 0.0]]);
    let post = prism(24, 0.3, 2.0, true);
    let world = world(vec![("post", DVec3::new(4.0, 0.0, -1.0), post), ("wall", DVec3::ZERO, wall)]);
    for sensor in [pinhole(), lens(), around()] {
        let seen = see(&world, &sensor, &Pose::IDENTITY, vec![contour(7, "post", side_of(0.3))]);
        for line in seen.features.iter().filter(|f| f.points_world.len() == 2) {
            assert!((line.visible_fraction - 0.5).abs() < 0.01, "{}", line.visible_fraction);
            assert_eq!((line.visible.len(), line.hidden.len()), (1, 1));
            assert_eq!((line.hidden[0].reason, line.hidden[0].by.unwrap().object), (Reason::Occluded, 1));
        }
    }
}

/// A pipe along x next to the camera continues behind it.
#[test]
fn contours_behind_the_camera_are_cut_off() {
    let pipe = bodies::turned(&prism(24, 0.1, 20.0, false), glam::DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2));
    let anchor = pipe.corners_of(0).sum::<DVec3>() / 4.0;
    let world = world(vec![("pipe", DVec3::new(-10.0, 1.0, 0.0), pipe)]);
    let seen = see(&world, &pinhole(), &Pose::IDENTITY, vec![contour(1, "pipe", anchor)]);
    let lines: Vec<&SeenFeature> = seen.features.iter().filter(|f| f.points_world.len() == 2).collect();
    assert_eq!(lines.len(), 2);
    for line in lines {
        let reasons: Vec<Reason> = line.hidden.iter().map(|h| h.reason).collect();
        assert!(reasons.contains(&Reason::BehindSensor) && reasons.contains(&Reason::OutsideImage), "{reasons:?}");
        let behind = line.hidden.iter().find(|h| h.reason == Reason::BehindSensor).unwrap();
        assert!((behind.t[1] - behind.t[0] - 0.5).abs() < 1e-3, "{behind:?}");
        assert!(line.visible_fraction > 0.99);
    }
    let all = see(&world, &around(), &Pose::IDENTITY, vec![contour(1, "pipe", anchor)]);
    assert!(all.features.iter().filter(|f| f.points_world.len() == 2).all(|f| f.visible_fraction > 0.99));
}

/// Checks every sample of every curve by a ray of its own.
#[test]
fn images_only_save_time() {
    let world = plant::plant(3);
    let options = presight_features::generate::GenerateOptions::default();
    let made = presight_features::generate::generate(world.environment(), "video", &options).unwrap();
    let mut layer = made.layer;
    layer.features.retain(|f| f.shape.kind() == "contour");
    let placed = place(&world, &layer).unwrap();
    for pose in presight_predict::free_poses::free_poses(&world, 1, 5).unwrap() {
        for sensor in [scenes::camera(160, 120), scenes::lens(160, 120), scenes::scanner(180, 31)] {
            let outputs = Outputs::of(&[Output::PolygonId]);
            let by = |visibility| {
                let options = FeatureOptions::default().with_placed(placed.clone()).with_hidden(Hidden::Full);
                let options = options.with_visibility(visibility);
                let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
                let request = Request::of(outputs).with_features(options);
                predictor.predict(&world, &sensor, &SensorPose::new(pose), &request).unwrap().features.unwrap().features
            };
            let (images, rays) = (by(Visibility::Image), by(Visibility::Rays));
            assert!(images.iter().filter(|f| !f.visible.is_empty()).count() > 10);
            let off = images.iter().zip(&rays).map(|(a, b)| (a.visible_fraction - b.visible_fraction).abs());
            let wrong = off.filter(|off| *off > 1e-9).count();
            assert_eq!(wrong, 0, "of {}", images.len());
        }
    }
}
