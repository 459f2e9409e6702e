//! Cameras with lenses, fisheyes and ray tables beside a pinhole camera of as many pixels: `cargo bench --bench lenses [-- SCENE...]`.
//!
//! Scenes are names of the shared data (`PRESIGHT_DATA`, default `../shared/data`) or paths of `.glb` and `.rhai` files.
//! `PRESIGHT_POSES` free poses (default 20), `PRESIGHT_ENGINE` cpu or gpu, `PRESIGHT_SENSORS` names, comma-separated. A row tells the median over the poses of the
//! whole prediction (the fastest of three at each), selection included, the median of its ratio to the pinhole's, and what the sensor's tables take.

#![allow(missing_docs, reason = "a bench has no interface")]
#![allow(clippy::print_stdout, reason = "the table is what it is for")]

use glam::DVec3;
use presight::free_poses::free_poses;
use presight::io::gltf::{ImportOptions, import};
use presight::sensor::PixelGrid;
use presight::{
    Backend, Camera, Distortion, Geometry, Options, Pose, Predictor, RayTable, Request, Sensor, SensorSpec, World,
};
use std::path::{Path, PathBuf};
use std::time::Instant;

const SIZE: (u32, u32) = (640, 480);

fn camera(name: &str, f: f64, distortion: Distortion) -> Sensor {
    let (width, height) = SIZE;
    let camera = Camera { distortion, ..Camera::pinhole(width, height, f, f, 319.5, 239.5) };
    Sensor::new(SensorSpec::new(name, "video", Geometry::Camera(camera))).expect("a sound camera")
}

/// Equidistant, so many degrees across the image's width; pixels past that are seen, too.
fn fisheye(name: &str, degrees: f64) -> Sensor {
    camera(name, f64::from(SIZE.0) / degrees.to_radians(), Distortion::Equidistant([-0.003, 0.0, 0.0, 0.0]))
}

fn table(name: &str, ray: impl Fn(u32, u32) -> DVec3) -> Sensor {
    let (width, height) = SIZE;
    let rays = (0..height).flat_map(|r| (0..width).map(move |c| (c, r))).map(|(c, r)| ray(c, r)).collect();
    let table = RayTable::new(width, height, rays).expect("sound rays");
    Sensor::new(SensorSpec::new(name, "video", Geometry::Rays(table))).expect("a sound table")
}

fn sensors() -> Vec<Sensor> {
    let pinhole = camera("pinhole", 525.0, Distortion::None);
    let listed = pinhole.clone();
    let same = move |c: u32, r: u32| listed.body_from_image() * listed.ray(c, r).expect("a ray a pixel");
    // A turning head of staggered beams: -25 to 25 degrees all round, every eleventh beam lost.
    let beams = |c: u32, r: u32| {
        let azimuth = std::f64::consts::TAU * (f64::from(c) + 0.25 * f64::from(r % 4)) / f64::from(SIZE.0);
        let elevation = (25.0 - 50.0 * f64::from(r) / f64::from(SIZE.1 - 1)).to_radians();
        let ray = DVec3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
        if (c + 7 * r).is_multiple_of(11) { DVec3::NAN } else { ray }
    };
    let rational = [0.47, 0.13, 2e-4, -1e-4, 0.01, 0.55, 0.2, 0.03];
    vec![
        pinhole,
        camera("plumb-bob", 525.0, Distortion::PlumbBob([-0.25, 0.08, 3e-4, -2e-4, -0.01])),
        camera("rational", 525.0, Distortion::RationalPolynomial(rational)),
        fisheye("fisheye 60", 60.0),
        fisheye("fisheye 120", 120.0),
        fisheye("fisheye 200", 200.0),
        table("pinhole's rays", same),
        table("beams all round", beams),
    ]
}

fn world(scene: &str) -> World {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let path = if scene.contains('.') {
        root.join(scene)
    } else {
        let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
        data.join("env").join(scene).with_extension("glb")
    };
    #[cfg(feature = "script")]
    if scene.ends_with(".rhai") {
        let loaded = presight::io::script::load(&path, &ImportOptions::default(), &mut |_| {});
        return World::new(loaded.unwrap_or_else(|e| panic!("{e}")).environment);
    }
    World::new(import(&path, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}")).environment)
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Milliseconds at each pose.
fn times(predictor: &mut Predictor, world: &World, sensor: &Sensor, poses: &[Pose]) -> Vec<f64> {
    let request = Request::default();
    let mut one = |pose: &Pose| {
        let start = Instant::now();
        predictor.predict(world, sensor, pose, &request).expect("it predicts");
        start.elapsed().as_secs_f64() * 1e3
    };
    one(&poses[0]);
    poses.iter().map(|pose| (0..3).map(|_| one(pose)).fold(f64::INFINITY, f64::min)).collect()
}

fn main() {
    let named: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let usual = ["hospital", "factory_hall", "city", "scenes/factory.rhai"].map(str::to_owned).to_vec();
    let scenes = if named.is_empty() { usual } else { named };
    let poses = std::env::var("PRESIGHT_POSES").map_or(20, |n| n.parse().expect("a number of poses"));
    let gpu = std::env::var("PRESIGHT_ENGINE").is_ok_and(|e| e == "gpu");
    let wanted = std::env::var("PRESIGHT_SENSORS").unwrap_or_default();
    let backend = if gpu { Backend::Gpu } else { Backend::Cpu };
    let mut predictor = Predictor::new(Options::new(backend)).expect("the engine starts");
    println!("{} x {}, {poses} free poses, medians", SIZE.0, SIZE.1);
    for scene in scenes {
        let world = world(&scene);
        let poses = free_poses(&world, poses, 1995).expect("free poses");
        let mut pinhole: Vec<f64> = Vec::new();
        for sensor in sensors() {
            let name = sensor.spec().name.clone();
            if !pinhole.is_empty() && !wanted.is_empty() && !wanted.split(',').any(|w| w == name) {
                continue;
            }
            let times = times(&mut predictor, &world, &sensor, &poses);
            if pinhole.is_empty() {
                pinhole.clone_from(&times);
            }
            let ratio = median(times.iter().zip(&pinhole).map(|(t, p)| t / p).collect());
            let tables = match sensor.grid() {
                PixelGrid::Rays(rays) => format!("{:.1} MB", rays.bytes() as f64 * 1e-6),
                PixelGrid::Lines(_) => "lines".to_owned(),
            };
            println!("| {scene} | {name} | {tables} | {:.2} ms | {ratio:.2} x |", median(times));
        }
    }
}
