//! What changed: a scan says, beam by beam, whether the model still holds.
//!
//! `cargo run --example what_changed`
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use glam::DVec3;
use presight::environment::Environment;
use presight::measured::Frame;
use presight::simulate::{Disturbances, Simulator};
use presight::verdict::{self, Verdict, Verdicts};
use presight::{Options, Pose, PoseEstimate, Predictor, Result, RobotPose, Scene, Sensor, World};

/// Where the robot stands, known to 1 cm and 0.005 rad.
fn believed() -> PoseEstimate {
    PoseEstimate::of_sigmas(RobotPose::from_xyz_rpy(DVec3::new(2.0, 1.5, 0.0), 0.0, 0.0, -0.9), 0.01, 0.005)
}

/// Compares a scan with the model.
pub fn what_changed(frame: &Frame) -> Result<Verdicts> {
    let model = Scene::open("scenes/room.glb")?.world;
    let mut predictor = Predictor::new(Options::default())?;
    verdict::of_frame(&mut predictor, &model, frame, &believed())
}

/// Stands in for a real scanner: it measures a room to which a box was added, 1 m ahead of it.
pub fn measure() -> Result<Frame> {
    let mut real = Environment::clone(Scene::open("scenes/room.glb")?.world.environment());
    let ahead = believed().world_from_robot * Pose::from_xyz_rpy(DVec3::new(1.0, 0.0, 0.8), 0.0, 0.0, 0.0);
    real.add_cuboid("box", ahead, DVec3::new(0.2, 0.4, 0.4))?;
    let mut spec = presight::preset("laser-scanner")?.spec().clone();
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.2, 0.0, 0.8), 0.0, 0.0, 0.0);
    let disturbances = Disturbances::default();
    let mut simulator = Simulator::new(Predictor::new(Options::default())?, Sensor::new(spec)?, disturbances, 1)?;
    simulator.frame(&World::new(real), 0.0, &believed().robot())
}

/// Prints how many beams have each verdict.
pub fn main() -> Result<()> {
    let verdicts = what_changed(&measure()?)?;
    Verdict::ALL.iter().zip(verdicts.counts()).for_each(|(verdict, beams)| println!("{}: {beams}", verdict.name()));
    Ok(())
}
