//! Compares the paper's two ways to curved projections: planar images with a lookup table for the curved pixels, at
//! one, two and four times the resolution, against exact spherical spans and against a ray table.
//!
//! `cargo bench --bench resampling` prints a table. Scenes: `scenes/room.glb`, and the hospital and the factory hall in
//! `PRESIGHT_DATA` (default `../shared/data`). Errors are relative to the reference; times are medians of a whole
//! prediction on all cores, with range, ids and angle in memory.

#![expect(clippy::print_stdout, reason = "a bench prints its figures")]

use glam::DVec3;
use presight_model::error::Result;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Angles, Camera, Geometry, RayTable, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_read::gltf::{ImportOptions, import};
use presight_render::plan::{FramePlan, ImageRequest, Images, Output};
use presight_render::reference;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// A spherical segment of 90 by 60 degrees, a quarter of a degree a pixel: as much as one planar image can hold.
const STEP_DEG: f64 = 0.25;
const COLUMNS: u32 = 360;
const ROWS: u32 = 240;
/// Timed predictions.
const RUNS: usize = 31;

fn segment() -> Result<Sensor> {
    let angles = |count: u32| {
        let start_deg = -0.5 * STEP_DEG * f64::from(count - 1);
        Angles::Uniform { start_deg, step_deg: STEP_DEG, count }
    };
    let scanner = Scanner { azimuth: angles(COLUMNS), elevation: angles(ROWS), beam_height_deg: None };
    Sensor::new(SensorSpec::new("segment", "laser", Geometry::Scanner(scanner)))
}

/// The same rays from a table.
fn table(sensor: &Sensor) -> Result<Sensor> {
    let pixels = (0..ROWS).flat_map(|row| (0..COLUMNS).map(move |column| (column, row)));
    let rays = pixels.map(|(column, row)| sensor.ray(column, row).unwrap_or(DVec3::NAN)).collect();
    Sensor::new(SensorSpec::new("table", "laser", Geometry::Rays(RayTable::new(COLUMNS, ROWS, rays)?)))
}

/// A planar image that covers the segment, with `scale` times the segment's resolution at its centre.
fn planar(scale: f64) -> Result<Sensor> {
    let focal = scale / STEP_DEG.to_radians();
    let half = |n: u32| (0.5 * STEP_DEG * f64::from(n)).to_radians();
    let (half_width, half_height) = (half(COLUMNS).tan(), half(ROWS).tan() / half(COLUMNS).cos());
    let side = |half: f64| (2.0 * half * focal).ceil() as u32 + 2;
    let (width, height) = (side(half_width), side(half_height));
    let middle = |n: u32| 0.5 * f64::from(n - 1);
    let camera = Camera::pinhole(width, height, focal, focal, middle(width), middle(height));
    Sensor::new(SensorSpec::new("planar", "laser", Geometry::Camera(camera)))
}

/// The planar pixel that each segment pixel's ray passes through, and the ratio of range to depth_z along the ray.
fn lookup(segment: &Sensor, planar: &Sensor) -> Vec<(usize, f32)> {
    let optical_from_body = planar.body_from_image().transpose();
    let one = |column, row| {
        let ray = optical_from_body * segment.ray(column, row)?;
        let (u, v) = planar.project(ray)?;
        let (u, v) = (u.round() as usize, v.round() as usize);
        Some((v * planar.width() as usize + u, (1.0 / ray.z) as f32))
    };
    let pixels = (0..ROWS).flat_map(|row| (0..COLUMNS).map(move |column| (column, row)));
    pixels.map(|(column, row)| one(column, row).expect("the planar image holds the segment")).collect()
}

fn resample(from: &Images, lookup: &[(usize, f32)], to: &mut Images) {
    to.prepare(COLUMNS, ROWS, ImageRequest::default().outputs);
    for (at, (source, stretch)) in lookup.iter().enumerate() {
        to.range[at] = from.depth_z[*source] * stretch;
        to.polygon_id[at] = from.polygon_id[*source];
        to.object_id[at] = from.object_id[*source];
        to.cos_incidence[at] = from.cos_incidence[*source];
    }
}

/// The median in milliseconds, after one run that is not counted.
fn time(mut run: impl FnMut() -> Result<()>) -> Result<f64> {
    run()?;
    let mut times = Vec::with_capacity(RUNS);
    for _ in 0..RUNS {
        let start = Instant::now();
        run()?;
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    times.sort_by(f64::total_cmp);
    Ok(times[RUNS / 2])
}

/// The share of wrong polygons, and the mean and largest range error in metres.
fn errors(truth: &Images, other: &Images) -> (f64, f64, f64) {
    let (mut others, mut sum, mut most, mut both) = (0usize, 0.0, 0f64, 0usize);
    for at in 0..truth.pixels() {
        others += usize::from(truth.polygon_id[at] != other.polygon_id[at]);
        let (r, o) = (f64::from(truth.range[at]), f64::from(other.range[at]));
        if r.is_finite() && o.is_finite() {
            sum += (r - o).abs();
            most = most.max((r - o).abs());
            both += 1;
        }
    }
    (others as f64 / truth.pixels() as f64, sum / both.max(1) as f64, most)
}

fn scenes() -> Vec<(&'static str, PathBuf, Pose)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let text = std::fs::read_to_string(root.join("benches/peers/poses.json")).expect("poses.json is in the repository");
    let poses: serde_json::Value = serde_json::from_str(&text).expect("poses.json is JSON");
    let pose = |[x, y, z, roll, pitch, yaw]: [f64; 6]| {
        Pose::from_xyz_rpy(DVec3::new(x, y, z), roll.to_radians(), pitch.to_radians(), yaw.to_radians())
    };
    let mut all = vec![("room", root.join("scenes/room.glb"), pose([0.3, 0.35, 1.65, 0.0, 12.0, 38.0]))];
    for name in ["factory_hall", "hospital"] {
        let path = data.join("env").join(name).with_extension("glb");
        if path.is_file() {
            let first = serde_json::from_value(poses["scenes"][name][0].clone()).expect("a pose is six numbers");
            all.push((name, path, pose(first)));
        }
    }
    all
}

fn measure(name: &str, world: &World, pose: &Pose) -> Result<()> {
    let sensor = segment()?;
    let request = ImageRequest::default();
    let mut truth = Images::default();
    reference::render(&FramePlan::new(world, &sensor, pose, request)?, &mut truth)?;
    let mut predictor = Predictor::new(Options::new(Backend::Cpu))?;
    let mut images = Images::default();
    let print = |way: &str, ms: f64, images: &Images| {
        let (others, mean, most) = errors(&truth, images);
        println!("| {name} | {way} | {ms:.2} ms | {:.3} % | {mean:.2e} m | {most:.2e} m |", 100.0 * others);
    };
    for (way, sensor) in [("spherical spans", sensor.clone()), ("ray table", table(&sensor)?)] {
        let ms = time(|| {
            predictor.predict_images(world, &sensor, &SensorPose::new(*pose), request, &mut images).map(|_| ())
        })?;
        print(way, ms, &images);
    }
    for scale in [1.0, 2.0, 4.0] {
        let planar = planar(scale)?;
        let table = lookup(&sensor, &planar);
        let outputs = request.outputs.without(Output::Range).with(Output::DepthZ);
        let request = ImageRequest { outputs, ..request };
        let mut curved = Images::default();
        let ms = time(|| {
            predictor.predict_images(world, &planar, &SensorPose::new(*pose), request, &mut images)?;
            resample(&images, &table, &mut curved);
            Ok(())
        })?;
        print(&format!("planar {scale}x, {} x {}, and lookup", planar.width(), planar.height()), ms, &curved);
    }
    Ok(())
}

fn main() -> Result<()> {
    println!(
        "| scene | way to {COLUMNS} x {ROWS} spherical pixels | median | other polygons | mean range error | greatest |"
    );
    println!("|---|---|---|---|---|---|");
    for (name, path, pose) in scenes() {
        let world = World::new(import(&path, &ImportOptions::default())?.environment);
        measure(name, &world, &pose)?;
    }
    Ok(())
}
