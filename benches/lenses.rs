//! Cameras with lenses, fisheyes and ray tables beside a pinhole camera of as many pixels: `cargo bench --bench lenses [-- SCENE...]`.
//!
//! Scenes are names of the shared data (`PRESIGHT_DATA`, default `../shared/data`), paths of `.glb` and `.rhai` files, or `open_hall`.
//! `PRESIGHT_POSES` free poses (default 20), `PRESIGHT_ENGINE` cpu or gpu, `PRESIGHT_SENSORS` names, comma-separated. A row tells the median over the poses of the
//! whole prediction (the fastest of three at each), selection included, the median of its ratio to the pinhole's, and what the sensor's tables take.

#![allow(missing_docs, reason = "a bench has no interface")]
#![allow(clippy::print_stdout, reason = "the table is what it is for")]

#[path = "common/cameras.rs"]
mod cameras;
#[path = "common/scenes.rs"]
mod scenes;

use cameras::SIZE;
use presight::sensor::PixelGrid;
use presight::{Backend, Options, Pose, Predictor, Request, Sensor, World};
use std::time::Instant;

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Milliseconds at each pose.
fn times(predictor: &mut Predictor, world: &World, sensor: &Sensor, poses: &[Pose]) -> Vec<f64> {
    let request = Request::default();
    let mut one = |pose: &Pose| {
        let start = Instant::now();
        predictor.predict(world, sensor, pose, &request).expect("it predicts");
        start.elapsed().as_secs_f64() * 1e3
    };
    one(&poses[0]);
    poses.iter().map(|pose| (0..3).map(|_| one(pose)).fold(f64::INFINITY, f64::min)).collect()
}

fn main() {
    let named: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let usual = ["hospital", "factory_hall", "city", "scenes/factory.rhai"].map(str::to_owned).to_vec();
    let scenes = if named.is_empty() { usual } else { named };
    let poses = std::env::var("PRESIGHT_POSES").map_or(20, |n| n.parse().expect("a number of poses"));
    let gpu = std::env::var("PRESIGHT_ENGINE").is_ok_and(|e| e == "gpu");
    let wanted = std::env::var("PRESIGHT_SENSORS").unwrap_or_default();
    let backend = if gpu { Backend::Gpu } else { Backend::Cpu };
    let mut predictor = Predictor::new(Options::new(backend)).expect("the engine starts");
    println!("{} x {}, {poses} free poses, medians", SIZE.0, SIZE.1);
    for scene in scenes {
        let world = World::new(scenes::environment(&scene));
        let poses = scenes::poses(&scene, &world, poses);
        let mut pinhole: Vec<f64> = Vec::new();
        for sensor in cameras::sensors() {
            let name = sensor.spec().name.clone();
            if !pinhole.is_empty() && !wanted.is_empty() && !wanted.split(',').any(|w| w == name) {
                continue;
            }
            let times = times(&mut predictor, &world, &sensor, &poses);
            if pinhole.is_empty() {
                pinhole.clone_from(&times);
            }
            let ratio = median(times.iter().zip(&pinhole).map(|(t, p)| t / p).collect());
            let tables = match sensor.grid() {
                PixelGrid::Rays(rays) => format!("{:.1} MB", rays.bytes() as f64 * 1e-6),
                PixelGrid::Lines(_) => "lines".to_owned(),
            };
            println!("| {scene} | {name} | {tables} | {:.2} ms | {ratio:.2} x |", median(times));
        }
    }
}
