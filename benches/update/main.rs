//! Learning from drives through changed sites: `cargo bench --bench update [-- SEEDS [SCENE [SENSOR [OFF [reasons]]]]]`. Scenes,
//! sensors and errors of poses are chosen by a part of their name, `-` for all. Each row is printed at once; `reasons` adds a
//! line for each visible change that was missed, with what pixels and views said of it. `-- walker FILE.png` draws a person who crosses
//! and leaves nothing.

#![allow(clippy::print_stdout, reason = "a bench prints its figures")]

mod case;
mod score;
mod walker;

use case::{Amounts, Case, Off};
use presight_files::{preset, sensor_toml};
use presight_model::environment::Environment;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_testkit::data;
use presight_update::{Evidence, LearnOptions, Learner};
use score::{HEAD, Score, score};
use std::collections::BTreeMap;
use std::time::Instant;

const AMOUNTS: Amounts = Amounts { removed: 20, moved: 20, added: 20, walkers: 10, views: 200 };
/// Poses that are off as stated, twice as far, and four times as far as stated.
const OFF: [(&str, Off); 3] = [
    ("5 mm, 0.1 deg", Off { is: (0.005, 0.1), stated: (0.005, 0.1) }),
    ("2 cm, 0.3 deg", Off { is: (0.02, 0.3), stated: (0.02, 0.3) }),
    ("2 cm, 0.3 deg, stated 5 mm, 0.075 deg", Off { is: (0.02, 0.3), stated: (0.005, 0.075) }),
];

/// A lidar of 32 rows, 1.8 degrees by 1.3.
const LIDAR: &str = "format = 1\nkind = \"scanner\"\nname = \"lidar-32\"\nclass = \"laser\"\nrange_min = 0.3\nrange_max = 30\n[azimuth]\nstart_deg = -180\nstep_deg = 0.6\ncount = 600\n[elevation]\nstart_deg = -25\nstep_deg = 1.29\ncount = 32\n[noise]\nrange_sigma = 0.01\nangle_sigma_deg = 0.02\n";

fn mounted(sensor: &Sensor, height: f64, pitch_deg: f64) -> Sensor {
    let mut spec = sensor.spec().clone();
    spec.mount = Pose::from_xyz_rpy(glam::DVec3::new(0.0, 0.0, height), 0.0, pitch_deg.to_radians(), 0.0);
    Sensor::new(spec).expect("a sound sensor")
}

fn sensors() -> Vec<(&'static str, Sensor)> {
    let lidar = Sensor::new(sensor_toml::parse(LIDAR, "lidar-32", None).expect("a sensor")).expect("a sensor");
    vec![
        ("range camera", mounted(&preset("laser-range-camera").expect("a preset"), 1.2, 0.0)),
        ("lidar of 32 rows", mounted(&lidar, 1.2, 0.0)),
        ("planar scanner", mounted(&preset("laser-scanner").expect("a preset"), 0.4, 0.0)),
    ]
}

fn scene(name: &str) -> Option<Environment> {
    if name.ends_with(".rhai") {
        let scene = presight::Scene::open(name).expect("a scene of the repository");
        return Some(Environment::clone(scene.world.environment()));
    }
    data::scene(name, true).map(|world| Environment::clone(world.environment()))
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let word = |k: usize| words.get(k).map_or("-", String::as_str);
    if word(0) == "walker" {
        return walker::strip(word(1));
    }
    let seeds = word(0).parse().unwrap_or(5u64);
    let chosen = |wanted: &str, name: &str| wanted == "-" || name.contains(wanted);
    println!("{HEAD}");
    let mut pooled: Vec<(String, Score)> = Vec::new();
    for name in ["factory_hall", "scenes/factory.rhai", "hospital"].into_iter().filter(|name| chosen(word(1), name)) {
        let Some(environment) = scene(name) else { continue };
        for seed in 1..=seeds {
            let case = Case::new(environment.clone(), AMOUNTS, seed);
            for (which, sensor) in sensors().iter().filter(|(which, _)| chosen(word(2), which)) {
                for (off_name, off) in OFF.iter().filter(|(off_name, _)| chosen(word(3), off_name)) {
                    let (found, seconds) = one(&case, sensor, *off);
                    println!("{} {seconds:.1} s", found.row(&format!("{name}, {seed}, {which}, {off_name}")));
                    if word(4) == "reasons" {
                        found.notes.iter().for_each(|note| println!("    {note}"));
                        found.missed.iter().for_each(|(name, note)| println!("    missed {name}: {note}"));
                    }
                    let key = format!("{which}, {off_name}");
                    match pooled.iter_mut().find(|(known, _)| *known == key) {
                        Some((_, sum)) => sum.add(&found),
                        None => pooled.push((key, found)),
                    }
                }
            }
        }
    }
    println!();
    pooled.iter().for_each(|(key, sum)| println!("{}", sum.row(key)));
}

/// Learns from one drive; returns also the seconds that learning took.
fn one(case: &Case, sensor: &Sensor, off: Off) -> (Score, f64) {
    let frames = case.drive(sensor, off);
    let started = Instant::now();
    let mut learner = Learner::new(LearnOptions::default()).expect("sound options");
    for (frame, pose, _) in &frames {
        learner.observe_at(&case.map, &[frame], pose).expect("a view");
    }
    learner.end_drive();
    let findings = learner.findings(&case.map);
    let seconds = started.elapsed().as_secs_f64();
    let truth: Vec<Pose> = frames.iter().map(|(_, _, truth)| *truth).collect();
    let mut score = score(case, sensor, &truth, &findings);
    let evidence: BTreeMap<String, Evidence> = learner.evidence(&case.map).into_iter().collect();
    for (name, note) in &mut score.missed {
        let (e, pixels) = (evidence.get(name), learner.pixels(&case.map, name));
        *note += &format!("; {e:?}; {pixels:?}");
    }
    (score, seconds)
}
