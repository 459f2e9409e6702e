//! Measures the CPU engine by stage: `cargo bench --bench stages [-- FILTER]`, with names such as
//! `prediction/hospital/video-camera`. Scenes: `scenes/room.glb`, and the hospital and the factory hall in
//! `PRESIGHT_DATA` (default `../shared/data`).

#![allow(missing_docs, reason = "criterion's macros make items without docs")]

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::{DMat3, DVec3};
use presight_features::{BoxOptions, BoxQuery, FeaturePrediction, PlacedFeature, SeenFeature, add_boxes};
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_read::gltf::{ImportOptions, import};
use presight_read::preset;
use presight_render::plan::FramePlan;
use std::hint::black_box;
use std::path::{Path, PathBuf};

const PRESETS: [&str; 4] = ["microwave-radar-image", "video-camera", "laser-range-camera", "microwave-radar-scan"];

struct Scene {
    name: &'static str,
    path: PathBuf,
    world_from_sensor: Pose,
}

fn pose([x, y, z, roll, pitch, yaw]: [f64; 6]) -> Pose {
    Pose::from_xyz_rpy(DVec3::new(x, y, z), roll.to_radians(), pitch.to_radians(), yaw.to_radians())
}

/// The room and the available large scenes, at the first pose of the Embree comparison.
fn scenes() -> Vec<Scene> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let text = std::fs::read_to_string(root.join("benches/peers/poses.json")).expect("poses.json is in the repository");
    let poses: serde_json::Value = serde_json::from_str(&text).expect("poses.json is JSON");
    let room = pose([0.3, 0.35, 1.65, 0.0, 12.0, 38.0]);
    let mut all = vec![Scene { name: "room", path: root.join("scenes/room.glb"), world_from_sensor: room }];
    for name in ["factory_hall", "hospital"] {
        let path = data.join("env").join(name).with_extension("glb");
        if path.is_file() {
            let first = serde_json::from_value(poses["scenes"][name][0].clone()).expect("a pose is six numbers");
            all.push(Scene { name, path, world_from_sensor: pose(first) });
        }
    }
    all
}

fn load(scene: &Scene) -> World {
    let imported = import(&scene.path, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"));
    World::new(imported.environment)
}

fn importing(c: &mut Criterion) {
    let mut group = c.benchmark_group("import");
    group.sample_size(10);
    for scene in scenes() {
        group.bench_function(scene.name, |b| b.iter(|| load(black_box(&scene))));
    }
}

/// From the hall's script to its environment, and on to a world with its index.
#[cfg(feature = "script")]
fn script(c: &mut Criterion) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/factory.rhai");
    let environment = || {
        let loaded = presight_read::script::load(&path, &ImportOptions::default(), &mut |_| {});
        loaded.unwrap_or_else(|e| panic!("{e}")).environment
    };
    let mut group = c.benchmark_group("script");
    group.sample_size(20);
    group.bench_function("factory/environment", |b| b.iter(environment));
    group.bench_function("factory/world", |b| b.iter(|| World::new(environment())));
}

#[cfg(not(feature = "script"))]
fn script(_: &mut Criterion) {}

fn selection(c: &mut Criterion) {
    let mut group = c.benchmark_group("selection");
    for scene in scenes() {
        let world = load(&scene);
        for name in PRESETS {
            let sensor = preset(name).expect("a preset");
            let request = Request::default();
            let mut plan = FramePlan::new(&world, &sensor, &scene.world_from_sensor, &request).expect("a valid pose");
            group.bench_function(BenchmarkId::new(scene.name, name), |b| {
                b.iter(|| plan.renew(&world, &sensor, black_box(&scene.world_from_sensor), &request));
            });
        }
    }
}

fn prediction(c: &mut Criterion) {
    let mut group = c.benchmark_group("prediction");
    group.sample_size(20);
    for scene in scenes() {
        let world = load(&scene);
        for name in PRESETS {
            let sensor = preset(name).expect("a preset");
            let options = Options::new(Backend::Cpu);
            let mut predictor = Predictor::new(options).expect("the CPU engine starts");
            let request = Request::default();
            group.bench_function(BenchmarkId::new(scene.name, name), |b| {
                b.iter(|| {
                    predictor.predict(&world, &sensor, &SensorPose::new(black_box(scene.world_from_sensor)), &request)
                });
            });
        }
    }
}

/// Boxes of 1,000 segments of about 60 pixels on one thread: the cost of a box and both covariances per element.
fn boxes(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let world = World::new(presight_model::environment::Environment::default());
    let mut group = c.benchmark_group("boxes");
    group.throughput(Throughput::Elements(1000));
    // Sigmas of position and heading, nearest and farthest distance.
    let cases = [
        ("linear", [0.005, 0.1], [6.0, 12.0]),
        ("linear, checked", [0.03, 1.0], [5.0, 10.0]),
        ("set", [0.1, 8.0], [1.0, 2.0]),
    ];
    for name in ["video-camera", "microwave-radar-image"] {
        let sensor = preset(name).expect("a preset");
        for (case, [position, heading_deg], distances) in cases {
            let placed = segments(distances);
            let mut prediction = all_seen(&placed);
            let mut options = BoxOptions::default();
            for (i, sigma) in [(0, position), (1, position), (5, f64::to_radians(heading_deg))] {
                options.sensor[i][i] = sigma * sigma;
            }
            group.bench_function(BenchmarkId::new(case, name), |b| {
                b.iter(|| {
                    pool.install(|| {
                        add_boxes(
                            &mut prediction,
                            &BoxQuery {
                                placed: &placed,
                                world: &world,
                                sensor: &sensor,
                                world_from_sensor: &Pose::IDENTITY,
                                options: &options,
                            },
                        )
                    })
                });
            });
        }
    }
}

/// Segments ahead, at any angle, of 0.1 rad.
fn segments([near, far]: [f64; 2]) -> Vec<PlacedFeature> {
    let mut state = 7u64;
    let mut unit = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut segment = |id: u32| {
        let distance = near + (far - near) * unit();
        let at = distance * DVec3::new(1.0, 0.5 * unit() - 0.25, 0.2 * unit() - 0.1);
        let along = DVec3::new(unit() - 0.5, unit() - 0.5, unit() - 0.5).normalize() * 0.05 * distance;
        let covariances = [DMat3::from_diagonal(DVec3::splat(1e-4)); 2];
        let shape = FeatureShape::Segment { ends: [at - along, at + along], covariances, cross: DMat3::ZERO };
        let (existence, properties) = (Existence::default(), Properties::default());
        let feature = Feature { id, name: None, object: None, shape, existence, properties };
        PlacedFeature { feature: feature.into(), object: None, slots: Vec::new() }
    };
    (1..=1000).map(&mut segment).collect()
}

fn all_seen(placed: &[PlacedFeature]) -> FeaturePrediction {
    let seen = |placed: &PlacedFeature| SeenFeature::whole(&placed.feature);
    FeaturePrediction { features: placed.iter().map(seen).collect(), ..FeaturePrediction::default() }
}

criterion_group!(stages, importing, script, selection, prediction, boxes);
criterion_main!(stages);
