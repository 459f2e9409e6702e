//! Compares the GPU engine's two rasterizers for pinhole cameras: `cargo bench --bench raster`.
//!
//! Both run on one adapter, in turns, at the same free poses, from plan to all four default outputs in memory. The
//! bench also reports the CPU time of the whole process, which on a software adapter also holds on a busy machine.
//! Scenes are in `PRESIGHT_DATA` (default `../shared/data`). `PRESIGHT_POSES` and `PRESIGHT_REPEATS` set the numbers of
//! poses and repeats. `-- drive [SCENE...]` measures the reuse of the previous frame's result on drives.
#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a bench prints its table")]

#[allow(dead_code, reason = "other benches share it")]
#[path = "common/cameras.rs"]
mod cameras;
#[path = "common/drive.rs"]
mod drive;
#[path = "common/scenes.rs"]
mod scenes;

use cpu_time::ProcessTime;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::free_poses::free_poses;
use presight_predict::gpu::{DeviceOptions, GpuEngine};
use presight_predict::request::Request;
use presight_read::gltf::{ImportOptions, import};
use presight_read::preset;
use presight_render::plan::{CountName, StageName};
use presight_render::plan::{FramePlan, Images, Raster, Stats};
use std::path::{Path, PathBuf};
use std::time::Instant;

fn number(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().expect("a number"))
}

fn main() {
    let named: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    if named.first().is_some_and(|what| what == "drive") {
        return drive::compare(&named[1..]);
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let times = ["time", "CPU time", "submission to answer"].map(|time| {
        format!(
            "{time}: compute, ms: median of poses' medians | render, ms | render over compute: median (least, most)"
        )
    });
    println!("| scene | {} | polygons set up | of these rendered | pixels that differ |", times.join(" | "));
    println!("|{}", "---|".repeat(13));
    for name in ["hospital", "factory_hall"] {
        let path = data.join("env").join(name).with_extension("glb");
        if path.is_file() {
            let imported = import(&path, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"));
            measure(name, &World::new(imported.environment));
        } else {
            println!("SKIPPED: {} is missing", path.display());
        }
    }
}

fn open(raster: Raster) -> GpuEngine {
    let engine = GpuEngine::new(DeviceOptions { raster, ..DeviceOptions::default() }).expect("an adapter");
    assert_eq!(engine.raster(), raster, "{} cannot", engine.adapter());
    engine
}

/// The results at one pose; times of compute and of render are in ms.
#[derive(Default)]
struct Found {
    wall: [f64; 2],
    cpu: [f64; 2],
    /// From submission to answer.
    device: [f64; 2],
    set_up: u64,
    rendered: u64,
    differ: usize,
}

fn measure(scene: &str, world: &World) {
    let sensor = preset("video-camera").expect("a preset");
    let poses = free_poses(world, number("PRESIGHT_POSES", 10), 1).expect("free poses");
    let mut engines = [Raster::Compute, Raster::Render].map(open);
    eprintln!("{scene}, {} x {}, on {}", sensor.width(), sensor.height(), engines[0].adapter());
    let found: Vec<_> = poses.iter().map(|pose| at_pose(world, &sensor, pose, &mut engines)).collect();
    println!(
        "| {scene} | {} | {} | {} | {} | {} | {} of {} |",
        compared(&found.iter().map(|f| f.wall).collect::<Vec<_>>()),
        compared(&found.iter().map(|f| f.cpu).collect::<Vec<_>>()),
        compared(&found.iter().map(|f| f.device).collect::<Vec<_>>()),
        middle(found.iter().map(|f| f.set_up as f64).collect()),
        middle(found.iter().map(|f| f.rendered as f64).collect()),
        found.iter().map(|f| f.differ).sum::<usize>(),
        poses.len() as u32 * sensor.width() * sensor.height(),
    );
}

/// The medians for compute and render over the poses, and the median ratio.
fn compared(pairs: &[[f64; 2]]) -> String {
    let mut ratios: Vec<f64> = pairs.iter().map(|[compute, render]| render / compute).collect();
    ratios.sort_by(f64::total_cmp);
    let of = |k: usize| middle(pairs.iter().map(|pair| pair[k]).collect());
    let (least, most) = (ratios[0], ratios[ratios.len() - 1]);
    format!("{:.1} | {:.1} | {:.2} ({least:.2}, {most:.2})", of(0), of(1), middle(ratios))
}

fn at_pose(world: &World, sensor: &Sensor, pose: &Pose, engines: &mut [GpuEngine; 2]) -> Found {
    let request = Request::default();
    let mut plan = FramePlan::new(world, sensor, pose, &request).expect("a valid pose");
    let mut images = [Images::default(), Images::default()];
    let mut found = Found::default();
    let mut times: [[Vec<f64>; 3]; 2] = Default::default();
    for repeat in 0..number("PRESIGHT_REPEATS", 15) + 2 {
        for ((engine, images), times) in engines.iter_mut().zip(&mut images).zip(&mut times) {
            let (wall, cpu) = (Instant::now(), ProcessTime::now());
            plan.renew(world, sensor, pose, &request).expect("a valid pose");
            let mut stats = Stats::default();
            engine.render(&plan, images, &mut stats).expect("the engine renders");
            // The first two runs create buffers and pipelines.
            if repeat >= 2 {
                times[0].push(wall.elapsed().as_secs_f64() * 1e3);
                times[1].push(cpu.elapsed().as_secs_f64() * 1e3);
                times[2].push(stats.stage_ms(StageName::Device).unwrap_or(0.0));
            }
            found.set_up = stats.count_of(CountName::PolygonsSetUp).unwrap_or(0);
            found.rendered = stats.count_of(CountName::PolygonsRendered).unwrap_or(0);
        }
    }
    let [compute, render] = &images;
    let bits = |image: &[f32]| image.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    let ids = compute.polygon_id.iter().zip(&render.polygon_id);
    let ranges = bits(&compute.range).into_iter().zip(bits(&render.range));
    found.differ = ids.zip(ranges).filter(|((a, b), (c, d))| a != b || c != d).count();
    let [compute, render] = times.map(|of_engine| of_engine.map(middle));
    [found.wall, found.cpu, found.device] = [0, 1, 2].map(|k| [compute[k], render[k]]);
    found
}

fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
