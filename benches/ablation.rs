//! Leaves out one means of speed at a time: `cargo bench --features ablation --bench ablation [-- PART.. SCENE..]`.
//! Parts, all of them by default:
//!
//! - `images`: images alone, all presets.
//! - `features`: a scene's own generated features with regions of interest, after the image, all presets.
//! - `few`: twelve of these features.
//! - `deadlines`: kept deadlines and final samples, on the process's CPU time in place of the clock.
//!
//! CPU times of one thread, in turns with the whole at each pose: the least of `PRESIGHT_REPEATS` (default 3) runs.
//! Each figure is the time without the means over the time with it, at the median and at the 95th percentile over
//! `PRESIGHT_POSES` (default 20) poses. Images and features must not depend on any means; the bench compares them.

#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a bench prints tables")]

#[path = "common/scenes.rs"]
mod scenes;

use cpu_time::ProcessTime;
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{BoxOptions, FeatureOptions, Hidden, PlacedFeatures, place};
use presight_files::preset;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{PRESETS, Sensor};
use presight_model::world::World;
use presight_predict::predict::{Backend, Options, Prediction, Predictor};
use presight_predict::request::Request;
use presight_render::ablation::{Means, leave_out};
use presight_render::deadline::Clock;
use presight_render::plan::{Output, Outputs};
use std::sync::Arc;
use std::time::Duration;

const SCENES: [&str; 7] = [
    "hospital",
    "factory_hall",
    "city",
    "scenes/factory.rhai",
    scenes::OPEN_HALL,
    "warehouse_small",
    "office_willowgarage",
];
const PARTS: [&str; 4] = ["images", "features", "few", "deadlines"];
const FEW: usize = 12;
const OF_IMAGES: [Means; 2] = [Means::Sieve, Means::HiddenRuns];
const OF_DEADLINES: [Means; 5] = [Means::Stride, Means::SecondStride, Means::Radius, Means::Angle, Means::Doubt];

/// Frames with a generous deadline that costs are learnt from first.
const LEARNT: usize = 50;
const GENEROUS_MS: f64 = 1e6;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let is_asked = |name: &str, all: &[&str]| {
        arguments.iter().any(|a| a == name) || !arguments.iter().any(|a| all.contains(&a.as_str()))
    };
    for scene in SCENES.into_iter().filter(|scene| is_asked(scene, &SCENES)) {
        let world = World::new(scenes::environment(scene));
        let poses = scenes::poses(scene, &world, number("PRESIGHT_POSES", 20));
        for part in PARTS.into_iter().filter(|part| is_asked(part, &PARTS)) {
            match part {
                "images" => {
                    let all = Request::of(Outputs::of(&[Output::Range, Output::PolygonId]));
                    times(scene, part, &world, &poses, &OF_IMAGES, |_| Some(all.clone()));
                }
                "features" | "few" => {
                    let of: Vec<Means> = Means::ALL
                        .into_iter()
                        .filter(|m| !OF_IMAGES.contains(m) && !OF_DEADLINES.contains(m))
                        .collect();
                    let most = if part == "few" { FEW } else { usize::MAX };
                    times(scene, part, &world, &poses, &of, |sensor| with_features(&world, sensor, most));
                }
                _ => deadlines(scene, &world, &poses),
            }
        }
    }
}

fn number(name: &str, default: usize) -> usize {
    std::env::var(name).map_or(default, |text| text.parse().expect("a whole number"))
}

/// At most `most` of the features generated for the sensor's class, with regions of interest for 1 cm and 0.5 degrees.
fn with_features(world: &World, sensor: &Sensor, most: usize) -> Option<Request> {
    let class = &sensor.spec().class;
    let mut layer = generate(world.environment(), class, &GenerateOptions::default()).ok()?.layer;
    let (mut number, step) = (0, layer.features.len().div_ceil(most).max(1));
    layer.features.retain(|_| (number % step == 0, number += 1).0);
    let placed = PlacedFeatures::from(place(world, &layer).ok()?);
    let turn = 7.6e-5f64.sqrt();
    let boxes = BoxOptions::default().with_sensor_sigmas([0.01, 0.01, 0.01, turn, turn, turn]);
    let features = FeatureOptions::default().with_hidden(Hidden::Count).with_placed(placed);
    Some(Request::of(Outputs::of(&[Output::PolygonId])).with_features(features).with_regions(boxes))
}

/// The value at a quantile, by nearest rank.
fn quantile(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut all: Vec<f64> = values.collect();
    all.sort_by(f64::total_cmp);
    all[((share * all.len() as f64).ceil() as usize).clamp(1, all.len()) - 1]
}

/// A feature's number, how much of it is seen, and its range.
type Seen = (u32, f64, Option<f64>);

/// What a prediction shows: sums of the images, and the features.
fn shown(prediction: &Prediction) -> ([u64; 2], Vec<Seen>) {
    let sum = |sum: u64, word: u32| sum.wrapping_mul(0x9e37_79b9_7f4a_7c15).wrapping_add(u64::from(word));
    let ids = prediction.images.polygon_id.iter().fold(0, |all, id| sum(all, *id));
    let ranges = prediction.images.range.iter().fold(0, |all, range| sum(all, range.to_bits()));
    let features = prediction.features.iter().flat_map(|of| &of.features);
    ([ids, ranges], features.map(|f| (f.feature.id, f.visible_fraction, f.range)).collect())
}

/// Returns true if two features differ by more than the order of their sums.
fn differ(a: &Seen, b: &Seen) -> bool {
    let off = |a: f64, b: f64| (a - b).abs() > 1e-9 * a.abs().max(1.0);
    a.0 != b.0 || off(a.1, b.1) || a.2.is_some() != b.2.is_some() || a.2.zip(b.2).is_some_and(|(a, b)| off(a, b))
}

fn times(
    scene: &str,
    part: &str,
    world: &World,
    poses: &[Pose],
    means: &[Means],
    request: impl Fn(&Sensor) -> Option<Request>,
) {
    let repeats = number("PRESIGHT_REPEATS", 3);
    println!("\n| {scene}, {part} | whole, ms: p50, p95 | {} |", names(means));
    println!("|---|---|{}", "---|".repeat(means.len()));
    for known in PRESETS {
        let sensor = preset(known.name).expect("a preset");
        let Some(request) = request(&sensor) else { continue };
        let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("the CPU engine starts");
        let mut prediction =
            predictor.predict(world, &sensor, &SensorPose::new(poses[0]), &request).expect("it predicts");
        let variants: Vec<Option<Means>> = std::iter::once(None).chain(means.iter().copied().map(Some)).collect();
        let mut least = vec![vec![f64::INFINITY; poses.len()]; variants.len()];
        let mut others = vec![0; variants.len()];
        for (number, pose) in poses.iter().enumerate() {
            let mut whole = shown(&prediction);
            for _ in 0..repeats {
                for ((variant, times), others) in variants.iter().zip(&mut least).zip(&mut others) {
                    leave_out(*variant);
                    let start = ProcessTime::now();
                    predictor.predict_again(world, &SensorPose::new(*pose), &mut prediction).expect("it predicts");
                    times[number] = times[number].min(1e3 * start.elapsed().as_secs_f64());
                    match variant {
                        None => whole = shown(&prediction),
                        Some(means) => {
                            let (images, features) = shown(&prediction);
                            assert_eq!(images, whole.0, "{scene}, {}: {means:?}", known.name);
                            let pairs = features.iter().zip(&whole.1);
                            *others +=
                                features.len().abs_diff(whole.1.len()) + pairs.filter(|(a, b)| differ(a, b)).count();
                        }
                    }
                }
            }
        }
        leave_out(None);
        let at = |times: &[f64]| [0.5, 0.95].map(|share| quantile(times.iter().copied(), share));
        let [p50, p95] = at(&least[0]);
        let cells = least[1..].iter().zip(&others[1..]).map(|(times, others)| {
            let [a, b] = at(times);
            let others = if *others > 0 { format!(" ({others} features differ)") } else { String::new() };
            format!("{:.2}, {:.2}{others}", a / p50, b / p95)
        });
        println!("| {} | {p50:.2}, {p95:.2} | {} |", known.name, cells.collect::<Vec<_>>().join(" | "));
    }
}

fn names(means: &[Means]) -> String {
    means.iter().map(|means| format!("{means:?}")).collect::<Vec<_>>().join(" | ")
}

/// CPU time of this process.
#[derive(Debug)]
struct CpuTime;

impl Clock for CpuTime {
    fn now(&self) -> Duration {
        ProcessTime::now().as_duration()
    }
}

/// A frame's CPU time in milliseconds, and the share of its samples that are final: 0 if it is refused.
fn frame(predictor: &mut Predictor, world: &World, sensor: &Sensor, pose: &Pose, deadline_ms: Option<f64>) -> [f64; 2] {
    let mut request = Request::default();
    request.deadline = deadline_ms.map(|ms| Duration::from_secs_f64(ms / 1e3));
    let start = ProcessTime::now();
    let answer = predictor.predict(world, sensor, &SensorPose::new(*pose), &request);
    let took = 1e3 * start.elapsed().as_secs_f64();
    let pixels = f64::from(sensor.width()) * f64::from(sensor.height());
    let lost = answer.map_or(pixels, |p| p.stats.degradation().map_or(0.0, |given_up| given_up.samples as f64));
    [took, 1.0 - lost / pixels]
}

/// Kept deadlines of 0.7 to 1.7 times the full time, and final samples at 0.3, 0.6 and 0.8 of it.
fn deadlines(scene: &str, world: &World, poses: &[Pose]) {
    let frames = number("PRESIGHT_FRAMES", 400);
    println!("\n| {scene}, deadlines | left out | kept, % | final samples in 0.3, 0.6, 0.8 of the time, %: mean |");
    println!("|---|---|---|---|");
    for known in PRESETS {
        let sensor = preset(known.name).expect("a preset");
        let variants = || std::iter::once(None).chain(OF_DEADLINES.into_iter().map(Some));
        let mut predictors: Vec<Predictor> = variants()
            .map(|_| {
                let mut predictor =
                    Predictor::new(Options::new(Backend::Cpu).with_threads(1)).expect("the CPU engine starts");
                predictor.set_clock(Arc::new(CpuTime));
                predictor
            })
            .collect();
        let mut full = vec![f64::INFINITY; poses.len()];
        for _ in 0..3 {
            for (pose, full) in poses.iter().zip(&mut full) {
                *full = full.min(frame(&mut predictors[0], world, &sensor, pose, None)[0]);
            }
        }
        for pose in poses.iter().cycle().take(LEARNT) {
            for (means, predictor) in variants().zip(&mut predictors) {
                leave_out(means);
                frame(predictor, world, &sensor, pose, Some(GENEROUS_MS));
            }
        }
        let mut kept = vec![0; predictors.len()];
        let mut there = vec![[0.0; 3]; predictors.len()];
        for number in 0..frames {
            let at = number % poses.len();
            // The golden ratio spreads the deadlines evenly.
            let deadline = full[at] * (0.7 + (number as f64 * 0.618_033_988_749_894_9).fract());
            for ((means, predictor), kept) in variants().zip(&mut predictors).zip(&mut kept) {
                leave_out(means);
                *kept += usize::from(frame(predictor, world, &sensor, &poses[at], Some(deadline))[0] <= deadline);
            }
        }
        for (pose, full) in poses.iter().zip(&full).cycle().take(3 * poses.len()) {
            for (k, share) in [0.3, 0.6, 0.8].into_iter().enumerate() {
                for ((means, predictor), there) in variants().zip(&mut predictors).zip(&mut there) {
                    leave_out(means);
                    there[k] += frame(predictor, world, &sensor, pose, Some(share * full))[1];
                }
            }
        }
        leave_out(None);
        for ((means, kept), there) in variants().zip(kept).zip(there) {
            let kept = 100.0 * f64::from(kept as u32) / frames as f64;
            let there = there.map(|sum| format!("{:.1}", 100.0 * sum / (3 * poses.len()) as f64)).join(", ");
            let name = means.map_or("nothing".to_owned(), |means| format!("{means:?}"));
            println!("| {} | {name} | {kept:.1} | {there} |", known.name);
        }
    }
}
