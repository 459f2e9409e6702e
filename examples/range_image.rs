//! A range image of a model: what a laser scanner should see from a pose.
//!
//! `cargo run --example range_image`
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use glam::DVec3;
use presight::{Images, Options, Predictor, Request, Result, Scene, SensorPose};

/// Predicts range, ids and angle of incidence for each beam.
pub fn range_image() -> Result<Images> {
    let scene = Scene::open("scenes/room.glb")?;
    let scanner = presight::preset("laser-scanner")?;
    let pose = SensorPose::from_xyz_rpy(DVec3::new(2.0, 1.5, 1.2), 0.0, 0.0, 0.5);
    let mut predictor = Predictor::new(Options::default())?;
    Ok(predictor.predict(&scene.world, &scanner, &pose, &Request::default())?.images)
}

/// Prints the shortest range.
pub fn main() -> Result<()> {
    let images = range_image()?;
    let nearest = images.range.iter().copied().fold(f32::INFINITY, f32::min);
    println!("{} beams, the nearest surface at {nearest:.3} m", images.range.len());
    Ok(())
}
