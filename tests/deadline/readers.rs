//! The consumers of predictions take account of omitted samples.

use crate::common::scenes::{camera, cuboid, empty, scanner};
use glam::{DMat3, DVec3, Vec3};
use presight_features::{FeatureSettings, PlacedFeature, Reason, predict_features};
use presight_model::environment::NewObject;
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Prediction, Predictor};
use presight_predict::request::Request;
use presight_predict::virtual_sensors::{Answer, FreeFloor, Nearest, Settings, View, VirtualSensor};
use presight_render::deadline::{DeadlineOutcome, Degradation};
use std::sync::Arc;

/// A pillar from 2 m to 2.4 m ahead in a room with walls at 4 m; the floor is at 0 and the sensor 1 m above it.
fn world() -> World {
    let mut environment = empty();
    for (name, mesh) in [
        ("room", cuboid(Vec3::new(-4.0, -4.0, 0.0), Vec3::new(4.0, 4.0, 3.0))),
        ("pillar", cuboid(Vec3::new(2.0, -0.2, 0.0), Vec3::new(2.4, 0.2, 3.0))),
    ] {
        environment.insert(NewObject::new(name, Pose::IDENTITY, Arc::new(mesh))).unwrap();
    }
    World::new(environment)
}

fn pose(pitch: f64) -> Pose {
    Pose::from_xyz_rpy(DVec3::Z, 0.0, pitch, 0.0)
}

fn of_class(sensor: &Sensor, class: &str) -> Sensor {
    let mut spec = sensor.spec().clone();
    spec.class = class.into();
    Sensor::new(spec).unwrap()
}

fn full(world: &World, sensor: &Sensor, pose: &Pose) -> Prediction {
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    predictor.predict(world, sensor, &SensorPose::new(*pose), &Request::default()).unwrap()
}

/// Makes the prediction look as if nothing beyond a range had been rendered.
fn given_up_beyond(mut prediction: Prediction, complete_to: f64) -> Prediction {
    let mut samples = 0;
    let images = &mut prediction.images;
    for at in 0..images.range.len() {
        if f64::from(images.range[at]) >= complete_to {
            (images.range[at], images.cos_incidence[at]) = (f32::NAN, f32::NAN);
            (images.polygon_id[at], images.object_id[at]) = (0, 0);
            samples += 1;
        }
    }
    let given_up = Some(Degradation { complete_to, samples, ..Degradation::default() });
    prediction.stats.deadline = Some(DeadlineOutcome { given_up, ..DeadlineOutcome::default() });
    prediction
}

fn nearest(world: &World, prediction: &Prediction) -> (Nearest, String) {
    let view = View::of(prediction, world.environment());
    let reading = VirtualSensor::RadarNearest.reduce(&view, &Settings::default()).unwrap();
    let summary = reading.summary();
    match reading.answer {
        Answer::RadarNearest(nearest) => (nearest, summary),
        other => panic!("{other:?}"),
    }
}

#[test]
fn nothing_is_reported_free_beyond_the_complete_range() {
    let (world, radar) = (world(), of_class(&scanner(720, 1), "radar"));
    let all = full(&world, &radar, &pose(0.0));
    // The pillar is straight ahead, in column 360; the nearest wall is 4 m away, to the left and elsewhere.
    let (seen, _) = nearest(&world, &given_up_beyond(all.clone(), 3.0));
    let pillar = seen.nearest.unwrap();
    assert_eq!((pillar.range, pillar.object.as_str(), seen.complete_to), (2.0, "pillar", Some(3.0)));
    assert_eq!(seen.directions.range[360], 2.0);
    assert!(seen.directions.range[540].is_nan(), "an object is possible there");

    let partial = given_up_beyond(all.clone(), 1.5);
    let (seen, summary) = nearest(&world, &partial);
    assert_eq!((seen.nearest, seen.complete_to), (None, Some(1.5)));
    assert_eq!(summary, "radar-nearest: none up to 1.500 m");
    assert!(seen.directions.range.iter().all(|range| range.is_nan()));

    // Without the note that samples were given up, the result is the wrong answer.
    let mut untold = partial;
    untold.stats = Default::default();
    assert_eq!(nearest(&world, &untold).1, "radar-nearest: nothing is seen");
    // A hit beyond `complete_to` is not the nearest one: an omitted object may be nearer.
    let mut holes = given_up_beyond(all, 3.0);
    let given_up = holes.stats.deadline.as_mut().unwrap().given_up.as_mut().unwrap();
    given_up.complete_to = 1.8;
    assert_eq!(nearest(&world, &holes).0.nearest, None);
}

#[test]
fn floor_that_was_not_predicted_is_not_free() {
    let (world, camera) = (world(), camera(96, 64));
    let all = full(&world, &camera, &pose(0.5));
    let floor = |prediction: &Prediction| -> FreeFloor {
        let view = View::of(prediction, world.environment());
        let settings = Settings { floor_z_world: Some(0.0), ..Settings::default() };
        match VirtualSensor::FreeFloor.reduce(&view, &settings).unwrap().answer {
            Answer::FreeFloor(floor) => floor,
            other => panic!("{other:?}"),
        }
    };
    let (whole, partial) = (floor(&all), given_up_beyond(all, 1.9));
    let part = floor(&partial);
    assert!(part.pixels > 100 && part.pixels < whole.pixels, "{} of {}", part.pixels, whole.pixels);
    let open = partial.not_predicted();
    assert!(open.contains(&true) && part.mask.pixels.iter().zip(&open).all(|(free, open)| !(*free && *open)));
}

/// The wall ahead as one patch: where its pixels were given up, it must not count as seen.
#[test]
fn patches_are_not_seen_where_pixels_were_given_up() {
    let mut environment = empty();
    let wall = cuboid(Vec3::new(3.0, -8.0, -8.0), Vec3::new(3.1, 8.0, 8.0));
    environment.insert(NewObject::new("wall", Pose::IDENTITY, Arc::new(wall))).unwrap();
    let (world, camera) = (World::new(environment), camera(96, 64));
    let corners = [[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]].map(|[y, z]| DVec3::new(2.9, y, z));
    let shape = FeatureShape::Patch { corners: corners.to_vec(), covariance: DMat3::ZERO };
    let (existence, properties) = (Existence::default(), Properties::default());
    let feature = Feature { id: 1, name: None, object: None, shape, existence, properties };
    let placed = [PlacedFeature { feature: feature.into(), object: None, slots: vec![] }];
    let mut prediction = full(&world, &camera, &Pose::IDENTITY);
    let seen = |prediction: &Prediction, is_partial| {
        let options = FeatureSettings { is_partial, ..FeatureSettings::default() };
        let found = predict_features(&world, &camera, &Pose::IDENTITY, &prediction.images, &placed, &options).unwrap();
        found.features.into_iter().next().unwrap()
    };
    assert_eq!(seen(&prediction, false).visible_fraction, 1.0);
    // The right half of the image.
    for at in (0..prediction.images.range.len()).filter(|at| at % 96 >= 48) {
        let images = &mut prediction.images;
        (images.range[at], images.cos_incidence[at]) = (f32::NAN, f32::NAN);
        (images.polygon_id[at], images.object_id[at]) = (0, 0);
    }
    let half = seen(&prediction, true);
    assert!((half.visible_fraction - 0.5).abs() < 0.02, "{}", half.visible_fraction);
    assert_eq!(half.hidden.iter().map(|h| h.reason).collect::<Vec<_>>(), [Reason::NotPredicted]);
    assert_eq!(seen(&prediction, false).visible_fraction, 1.0, "without the note the answer must be wrong");
}
