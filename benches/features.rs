//! Measures feature prediction: `cargo bench --bench features [-- SCENE.. SENSOR.. --no-rays]` prints a table for
//! benches/RESULTS.md.
//!
//! *CPU engine* and *GPU engine* are the times of features and 99 % regions of interest together, after the images, on
//! all threads. Each time is the fastest of many runs on one thread, the run that other work on the machine disturbs
//! least.
//!
//! The features are edges generated from the model and cut into pieces of about 60 pixels of `video-camera` (512 x 512,
//! the layer has class `video` for all sensors): 2,000 pieces, sampled at half-pixel steps, at the poses of the Embree
//! comparison. Scenes: the hospital and the factory hall in `PRESIGHT_DATA` (default `../shared/data`).

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a bench prints a table")]

mod common;

use common::fastest;
use glam::{DMat3, DVec3};
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{
    BoxOptions, FeatureOptions, FeatureSettings, Hidden, Piece, PlacedFeature, Sampler, Visibility, place,
    predict_features,
};
use presight_model::environment::FeatureShape;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_read::gltf::{ImportOptions, import};
use presight_read::preset;
use presight_render::plan::{Output, Outputs};
use std::path::{Path, PathBuf};
use std::sync::Arc;

const SCENES: [&str; 2] = ["hospital", "factory_hall"];
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
        "| scene, pose, sensor, which | segments (seen) | samples | image space, ns a sample | rays, ns a sample | times as fast | us a region | CPU engine, ms | GPU engine, ms | image, ms |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    // Includes all of a kind if none of it is named.
    let is_asked =
        |name: &str, all: &[&str]| asked.iter().any(|a| a == name) || !asked.iter().any(|a| all.contains(&a.as_str()));
    for scene in SCENES {
        let path = data.join("env").join(scene).with_extension("glb");
        if !is_asked(scene, &SCENES) || !path.is_file() {
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
            for name in SENSORS.into_iter().filter(|name| is_asked(name, &SENSORS)) {
                measure(&format!("{scene} {index}, {name}"), name, &world, &pose, &placed);
            }
        }
    }
}

fn measure(case: &str, sensor: &str, world: &World, pose: &Pose, placed: &[PlacedFeature]) {
    let sensor = preset(sensor).expect("a preset");
    let request = Request::of(Outputs::of(&[Output::PolygonId]));
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("the CPU engine starts");
    let image_ms = fastest(|| {
        let seen = predictor.predict(world, &sensor, &SensorPose::new(*pose), &request).expect("it predicts");
        assert!(!seen.images.polygon_id.is_empty());
    });
    let images = predictor.predict(world, &sensor, &SensorPose::new(*pose), &request).expect("it predicts").images;
    let one = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let cut = pieces(world, &sensor, pose, placed);
    let predict = |list: &[PlacedFeature], visibility| {
        let options = FeatureSettings { visibility, ..FeatureSettings::default() };
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
        let by_pixels = fastest(|| assert_eq!(predict(&list, Visibility::Image).stats.samples, samples));
        let no_rays = std::env::args().any(|a| a == "--no-rays");
        let rays = || fastest(|| assert_eq!(predict(&list, Visibility::Rays).stats.samples, samples));
        let by_rays = if no_rays { f64::NAN } else { rays() };
        let each = |ms: f64| ms * 1e6 / samples as f64;
        let region_us = with_regions(Options::new(Backend::Cpu).with_threads(1), world, &sensor, pose, &list)
            .map_or(f64::NAN, |[features, both]| (both - features) * 1e3 / count as f64);
        let all_threads = [Backend::Cpu, Backend::Gpu].map(|backend| {
            let both = with_regions(Options::new(backend), world, &sensor, pose, &list);
            both.map_or(f64::NAN, |[_, both]| both)
        });
        println!(
            "| {case}, {name} | {} ({count}) | {samples} | {:.1} | {:.0} | {:.1} | {region_us:.2} | {:.2} | {:.2} | {image_ms:.2} |",
            list.len(),
            each(by_pixels),
            each(by_rays),
            by_rays / by_pixels,
            all_threads[0],
            all_threads[1],
        );
        eprintln!("{:?}", told.stats);
    }
}

/// The milliseconds for features, and for features with regions of interest, after their images; `None` without the
/// engine.
fn with_regions(
    options: Options,
    world: &World,
    sensor: &Sensor,
    pose: &Pose,
    list: &[PlacedFeature],
) -> Option<[f64; 2]> {
    let mut predictor = Predictor::new(options).ok()?;
    // 1 cm and 0.5 degrees.
    let turn = 7.6e-5f64.sqrt();
    let boxes = BoxOptions::default().with_sensor_sigmas([0.01, 0.01, 0.01, turn, turn, turn]);
    let request = Request::of(Outputs::of(&[Output::PolygonId]))
        .with_features(FeatureOptions::default().with_hidden(Hidden::Full).with_placed(list.to_vec()))
        .with_regions(boxes);
    let mut prediction = predictor.predict(world, sensor, &SensorPose::new(*pose), &request).expect("it predicts");
    let mut least = [f64::INFINITY; 2];
    for _ in 0..12 {
        predictor.predict_again(world, &SensorPose::new(*pose), &mut prediction).expect("it predicts");
        let of = |name: &str| {
            prediction.stats.stages_ms.iter().filter(|(n, _)| n.name() == name).map(|(_, ms)| ms).sum::<f64>()
        };
        let features = of("features") + of("features on the device");
        let both = features + of("regions of interest");
        let seen = prediction.features.as_ref().expect("features");
        assert!(seen.features.iter().all(|f| f.visible_fraction == 0.0 || f.roi.is_some() || f.roi_flag.is_some()));
        least = [least[0].min(features), least[1].min(both)];
    }
    Some(least)
}

/// An evenly spaced selection of a long list, or repetitions of a short one.
fn sample(list: &[PlacedFeature]) -> Vec<PlacedFeature> {
    if list.len() < WANTED {
        return list.iter().cycle().take(WANTED).cloned().collect();
    }
    let step = list.len() as f64 / WANTED as f64;
    (0..).map(|i| (f64::from(i) * step) as usize).take_while(|i| *i < list.len()).map(|i| list[i].clone()).collect()
}

/// Cuts all features in the image, hidden or not, into pieces of about the wanted length.
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
            let feature = Arc::make_mut(&mut cut.feature);
            feature.id = all.len() as u32 + 1;
            feature.shape = FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO };
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
