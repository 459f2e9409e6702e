//! Where a robot is, without a pose to start from: scans and odometry lead to one place in the map.
//!
//! `cargo run --example where_am_i`
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use glam::DVec3;
use presight::localize::{EstimateOptions, Estimator};
use presight::localize::{LocalizeOptions, Localizer, Search, SearchOptions, Step};
use presight::measured::Frame;
use presight::simulate::{Disturbances, Simulator};
use presight::{Options, Pose, Predictor, Result, RobotPose, Scene, Sensor};

/// The last step of a drive. The robot is known once its phase is `Tracking`.
pub fn where_am_i(frames: &[Frame]) -> Result<Option<Step>> {
    let map = Scene::open("scenes/room.glb")?.world;
    let mut estimator = Estimator::new(Predictor::new(Options::default())?, EstimateOptions::planar());
    let search = Search::new(&mut estimator, &map, frames[0].sensor(), SearchOptions::default())?;
    let mut localizer = Localizer::unknown(estimator, search, LocalizeOptions::default());
    let steps = frames.iter().map(|frame| localizer.step(&map, frame));
    Ok(steps.collect::<Result<Vec<Step>>>()?.pop())
}

/// Where the robot really is in frame `k`.
pub fn truth(k: u32) -> RobotPose {
    RobotPose::from_xyz_rpy(DVec3::new(1.5 + 0.1 * f64::from(k), 1.5, 0.0), 0.0, 0.0, 0.4)
}

/// Stands in for a real robot that drives ahead.
pub fn drive() -> Result<Vec<Frame>> {
    let world = Scene::open("scenes/room.glb")?.world;
    let mut spec = presight::preset("laser-scanner")?.spec().clone();
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.2, 0.0, 1.2), 0.0, 0.0, 0.0);
    let disturbances = Disturbances::default();
    let mut simulator = Simulator::new(Predictor::new(Options::default())?, Sensor::new(spec)?, disturbances, 1)?;
    (0..8).map(|k| simulator.frame(&world, f64::from(k), &truth(k))).collect()
}

/// Prints the pose that was found.
pub fn main() -> Result<()> {
    if let Some(step) = where_am_i(&drive()?)? {
        let (at, sigmas) = (step.pose.world_from_robot.translation, step.pose.covariance.sigmas());
        println!("{}: x {:.3} +- {:.3} m, y {:.3} +- {:.3} m", step.phase.name(), at.x, sigmas[0], at.y, sigmas[1]);
    }
    Ok(())
}
