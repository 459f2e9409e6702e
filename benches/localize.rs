//! What one update costs, prediction and verdicts included: `cargo bench --bench localize`. Medians and 95th percentiles on
//! two threads, from where the frame before was. Sets of ../shared/data (or $PRESIGHT_DATA) that are not there are left out.

#![allow(clippy::print_stdout, reason = "a bench prints its figures")]

use cpu_time::ProcessTime;
use glam::DVec3;
use presight::estimate::{EstimateOptions, Estimator, Prior};
use presight::frame::Frame;
use presight::io::gltf::import;
use presight::io::log::{Frames, Observation};
use presight::simulate::{Disturbances, Simulator};
use presight::{Backend, Options, Pose, Predictor, Sensor, World};
use presight_testkit::data;
use std::path::Path;
use std::time::Instant;

fn predictor() -> Predictor {
    Predictor::new(Options::new(Backend::Cpu).with_threads(2)).expect("two threads")
}

fn map(path: &Path) -> World {
    World::new(import(path, &Default::default()).expect("the map imports").environment)
}

/// Updates each frame from a prior and prints the times. The first frames warm up. CPU time holds on a busy machine, too.
fn measure(name: &str, aim: &str, world: &World, options: EstimateOptions, frames: &[(Frame, Prior)]) {
    let mut estimator = Estimator::new(predictor(), options);
    let (mut times, mut cpu) = (Vec::new(), Vec::new());
    for (frame, prior) in frames.iter().take(3).chain(frames) {
        let (start, cpu_start) = (Instant::now(), ProcessTime::now());
        estimator.estimate(world, &[frame], prior).expect("an estimate");
        cpu.push(1e3 * cpu_start.elapsed().as_secs_f64());
        times.push(1e3 * start.elapsed().as_secs_f64());
    }
    let [times, cpu] = [times, cpu].map(|mut ms| {
        let mut ms = ms.split_off(3.min(frames.len()));
        ms.sort_by(f64::total_cmp);
        [0.5, 0.95].map(|share| ms[((ms.len() - 1) as f64 * share).round() as usize])
    });
    println!(
        "{name}: p50 {:.2} ms, p95 {:.2} ms; CPU p50 {:.2} ms, p95 {:.2} ms; {} updates (aim: {aim})",
        times[0],
        times[1],
        cpu[0],
        cpu[1],
        frames.len()
    );
}

/// Each frame with the reference of the one before as its prior.
fn followed(observations: Vec<Observation>, sigmas: (f64, f64)) -> Vec<(Frame, Prior)> {
    let reference: Vec<Option<Pose>> = observations.iter().map(|o| o.reference).collect();
    let frames = observations.into_iter().enumerate().skip(1);
    frames.filter_map(|(i, o)| Some((o.frame, Prior::of_sigmas(reference[i - 1]?, sigmas.0, sigmas.1)))).collect()
}

fn livingroom() {
    let (Some(log), Some(path)) = (data::file("rgbd/livingroom"), data::file("rgbd/livingroom/livingroom_map.glb"))
    else {
        return;
    };
    let frames = Frames::open(&log, None, &Default::default()).expect("a log").take(60);
    let thinned = |o: presight::Result<Observation>| {
        let o = o.expect("a frame");
        Observation { frame: o.frame.thinned(4).expect("a stride"), ..o }
    };
    let frames = followed(frames.map(thinned).collect(), (0.03, 0.02));
    measure("livingroom, 640 x 480 at a stride of 4", "33 ms", &map(&path), EstimateOptions::default(), &frames);
}

fn malaga() {
    let (Some(log), Some(path)) =
        (data::file("lidar2d/malaga_corridor_run_scans.json"), data::file("lidar2d/malaga_corridor_map.glb"))
    else {
        return;
    };
    let frames: Vec<Observation> =
        Frames::open(&log, None, &Default::default()).expect("a log").map(|o| o.expect("a scan")).collect();
    // Scans lie far apart: each from near its own place.
    let near = |o: Observation| Some((o.frame, Prior::of_sigmas(o.reference?, 0.03, 0.02)));
    let frames: Vec<(Frame, Prior)> = frames.into_iter().filter_map(near).collect();
    measure("malaga, 361 beams", "1 ms p95", &map(&path), EstimateOptions::planar(), &frames);
}

fn hall() {
    let Some(path) = data::file("env/factory_hall.glb") else { return };
    let world = map(&path);
    let mut spec = presight::preset("laser-range-camera").expect("a preset").spec().clone();
    spec.noise.range_sigma = 0.01;
    let camera = Sensor::new(spec).expect("a camera");
    let mut simulator = Simulator::new(predictor(), camera, Disturbances::default(), 1).expect("a simulator");
    let places = presight::free_poses::free_poses(&world, 20, 11).expect("free poses");
    let frame = |(k, place): (usize, &Pose)| {
        let off = Pose { translation: place.translation + DVec3::new(0.01, -0.01, 0.0), ..*place };
        (simulator.frame(&world, k as f64, place).expect("a frame"), Prior::of_sigmas(off, 0.02, 0.01))
    };
    let frames: Vec<(Frame, Prior)> = places.iter().enumerate().map(frame).collect();
    measure("factory hall, laser range camera", "8 ms p95", &world, EstimateOptions::default(), &frames);
}

fn main() {
    livingroom();
    malaga();
    hall();
}
