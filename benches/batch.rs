//! Compares batches with single predictions: `cargo bench --bench batch [-- FOLDER]`.
//!
//! - Weighs a real scan at 360 headings of many places of its map, per pose; the time for the panoramas is included.
//! - Measures peak memory after 1,000 poses and after 100,000 (Linux).
//! - Weighs a measured image at free poses of two scenes (`PRESIGHT_POSES`, default 1000) by a batch, and by single
//!   predictions of range and cos_incidence that are weighed afterwards.
//!
//! `PRESIGHT_GPU=1` selects the GPU engine. Data: `PRESIGHT_DATA`, default `../shared/data`. `PRESIGHT_THREADS`,
//! default 2. With a FOLDER the bench writes the poses to SCENE.tum in it, for `benches/peers/batch.py`.

#![allow(missing_docs, reason = "a bench has no interface")]
#![allow(clippy::print_stdout, reason = "a bench prints a table")]

use presight_model::geometry::{Pose, SensorPose};
use presight_model::measured::{Frame, Measurement};
use presight_model::sensor::{Noise, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::batch::{BatchRequest, Headings, PoseCell, RangeLikelihood};
use presight_predict::free_poses::free_poses;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_read::gltf::{ImportOptions, import};
use presight_read::log;
use presight_render::plan::{Images, Output, Outputs};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::time::Instant;

fn number(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().expect("a number"))
}

fn data(name: &str) -> PathBuf {
    let default = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    std::env::var_os("PRESIGHT_DATA").map_or_else(default, PathBuf::from).join(name)
}

fn world(name: &str) -> World {
    World::new(import(data(name), &ImportOptions::default()).expect("the scene imports").environment)
}

fn predictor() -> Predictor {
    let threads = number("PRESIGHT_THREADS", 2);
    let backend = if std::env::var_os("PRESIGHT_GPU").is_some() { Backend::Gpu } else { Backend::Cpu };
    Predictor::new(Options::new(backend).with_threads(threads)).expect("an engine")
}

fn frame_of(sensor: &Sensor, ranges: Vec<f32>) -> Frame {
    Frame::new(0.0, sensor.clone(), Measurement::Range(ranges)).expect("a sound scan")
}

fn noisy(spec: &SensorSpec) -> Sensor {
    let noise = Noise { range_sigma: 0.03, angle_sigma: 2e-3, ..Noise::default() };
    Sensor::new(spec.clone().with_noise(noise)).expect("a valid sensor")
}

/// The smallest of several times, in milliseconds.
fn least(times: usize, mut run: impl FnMut()) -> f64 {
    let time = |()| {
        let start = Instant::now();
        run();
        start.elapsed().as_secs_f64() * 1e3
    };
    std::iter::repeat_n((), times).map(time).fold(f64::INFINITY, f64::min)
}

/// Weighs a scan of the Malaga run at all headings of places 0.25 m apart near the map's walls.
fn malaga() {
    let world = world("lidar2d/malaga_corridor_map.glb");
    let log = log::open(&data("lidar2d/malaga_corridor_run_scans.json")).expect("the log opens");
    let sensor = noisy(log.sensor().spec());
    let frame = log.map(|frame| frame.expect("a valid frame")).nth(10).expect("eleven frames");
    let headings = Headings::new(&sensor, 360).expect("a step of half a degree");
    let bounds = world.environment().bounds();
    let mut places = Vec::new();
    let mut at = bounds.min.with_z(sensor.spec().mount.translation.z);
    while at.y < bounds.max.y {
        at.x = bounds.min.x;
        while at.x < bounds.max.x {
            places.push(Pose { translation: at, ..Pose::IDENTITY });
            at.x += 0.25;
        }
        at.y += 0.25;
    }
    // Places spread over the whole map.
    let every = places.len() as f64 / 3714.0;
    let places: Vec<Pose> = (0..3714).map(|i| places[(i as f64 * every) as usize]).collect();
    let beams = frame.range.iter().filter(|r| r.is_finite()).count();
    let cell = PoseCell { side: 0.25, turn: 1f64.to_radians() };
    let sensed = RangeLikelihood::new(&frame_of(&sensor, frame.range), cell).expect("a valid scan");
    let request = BatchRequest { likelihood: Some(sensed), headings: Some(headings), ..BatchRequest::default() };
    let mut predictor = predictor();
    let mut cut_ms = 0.0;
    let mut best = f32::NEG_INFINITY;
    let ms = least(5, || {
        // Each run gets another version of the world, so that the cut through it is computed each time.
        let world = world.reindexed(&Default::default());
        let batch = predictor
            .batch(&world, &sensor, places.iter().copied().map(SensorPose::new), &request)
            .expect("a valid request");
        best = batch.flat_map(|item| item.expect("a place").headings).fold(f32::NEG_INFINITY, f32::max);
    });
    let first = least(5, || {
        let batch = predictor
            .batch(&world, &sensor, places[..1].iter().copied().map(SensorPose::new), &request)
            .expect("a valid request");
        cut_ms += batch.count() as f64;
    });
    let poses = places.len() * 360;
    println!(
        "Malaga: {} places x 360 headings, {beams} beams with a reading: {ms:.0} ms, first place {first:.2} ms",
        places.len()
    );
    println!("{poses} poses; by 1,000,000 poses {:.0} ms; best log-likelihood {best}", ms * 1e6 / poses as f64);
}

fn scene(name: &str, preset: &str, poses: &[Pose], world: &World) {
    let sensor = noisy(presight_read::preset(preset).expect("a preset").spec());
    let mut predictor = predictor();
    let outputs = Outputs::of(&[Output::Range, Output::CosIncidence]);
    let asked = Request::of(outputs);
    let mut images = Images::default();
    predictor.predict_images(world, &sensor, &SensorPose::new(poses[0]), &asked, &mut images).expect("it predicts");
    let sensed =
        RangeLikelihood::new(&frame_of(&sensor, images.range.clone()), PoseCell::default()).expect("a valid image");
    let request = BatchRequest { likelihood: Some(sensed.clone()), ..BatchRequest::default() };
    let mut sums = [0.0, 0.0];
    let batch = least(3, || {
        let items = predictor
            .batch(world, &sensor, poses.iter().copied().map(SensorPose::new), &request)
            .expect("a valid request");
        sums[0] = items.map(|item| item.expect("a pose").log_likelihood.unwrap_or(0.0)).sum();
    });
    let single = least(3, || {
        sums[1] = 0.0;
        for pose in poses {
            predictor
                .predict_images(world, &sensor, &SensorPose::new(*pose), &asked, &mut images)
                .expect("it predicts");
            sums[1] += sensed.log_likelihood(&images.range, &images.cos_incidence);
        }
    });
    let n = poses.len() as f64;
    let (batch, single) = (batch / n, single / n);
    println!(
        "| {name} | {preset} | {n} | {batch:.4} | {single:.4} | {:.2} | {:.1e} |",
        single / batch,
        (sums[0] / sums[1] - 1.0).abs()
    );
}

/// Prints the average time of each stage and the average counts for a pose's image.
fn stages(name: &str, preset: &str, poses: &[Pose], world: &World) {
    let sensor = noisy(presight_read::preset(preset).expect("a preset").spec());
    let mut predictor = predictor();
    let range = vec![2.0; (sensor.width() * sensor.height()) as usize];
    let sensed = RangeLikelihood::new(&frame_of(&sensor, range), PoseCell::default()).expect("a valid image");
    let request = BatchRequest { likelihood: Some(sensed), statistics: true, ..BatchRequest::default() };
    let (mut times, mut counts) = (BTreeMap::new(), BTreeMap::new());
    for item in
        predictor.batch(world, &sensor, poses.iter().copied().map(SensorPose::new), &request).expect("a valid request")
    {
        let stats = item.expect("a pose").stats.expect("statistics were requested");
        for (stage, ms) in stats.stages_ms {
            *times.entry(stage.to_string()).or_insert(0.0) += 1e3 * ms / poses.len() as f64;
        }
        for (count, n) in stats.counts {
            *counts.entry(count.to_string()).or_insert(0.0) += n as f64 / poses.len() as f64;
        }
    }
    println!("{name}, {preset}, by pose: microseconds {times:.1?}, counts {counts:.0?}");
}

/// The peak memory of this process so far, in KiB.
fn peak() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.trim().strip_suffix(" kB")?.trim().parse().ok()
}

/// Measures memory after few poses and after many: images and weights of a longer batch must need no more.
fn memory() {
    let world = world("env/factory_hall.glb");
    let sensor = noisy(presight_read::preset("laser-scanner").expect("a preset").spec());
    let place = free_poses(&world, 1, 1).expect("a free pose")[0];
    let range = vec![2.0; 361];
    let request = BatchRequest {
        images: Some(Outputs::of(&[Output::Range]).into()),
        likelihood: Some(RangeLikelihood::new(&frame_of(&sensor, range), PoseCell::default()).expect("a valid image")),
        ..BatchRequest::default()
    };
    let mut predictor = predictor();
    let mut run = |count: usize| {
        let turned = |i: usize| place * Pose::from_xyz_rpy(glam::DVec3::ZERO, 0.0, 0.0, i as f64);
        let batch = predictor
            .batch(&world, &sensor, (0..count).map(turned).map(SensorPose::new), &request)
            .expect("a valid request");
        assert_eq!(batch.inspect(|item| assert!(item.is_ok(), "a pose")).count(), count);
        peak()
    };
    if let (Some(few), Some(many)) = (run(1_000), run(100_000)) {
        println!(
            "Peak memory: {few} KiB after 1,000 poses, {many} KiB after 100,000: {:.2} % more",
            100.0 * (many / few - 1.0)
        );
    }
}

fn main() {
    memory();
    let folder = std::env::args().skip(1).find(|a| !a.starts_with("--")).map(PathBuf::from);
    malaga();
    println!("\n| scene | sensor | poses | batch, ms a pose | single, ms a pose | times as fast | sums differ by |");
    println!("|---|---|---|---|---|---|---|");
    for name in ["hospital", "factory_hall"] {
        let world = world(&format!("env/{name}.glb"));
        let poses = free_poses(&world, number("PRESIGHT_POSES", 1000), 1).expect("free poses");
        if let Some(folder) = &folder {
            let mut text = String::new();
            for pose in &poses {
                let (p, q) = (pose.translation, pose.rotation);
                writeln!(text, "0 {} {} {} {} {} {} {}", p.x, p.y, p.z, q.x, q.y, q.z, q.w).expect("a string");
            }
            std::fs::write(folder.join(format!("{name}.tum")), text).expect("the poses are written");
        }
        // One-row scanners are level on a robot, all at one height.
        let height = poses[0].translation.z;
        let yaw = |pose: &Pose| Pose::from_xyz_rpy(pose.translation.with_z(height), 0.0, 0.0, pose.rpy().2);
        let level: Vec<Pose> = poses.iter().map(yaw).collect();
        stages(name, "laser-range-camera", &poses, &world);
        scene(name, "laser-range-camera", &poses, &world);
        scene(name, "laser-scanner", &level, &world);
        scene(name, "microwave-radar-scan", &level, &world);
    }
}
