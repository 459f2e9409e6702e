//! Learning from drives through changed sites: `cargo bench --bench update [-- SEEDS [SCENE [SENSOR [OFF
//! [reasons]]]]]`. Scenes, sensors and errors of poses are chosen by a part of their name, `-` for all; the errors
//! `displaced`, `office` and `right` are other tables: of sites where every object is 1 cm off, of two states of one
//! office, and of the pixels of another drive. Each row is printed at once; `reasons` adds a line for each visible
//! change that was missed, with what pixels and views said of it. `-- walker FILE.png` draws a person who crosses and
//! leaves nothing; `-- willow [FOLDER]` learns a real building, and writes its logs into a folder; `-- hall FOLDER`
//! writes the log of a changed hall; `-- live` compares the time of learning with that of localizing.

#![allow(clippy::print_stdout, reason = "a bench prints its figures")]

mod case;
mod displaced;
mod live;
mod office;
mod right;
mod score;
mod walker;
mod willow;

use case::{Amounts, Case, Off};
use displaced::Judged;
use presight_model::environment::Environment;
use presight_model::geometry::{Pose, PoseEstimate};
use presight_model::measured::Frame;
use presight_model::sensor::Sensor;
use presight_read::{preset, sensor_toml};
use presight_testkit::data;
use presight_update::{Evidence, LearnOptions, Learner, SiteFindings};
use right::Right;
use score::{HEAD, Score, score, share};
use std::collections::BTreeMap;
use std::time::Instant;

const SCENES: [&str; 3] = ["factory_hall", "scenes/factory.rhai", "hospital"];
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

/// Each sensor, and all of them on one robot.
fn sets() -> Vec<(&'static str, Vec<&'static Sensor>)> {
    static ALL: std::sync::LazyLock<Vec<(&'static str, Sensor)>> = std::sync::LazyLock::new(sensors);
    let each = ALL.iter().map(|(name, sensor)| (*name, vec![sensor]));
    each.chain([("all sensors", ALL.iter().map(|(_, sensor)| sensor).collect())]).collect()
}

fn scene(name: &str) -> Option<Environment> {
    if name.ends_with(".rhai") {
        let scene = presight::Scene::open(name).expect("a scene of the repository");
        return Some(Environment::clone(scene.world.environment()));
    }
    data::scene(name, true).map(|world| Environment::clone(world.environment()))
}

/// Frames with estimated and true poses.
type Drive = Vec<(Frame, PoseEstimate, Pose)>;

/// Returns true for names that the words on the command line choose.
type Choice<'a> = &'a dyn Fn(&str, &str) -> bool;

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let word = |k: usize| words.get(k).map_or("-", String::as_str);
    if word(0) == "walker" {
        return walker::strip(word(1));
    }
    let seeds = word(0).parse().unwrap_or(5u64);
    if word(0) == "live" {
        return live::run();
    }
    if word(0) == "hall" {
        let case = Case::new(scene("factory_hall").expect("shared data"), AMOUNTS, 1);
        let frames =
            case.drive(&sensors()[0].1, OFF[0].1).into_iter().map(|(frame, pose, _)| (frame, pose.world_from_robot));
        return willow::write(word(1).as_ref(), &[frames.collect()]).expect("logs can be written");
    }
    if word(0) == "willow" {
        return willow::run(word(1), (word(2).parse().unwrap_or(0.05), word(3).parse().unwrap_or(0.003)));
    }
    let chosen = |wanted: &str, name: &str| wanted == "-" || name.contains(wanted);
    if word(3) == "right" {
        return right_pixels(seeds, (&chosen, word(1), word(2)));
    }
    if word(3) == "displaced" {
        return all_displaced(seeds, &chosen, (word(1), word(2)));
    }
    if word(3) == "office" {
        return both_offices(seeds, (&chosen, word(2)), word(4) == "reasons");
    }
    println!("{HEAD}");
    let mut pooled: Vec<(String, Score)> = Vec::new();
    for name in SCENES.into_iter().filter(|name| chosen(word(1), name)) {
        let Some(environment) = scene(name) else { continue };
        for seed in 1..=seeds {
            let case = Case::new(environment.clone(), AMOUNTS, seed);
            for (which, sensors) in sets().iter().filter(|(which, _)| chosen(word(2), which)) {
                for (off_name, off) in OFF.iter().filter(|(off_name, _)| chosen(word(3), off_name)) {
                    let (found, seconds) = one(&case, sensors, *off);
                    print(&found, &format!("{name}, {seed}, {which}, {off_name}"), seconds, word(4) == "reasons");
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

/// Every object is 1 cm off: where another drive finds the robot, before and after one drive taught how they stand.
fn all_displaced(seeds: u64, chosen: &dyn Fn(&str, &str) -> bool, (scenes, sensor_names): (&str, &str)) {
    println!("| drive | objects learnt | RMS mm before | after | NEES before | after |\n|---|---|---|---|---|---|");
    let row = |name: &str, objects: usize, [before, after]: &[Judged; 2]| {
        println!(
            "| {name} | {objects} | {:.2} | {:.2} | {:.2} | {:.2} |",
            1e3 * before.rms(),
            1e3 * after.rms(),
            before.nees(),
            after.nees()
        );
    };
    let judging = Off { is: (0.02, 0.5), stated: (0.02, 0.5) };
    let mut pooled: BTreeMap<&str, (usize, [Judged; 2])> = BTreeMap::new();
    for name in SCENES.into_iter().filter(|name| chosen(scenes, name)) {
        let Some(environment) = scene(name) else { continue };
        for seed in 1..=seeds {
            for (which, sensor) in sensors().iter().filter(|(which, _)| chosen(sensor_names, which)) {
                let case = displaced::case(environment.clone(), sensor, AMOUNTS.views, seed);
                let (after, refined) = displaced::learn(&case, sensor, OFF[0].1);
                let frames = case.on_another_way(seed + 100, 60).drive(sensor, judging);
                let judged = [&case.map, &after].map(|world| displaced::judge(world, &frames));
                row(&format!("{name}, {seed}, {which}"), refined.len(), &judged);
                let (objects, sum) = pooled.entry(which).or_default();
                *objects += refined.len();
                sum.iter_mut().zip(&judged).for_each(|(sum, own)| sum.add(own));
            }
        }
    }
    println!();
    pooled.iter().for_each(|(which, (objects, sum))| row(which, *objects, sum));
}

fn print(found: &Score, name: &str, seconds: f64, reasons: bool) {
    println!("{} {seconds:.1} s", found.row(name));
    if reasons {
        found.notes.iter().for_each(|note| println!("    {note}"));
        found.missed.iter().for_each(|(name, note)| println!("    missed {name}: {note}"));
    }
}

/// An office, and the same one as a building site: each is the map of the other.
fn both_offices(seeds: u64, (chosen, sensor_names): (Choice<'_>, &str), reasons: bool) {
    let (Some(office), Some(building)) = (scene("office_clearpath"), scene("office_construction_clearpath")) else {
        return;
    };
    println!(
        "| drive | missing and seen past, found | missing and visible, found | false deletions | moved that stand |\n|---|---|---|---|---|"
    );
    let row = |name: &str, s: &Score| {
        let (past, visible) = (share(s.seen_past), share(s.removed));
        println!("| {name} | {past} | {visible} | {} of {} | {} |", s.false_gone, s.standing, s.false_moved);
    };
    for (way, map, site) in [("office, then site", &office, &building), ("site, then office", &building, &office)] {
        for (which, sensors) in sets().iter().filter(|(which, _)| chosen(sensor_names, which)) {
            let mut sum = Score::default();
            for seed in 1..=seeds {
                let (found, _) = one(&office::case(map, site, 150, seed), sensors, OFF[0].1);
                row(&format!("{way}, {seed}, {which}"), &found);
                if reasons {
                    found.notes.iter().for_each(|note| println!("    {note}"));
                    found.missed.iter().for_each(|(name, note)| println!("    missed {name}: {note}"));
                }
                sum.add(&found);
            }
            row(&format!("{way}, {which}, all"), &sum);
        }
    }
}

/// The pixels of another drive after an update, by sensor.
fn right_pixels(seeds: u64, (chosen, scenes, sensor_names): (Choice<'_>, &str, &str)) {
    println!("| drive | were wrong, right now | were right, wrong now |\n|---|---|---|");
    let mut pooled: BTreeMap<&str, Right> = BTreeMap::new();
    for name in SCENES.into_iter().filter(|name| chosen(scenes, name)) {
        let Some(environment) = scene(name) else { continue };
        for seed in 1..=seeds {
            let case = Case::new(environment.clone(), AMOUNTS, seed);
            for (which, sensor) in sensors().iter().filter(|(which, _)| chosen(sensor_names, which)) {
                let (_, findings) = learnt(&case, &[case.drive(sensor, OFF[0].1)]);
                let right = right::count(&case, sensor, &findings, seed);
                println!("{}", right.row(&format!("{name}, {seed}, {which}")));
                pooled.entry(*which).or_default().add(&right);
            }
        }
    }
    println!();
    pooled.iter().for_each(|(which, sum)| println!("{}", sum.row(which)));
}

/// What one drive teaches, whose sensors have these frames.
fn learnt(case: &Case, drives: &[Drive]) -> (Learner, SiteFindings) {
    let mut learner = Learner::new(LearnOptions::default()).expect("sound options");
    for (k, (_, pose, _)) in drives[0].iter().enumerate() {
        let frames: Vec<_> = drives.iter().map(|drive| &drive[k].0).collect();
        learner.observe_at(&case.map, &frames, pose).expect("a view");
    }
    learner.end_drive();
    let findings = learner.findings(&case.map);
    (learner, findings)
}

/// Learns from one drive of several sensors; returns also the seconds that learning took.
fn one(case: &Case, sensors: &[&Sensor], off: Off) -> (Score, f64) {
    let drives: Vec<Drive> = sensors.iter().map(|sensor| case.drive(sensor, off)).collect();
    let started = Instant::now();
    let (learner, findings) = learnt(case, &drives);
    let seconds = started.elapsed().as_secs_f64();
    let truth: Vec<Pose> = drives[0].iter().map(|(_, _, truth)| *truth).collect();
    let mut score = score(case, sensors, &truth, &findings);
    let evidence: BTreeMap<String, Evidence> = learner.evidence(&case.map).into_iter().collect();
    for (name, note) in &mut score.missed {
        *note += &format!("; {:?}", evidence.get(name));
    }
    (score, seconds)
}
