//! Compares the two ways of the CPU engine: `cargo bench --bench ways -- [SCENE...]`, or `-- bits RAYS [SEED]`.
//!
//! From plan to all default images in memory, in turns in one process, by its CPU time: least of `PRESIGHT_REPEATS` (15) frames at each of
//! `PRESIGHT_POSES` (5) free poses, on `PRESIGHT_THREADS` (1). Between frames 32 MB are written: *cold*; `PRESIGHT_WARM=1` leaves that out.
//! `PRESIGHT_SENSORS=a,b` names sensors, `PRESIGHT_SSE=1` searches without AVX2. `bits` draws hard scenes of the test kit both ways until so
//! many rays are compared, and judges what differs by the reference.
#![expect(clippy::print_stdout, reason = "a bench prints its table")]

#[allow(dead_code, reason = "other benches share it")]
#[path = "common/cameras.rs"]
mod cameras;
#[allow(dead_code, reason = "other benches share it")]
#[path = "common/scenes.rs"]
mod scenes;

use cpu_time::ProcessTime;
use glam::DVec3;
use presight_model::geometry::Pose;
use presight_model::sensor::{Geometry, RayTable, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::request::Request;
use presight_read::preset;
use presight_render::cpu::{CpuEngine, Vectors};
use presight_render::plan::{ChosenWay, CountName, FramePlan, Images, Output, PlanBuffers, Samples, Stats, Way};
use presight_render::verify::{PixelValues, Precision, compare_values};
use presight_testkit::hard::{case, grazing};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{Config, RngSeed, TestRunner};
use std::hint::black_box;
use std::sync::Arc;

fn number(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().expect("a number"))
}

fn main() {
    let named: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    if named.first().is_some_and(|what| what == "bits") {
        let of = |i: usize, default: u64| named.get(i).map_or(default, |text| text.parse().expect("a number"));
        return bits(of(1, 10_000_000) as usize, of(2, 1));
    }
    let known = [
        "hospital",
        "factory_hall",
        "city",
        "scenes/factory.rhai",
        "open_hall",
        "warehouse_small",
        "office_willowgarage",
    ];
    let scenes: Vec<&str> = if named.is_empty() { known.into() } else { named.iter().map(String::as_str).collect() };
    println!(
        "| scene | sensor | raster, ms of CPU | tiles, ms | by counts, ms | raster over tiles: median (least, most) | the faster one over by counts | polygons left, a ray | rays that differ |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for scene in scenes {
        let world = World::new(scenes::environment(scene));
        let start = ProcessTime::now();
        world.make_ray_trees(0..world.environment().objects().len() as u32).expect("memory");
        let built = start.elapsed();
        let mut meshes: Vec<_> = world.environment().objects().iter().map(|o| &o.mesh).collect();
        meshes.sort_unstable_by_key(|mesh| Arc::as_ptr(mesh));
        meshes.dedup_by_key(|mesh| Arc::as_ptr(mesh));
        let trees = meshes.iter().filter_map(|mesh| mesh.known_ray_tree());
        let (mut bytes, mut triangles) = (0, 0);
        trees.for_each(|tree| {
            bytes += tree.bytes();
            triangles += tree.blocks.iter().map(|b| b.count as usize).sum::<usize>();
        });
        let each = 1.0 / triangles.max(1) as f64;
        println!(
            "| {scene} | {triangles} triangles in trees | {:.2} us of CPU, {:.1} bytes each | | | | | | |",
            built.as_secs_f64() * 1e6 * each,
            bytes as f64 * each
        );
        for sensor in sensors() {
            measure(scene, &world, &sensor);
        }
    }
}

/// Presets, one row of 3,600, lenses, and a rosette of 24,000 rays in time order.
fn sensors() -> Vec<Sensor> {
    let presets =
        ["laser-scanner", "vlp-16", "microwave-radar-scan", "laser-range-camera", "microwave-radar-image", "os1-128"];
    let mut all: Vec<Sensor> = presets.iter().map(|name| preset(name).expect("a preset")).collect();
    all.push(rosette());
    all.extend(cameras::sensors());
    let wanted = std::env::var("PRESIGHT_SENSORS").ok();
    all.retain(|s| wanted.as_ref().is_none_or(|names| names.split(',').any(|name| name == s.spec().name)));
    all
}

/// Two wedge prisms turned against each other: 70 degrees across.
fn rosette() -> Sensor {
    let ray = |i: u32| {
        let t = f64::from(i) / 24_000.0;
        let (fast, slow) = ((t * 731.0).sin_cos(), (t * -487.3).sin_cos());
        let wedge = 17.5f64.to_radians().tan();
        DVec3::new(1.0, wedge * (fast.1 + slow.1), wedge * (fast.0 + slow.0))
    };
    let table = RayTable::new(240, 100, (0..24_000).map(ray).collect()).expect("sound rays");
    let spec = SensorSpec::new("rosette", "laser", Geometry::Rays(table)).with_limits(0.1, 100.0);
    Sensor::new(spec).expect("a valid table")
}

fn engine() -> CpuEngine {
    let vectors = if number("PRESIGHT_SSE", 0) > 0 { Vectors::Sse42 } else { Vectors::best() };
    CpuEngine::new(number("PRESIGHT_THREADS", 1)).expect("threads").with_vectors(vectors)
}

/// Both ways.
const WAYS: [ChosenWay; 2] = [ChosenWay::RASTER, ChosenWay::TILES];

/// Polygons that may show after the first wave, for each ray; `None` if there is one wave only.
fn left(engine: &mut CpuEngine, world: &World, sensor: &Sensor, pose: &Pose) -> Option<f64> {
    let (chosen, mut stats) = (ChosenWay { at_once: true, max_left: 0, ..ChosenWay::RASTER }, Stats::default());
    let plan = FramePlan::by(chosen, PlanBuffers::default(), world, sensor, pose, (&Request::default()).into());
    engine.render(&plan.expect("a valid pose"), &mut Images::default(), &mut stats).expect("the engine renders");
    let rays = f64::from(sensor.width()) * f64::from(sensor.height());
    stats.count_of(CountName::PolygonsLeft).map(|left| left as f64 / rays)
}

fn measure(scene: &str, world: &World, sensor: &Sensor) {
    let poses = scenes::poses(scene, world, number("PRESIGHT_POSES", 5));
    let mut engine = engine();
    let request = Request::default();
    let mut cold = vec![0u8; if number("PRESIGHT_WARM", 0) > 0 { 0 } else { 32 << 20 }];
    let (mut times, mut differ, mut max_left) = ([const { Vec::new() }; 3], 0, 0f64);
    let mut images = <[Images; 3]>::default();
    let ways = [WAYS[0], WAYS[1], Way::Counts.choose(world, sensor)];
    for pose in &poses {
        let mut least = [f64::INFINITY; 3];
        for round in 0..number("PRESIGHT_REPEATS", 15) + 1 {
            for (way, images) in images.iter_mut().enumerate() {
                cold.iter_mut().step_by(64).for_each(|byte| *byte = round as u8);
                black_box(&cold);
                let start = ProcessTime::now();
                let plan = FramePlan::by(ways[way], PlanBuffers::default(), world, sensor, pose, (&request).into());
                let plan = plan.expect("a valid pose");
                engine.render(&plan, images, &mut Stats::default()).expect("the engine renders");
                if round > 0 {
                    least[way] = least[way].min(start.elapsed().as_secs_f64() * 1e3);
                }
            }
        }
        times.iter_mut().zip(least).for_each(|(times, least)| times.push(least));
        differ += differing(&images[0], &images[1]).len() + differing(&images[0], &images[2]).len();
        let left = left(&mut engine, world, sensor, pose);
        max_left = max_left.max(left.unwrap_or(0.0));
        if number("PRESIGHT_EACH", 0) > 0 {
            println!("{scene} {} {left:?} {least:?}", sensor.spec().name);
        }
    }
    let mut ratios: Vec<f64> = times[0].iter().zip(&times[1]).map(|(raster, tiles)| raster / tiles).collect();
    ratios.sort_by(f64::total_cmp);
    let mut kept: Vec<f64> = (0..poses.len()).map(|i| times[0][i].min(times[1][i]) / times[2][i]).collect();
    kept.sort_by(f64::total_cmp);
    println!(
        "| {scene} | {} {} x {} | {:.3} | {:.3} | {:.3} | {:.2} ({:.2}, {:.2}) | {:.2} ({:.2}) | {max_left:.3} | {differ} of {} |",
        sensor.spec().name,
        sensor.width(),
        sensor.height(),
        middle(&times[0]),
        middle(&times[1]),
        middle(&times[2]),
        middle(&ratios),
        ratios[0],
        ratios[ratios.len() - 1],
        middle(&kept),
        kept[0],
        poses.len() as u32 * sensor.width() * sensor.height(),
    );
}

fn middle(values: &[f64]) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Pixels whose bits differ in any image.
fn differing(one: &Images, other: &Images) -> Vec<usize> {
    let words = |images: &Images, output: Output| match images.samples(output) {
        Some(Samples::Floats(image)) => image.iter().map(|v| v.to_bits()).collect(),
        Some(Samples::Ids(image)) => image.to_vec(),
        Some(Samples::Vectors(image)) => {
            image.iter().map(|v| v.map(f32::to_bits)).map(|v| v[0] ^ v[1] ^ v[2]).collect()
        }
        None => Vec::new(),
    };
    let mut all: Vec<usize> = Vec::new();
    for output in Output::ALL {
        let (a, b) = (words(one, output), words(other, output));
        all.extend((0..a.len().max(b.len())).filter(|i| a.get(*i) != b.get(*i)));
    }
    all.sort_unstable();
    all.dedup();
    all
}

/// Draws hard scenes until this number of rays is compared.
fn bits(rays: usize, seed: u64) {
    let config = Config { rng_seed: RngSeed::Fixed(seed), failure_persistence: None, ..Config::default() };
    let mut runner = TestRunner::new(config);
    let cases = prop_oneof![2 => case(), 1 => grazing()];
    let (mut engine, mut done, mut at_edges, mut faults) = (engine(), 0usize, 0, 0);
    let mut told = 0;
    while done < rays {
        let drawn = cases.new_tree(&mut runner).expect("a case").current();
        let (world, pose, sensors) = drawn.build();
        for sensor in &sensors {
            let mut images = [Images::default(), Images::default()];
            let request = presight_testkit::plan(&world, sensor, &pose).request;
            for (way, images) in WAYS.iter().zip(&mut images) {
                let plan = FramePlan::by(*way, PlanBuffers::default(), &world, sensor, &pose, request);
                engine.render(&plan.expect("a valid pose"), images, &mut Stats::default()).expect("the engine renders");
            }
            done += images[0].range.len();
            let differ = differing(&images[0], &images[1]);
            if !differ.is_empty() {
                let found = judge(&world, sensor, &pose, &images, &differ);
                at_edges += found[0];
                faults += found[1];
            }
        }
        if done / 10_000_000 > told {
            told = done / 10_000_000;
            println!("{done} rays: {at_edges} differ at edges by the reference, {faults} elsewhere");
        }
    }
    println!("{done} rays, seed {seed}: {at_edges} differ at edges by the reference, {faults} elsewhere");
    assert_eq!(faults, 0);
}

/// How many of some pixels the reference calls edges, and how many not.
fn judge(world: &World, sensor: &Sensor, pose: &Pose, images: &[Images; 2], differ: &[usize]) -> [usize; 2] {
    let plan = presight_testkit::plan(world, sensor, pose);
    let truth = presight_testkit::reference(&plan);
    let mut found = [0, 0];
    for &i in differ {
        let at = (i as u32 % truth.width, i as u32 / truth.width);
        let own = PixelValues::of(&truth, i);
        let reports = images
            .each_ref()
            .map(|images| compare_values([(at, own, PixelValues::of(images, i))].into_iter(), &plan, Precision::F64));
        let is_edge = reports.iter().all(|r| r.fault == 0) && reports.iter().any(|r| r.edge + r.coincident > 0);
        found[usize::from(!is_edge)] += 1;
        if !is_edge {
            println!(
                "{} {at:?}: {own:?} raster {:?} tiles {:?}",
                sensor.spec().name,
                PixelValues::of(&images[0], i),
                PixelValues::of(&images[1], i)
            );
        }
    }
    found
}
