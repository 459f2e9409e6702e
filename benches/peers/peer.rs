//! presight's side of benches/peers: `peer SCENE FOLDER POSES THREADS BACKEND` (cpu, gpu; parry for its tracer) opens a
//! scene, writes Embree's input into a folder, and then predicts by the commands on its standard input.
//!
//! The first line of output has, as JSON, the triangles (a `.glb`), the poses (rows of `world_from_body`, 3 x 4) and
//! the sensors. Sensors on a robot have poses of their own, level or leaning. The unit rays of a sensor are in
//! `SENSOR.f64` (body axes, f64, row by row, NaN where there is no ray). For each input line `SENSOR POSE REPEAT`, with
//! both numbers from 0, it prints the milliseconds of REPEAT predictions, and of CPU time, and writes the range image
//! (f32) to `range.f32`. `SENSOR POSE REPEAT cold` writes 32 MB between predictions. `SENSOR POSE cut` prints the
//! milliseconds of CPU time that a cut of the world at that height takes, and its segments.

#![allow(missing_docs, reason = "a bench has no interface")]
#![allow(clippy::print_stdout, reason = "its output is its interface")]

#[path = "../common/cameras.rs"]
mod cameras;
#[path = "../common/robots.rs"]
mod robots;
#[path = "../common/scenes.rs"]
mod scenes;

use cpu_time::ProcessTime;
use glam::DVec3;
use parry3d_f64::math::Vector;
use parry3d_f64::query::Ray;
use parry3d_f64::shape::{CompositeShapeRef, TriMesh};
use presight_model::environment::{Environment, Material, NewObject};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::PixelGrid;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_read::gltf::write_glb;
use presight_read::preset;
use presight_render::cpu::{CpuEngine, Vectors};
use presight_render::plan::{Output, Outputs};
use presight_render::row::RowCut;
use rayon::prelude::*;
use serde_json::{Value, json};
use std::io::BufRead;
use std::path::{Path, PathBuf};
use std::time::Instant;

const PRESETS: [&str; 4] = ["microwave-radar-image", "video-camera", "laser-range-camera", "microwave-radar-scan"];

/// The sensors of [`cameras::sensors`] that are compared.
const CAMERAS: [&str; 6] = ["pinhole", "plumb-bob", "rational", "fisheye 60", "fisheye 120", "fisheye 200"];

/// A sensor at free poses, or on a robot, which stands level or leans by some degrees.
struct Compared {
    sensor: Sensor,
    lean_deg: Option<f64>,
}

impl Compared {
    fn pose(&self, free: &Pose) -> Pose {
        let Some(lean) = self.lean_deg else { return *free };
        let (along, lean) = (free.rpy().2, lean.to_radians());
        Pose::from_xyz_rpy(free.translation, 0.6 * lean, 0.8 * lean, along)
    }
}

fn sensors() -> Vec<Compared> {
    let cameras = cameras::sensors().into_iter().filter(|sensor| CAMERAS.contains(&sensor.spec().name.as_str()));
    let free = cameras.chain(PRESETS.iter().map(|name| preset(name).expect("a preset")));
    let on_robots = robots::sensors().into_iter().map(|(sensor, lean)| Compared { sensor, lean_deg: Some(lean) });
    free.map(|sensor| Compared { sensor, lean_deg: None }).chain(on_robots).collect()
}

fn write<'a>(path: &Path, values: impl Iterator<Item = &'a [u8]>) {
    std::fs::write(path, values.flatten().copied().collect::<Vec<u8>>())
        .unwrap_or_else(|e| panic!("{}: {e}", path.display()));
}

/// Writes the rays of a sensor.
fn describe(compared: &Compared, poses: &[Pose], folder: &Path) -> Value {
    let sensor = &compared.sensor;
    let (width, height) = (sensor.width(), sensor.height());
    let ray =
        |column, row| sensor.ray(column, row).map_or(DVec3::NAN, |ray| sensor.body_from_image() * ray.normalize());
    let rays = (0..height).flat_map(|row| (0..width).map(move |column| ray(column, row)));
    let bytes: Vec<[u8; 8]> = rays.flat_map(|ray| ray.to_array()).map(f64::to_le_bytes).collect();
    let name = &sensor.spec().name;
    write(&folder.join(name).with_extension("f64"), bytes.iter().map(<[u8; 8]>::as_slice));
    let tables = match sensor.grid() {
        PixelGrid::Rays(grid) => grid.bytes(),
        PixelGrid::Lines(_) => 0,
    };
    let mut told = json!({ "name": name, "size": [width, height], "range_max": sensor.spec().range_max.min(f64::MAX), "table_bytes": tables });
    if compared.lean_deg.is_some() {
        told["poses"] = poses.iter().map(|pose| json!(rows(&compared.pose(pose)))).collect();
    }
    told
}

/// Unit rays in the world frame; NaN where there is no ray.
fn world_rays(sensor: &Sensor, pose: &Pose) -> Vec<DVec3> {
    let turn = pose.rotation_matrix() * sensor.body_from_image();
    let ray = |column, row| sensor.ray(column, row).map_or(DVec3::NAN, |ray| turn * ray.normalize());
    (0..sensor.height()).flat_map(|row| (0..sensor.width()).map(move |column| ray(column, row))).collect()
}

/// A tracer independent of presight: parry's BVH in f64, with the rays distributed over the same number of threads.
struct Parry {
    mesh: TriMesh,
    pool: rayon::ThreadPool,
}

impl Parry {
    fn new(environment: &Environment, threads: usize) -> Self {
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for object in environment.objects() {
            let world_from_mesh = object.world_from_mesh();
            for polygon in 0..object.mesh.polygon_count() as u32 {
                let first = vertices.len() as u32;
                let corners = object.mesh.corners_of(polygon).map(|p| world_from_mesh.transform_point3(p));
                vertices.extend(corners.map(|p| Vector::new(p.x, p.y, p.z)));
                triangles.extend((first + 2..vertices.len() as u32).map(|k| [first, k - 1, k]));
            }
        }
        let mesh = TriMesh::new(vertices, triangles).expect("triangles");
        Self { mesh, pool: rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads") }
    }

    /// Ranges in metres; infinite without a hit, NaN where there is no ray.
    fn trace(&self, from: DVec3, rays: &[DVec3]) -> Vec<f64> {
        let vector = |v: &DVec3| Vector::new(v.x, v.y, v.z);
        let cast = |ray: &DVec3| {
            let hit =
                CompositeShapeRef(&self.mesh).cast_local_ray(&Ray::new(vector(&from), vector(ray)), f64::MAX, false);
            hit.map_or(f64::INFINITY, |(_, range)| range)
        };
        self.pool.install(|| rays.par_iter().map(|ray| if ray.is_nan() { f64::NAN } else { cast(ray) }).collect())
    }
}

/// The same objects with materials that every class sees from both sides, as peers see all triangles.
fn opaque(environment: &Environment) -> Environment {
    let mut all = Environment::new();
    for material in environment.materials() {
        all.add_material(Material::named(&material.name)).unwrap_or_else(|e| panic!("{e}"));
    }
    for object in environment.objects() {
        let new = NewObject {
            object_from_mesh: object.object_from_mesh,
            ..NewObject::new(&object.name, object.world_from_object, object.mesh.clone())
        };
        all.insert(new).unwrap_or_else(|e| panic!("{e}"));
    }
    all
}

/// Predictions at a pose before it is measured.
const WARM: usize = 40;

/// Milliseconds of CPU time of one cut, the least of three, and its segments.
fn cut(world: &World, sensor: &Sensor, pose: &Pose) -> (f64, usize) {
    let cut = |()| {
        let cpu = ProcessTime::now();
        let cut = RowCut::new(world, &sensor.spec().class, pose.translation.z);
        (cpu.elapsed().as_secs_f64() * 1e3, cut.segments.len())
    };
    let times = std::iter::repeat_n((), 3).map(cut);
    times.min_by(|a, b| a.0.total_cmp(&b.0)).expect("three cuts")
}

fn rows(pose: &Pose) -> [[f64; 4]; 3] {
    let (r, t) = (pose.rotation_matrix(), pose.translation);
    std::array::from_fn(|i| [r.x_axis[i], r.y_axis[i], r.z_axis[i], t[i]])
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let [scene, folder, count, threads, backend] = arguments.as_slice() else {
        panic!("peer SCENE FOLDER POSES THREADS BACKEND")
    };
    let number = |text: &str| text.parse::<usize>().unwrap_or_else(|e| panic!("{text}: {e}"));
    let (folder, environment) = (PathBuf::from(folder), opaque(&scenes::environment(scene)));
    let glb = scenes::glb_of(scene).unwrap_or_else(|| {
        let path = folder.join("scene.glb");
        write_glb(&path, &environment).unwrap_or_else(|e| panic!("{e}"));
        path
    });
    let world = World::new(environment);
    let polygons: usize = world.environment().objects().iter().map(|o| o.mesh.polygon_count()).sum();
    let poses = scenes::poses(scene, &world, number(count));
    let sensors = sensors();
    let options =
        Options::new(if backend == "gpu" { Backend::Gpu } else { Backend::Cpu }).with_threads(number(threads));
    let parry = (backend == "parry").then(|| Parry::new(world.environment(), number(threads)));
    let made = match std::env::var_os("PRESIGHT_SSE") {
        Some(_) => CpuEngine::new(number(threads))
            .map(|engine| engine.with_vectors(Vectors::Sse42))
            .map(|engine| Predictor::with_engine(options, Box::new(engine))),
        None => Predictor::new(options),
    };
    let mut predictor = made.unwrap_or_else(|e| panic!("{e}"));
    let told: Vec<Value> = sensors.iter().map(|sensor| describe(sensor, &poses, &folder)).collect();
    let poses_told: Vec<_> = poses.iter().map(rows).collect();
    let engine = if parry.is_some() { "parry".to_owned() } else { predictor.engine_name() };
    println!("{}", json!({ "glb": glb, "polygons": polygons, "engine": engine, "poses": poses_told, "sensors": told }));
    let all = Request::default();
    let range = Request::of(Outputs::of(&[Output::Range]));
    // As much as other work of a robot leaves in the caches.
    let mut others = vec![0u64; 4 << 20];
    for line in std::io::stdin().lock().lines() {
        let line = line.expect("text");
        let words: Vec<&str> = line.split_whitespace().collect();
        let (&[sensor, pose, repeat] | &[sensor, pose, repeat, _]) = words.as_slice() else {
            panic!("{line}: not SENSOR POSE REPEAT")
        };
        let (compared, is_cold) = (&sensors[number(sensor)], words.len() == 4);
        let (sensor, pose) = (&compared.sensor, &compared.pose(&poses[number(pose)]));
        if repeat == "cut" {
            println!("{}", json!(cut(&world, sensor, pose)));
            continue;
        }
        let repeat = number(repeat);
        let tell = |range: &[f32]| {
            let bytes: Vec<[u8; 4]> = range.iter().map(|range| range.to_le_bytes()).collect();
            write(&folder.join("range.f32"), bytes.iter().map(<[u8; 4]>::as_slice));
        };
        if let Some(parry) = &parry {
            let rays = world_rays(sensor, pose);
            let trace = || {
                let start = Instant::now();
                let ranges = parry.trace(pose.translation, &rays);
                (start.elapsed().as_secs_f64() * 1e3, ranges)
            };
            let far = |range: f64| if range > sensor.spec().range_max { f32::INFINITY } else { range as f32 };
            tell(&trace().1.into_iter().map(far).collect::<Vec<f32>>());
            println!("{}", json!([(0..repeat).map(|_| trace().0).collect::<Vec<f64>>(), []]));
            continue;
        }
        let mut predict = |request: &Request| {
            let (start, cpu) = (Instant::now(), ProcessTime::now());
            let prediction =
                predictor.predict(&world, sensor, &SensorPose::new(*pose), request).unwrap_or_else(|e| panic!("{e}"));
            ([start.elapsed(), cpu.elapsed()].map(|time| time.as_secs_f64() * 1e3), prediction)
        };
        tell(&predict(&range).1.images.range);
        // Trees and cuts are made for a sensor that returns.
        let before = if sensor.width() * sensor.height() <= 4096 { WARM } else { 1 };
        (0..before).for_each(|_| drop(predict(&all)));
        let mut times = [Vec::new(), Vec::new()];
        for _ in 0..repeat {
            if is_cold {
                others.iter_mut().step_by(8).for_each(|word| *word += 1);
            }
            let (ms, _) = predict(&all);
            times.iter_mut().zip(ms).for_each(|(times, ms)| times.push(ms));
        }
        println!("{}", json!(times));
    }
}
