//! A robot at the end of a room of 10 x 8 x 3 m, and a corridor of 4 x 0.8 m before it.

use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, NewObject};
use presight_model::geometry::{Pose, PoseEstimate, RobotPose, SensorPose};
use presight_model::measured::{Frame, Measurement};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::virtual_sensors::Corridor;
use presight_supervise::{Report, SuperviseOptions, Supervisor};
use presight_testkit::{intruders, scenes};
use std::sync::Arc;

/// Where the robot stands.
pub fn robot() -> Pose {
    Pose::from_xyz_rpy(DVec3::new(-4.0, 0.3, 0.0), 0.0, 0.0, 0.0)
}

pub fn predictor() -> Predictor {
    Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap()
}

/// The room with crates on both sides of the corridor.
pub fn room() -> Environment {
    let mut environment = scenes::room(1, 0);
    for (k, (x, y, size)) in
        [(-2.0, 1.4, 0.5), (-0.5, -0.9, 0.8), (1.0, 1.3, 1.0), (2.0, -1.0, 0.4)].into_iter().enumerate()
    {
        let half = (0.5 * size) as f32;
        let mesh = scenes::cuboid(Vec3::new(-half, -half, 0.0), Vec3::new(half, half, 2.0 * half));
        let pose = Pose::from_xyz_rpy(DVec3::new(x, y, 0.0), 0.0, 0.0, 0.2 * k as f64);
        environment.insert(NewObject::new(format!("crate{k}"), pose, Arc::new(mesh))).unwrap();
    }
    environment
}

/// The corridor in the robot's frame, 4 m long.
pub fn corridor() -> Corridor {
    let (length, half, [low, high]) = (intruders::LENGTH, intruders::HALF_WIDTH, intruders::HEIGHTS);
    let corners = vec![[0.0, -half], [length, -half], [length, half], [0.0, half]];
    Corridor::polygon(corners, low, high).unwrap()
}

/// What a sensor measures without any error.
pub fn exact(world: &World, sensor: &Sensor) -> Frame {
    let outputs = presight_render::plan::Outputs::of(&[presight_render::plan::Output::Range]);
    let mut images = presight_render::plan::Images::default();
    let pose = robot() * sensor.spec().mount;
    predictor().predict_images(world, sensor, &SensorPose::new(pose), outputs, &mut images).unwrap();
    Frame::new(0.0, sensor.clone(), Measurement::Range(images.range)).unwrap()
}

/// The robot's pose and its deviations in most tests.
pub fn known() -> PoseEstimate {
    PoseEstimate::of_sigmas(RobotPose::new(robot()), 0.003, 0.001)
}

/// Supervises frames of the world with the room as the model.
pub fn supervised(options: SuperviseOptions, frames: &[&Frame], robot: Option<&PoseEstimate>) -> (Supervisor, Report) {
    supervised_in(&World::new(room()), options, frames, robot)
}

/// As [`supervised`], with another model.
pub fn supervised_in(
    model: &World,
    options: SuperviseOptions,
    frames: &[&Frame],
    robot: Option<&PoseEstimate>,
) -> (Supervisor, Report) {
    let mut supervisor = Supervisor::new(corridor(), options).unwrap();
    let report = supervisor.supervise(&mut predictor(), model, frames, robot).unwrap();
    (supervisor, report)
}
