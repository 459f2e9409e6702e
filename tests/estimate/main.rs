//! Poses from frames: truths calculated by hand, simulated rooms, real depth images, and cases without a determined
//! pose.

mod beside;
mod changed;
mod drives;
mod edges;
#[cfg(feature = "fiducials")]
mod fiducials;
mod fused;
mod hall;
mod livingroom;
mod malaga;
mod misled;
mod noise;
mod objects;
mod reflectors;
mod rooms;
mod scans;
mod search;
mod simulated;
mod singular;
mod street;
mod turning;
mod verdicts;
mod willow;

use glam::{DVec3, Vec3};
use presight_features::PlacedFeatures;
use presight_localize::estimate::{EstimateOptions, Estimator, moved};
use presight_localize::localize::{LocalizeOptions, Localizer, Step};
use presight_localize::simulate::GreySimulator;
use presight_model::environment::{Environment, Material, Mesh, NewObject};
use presight_model::geometry::{Pose, PoseEstimate, RobotPose, SensorPose};
use presight_model::measured::{Frame, Measurement};
use presight_model::sensor::{Angles, Camera, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::statistics::normal_pair;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_testkit::Random;
use std::sync::Arc;

/// Adds a box between two corners as an object of its own.
pub fn add_box(environment: &mut Environment, name: &str, least: Vec3, most: Vec3) {
    let mesh = Mesh::cuboid(name, least, most, 0).unwrap();
    environment.insert(NewObject::new(name, Pose::IDENTITY, Arc::new(mesh))).unwrap();
}

/// A room of 6 x 4 x 2.6 m made unique by a table, a shelf and a pillar; `shift` moves all of these.
pub fn room(shift: Vec3) -> World {
    room_up_to(4.0, shift)
}

/// The same room with its last wall at y.
pub fn room_up_to(y: f32, shift: Vec3) -> World {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    add_box(&mut environment, "room", Vec3::ZERO, Vec3::new(6.0, y, 2.6));
    for (name, least, most) in [
        ("table", [2.0, 0.8, 0.0], [3.2, 1.6, 0.75]),
        ("shelf", [4.6, 3.4, 0.0], [5.9, 4.0, 1.9]),
        ("pillar", [3.6, 2.5, 0.0], [3.9, 2.8, 2.6]),
        ("crate", [5.2, 0.0, 0.0], [6.0, 0.7, 0.6]),
    ] {
        add_box(&mut environment, name, Vec3::from(least) + shift, Vec3::from(most) + shift);
    }
    World::new(environment)
}

/// A laser range camera of 80 x 60 pixels, 60 degrees wide, with this noise.
pub fn camera(range_sigma: f64) -> Sensor {
    let camera = Camera::pinhole(80, 60, 70.0, 70.0, 39.5, 29.5);
    let mut spec = SensorSpec::new("range camera", "laser", Geometry::Camera(camera));
    spec.noise.range_sigma = range_sigma;
    Sensor::new(spec).unwrap()
}

/// A level scanner of one row, 360 beams.
pub fn scanner(range_sigma: f64) -> Sensor {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 1.0, count: 360 };
    let elevation = Angles::Listed(vec![0.0]);
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    let mut spec = SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner));
    spec.noise.range_sigma = range_sigma;
    Sensor::new(spec).unwrap()
}

/// A predictor on two threads.
pub fn predictor() -> Predictor {
    Predictor::new(Options::new(Backend::Cpu).with_threads(2)).unwrap()
}

/// An estimator on two threads.
pub fn estimator(options: EstimateOptions) -> Estimator {
    Estimator::new(predictor(), options)
}

/// A random number with mean 0 and variance 1.
pub fn normal(random: &mut Random) -> f64 {
    let [x, y] = [random.unit(), random.unit()];
    normal_pair(x.max(1e-300), y, 1.0)[0]
}

/// A unit vector of random direction.
pub fn direction(random: &mut Random) -> DVec3 {
    DVec3::new(normal(random), normal(random), normal(random)).normalize()
}

/// Simulates the measurement of a sensor at the robot's origin, with the sensor's stated noise.
pub fn sense(world: &World, sensor: &Sensor, pose: &Pose, random: &mut Random) -> Frame {
    let seen = predictor().predict(world, sensor, &SensorPose::new(*pose), &Request::default()).unwrap();
    let sigma = sensor.spec().noise.range_sigma;
    let noisy = |r: &f32| (f64::from(*r) + sigma * normal(random)) as f32;
    Frame::new(0.0, sensor.clone(), Measurement::Range(seen.images.range.iter().map(noisy).collect())).unwrap()
}

/// A pose moved by this distance and angle in a random direction.
pub fn off_by(pose: &Pose, metres: f64, degrees: f64, random: &mut Random) -> Pose {
    let (t, r) = (metres * direction(random), degrees.to_radians() * direction(random));
    moved(pose, &[t.x, t.y, t.z, r.x, r.y, r.z])
}

/// The distance between two poses, in metres and degrees.
pub fn apart(a: &Pose, b: &Pose) -> (f64, f64) {
    ((a.translation - b.translation).length(), a.rotation.angle_between(b.rotation).to_degrees())
}

/// 320 x 240 pixels, 65 degrees wide.
pub fn video() -> Sensor {
    let camera = Camera::pinhole(320, 240, 250.0, 250.0, 159.5, 119.5);
    Sensor::new(SensorSpec::new("camera", "video", Geometry::Camera(camera))).unwrap()
}

/// A simulated grey image.
pub fn grey(video: &Sensor, world: &World, pose: &Pose, stamp: f64, seed: u64) -> Frame {
    GreySimulator::new(predictor(), video.clone(), 0.7, 0.01, seed)
        .unwrap()
        .frame(world, stamp, &RobotPose::new(*pose))
        .unwrap()
}

/// Four frames along x, 3 cm apart, localized by grey images with or without ranges: the true poses and the steps.
pub fn drive(
    video: &Sensor,
    world: &World,
    features: &PlacedFeatures,
    from: &Pose,
    with_ranges: bool,
) -> Vec<(Pose, Step)> {
    let estimator = estimator(EstimateOptions::default()).with_features(features.clone());
    let mut robot = Localizer::new(
        estimator,
        PoseEstimate::of_sigmas(RobotPose::new(*from), 0.02, 0.01),
        LocalizeOptions::default(),
    );
    let step = |k: u32| {
        let stamp = f64::from(k);
        let truth = Pose { translation: from.translation + 0.03 * stamp * DVec3::X, ..*from };
        let grey = grey(video, world, &truth, stamp, k.into());
        let mut ranges = sense(world, &camera(0.01), &truth, &mut Random(k.into()));
        ranges.stamp = stamp;
        let step = if with_ranges { robot.step_together(world, &ranges, &[&grey]) } else { robot.step(world, &grey) };
        (truth, step.unwrap())
    };
    (0..4).map(step).collect()
}
