//! Measures the reductions of the virtual sensors and compares them with the predictions that they reduce: `cargo bench
//! --bench virtual_sensors` prints a table in Markdown. On one thread, the fastest of many runs. Scenes: the charging
//! bay of `scenes/docking.rhai`, and the hospital in `PRESIGHT_DATA` (default `../shared/data`).
#![expect(clippy::print_stdout, clippy::print_stderr, reason = "a bench prints a table")]

mod common;

use common::fastest;
use glam::DVec3;
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{FeatureOptions, PlacedFeature, place};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::free_poses::free_poses;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_predict::virtual_sensors::{Corridor, Settings, View, VirtualSensor};
use presight_read::preset;
use presight_read::{gltf, script};
use presight_render::plan::Output;
use std::path::{Path, PathBuf};

fn main() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    println!(
        "| scene, virtual sensor | preset | prediction, ms | features (landmarks) | their prediction, ms | reduction, ms |"
    );
    println!("|---|---|---|---|---|---|");
    let bay = script::load(root.join("scenes/docking.rhai"), &Default::default(), &mut |_| ()).expect("a scene");
    // The viewpoint of scenes/pictures.sh.
    let pose = Pose::from_xyz_rpy(DVec3::new(0.2, -0.6, 1.0), 0.0, 0.0, 5f64.to_radians());
    measure("docking", &World::new(bay.environment), &pose);
    let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let hospital = data.join("env/hospital.glb");
    if hospital.is_file() {
        let world = World::new(gltf::import(&hospital, &Default::default()).expect("a scene").environment);
        let pose = free_poses(&world, 1, 1).expect("a free pose")[0];
        measure("hospital", &world, &pose);
    } else {
        eprintln!("SKIPPED: hospital");
    }
}

fn measure(scene: &str, world: &World, pose: &Pose) {
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("the CPU engine starts");
    // Five metres ahead, as wide as a robot of 60 cm.
    let corridor = Corridor::new(vec![[0.0, 0.0], [5.0, 0.0]], 0.3, -1.0, 1.0).expect("a corridor");
    let settings = Settings { floor_z_world: Some(0.0), corridor: Some(corridor) };
    for task in VirtualSensor::ALL {
        let name = match task {
            VirtualSensor::FreeFloor | VirtualSensor::Edges => "video-camera",
            VirtualSensor::RadarLines | VirtualSensor::RadarNearest | VirtualSensor::RadarLandmarks => {
                "microwave-radar-scan"
            }
            VirtualSensor::DepthImage | VirtualSensor::VerticalPlanes => "laser-range-camera",
            VirtualSensor::Docking => "laser-scanner",
        };
        let mut spec = preset(name).expect("a preset").spec().clone();
        // Docking requires a noise model.
        (spec.noise.range_sigma, spec.noise.angle_sigma) = (0.01, 0.001);
        let sensor = Sensor::new(spec).expect("a sensor");
        let placed = if task.needs_features() { wanted(task, world) } else { Vec::new() };
        let outputs = if task.needs_features() { task.outputs().with(Output::PolygonId) } else { task.outputs() };
        let images = Request::of(outputs);
        let image_ms = fastest(|| {
            predictor.predict(world, &sensor, &SensorPose::new(*pose), &images).expect("it predicts");
        });
        let options = FeatureOptions::default().with_placed(placed.clone());
        let request = if task.needs_features() { images.with_features(options) } else { images };
        let prediction = predictor.predict(world, &sensor, &SensorPose::new(*pose), &request).expect("it predicts");
        let features_ms = if placed.is_empty() {
            0.0
        } else {
            let together = fastest(|| {
                predictor.predict(world, &sensor, &SensorPose::new(*pose), &request).expect("it predicts");
            });
            together - image_ms
        };
        let view = View::of(&prediction, world.environment());
        let reduction_ms = fastest(|| {
            task.reduce(&view, &settings).expect("an answer");
        });
        println!(
            "| {scene}, `{}` | {name} | {image_ms:.2} | {} | {features_ms:.2} | {reduction_ms:.3} |",
            task.name(),
            placed.len()
        );
    }
}

/// The features of the scene's own layer that the task uses, or edges generated from the model.
fn wanted(task: VirtualSensor, world: &World) -> Vec<PlacedFeature> {
    let environment = world.environment();
    let own = environment.layer(task.class()).cloned();
    let mut layer = match (own, task) {
        (_, VirtualSensor::Edges) => generate(environment, "video", &GenerateOptions::default()).expect("edges").layer,
        (Some(own), _) => own,
        (None, _) => return Vec::new(),
    };
    layer.features.retain(|f| task.wants(&f.shape));
    place(world, &layer).expect("features of this world")
}
