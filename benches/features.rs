//! What predicting features costs: `cargo bench --bench features [-- SCENE]`, prints a table of benches/RESULTS.md.
//!
//! Times are of the processor, on one thread: other work on the machine disturbs them less than wall-clock times (Linux).
//!
//! Edges generated from the model, cut into pieces of about 60 pixels of `video-camera` (512 x 512, the layer's class is
//! `video` for all sensors), 2,000 of them (or as many as there are) at the first poses at which the scene is compared with Embree; sampled at half-pixel steps. Scenes:
//! the hospital and the factory hall where `PRESIGHT_DATA` (default `../shared/data`) holds them.

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "its table is what it is for")]

use glam::{DMat3, DVec3};
use presight::acquire::features::{GenerateOptions, generate};
use presight::environment::FeatureShape;
use presight::features::{FeatureOptions, Piece, PlacedFeature, Sampler, Visibility, place, predict_features};
use presight::io::gltf::{ImportOptions, import};
use presight::{Backend, Options, Output, Outputs, Pose, Predictor, Request, Sensor, World, preset};
use std::path::{Path, PathBuf};

const SENSORS: [&str; 2] = ["video-camera", "microwave-radar-image"];
const POSES: usize = 3;
const WANTED: usize = 2000;
const PIXELS: f64 = 60.0;

fn main() {
    let asked: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let data = std::env::var_os("PRESIGHT_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let text = std::fs::read_to_string(root.join("benches/peers/poses.json")).expect("poses.json is in the repository");
    let poses: serde_json::Value = serde_json::from_str(&text).expect("poses.json is JSON");
    println!(
        "| scene, pose, sensor, which | segments (seen) | samples | image space, ns a sample | rays, ns a sample | times as fast | image, ms |"
    );
    println!("|---|---|---|---|---|---|---|");
    for scene in ["hospital", "factory_hall"] {
        let path = data.join("env").join(scene).with_extension("glb");
        if !asked.is_empty() && !asked.iter().any(|a| a == scene) || !path.is_file() {
            eprintln!("SKIPPED: {scene}");
            continue;
        }
        let world = World::new(import(&path, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}")).environment);
        let options = GenerateOptions::default();
        let mut layer = generate(world.environment(), "video", &options).unwrap_or_else(|e| panic!("{e}")).layer;
        layer.features.retain(|f| matches!(f.shape, FeatureShape::Segment { .. }));
        let placed = place(&world, &layer).unwrap_or_else(|e| panic!("{e}"));
        for index in 0..POSES {
            let six: [f64; 6] = serde_json::from_value(poses["scenes"][scene][index].clone()).expect("six numbers");
            let [x, y, z, roll, pitch, yaw] = six;
            let turn = [roll, pitch, yaw].map(f64::to_radians);
            let pose = Pose::from_xyz_rpy(DVec3::new(x, y, z), turn[0], turn[1], turn[2]);
            for name in SENSORS {
                measure(&format!("{scene} {index}, {name}"), name, &world, &pose, &placed);
            }
        }
    }
}

fn measure(case: &str, sensor: &str, world: &World, pose: &Pose, placed: &[PlacedFeature]) {
    let sensor = preset(sensor).expect("a preset");
    let request = Request { outputs: Outputs::of(&[Output::PolygonId]), ..Request::default() };
    let mut predictor = Predictor::new(Options { backend: Backend::Cpu, threads: 1 }).expect("the CPU engine starts");
    let image_ms = mean(|| {
        let seen = predictor.predict(world, &sensor, pose, &request).expect("it predicts");
        assert!(!seen.images.polygon_id.is_empty());
    });
    let images = predictor.predict(world, &sensor, pose, &request).expect("it predicts").images;
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let cut = pieces(world, &sensor, pose, placed);
    let predict = |list: &[PlacedFeature], visibility| {
        let options = FeatureOptions { visibility, ..FeatureOptions::default() };
        one.install(|| predict_features(world, &sensor, pose, &images, list, &options)).expect("it predicts")
    };
    let all = predict(&cut, Visibility::Image);
    let seen = |f: &usize| all.features[*f].visible_fraction > 0.0;
    let visible: Vec<PlacedFeature> = (0..cut.len()).filter(seen).map(|i| cut[i].clone()).collect();
    let sets = [("all in the image", sample(&cut)), ("seen in part", sample(&visible))];
    for (name, list) in sets.into_iter().filter(|(_, list)| !list.is_empty()) {
        let told = predict(&list, Visibility::Image);
        let count = told.features.iter().filter(|f| f.visible_fraction > 0.0).count();
        let samples = told.stats.samples;
        let by_pixels = mean(|| assert_eq!(predict(&list, Visibility::Image).stats.samples, samples));
        let by_rays = mean(|| assert_eq!(predict(&list, Visibility::Rays).stats.samples, samples));
        let each = |ms: f64| ms * 1e6 / samples as f64;
        println!(
            "| {case}, {name} | {} ({count}) | {samples} | {:.1} | {:.0} | {:.1} | {image_ms:.2} |",
            list.len(),
            each(by_pixels),
            each(by_rays),
            by_rays / by_pixels
        );
        eprintln!("{:?}", told.stats);
    }
}

/// Evenly chosen ones of too many; too few are repeated.
fn sample(list: &[PlacedFeature]) -> Vec<PlacedFeature> {
    if list.len() < WANTED {
        return list.iter().cycle().take(WANTED).cloned().collect();
    }
    let step = list.len() as f64 / WANTED as f64;
    (0..).map(|i| (f64::from(i) * step) as usize).take_while(|i| *i < list.len()).map(|i| list[i].clone()).collect()
}

/// Pieces of about the wanted length of all that is in the image, hidden or not.
fn pieces(world: &World, sensor: &Sensor, pose: &Pose, placed: &[PlacedFeature]) -> Vec<PlacedFeature> {
    let sampler = Sampler::new(sensor);
    let image_from_world = (pose.rotation_matrix() * sensor.body_from_image()).transpose();
    let mut all = Vec::new();
    for p in placed {
        let place = p.object.map(|o| world.environment().objects()[o as usize].world_from_object);
        let ends = p.feature.shape.points();
        let [a, b] = [ends[0], ends[1]].map(|e| {
            let at = place.map_or(e, |pose| pose.transform_point(e));
            image_from_world * (at - pose.translation)
        });
        let (mut length, mut from) = (0.0, None);
        let mut piece = |t: [f64; 2]| {
            let mut cut = p.clone();
            let ends = t.map(|t| ends[0] + t * (ends[1] - ends[0]));
            cut.feature.id = all.len() as u32 + 1;
            cut.feature.shape = FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
            all.push(cut);
        };
        sampler.segment(a, b, &mut |part| match part {
            Piece::Inside(s) => {
                length += s.weight;
                let start = *from.get_or_insert(s.t[0]);
                if length >= PIXELS {
                    piece([start, s.t[1]]);
                    (length, from) = (0.0, None);
                }
            }
            Piece::Outside { .. } => (length, from) = (0.0, None),
        });
    }
    all
}

/// Milliseconds of processor time of one run, from at least two and 0.3 s.
fn mean(mut run: impl FnMut()) -> f64 {
    run();
    let (start, mut runs) = (ticks(), 0);
    while ticks() - start < 30 || runs < 2 {
        run();
        runs += 1;
    }
    (ticks() - start) as f64 * 10.0 / f64::from(runs)
}

/// Hundredths of a second that this process has used.
fn ticks() -> u64 {
    let text = std::fs::read_to_string("/proc/self/stat").expect("Linux tells the time of a process");
    // Fields 14 and 15; the name, which may hold anything, ends with the last bracket.
    let after = text.rsplit(')').next().unwrap_or_default();
    let used = after.split_whitespace().skip(11).take(2);
    used.map(|field| field.parse::<u64>().expect("a number")).sum()
}
