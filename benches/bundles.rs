//! Moving scans and rays with origins against the same sensor standing: `cargo bench --bench bundles -- [SCENE...]`.
//!
//! From plan to all default images in memory, in turns in one process, by its CPU time on one thread: the minimum of
//! `PRESIGHT_REPEATS` (15) frames at each of `PRESIGHT_POSES` (5) free poses, and the median of the poses. The robot
//! drives at 1.5 m/s and 1 rad/s. A standing sensor has one origin. Trees and tiles are built before.
#![expect(clippy::print_stdout, reason = "a bench prints its table")]

#[allow(dead_code, reason = "other benches share it")]
#[path = "common/scenes.rs"]
mod scenes;

use cpu_time::ProcessTime;
use glam::DVec3;
use presight_model::geometry::{Pose, Twist};
use presight_model::measured::{ScanMotion, ScanPoses};
use presight_model::sensor::{Geometry, RayTable, RayTimes, Sensor, StampAt};
use presight_model::world::World;
use presight_predict::request::Request;
use presight_read::preset;
use presight_render::cpu::CpuEngine;
use presight_render::plan::{FramePlan, Images, PlanBuffers, Stats, Way};

fn number(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().expect("a number"))
}

fn main() {
    let named: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let known = ["hospital", "factory_hall", "open_hall"];
    let scenes: Vec<&str> = if named.is_empty() { known.into() } else { named.iter().map(String::as_str).collect() };
    println!("| scene | sensor | bundles | standing, one origin, ms of CPU | moving, ms | moving over standing |");
    println!("|---|---|---|---|---|---|");
    for scene in scenes {
        let world = World::new(scenes::environment(scene));
        world.make_ray_trees(0..world.environment().objects().len() as u32).expect("memory");
        for sensor in sensors() {
            measure(scene, &world, &sensor);
        }
    }
}

/// An ideal lidar of columns, real ones with origins and firing times, a Livox-like pattern, and a rolling shutter.
fn sensors() -> Vec<Sensor> {
    let timed = |name: &str, times: RayTimes| {
        let spec = preset(name).expect("a preset").spec().clone();
        Sensor::new(spec.with_times(times)).expect("a sound sensor")
    };
    let mut all = vec![timed("os1-128", RayTimes::turning(0.1, StampAt::First))];
    let real = ["os1-128-real", "vlp-16-real", "vlp-32c-real", "mid-360-like"];
    all.extend(real.map(|name| preset(name).expect("a preset")));
    all.push(timed("video-camera", RayTimes::Rows { readout_s: 0.02, stamp: StampAt::First }));
    all
}

/// The sensor with all rays from its own origin.
fn with_one_origin(sensor: &Sensor) -> Sensor {
    let spec = sensor.spec().clone();
    let Geometry::Rays(table) = &spec.geometry else { return sensor.clone() };
    let rays = table.directions().to_vec();
    let table = RayTable::new(table.width(), table.height(), rays).expect("sound rays");
    Sensor::new(spec.with_geometry(Geometry::Rays(table))).expect("a sound sensor")
}

fn measure(scene: &str, world: &World, sensor: &Sensor) {
    let mut engine = CpuEngine::new(1).expect("threads");
    let still = with_one_origin(sensor);
    let motion = ScanMotion::Twist(Twist::new(DVec3::X * 1.5, DVec3::Z));
    let request = (&Request::default()).into();
    let (mut images, mut times) = (Images::default(), [Vec::new(), Vec::new()]);
    let mut bundles = 0;
    for pose in &scenes::poses(scene, world, number("PRESIGHT_POSES", 5)) {
        let mut least = [f64::INFINITY; 2];
        for round in 0..=number("PRESIGHT_REPEATS", 15) {
            for (of, least) in least.iter_mut().enumerate() {
                let start = ProcessTime::now();
                let plan = if of == 0 {
                    let chosen = Way::Counts.choose(world, &still);
                    FramePlan::by(chosen, PlanBuffers::default(), world, &still, pose, request)
                } else {
                    in_motion(world, sensor, pose, &motion, &mut bundles)
                };
                let plan = plan.expect("a valid pose");
                engine.render(&plan, &mut images, &mut Stats::default()).expect("the engine renders");
                if round > 0 {
                    *least = least.min(start.elapsed().as_secs_f64() * 1e3);
                }
            }
        }
        times.iter_mut().zip(least).for_each(|(times, least)| times.push(least));
    }
    let [standing, moving] = times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    });
    let (name, width, height) = (&sensor.spec().name, sensor.width(), sensor.height());
    let ratio = moving / standing;
    println!("| {scene} | {name} {width} x {height} | {bundles} | {standing:.3} | {moving:.3} | {ratio:.2} |");
}

fn in_motion(
    world: &World,
    sensor: &Sensor,
    pose: &Pose,
    motion: &ScanMotion,
    bundles: &mut usize,
) -> presight_model::Result<FramePlan> {
    let poses = ScanPoses::new(sensor, pose, Some(motion))?.expect("several poses");
    *bundles = poses.poses().len();
    FramePlan::in_bundles(PlanBuffers::default(), world, sensor, pose, (&Request::default()).into(), poses)
}
