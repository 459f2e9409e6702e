//! Compares cameras with lenses, fisheyes and ray tables with a pinhole camera of the same size: `cargo bench --bench
//! lenses [-- SCENE...]`.
//!
//! Scenes are names from the shared data (`PRESIGHT_DATA`, default `../shared/data`), paths of `.glb` and `.rhai`
//! files, or `open_hall`. `PRESIGHT_POSES` is the number of free poses (default 20), `PRESIGHT_ENGINE` is cpu or gpu,
//! and `PRESIGHT_SENSORS` selects these cameras and presets by name, separated by commas. A row has medians over the
//! poses for the whole prediction, selection included (the fastest of three runs at each): its time, its ratio to the
//! pinhole camera's, the CPU time of the process, which also holds on a busy machine with a software adapter, and the
//! size of the sensor's tables.

#![allow(missing_docs, reason = "a bench has no interface")]
#![allow(clippy::print_stdout, reason = "a bench prints a table")]

#[path = "common/cameras.rs"]
mod cameras;
#[path = "common/scenes.rs"]
mod scenes;

use cameras::SIZE;
use cpu_time::ProcessTime;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::PixelGrid;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_read::preset;
use std::time::Instant;

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The milliseconds at each pose by the clock and by CPU time.
fn times(predictor: &mut Predictor, world: &World, sensor: &Sensor, poses: &[Pose]) -> [Vec<f64>; 2] {
    let request = Request::default();
    let mut one = |pose: &Pose| {
        let (start, cpu) = (Instant::now(), ProcessTime::now());
        predictor.predict(world, sensor, &SensorPose::new(*pose), &request).expect("it predicts");
        [start.elapsed(), cpu.elapsed()].map(|time| time.as_secs_f64() * 1e3)
    };
    one(&poses[0]);
    let least = |a: [f64; 2], b: [f64; 2]| [a[0].min(b[0]), a[1].min(b[1])];
    let of_pose = |pose: &Pose| (0..3).map(|_| one(pose)).fold([f64::INFINITY; 2], least);
    let of_poses: Vec<[f64; 2]> = poses.iter().map(of_pose).collect();
    [0, 1].map(|k| of_poses.iter().map(|times| times[k]).collect())
}

/// The pinhole camera first.
fn sensors() -> Vec<Sensor> {
    let wanted = std::env::var("PRESIGHT_SENSORS").unwrap_or_default();
    let all = cameras::sensors();
    if wanted.is_empty() {
        return all;
    }
    let is_wanted = |sensor: &Sensor| wanted.split(',').any(|name| name == sensor.spec().name);
    let cameras =
        all.into_iter().enumerate().filter(|(i, sensor)| *i == 0 || is_wanted(sensor)).map(|(_, sensor)| sensor);
    cameras.chain(wanted.split(',').filter_map(|name| preset(name).ok())).collect()
}

fn main() {
    let named: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let usual = ["hospital", "factory_hall", "city", "scenes/factory.rhai"].map(str::to_owned).to_vec();
    let scenes = if named.is_empty() { usual } else { named };
    let poses = std::env::var("PRESIGHT_POSES").map_or(20, |n| n.parse().expect("a number of poses"));
    let gpu = std::env::var("PRESIGHT_ENGINE").is_ok_and(|e| e == "gpu");
    let backend = if gpu { Backend::Gpu } else { Backend::Cpu };
    let mut predictor = Predictor::new(Options::new(backend)).expect("the engine starts");
    println!("{} x {}, {poses} free poses, medians", SIZE.0, SIZE.1);
    for scene in scenes {
        let world = World::new(scenes::environment(&scene));
        let poses = scenes::poses(&scene, &world, poses);
        let mut pinhole: Vec<f64> = Vec::new();
        for sensor in sensors() {
            let name = &sensor.spec().name;
            let [times, cpu] = times(&mut predictor, &world, &sensor, &poses);
            if pinhole.is_empty() {
                pinhole.clone_from(&times);
            }
            let ratio = median(times.iter().zip(&pinhole).map(|(t, p)| t / p).collect());
            let tables = match sensor.grid() {
                PixelGrid::Rays(rays) => format!("{:.1} MB", rays.bytes() as f64 * 1e-6),
                PixelGrid::Lines(_) => "lines".to_owned(),
            };
            println!(
                "| {scene} | {name} | {tables} | {:.2} ms | {ratio:.2} x | {:.2} ms |",
                median(times),
                median(cpu)
            );
        }
    }
}
