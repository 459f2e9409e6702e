//! Virtual sensors: known results on small scenes, properties on generated ones, and planted faults.

use presight_testkit as common;

mod docking;
mod free_floor;
mod laser;
mod radar;

use common::scenes;
use glam::{DMat3, DVec3, Vec3};
use presight_features::{FeaturePrediction, FeatureSettings, PlacedFeature, predict_features};
use presight_model::environment::{Environment, NewObject};
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::error::ErrorKind;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Angles, Camera, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Prediction, Predictor};
use presight_predict::request::Request;
use presight_predict::virtual_sensors::{Answer, Settings, View, VirtualSensor};
use presight_render::plan::Outputs;

/// A world of named meshes at their own coordinates.
fn world(objects: Vec<(&str, presight_model::environment::Mesh)>) -> World {
    let mut environment = scenes::empty();
    for (name, mesh) in objects {
        environment.insert(NewObject::new(name, Pose::IDENTITY, mesh.into())).unwrap();
    }
    World::new(environment)
}

/// One polygon.
fn quad(corners: [[f32; 3]; 4]) -> presight_model::environment::Mesh {
    scenes::mesh(&[corners.map(Vec3::from).to_vec()])
}

/// A box; differences of 0.1 mm do not matter in f32.
fn cuboid(least: [f32; 3], most: [f32; 3]) -> presight_model::environment::Mesh {
    scenes::cuboid(least.into(), most.into())
}

fn uniform(start_deg: f64, step_deg: f64, count: u32) -> Angles {
    Angles::Uniform { start_deg, step_deg, count }
}

fn scanner(class: &str, azimuth: Angles, elevation: Angles) -> SensorSpec {
    SensorSpec::new("scanner", class, Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None }))
}

fn camera(class: &str, width: u32, height: u32, f: f64) -> SensorSpec {
    let (cx, cy) = (0.5 * f64::from(width - 1), 0.5 * f64::from(height - 1));
    SensorSpec::new("camera", class, Geometry::Camera(Camera::pinhole(width, height, f, f, cx, cy)))
}

fn predict(world: &World, sensor: &Sensor, pose: &Pose) -> Prediction {
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    predictor.predict(world, sensor, &SensorPose::new(*pose), &Request::of(Outputs::default())).unwrap()
}

/// Predicts and reduces.
fn answer(v: VirtualSensor, world: &World, sensor: &Sensor, pose: &Pose, settings: &Settings) -> Answer {
    let prediction = predict(world, sensor, pose);
    of(v, world.environment(), &prediction, None, settings)
}

fn of(
    v: VirtualSensor,
    environment: &Environment,
    prediction: &Prediction,
    features: Option<&FeaturePrediction>,
    settings: &Settings,
) -> Answer {
    let view = View::of(prediction, environment);
    let reading = v.reduce(&features.map_or(view, |f| view.with_features(f)), settings).unwrap();
    assert_eq!(reading.name, v.name());
    assert!(!reading.summary().is_empty());
    serde_json::to_string(&reading).unwrap();
    reading.answer
}

fn feature(id: u32, shape: FeatureShape) -> Feature {
    Feature {
        id,
        name: Some(format!("mark {id}")),
        object: None,
        shape,
        existence: Existence::default(),
        properties: Properties::default(),
    }
}

fn reflector(id: u32, at: DVec3) -> Feature {
    feature(id, FeatureShape::Reflector { at, covariance: DMat3::ZERO })
}

/// The visibility of features that lie on no polygon.
fn seen(world: &World, prediction: &Prediction, features: Vec<Feature>) -> FeaturePrediction {
    let placed: Vec<PlacedFeature> = features
        .into_iter()
        .map(|feature| PlacedFeature { feature: feature.into(), object: None, slots: Vec::new() })
        .collect();
    let (sensor, pose) = (&prediction.sensor, &prediction.pose.world_from_sensor());
    predict_features(world, sensor, pose, &prediction.images, &placed, &FeatureSettings::default()).unwrap()
}

#[test]
fn other_sensors_are_refused_with_a_remedy() {
    let with_noise = |mut spec: SensorSpec| {
        (spec.noise.range_sigma, spec.noise.angle_sigma, spec.noise.pixel_sigma) = (0.01, 0.001, 0.5);
        Sensor::new(spec).unwrap()
    };
    let flat = || uniform(0.0, 0.0, 1);
    let sensors = [
        with_noise(camera("video", 8, 6, 6.0)),
        with_noise(scanner("radar", uniform(-180.0, 5.0, 72), flat())),
        with_noise(scanner("laser", uniform(-30.0, 5.0, 12), uniform(-20.0, 4.0, 10))),
    ];
    for v in VirtualSensor::ALL {
        assert_eq!(v.name().parse::<VirtualSensor>().unwrap(), v);
        for sensor in &sensors {
            let right = sensor.spec().class == v.class();
            match v.check(sensor) {
                Ok(()) => assert!(right, "{} of {}", v.name(), sensor.spec().class),
                Err(e) => {
                    assert!(!right, "{e}");
                    assert!(e.kind() == ErrorKind::Usage && e.remedy().contains(v.class()), "{e}");
                }
            }
        }
    }
    assert_eq!("walls".parse::<VirtualSensor>().unwrap_err().kind(), ErrorKind::Usage);
    // The right class alone is not enough.
    let wrong = [
        (VirtualSensor::FreeFloor, with_noise(scanner("video", uniform(0.0, 5.0, 9), flat()))),
        (VirtualSensor::RadarLines, with_noise(scanner("radar", uniform(0.0, 5.0, 9), uniform(-1.0, 2.0, 2)))),
        (VirtualSensor::RadarNearest, with_noise(camera("radar", 8, 6, 6.0))),
        (VirtualSensor::Docking, Sensor::new(camera("laser", 8, 6, 6.0)).unwrap()),
    ];
    for (v, sensor) in wrong {
        let e = v.check(&sensor).unwrap_err();
        assert!(e.kind() == ErrorKind::Usage && !e.remedy().is_empty(), "{e}");
    }
}

#[test]
fn missing_inputs_are_named() {
    let world = world(vec![("room", cuboid([-2.0; 3], [2.0; 3]))]);
    let mut spec = camera("video", 8, 6, 6.0);
    spec.mount = Pose::from_xyz_rpy(DVec3::Z, 0.0, 0.3, 0.0);
    let sensor = Sensor::new(spec).unwrap();
    let mut prediction = predict(&world, &sensor, &Pose::IDENTITY);
    let reduce = |v: VirtualSensor, prediction: &Prediction| {
        v.reduce(&View::of(prediction, world.environment()), &Settings::default()).unwrap_err()
    };
    let e = reduce(VirtualSensor::Edges, &prediction);
    assert!(e.kind() == ErrorKind::Usage && e.remedy().contains("`View::features`"), "{e}");
    prediction.images.object_id.clear();
    let e = reduce(VirtualSensor::FreeFloor, &prediction);
    assert!(e.kind() == ErrorKind::Invalid && e.to_string().contains("object_id"), "{e}");
    prediction.images.object_id = vec![1; 7];
    assert_eq!(reduce(VirtualSensor::FreeFloor, &prediction).kind(), ErrorKind::Invalid);
}

#[test]
fn visible_segments_are_edges() {
    // A post in front of the middle of the far edge.
    let world = world(vec![("post", cuboid([1.9, -0.1, -1.0], [2.0, 0.1, 1.0]))]);
    let sensor = Sensor::new(camera("video", 64, 48, 40.0)).unwrap();
    let prediction = predict(&world, &sensor, &Pose::IDENTITY);
    let segment = |ends: [DVec3; 2]| FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
    let ends = [DVec3::new(4.0, -1.0, 0.2), DVec3::new(4.0, 1.0, 0.2)];
    let behind = [DVec3::new(4.0, -0.05, 0.0), DVec3::new(4.0, 0.05, 0.0)];
    let features = seen(
        &world,
        &prediction,
        vec![feature(7, segment(ends)), feature(8, segment(behind)), reflector(9, DVec3::new(3.0, -0.8, 0.0))],
    );
    let Answer::Edges(found) =
        of(VirtualSensor::Edges, world.environment(), &prediction, Some(&features), &Settings::default())
    else {
        panic!("no edges");
    };
    assert_eq!((found.segments, found.edges.len()), (2, 1));
    let edge = &found.edges[0];
    assert_eq!((edge.id, edge.name.as_deref(), edge.visible.len()), (7, Some("mark 7"), 2));
    // The post's front face, 1.9 m away and 0.2 m wide, hides 0.2 * 4 / 1.9 m of it.
    let hidden = 0.2 * 4.0 / 1.9;
    let pixel = 4.0 / 40.0;
    let length = |p: &presight_predict::virtual_sensors::EdgePiece| p.ends_world[1][1] - p.ends_world[0][1];
    let shown: f64 = edge.visible.iter().map(length).sum();
    assert!((shown - (2.0 - hidden)).abs() < pixel, "{shown}");
    assert!((edge.visible_fraction - shown / 2.0).abs() < 0.03);
    for piece in &edge.visible {
        for (p, pixel) in piece.ends_world.iter().zip(&piece.pixels) {
            let (u, v) = sensor.project(DVec3::new(-p[1], -p[2], p[0])).unwrap();
            assert!((u - pixel[0]).hypot(v - pixel[1]) < 1e-6, "{pixel:?} {u} {v}");
        }
    }
}
