//! Measures one update including prediction and verdicts: `cargo bench --bench localize`. Prints medians and 95th
//! percentiles on two threads, starting from the previous frame's pose. Missing sets of ../shared/data (or
//! $PRESIGHT_DATA) are skipped.
//! `cargo bench --bench localize -- alarms 30000 1e-6` (or `accuracy 200`, `fidelity 40`, `noise 60`, `kidnapped`) simulates
//! drives, see `drives.rs`; `changed` drives through changed rooms, see `changed.rs`, `scans` with lidars that turn, see `scans.rs`, and `wrong 300` for 300 s in maps of other buildings; `-- frames DIR` also writes the frames and their estimates for `benches/peers/localize.sh`.

#![allow(clippy::print_stdout, reason = "a bench prints its figures")]

mod cases;
mod changed;
mod drives;
mod scans;

use cpu_time::ProcessTime;
use glam::DVec3;
use presight_localize::estimate::{EstimateOptions, Estimator, Freedom, measured_points};
use presight_localize::simulate::{Disturbances, Simulator};
use presight_model::geometry::{Pose, PoseEstimate, RobotPose};
use presight_model::measured::Frame;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_read::gltf::import;
use presight_read::log::{Frames, Observation};
use presight_testkit::data;
use std::path::Path;
use std::time::Instant;

fn predictor() -> Predictor {
    Predictor::new(Options::new(Backend::Cpu).with_threads(2)).expect("two threads")
}

fn single() -> Predictor {
    Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("one thread")
}

fn map(path: &Path) -> World {
    World::new(import(path, &Default::default()).expect("the map imports").environment)
}

/// A frame, the prior knowledge of its pose, and the robot's true pose.
struct Known {
    frame: Frame,
    prior: PoseEstimate,
    truth: Pose,
}

/// Frames in a map, and the options of their estimation.
struct Case {
    name: &'static str,
    aim: &'static str,
    map: std::path::PathBuf,
    options: EstimateOptions,
    frames: Vec<Known>,
}

impl Case {
    /// Updates each frame from its prior and prints the times. The first frames warm up. CPU times also hold on a busy
    /// machine.
    fn measure(&self, out: Option<&Path>) {
        let world = map(&self.map);
        let mut estimator = Estimator::new(predictor(), self.options);
        let (mut wall, mut cpu, mut found) = (Vec::new(), Vec::new(), Vec::new());
        let warm = 3.min(self.frames.len());
        for (k, known) in self.frames.iter().take(warm).chain(&self.frames).enumerate() {
            let (start, cpu_start) = (Instant::now(), ProcessTime::now());
            let estimate = estimator.estimate(&world, &[&known.frame], &known.prior).expect("an estimate");
            if k >= warm {
                cpu.push(1e3 * cpu_start.elapsed().as_secs_f64());
                wall.push(1e3 * start.elapsed().as_secs_f64());
                found.push(estimate.pose.world_from_robot);
            }
        }
        if let Some(out) = out {
            self.write(out, &found, [&wall, &cpu]);
        }
        let at = |ms: &[f64], share: f64| {
            let mut ms = ms.to_vec();
            ms.sort_by(f64::total_cmp);
            ms[((ms.len() - 1) as f64 * share).round() as usize]
        };
        let off = |(known, found): (&Known, &Pose)| {
            let (a, b) = (&known.truth, found);
            ((a.translation - b.translation).length(), a.rotation.angle_between(b.rotation).to_degrees())
        };
        let (metres, degrees): (Vec<f64>, Vec<f64>) = self.frames.iter().zip(&found).map(off).unzip();
        println!(
            "{}: p50 {:.2} ms, p95 {:.2} ms; CPU p50 {:.2} ms, p95 {:.2} ms; {} updates (aim: {}); off p50 {:.2} mm, {:.4} deg, p95 {:.2} mm, {:.4} deg",
            self.name,
            at(&wall, 0.5),
            at(&wall, 0.95),
            at(&cpu, 0.5),
            at(&cpu, 0.95),
            wall.len(),
            self.aim,
            at(&metres, 0.5) * 1e3,
            at(&degrees, 0.5),
            at(&metres, 0.95) * 1e3,
            at(&degrees, 0.95)
        );
    }

    /// Writes NAME.json, and NAME.points: x y z of all measured points in the robot's frame, f32, frame by frame.
    fn write(&self, out: &Path, found: &[Pose], [wall, cpu]: [&[f64]; 2]) {
        let numbers = |pose: &Pose| [pose.translation.to_array().to_vec(), pose.rotation.to_array().to_vec()].concat();
        let (mut points, mut frames) = (Vec::new(), Vec::new());
        for ((known, found), (ms, cpu)) in self.frames.iter().zip(found).zip(wall.iter().zip(cpu)) {
            let sensor = known.frame.sensor();
            let (mount, body) = (sensor.spec().mount, sensor.body_from_image());
            let measured = measured_points(&known.frame);
            for p in &measured {
                let q = mount.transform_point(body * p.point.as_dvec3()).as_vec3();
                q.to_array().iter().for_each(|x| points.extend(x.to_le_bytes()));
            }
            frames.push(serde_json::json!({
                "points": measured.len(), "origin": mount.translation.to_array(), "ms": ms, "cpu_ms": cpu,
                "prior": numbers(&known.prior.world_from_robot), "truth": numbers(&known.truth), "found": numbers(found),
            }));
        }
        let planar = self.options.freedom == Freedom::Planar;
        let all = serde_json::json!({ "name": self.name, "map": self.map, "planar": planar, "frames": frames });
        let stem: String = self.name.chars().take_while(|c| c.is_alphanumeric()).collect();
        std::fs::create_dir_all(out).expect("the folder");
        std::fs::write(out.join(format!("{stem}.points")), points).expect("points are written");
        std::fs::write(out.join(format!("{stem}.json")), all.to_string()).expect("frames are written");
    }
}

fn livingroom() -> Option<Case> {
    let (log, map) = (data::file("rgbd/livingroom")?, data::file("rgbd/livingroom/livingroom_map.glb")?);
    let frames = Frames::open(&log, None, &Default::default()).expect("a log").take(60);
    let frames: Vec<Observation> = frames.map(|o| o.expect("a frame")).collect();
    // The prior of each frame is the previous frame's reference.
    let known = |pair: &[Observation]| {
        let prior = PoseEstimate::of_sigmas(pair[0].reference?, 0.03, 0.02);
        Some(Known {
            frame: pair[1].frame.thinned(4).expect("a stride"),
            prior,
            truth: pair[1].reference?.world_from_robot(),
        })
    };
    let frames = frames.windows(2).filter_map(known).collect();
    let (name, aim) = ("livingroom, 640 x 480 at a stride of 4", "33 ms");
    Some(Case { name, aim, map, options: EstimateOptions::default(), frames })
}

fn malaga() -> Option<Case> {
    let log = data::file("lidar2d/malaga_corridor_run_scans.json")?;
    let map = data::file("lidar2d/malaga_corridor_map.glb")?;
    // The scans are far apart, so each prior is a little off the scan's own reference.
    let known = |o: Observation| {
        let truth = o.reference?.world_from_robot();
        let beside = truth * Pose::from_xyz_rpy(DVec3::new(0.03, -0.02, 0.0), 0.0, 0.0, 0.015);
        Some(Known { frame: o.frame, prior: PoseEstimate::of_sigmas(RobotPose::new(beside), 0.03, 0.02), truth })
    };
    let frames = Frames::open(&log, None, &Default::default()).expect("a log").map(|o| o.expect("a scan"));
    let frames = frames.filter_map(known).collect();
    let (name, aim) = ("malaga, 361 beams", "1 ms");
    Some(Case { name, aim, map, options: EstimateOptions::planar(), frames })
}

fn hall() -> Option<Case> {
    let path = data::file("env/factory_hall.glb")?;
    let world = map(&path);
    let mut simulator = Simulator::new(predictor(), drives::laser(), Disturbances::default(), 1).expect("a simulator");
    let places = presight_predict::free_poses::free_poses(&world, 20, 11).expect("free poses");
    let known = |(k, place): (usize, &Pose)| {
        let off = Pose { translation: place.translation + DVec3::new(0.01, -0.01, 0.0), ..*place };
        let frame = simulator.frame(&world, k as f64, &RobotPose::new(*place)).expect("a frame");
        Known { frame, prior: PoseEstimate::of_sigmas(RobotPose::new(off), 0.02, 0.01), truth: *place }
    };
    let frames = places.iter().enumerate().map(known).collect();
    let (name, aim) = ("hall, laser range camera", "8 ms p95");
    Some(Case { name, aim, map: path, options: EstimateOptions::default(), frames })
}

fn main() {
    // Cargo passes --bench.
    let words: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let number = |default| words.get(1).map_or(default, |n| n.parse().expect("a number of frames"));
    match words.first().map(String::as_str) {
        None | Some("frames") => {
            let out = words.get(1).map(Path::new);
            [livingroom(), malaga(), hall()].into_iter().flatten().for_each(|case| case.measure(out));
        }
        Some("alarms") => {
            let rate = words.get(2).map_or(1e-6, |rate| rate.parse().expect("a rate"));
            drives::alarms(number(30_000) as u64, rate)
        }
        Some("accuracy") => drives::accuracy(number(200)),
        Some("fidelity") => drives::fidelity(number(40)),
        Some("noise") => drives::noise(number(60)),
        Some("kidnapped") => drives::kidnapped(),
        Some("changed") => changed::all(&words[1..]),
        Some("scans") => scans::all(&words[1..]),
        Some("turns") => scans::turns(&words[1..]),
        Some("wrong") => changed::wrong(&words[1..]),
        Some("leads") => changed::leads(&words[1..]),
        Some(other) => {
            panic!(
                "{other}: give frames DIR, alarms, accuracy, fidelity, noise, kidnapped, changed, scans, turns, wrong or leads, or nothing"
            )
        }
    }
}
