//! A pinhole camera by the hardware rasterizer beside the engine's compute spans: `cargo bench --bench render_pipeline`.
//!
//! Both on the same adapter in one process, by turns, at the same free poses, from plan to all four default outputs in
//! memory. Scenes where `PRESIGHT_DATA` (default `../shared/data`) holds them. `PRESIGHT_POSES`, `PRESIGHT_REPEATS`.
#![expect(clippy::print_stdout, reason = "a bench prints its table")]

mod pipeline;

use pipeline::{Order, Pipeline};
use presight::free_poses::free_poses;
use presight::gpu::{DeviceOptions, GpuEngine};
use presight::io::gltf::{ImportOptions, import};
use presight::verify::{Precision, Report, compare};
use presight::{FramePlan, Images, Pose, Request, Sensor, Stats, World, preset, reference};
use std::path::{Path, PathBuf};
use std::time::Instant;

fn number(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().expect("a number"))
}

fn main() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    for name in ["hospital", "factory_hall"] {
        let path = data.join("env").join(name).with_extension("glb");
        if path.is_file() {
            let imported = import(&path, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"));
            measure(name, &World::new(imported.environment));
        } else {
            println!("SKIPPED: {} is not there", path.display());
        }
    }
}

type Render<'a> = Box<dyn FnMut(&FramePlan, &mut Images) + 'a>;

/// A way of making images, its times at each pose and what is wrong with them.
struct Rival<'a> {
    name: &'static str,
    render: Render<'a>,
    precision: Precision,
    medians: Vec<f64>,
    least: Vec<f64>,
    report: Report,
    other_ids: usize,
}

fn measure(scene: &str, world: &World) {
    let sensor = preset("video-camera").expect("a preset");
    let poses = free_poses(world, number("PRESIGHT_POSES", 10), 1).expect("free poses");
    let plan = FramePlan::new(world, &sensor, &poses[0], &Request::default()).expect("a sound pose");
    let mut engine = GpuEngine::new(DeviceOptions::default()).expect("an adapter");
    let pipeline = std::cell::RefCell::new(Pipeline::new(&plan));
    println!("{scene}: engine on {}; pipeline on {}", engine.adapter(), pipeline.borrow().adapter);
    let by = |order| {
        let pipeline = &pipeline;
        Box::new(move |plan: &FramePlan, images: &mut Images| pipeline.borrow_mut().render(plan, order, images))
    };
    let spans = Box::new(|plan: &FramePlan, images: &mut Images| {
        engine.render(plan, images, &mut Stats::default()).expect("the engine renders");
    });
    let mut rivals = [
        rival("compute spans", spans, Precision::F32),
        rival("render pipeline, nearest first", by(Order::Front), Precision::Snapped),
        rival("render pipeline, by object", by(Order::Object), Precision::Snapped),
    ];
    for pose in &poses {
        at_pose(world, &sensor, pose, &mut rivals);
    }
    let pixels = poses.len() as u32 * sensor.width() * sensor.height();
    println!(
        "scene, way, ms at each pose: median (best run), times as fast as spans, of {pixels} pixels: other id, edge,"
    );
    println!("coincident, fault");
    for r in &rivals {
        // At each pose by itself, for poses differ more than rivals.
        let faster = |of: &[f64], than: &[f64]| middle(than.iter().zip(of).map(|(a, b)| a / b).collect());
        println!(
            "| {scene} | {} | {:.1} ({:.1}) | {:.2} x ({:.2} x) | {} | {} | {} | {} |",
            r.name,
            middle(r.medians.clone()),
            middle(r.least.clone()),
            faster(&r.medians, &rivals[0].medians),
            faster(&r.least, &rivals[0].least),
            r.other_ids,
            r.report.edge,
            r.report.coincident,
            r.report.fault
        );
    }
}

fn rival<'a>(name: &'static str, render: Render<'a>, precision: Precision) -> Rival<'a> {
    Rival { name, render, precision, medians: Vec::new(), least: Vec::new(), report: Report::default(), other_ids: 0 }
}

fn at_pose(world: &World, sensor: &Sensor, pose: &Pose, rivals: &mut [Rival<'_>]) {
    let request = Request::default();
    let mut plan = FramePlan::new(world, sensor, pose, &request).expect("a sound pose");
    let mut right = Images::default();
    reference::render(&plan, &mut right).expect("the reference renders");
    let mut images = Images::default();
    let mut times = vec![Vec::new(); rivals.len()];
    for repeat in 0..number("PRESIGHT_REPEATS", 15) + 2 {
        for (rival, times) in rivals.iter_mut().zip(&mut times) {
            let start = Instant::now();
            plan.renew(world, sensor, pose, &request).expect("a sound pose");
            (rival.render)(&plan, &mut images);
            // The first two make buffers and pipelines.
            if repeat >= 2 {
                times.push(start.elapsed().as_secs_f64() * 1e3);
                continue;
            }
            if repeat == 1 {
                rival.report.add(compare(&right, &images, &plan, rival.precision).expect("images of one shape"));
                let pairs = right.polygon_id.iter().zip(&images.polygon_id);
                rival.other_ids += pairs.filter(|(a, b)| a != b).count();
            }
        }
    }
    for (rival, times) in rivals.iter_mut().zip(times) {
        rival.least.push(times.iter().copied().fold(f64::INFINITY, f64::min));
        rival.medians.push(middle(times));
    }
}

fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}
