//! Estimates what each part of a prediction costs on one thread of the CPU engine, and compares it with the limit that
//! memory sets: `cargo bench --bench cost [-- SCENE...]`, on a quiet machine.
//!
//! The bench times the stages and counts their parts at free poses of each scene with each sensor; the fastest of five
//! runs counts. Part costs are the nonnegative least-squares fit to each stage's times, by relative error. A part's
//! bytes are the bytes that it reads or writes for the first time.

#![allow(missing_docs, reason = "a bench has no interface")]
#![allow(clippy::print_stdout, reason = "a bench prints a table")]

#[path = "common/scenes.rs"]
mod scenes;

use presight_model::world::World;
use presight_predict::request::Request;
use presight_read::preset;
use presight_render::cpu::CpuEngine;
use presight_render::plan::{CountName, StageName};
use presight_render::plan::{FramePlan, Images, Stats};
use std::hint::black_box;
use std::time::Instant;

const SCENES: [&str; 4] = ["hospital", "factory_hall", "scenes/factory.rhai", scenes::OPEN_HALL];
const SENSORS: [&str; 5] =
    ["microwave-radar-image", "video-camera", "laser-range-camera", "microwave-radar-scan", "vlp-16"];

/// A part of a stage: its name, the bytes that it moves, and its number in a frame.
struct Part {
    name: &'static str,
    bytes: f64,
    count: fn(&Frame) -> f64,
}

/// The milliseconds of each stage, and the counts.
struct Frame {
    selection: f64,
    stats: Stats,
    pixels: f64,
}

impl Frame {
    fn count(&self, name: CountName) -> f64 {
        self.stats.count_of(name).unwrap_or(0) as f64
    }

    fn ms(&self, stage: StageName) -> f64 {
        self.stats.stage_ms(stage).unwrap_or(0.0)
    }
}

/// A stage, its time, and its parts.
type Stage = (&'static str, fn(&Frame) -> f64, Vec<Part>);

fn stages() -> [Stage; 4] {
    let part = |name, bytes, count| Part { name, bytes, count };
    [
        (
            "selection",
            |f| f.selection,
            vec![
                part("frame", 0.0, |_| 1.0),
                // The cluster's box, and the run made from it.
                part("cluster selected", 80.0, |f| f.count(CountName::RunsSelected)),
            ],
        ),
        (
            "hidden",
            |f| f.ms(StageName::Hidden),
            vec![part("cluster compared with the depth drawn", 80.0, |f| f.count(CountName::RunsSelected))],
        ),
        (
            "setup",
            |f| f.ms(StageName::Setup),
            vec![
                part("frame", 0.0, |_| 1.0),
                // Record, three corners, a vertex, a plane.
                part("polygon placed", 59.0, |f| f.count(CountName::PolygonsPlaced)),
                // Three corners, three vertices.
                part("polygon passed", 48.0, |f| f.count(CountName::PolygonsPassed)),
                part("polygon bounded", 0.0, |f| f.count(CountName::PolygonsBounded)),
                // Reads the plane; writes planes, edges, bounds and the data for the images.
                part("polygon set up", 190.0, |f| {
                    f.count(CountName::PolygonsSetUp) + f.count(CountName::PolygonsBetweenSamples)
                }),
            ],
        ),
        (
            "rasterization",
            |f| f.ms(StageName::Rasterization),
            vec![
                part("span", 0.0, |f| f.count(CountName::Spans)),
                // Depth and winner stay in the cache of a core.
                part("sample drawn", 0.0, |f| f.count(CountName::SamplesTested)),
                // Read again in each further wave.
                part("sample whose depth is looked at again", 0.0, |f| f.pixels * (f.count(CountName::Waves) - 1.0)),
                // Depth and winner are written and read; four images are written, and fetched before that.
                part("pixel cleared and resolved", 64.0, |f| f.pixels),
            ],
        ),
    ]
}

fn measure(scene: &str) -> Vec<Frame> {
    let world = World::new(scenes::environment(scene));
    let poses = scenes::poses(scene, &world, 10);
    let mut engine = CpuEngine::new(1).expect("a thread");
    let (mut images, mut frames, request) = (Images::default(), Vec::new(), Request::default());
    for name in SENSORS {
        let sensor = preset(name).expect("a preset");
        let mut plan = FramePlan::new(&world, &sensor, &poses[0], &request).expect("a valid pose");
        for pose in &poses {
            let mut one = || {
                let start = Instant::now();
                plan.renew(&world, &sensor, pose, &request).expect("a valid pose");
                let selection = start.elapsed().as_secs_f64() * 1e3;
                let mut stats = Stats::default();
                engine.render(&plan, &mut images, &mut stats).expect("the engine renders");
                let pixels = f64::from(sensor.width()) * f64::from(sensor.height());
                Frame { selection, stats, pixels }
            };
            let total = |f: &Frame| f.selection + f.stats.stages_ms.iter().map(|(_, ms)| ms).sum::<f64>();
            one();
            let runs = (0..5).map(|_| one());
            frames.extend(runs.min_by(|a, b| total(a).total_cmp(&total(b))));
        }
    }
    frames
}

/// Solves a small positive definite system.
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for k in 0..n {
        for i in k + 1..n {
            let factor = a[i][k] / a[k][k];
            for j in k..n {
                a[i][j] -= factor * a[k][j];
            }
            b[i] -= factor * b[k];
        }
    }
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|j| a[k][j] * b[j]).sum();
        b[k] = (b[k] - known) / a[k][k];
    }
    b
}

/// The cost of each part, in milliseconds; negative costs are set to zero.
fn fit(rows: &[(Vec<f64>, f64)]) -> Vec<f64> {
    let mut used: Vec<usize> = (0..rows[0].0.len()).collect();
    loop {
        let entry = |i: usize, j: usize| rows.iter().map(|(x, y)| x[i] * x[j] / (y * y)).sum::<f64>();
        let a = used.iter().map(|&i| used.iter().map(|&j| entry(i, j)).collect()).collect();
        let b = used.iter().map(|&i| rows.iter().map(|(x, y)| x[i] / y).sum()).collect();
        let cost = solve(a, b);
        let least = cost.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1)).map(|(i, cost)| (i, *cost));
        match least {
            Some((i, cost)) if cost < 0.0 => drop(used.remove(i)),
            _ => {
                let mut all = vec![0.0; rows[0].0.len()];
                used.iter().zip(cost).for_each(|(&i, cost)| all[i] = cost);
                return all;
            }
        }
    }
}

/// Nanoseconds for a byte of memory read and for one written, on one thread.
fn memory() -> [f64; 2] {
    let mut large = vec![1u64; 32 << 20];
    let mut ns = [f64::INFINITY; 2];
    for _ in 0..5 {
        let start = Instant::now();
        black_box(large.iter().fold(0u64, |sum, x| sum.wrapping_add(*x)));
        ns[0] = ns[0].min(start.elapsed().as_secs_f64() * 1e9 / (8.0 * large.len() as f64));
        let start = Instant::now();
        large.fill(black_box(2));
        ns[1] = ns[1].min(start.elapsed().as_secs_f64() * 1e9 / (8.0 * large.len() as f64));
    }
    ns
}

fn main() {
    let named: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let scenes = if named.is_empty() { SCENES.map(str::to_owned).to_vec() } else { named };
    let frames: Vec<Frame> = scenes.iter().flat_map(|scene| measure(scene)).collect();
    let [read, written] = memory();
    println!("{} frames; memory: {:.1} GB/s read, {:.1} GB/s written\n", frames.len(), 1.0 / read, 1.0 / written);
    println!(
        "| stage, share of the time | part | ns | bytes | ns by memory | share of the stage |\n|---|---|---|---|---|---|"
    );
    let total: f64 = stages().iter().map(|(_, ms, _)| frames.iter().map(ms).sum::<f64>()).sum();
    for (name, ms, parts) in stages() {
        let row = |f: &Frame| (parts.iter().map(|part| (part.count)(f)).collect::<Vec<f64>>(), ms(f));
        let rows: Vec<_> = frames.iter().map(row).filter(|(_, ms)| *ms > 1e-3).collect();
        let cost = fit(&rows);
        let stage: f64 = rows.iter().map(|(_, ms)| ms).sum();
        let told = |x: &[f64]| x.iter().zip(&cost).map(|(x, c)| x * c).sum::<f64>();
        let mut errors: Vec<f64> = rows.iter().map(|(x, ms)| (told(x) / ms - 1.0).abs()).collect();
        errors.sort_by(f64::total_cmp);
        for (i, (part, cost)) in parts.iter().zip(&cost).enumerate() {
            let own: f64 = rows.iter().map(|(x, _)| x[i] * cost).sum();
            let limit = if part.bytes > 0.0 { format!("{:.1}", part.bytes * read.max(written)) } else { String::new() };
            let bytes = if part.bytes > 0.0 { format!("{:.0}", part.bytes) } else { String::new() };
            let share = format!("{:.0} %", 100.0 * own / stage);
            println!(
                "| {name} {:.0} % | {} | {:.2} | {bytes} | {limit} | {share} |",
                100.0 * stage / total,
                part.name,
                cost * 1e6
            );
        }
        println!("| {name} | median error of the sum | {:.0} % | | | |", 100.0 * errors[errors.len() / 2]);
    }
}
