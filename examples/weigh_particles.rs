//! Weighs the particles of a particle filter: how likely is a scan at each of 1,000 poses?
//!
//! `cargo run --example weigh_particles`
#![allow(clippy::print_stdout, reason = "an example prints its result")]

use glam::DVec3;
use presight::measured::{Frame, Measurement};
use presight::predict::{BatchRequest, PoseCell, RangeLikelihood};
use presight::{Options, Predictor, Request, Result, Scene, SensorPose};

/// The logarithm of the likelihood of a scan at each pose of its sensor.
pub fn weigh(frame: &Frame, particles: &[SensorPose]) -> Result<Vec<f64>> {
    let map = Scene::open("scenes/room.glb")?.world;
    let likelihood = Some(RangeLikelihood::new(frame, PoseCell::default())?);
    let request = BatchRequest { likelihood, ..BatchRequest::default() };
    let mut predictor = Predictor::new(Options::default())?;
    let weighed = predictor.batch(&map, frame.sensor(), particles.iter().copied(), &request)?;
    weighed.map(|item| Ok(item?.log_likelihood.unwrap_or(f64::NEG_INFINITY))).collect()
}

/// Stands in for a real scan.
pub fn measure(pose: &SensorPose) -> Result<Frame> {
    let (scene, scanner) = (Scene::open("scenes/room.glb")?, presight::preset("laser-scanner")?);
    let mut predictor = Predictor::new(Options::default())?;
    let seen = predictor.predict(&scene.world, &scanner, pose, &Request::default())?;
    Frame::new(0.0, scanner, Measurement::Range(seen.images.range))
}

/// 1,000 particles around a place, 2 cm apart along x and y; the place itself is number 515.
pub fn particles() -> Vec<SensorPose> {
    let at = |i: i32| DVec3::new(2.0 + 0.02 * f64::from(i % 40 - 35), 1.5 + 0.02 * f64::from(i / 40 - 12), 1.2);
    (0..1000).map(|i| SensorPose::from_xyz_rpy(at(i), 0.0, 0.0, 0.5)).collect()
}

/// Prints the likeliest particle.
pub fn main() -> Result<()> {
    let particles = particles();
    let logs = weigh(&measure(&particles[515])?, &particles)?;
    let best = (0..logs.len()).max_by(|a, b| logs[*a].total_cmp(&logs[*b])).unwrap_or(0);
    println!("particle {best} of {} is the likeliest: {}", logs.len(), particles[best].world_from_sensor().translation);
    Ok(())
}
