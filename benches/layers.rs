//! Measures the features of a whole layer in relation to an image: `cargo bench --bench layers [-- PART.. SENSOR..]`
//! prints tables in Markdown. Parts, all of them by default:
//!
//! - `hospital`, `stacked` (three copies of the hospital, one above the other), `factory_hall`: all features generated
//!   from the model, contours included, at 20 free poses, with hidden features counted, on all threads of each
//!   available engine. The figures are milliseconds: the median over the poses of each pose's median run, and the worst
//!   pose.
//! - `far`: a million features, copies of the hospital's own, all out of view.
//! - `load`: a million features from a layer file and from a store, each in its own process with its peak memory
//!   (Linux).
//!
//! Scenes are in `PRESIGHT_DATA` (default `../shared/data`).

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a bench prints tables")]

use glam::DVec3;
use presight::{Scene, SensorPose};
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{BoxOptions, FeatureOptions, Hidden, PlacedFeatures, place};
use presight_model::environment::{Environment, NewObject};
use presight_model::environment::{Feature, FeatureLayer};
use presight_model::geometry::Pose;
use presight_model::placement;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::free_poses::free_poses;
use presight_predict::predict::{Backend, Options, Prediction, Predictor};
use presight_predict::request::Request;
use presight_read::gltf::{ImportOptions, import};
use presight_read::layer;
use presight_read::preset;
use presight_render::plan::{Output, Outputs};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

const PARTS: [&str; 5] = ["hospital", "stacked", "factory_hall", "far", "load"];
const SENSORS: [&str; 2] = ["video-camera", "microwave-radar-image"];
const POSES: usize = 20;
/// Runs at each pose.
const RUNS: usize = 5;
const MILLION: usize = 1_000_000;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    if let [child, scene, layer] = &arguments[..]
        && child == "--child"
    {
        return open(Path::new(scene), layer);
    }
    let is_asked = |name: &str, all: &[&str]| {
        arguments.iter().any(|a| a == name) || !arguments.iter().any(|a| all.contains(&a.as_str()))
    };
    let sensors: Vec<&str> = SENSORS.into_iter().filter(|name| is_asked(name, &SENSORS)).collect();
    for part in PARTS.into_iter().filter(|part| is_asked(part, &PARTS)) {
        let is_hospital = part != "factory_hall";
        let Some(environment) = scene(if is_hospital { "hospital" } else { part }) else { continue };
        match part {
            "far" => far(World::new(environment)),
            "load" => load(environment),
            "stacked" => beside_images(part, &World::new(stacked(&environment, 3)), &sensors),
            _ => beside_images(part, &World::new(environment), &sensors),
        }
    }
}

fn scene(name: &str) -> Option<Environment> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let path = data.join("env").join(name).with_extension("glb");
    if !path.is_file() {
        eprintln!("SKIPPED: {name}");
        return None;
    }
    Some(import(&path, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}")).environment)
}

/// Copies, one above the other, one metre apart.
fn stacked(one: &Environment, copies: u32) -> Environment {
    let mut all = one.clone();
    let bounds = one.bounds();
    for k in 1..copies {
        let up = DVec3::Z * (bounds.max.z - bounds.min.z + 1.0) * f64::from(k);
        for object in one.objects() {
            let Pose { rotation, translation } = object.world_from_object;
            let pose = Pose { rotation, translation: translation + up };
            let object_from_mesh = object.object_from_mesh;
            let new = NewObject::new(format!("level {k}/{}", object.name), pose, object.mesh.clone());
            all.insert(NewObject { object_from_mesh, ..new }).expect("it fits");
        }
    }
    all
}

fn made(environment: &Environment) -> FeatureLayer {
    generate(environment, "video", &GenerateOptions::default()).unwrap_or_else(|e| panic!("{e}")).layer
}

/// A request that also counts hidden features, with regions of interest for 1 cm and 0.5 degrees.
fn request(placed: impl Into<PlacedFeatures>, hidden: Hidden) -> Request {
    let turn = 7.6e-5f64.sqrt();
    let boxes = BoxOptions::default().with_sensor_sigmas([0.01, 0.01, 0.01, turn, turn, turn]);
    let features = FeatureOptions::default().with_hidden(hidden).with_placed(placed);
    Request::of(Outputs::of(&[Output::PolygonId])).with_features(features).with_regions(boxes)
}

/// The milliseconds of images, features and regions.
fn stages(prediction: &Prediction) -> [f64; 3] {
    let mut sums = [0.0; 3];
    for (name, ms) in &prediction.stats.stages_ms {
        let of = match name.name() {
            "features" | "features on the device" => 1,
            "regions of interest" => 2,
            _ => 0,
        };
        sums[of] += ms;
    }
    sums
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut all: Vec<f64> = values.collect();
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

fn beside_images(name: &str, world: &World, sensors: &[&str]) {
    let placed = PlacedFeatures::from(place(world, &made(world.environment())).unwrap_or_else(|e| panic!("{e}")));
    let poses = free_poses(world, POSES, 1995).expect("free poses");
    println!(
        "\n| {name}, {} features | requested | seen | image, ms (worst) | features, ms (worst) | regions, ms (worst) | both, ms (worst) |",
        placed.features.len()
    );
    println!("|---|---|---|---|---|---|---|");
    for sensor in sensors {
        for backend in [Backend::Cpu, Backend::Gpu] {
            let Ok(mut predictor) = Predictor::new(Options::new(backend)) else { continue };
            let sensor = preset(sensor).expect("a preset");
            let request = request(placed.clone(), Hidden::Count);
            let mut prediction =
                predictor.predict(world, &sensor, &SensorPose::new(poses[0]), &request).expect("it predicts");
            let (mut all, mut counts) = (Vec::new(), Vec::new());
            for pose in &poses {
                let mut runs = Vec::new();
                for _ in 0..RUNS {
                    predictor.predict_again(world, &SensorPose::new(*pose), &mut prediction).expect("it predicts");
                    runs.push(stages(&prediction));
                }
                let [image, features, regions] = [0, 1, 2].map(|k| median(runs.iter().map(|run| run[k])));
                all.push([image, features, regions, median(runs.iter().map(|run| run[1] + run[2]))]);
                let seen = prediction.features.as_ref().expect("features");
                counts.push([seen.stats.asked, seen.features.len()].map(|n| n as f64));
            }
            let [asked, seen] = [0, 1].map(|k| median(counts.iter().map(|count| count[k])));
            let told = [0, 1, 2, 3].map(|k| {
                let worst = all.iter().map(|one| one[k]).fold(0.0, f64::max);
                format!("{:.2} ({worst:.2})", median(all.iter().map(|one| one[k])))
            });
            let engine = if backend == Backend::Cpu { "CPU engine" } else { "GPU engine" };
            println!("| {}, {engine} | {asked} | {seen} | {} |", sensor.spec().name, told.join(" | "));
        }
    }
}

/// Repeats the features of a layer under new ids.
fn a_million(layer: &FeatureLayer) -> Vec<Arc<Feature>> {
    let numbered = |(id, feature): (u32, &Arc<Feature>)| Arc::new(Feature { id, ..Feature::clone(feature) });
    (1..).zip(layer.features.iter().cycle()).take(MILLION).map(numbered).collect()
}

fn far(world: World) {
    let layer = made(world.environment());
    let one = place(&world, &layer).unwrap_or_else(|e| panic!("{e}"));
    // Each contour would add a surface.
    let no_contour = one.into_iter().filter(|p| p.feature.shape.kind() != "contour").collect::<Vec<_>>();
    let mut placed: Vec<_> = no_contour.iter().cycle().take(MILLION).cloned().collect();
    (1..).zip(&mut placed).for_each(|(id, p)| Arc::make_mut(&mut p.feature).id = id);
    let placed = PlacedFeatures::from(placed);
    let sensor: Sensor = preset(SENSORS[0]).expect("a preset");
    // 400 m away, looking elsewhere.
    let pose = Pose::from_xyz_rpy(world.environment().bounds().center() + 400.0 * DVec3::X, 0.0, 0.0, 0.0);
    println!("\n| none of {MILLION} features in view | features, ms: median of 20 |");
    println!("|---|---|");
    for hidden in [Hidden::Count, Hidden::Reason, Hidden::Full] {
        let mut predictor = Predictor::new(Options::new(Backend::Cpu)).expect("the CPU engine starts");
        let request = request(placed.clone(), hidden);
        let mut prediction = predictor.predict(&world, &sensor, &SensorPose::new(pose), &request).expect("it predicts");
        let mut once = || {
            predictor.predict_again(&world, &SensorPose::new(pose), &mut prediction).expect("it predicts");
            stages(&prediction)[1]
        };
        println!("| {hidden:?} | {:.3} |", median((0..20).map(|_| once())));
    }
}

fn load(mut environment: Environment) {
    let folder = tempfile::tempdir().expect("a folder");
    let layer = made(&environment);
    let million = FeatureLayer { features: a_million(&layer), ..layer.clone() };
    let path = |name: &str| folder.path().join(name);
    let (few, many) = (path("few.layer.json"), path("many.layer.json"));
    layer::write(&few, &layer).expect("it is written");
    layer::write(&many, &million).expect("it is written");
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let glb = data.join("env/hospital.glb");
    println!("\n| features | from | opened, s | features placed, s | most memory, MiB |");
    println!("|---|---|---|---|---|");
    for (layer, count) in [(&few, layer.features.len()), (&many, MILLION)] {
        in_a_process(&format!("{count} | layer file"), &glb, layer);
    }
    #[cfg(feature = "store")]
    {
        let (count, store) = (million.features.len(), path("many.presight"));
        environment.add_layer(million).expect("it fits");
        let note = presight_store::Note::new("bench", 0.0);
        presight_store::create(&store, &environment, &note).expect("a store");
        in_a_process(&format!("{count} | store"), &store, Path::new(""));
    }
    #[cfg(not(feature = "store"))]
    let _ = (&mut environment, &million);
}

fn in_a_process(name: &str, scene: &Path, layer: &Path) {
    let this = std::env::current_exe().expect("a program");
    let done = std::process::Command::new(this).arg("--child").arg(scene).arg(layer).output().expect("it runs");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    println!("| {name} | {} |", String::from_utf8_lossy(&done.stdout).trim());
}

/// Opens a scene, places the given layer or the scene's own, and prints the time and memory.
fn open(scene: &Path, layer: &str) {
    let start = Instant::now();
    let scene = Scene::open(scene).unwrap_or_else(|e| panic!("{e}"));
    let opened = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let placed = match scene.world.environment().layer("video") {
        Some(own) if layer.is_empty() => placement::place_layer(&scene.world, own),
        _ => scene.place_layers(&[layer], "video").map(|of| of.placed),
    };
    let placed = placed.unwrap_or_else(|e| panic!("{e}"));
    let placing = start.elapsed().as_secs_f64();
    assert!(placed.lost.is_empty());
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let most = status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")?.parse().ok());
    println!("{opened:.2} | {placing:.2} | {:.0}", most.map_or(f64::NAN, |kib: f64| kib / 1024.0));
}
