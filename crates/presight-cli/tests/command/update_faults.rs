//! `presight update` on disks that are full, with sensors that see nothing, and before glass and mirrors.

use super::update::{CHANGE, LIDAR, POSES, changes, drive, room, site, site_of};
use super::{Outcome, Place};
use glam::{DVec3, Vec3};
use presight::environment::{Appearance, Environment, Material, Mesh, NewObject};
use presight::store;
use presight::{Pose, RobotPose};
use serde_json::{Value, json};
use std::fs;

fn bytes(place: &Place) -> Vec<u8> {
    fs::read(place.path("map.presight")).unwrap()
}

/// The lines of a log after its header.
fn frames(place: &Place, folder: &str) -> (String, Vec<Value>) {
    let text = fs::read_to_string(place.path(folder).join("scans.jsonl")).unwrap();
    let (header, rest) = text.split_once('\n').unwrap();
    (header.to_owned(), rest.lines().map(|line| serde_json::from_str(line).unwrap()).collect())
}

/// Writes a log with other readings, by frame, ray and measured range.
fn rewrite(place: &Place, from: &str, to: &str, reading: impl Fn(usize, usize, &Value) -> Value) {
    let (header, frames) = frames(place, from);
    let line = |(number, mut frame): (usize, Value)| {
        let ranges = frame["range"].as_array_mut().unwrap();
        ranges.iter_mut().enumerate().for_each(|(ray, range)| *range = reading(number, ray, range));
        frame.to_string()
    };
    let lines: Vec<String> = frames.into_iter().enumerate().map(line).collect();
    place.write(to, format!("{header}\n{}\n", lines.join("\n")).as_bytes());
}

/// Files may grow to ever more kilobytes, as on a disk that is full at some moment: the run says which file could not be written, the
/// store has no change or the acknowledged ones, and the evidence is whole or missing. With room the next run ends well.
#[cfg(unix)]
#[test]
fn a_full_disk_leaves_store_and_evidence_whole() {
    let place = site(Some(2), Some(5));
    let line = format!("update log/scans.jsonl --map map.presight {CHANGE} --evidence e.json --out found --apply");
    let (mut failed, mut ended) = (0, 0);
    for blocks in [1, 8, 32, 128, 512, 1024, 4096] {
        let mut shell = std::process::Command::new("sh");
        shell.current_dir(place.path("")).args(["-c", &format!("ulimit -f {blocks}; exec \"$@\""), "sh"]);
        let done = shell.arg(env!("CARGO_BIN_EXE_presight")).args(line.split(' ')).output().unwrap();
        let stderr = String::from_utf8(done.stderr).unwrap();
        let count = store::check(&place.path("map.presight")).unwrap().changes;
        match done.status.code() {
            Some(0) => ended += 1,
            Some(4) => {
                failed += 1;
                let errors: Vec<&str> = stderr.lines().filter(|line| line.starts_with("error: ")).collect();
                assert!(errors.len() == 1 && errors[0].contains("; "), "{blocks}: {stderr}");
                assert!(["found", "map.presight", "e.json"].iter().any(|name| errors[0].contains(name)), "{stderr}");
            }
            _ => panic!("{blocks}: {} {stderr}", done.status),
        }
        assert!(count == 0 || count >= 3, "three changes are committed together: {count}");
        if let Ok(text) = fs::read_to_string(place.path("e.json")) {
            assert!(serde_json::from_str::<Value>(&text).is_ok(), "{blocks}");
        }
        assert!(!place.path("map.presight-update").exists(), "{blocks}");
    }
    assert!(failed > 0 && ended > 0, "{failed} {ended}");
    assert_eq!(place.run(&line).status, Some(0));
    assert!(store::check(&place.path("map.presight")).unwrap().environment.object("crate 2").is_none());
}

/// A covered sensor, one whose readings are all missing, and one that meets nothing within its reach: nothing is changed.
#[test]
fn a_sensor_that_sees_nothing_changes_nothing() {
    let place = site(None, None);
    for (name, value) in
        [("missing", Value::Null), ("nothing", json!("inf")), ("covered", json!("-inf")), ("near", json!(0.05))]
    {
        rewrite(&place, "log", "blind.jsonl", |_, _, _| value.clone());
        let before = bytes(&place);
        // A localizer without readings searches all over: once is enough.
        for start in [POSES, "--init reference"].iter().take(if name == "missing" { 2 } else { 1 }) {
            let line = format!("update blind.jsonl --map map.presight {start} --policy change --out found --apply");
            let done = place.run(&line);
            assert!(changes(&place, "found").is_empty(), "{name}, {start}: {done:?}");
            assert_eq!(bytes(&place), before, "{name}, {start}");
        }
    }
    // Half of its rays see nothing: what the others see stands, and the rest is in doubt or unseen.
    rewrite(&place, "log", "half.jsonl", |_, ray, range| if ray % 180 < 90 { Value::Null } else { range.clone() });
    let done = place.run(&format!("update half.jsonl --map map.presight {CHANGE} --out found"));
    assert!(done.stdout.contains("0 gone, 0 moved, 0 new"), "{done:?}");
}

/// A mount whose yaw is 3 degrees off, with the localizer's own poses: whatever it makes of it, nothing that stands is changed.
#[test]
fn a_yaw_of_the_mount_deletes_nothing_with_own_poses() {
    let place = site(None, None);
    place.write("wrong.toml", format!("{LIDAR}rpy_deg = [0.0, 0.0, 3.0]\n").as_bytes());
    let line =
        "update log/scans.jsonl --map map.presight --sensor wrong.toml --init reference --policy change --out found";
    let done = place.run(line);
    assert!(done.stdout.contains("0 gone, 0 moved, 0 new, 0 parts gone"), "{done:?}");
}

/// The room with a pane that faces y, of a material that radar sees through if `clear`.
fn with_pane(clear: bool, least: DVec3, width: f32) -> Environment {
    let mut environment = room(None, None);
    let mut glass = Material::named("pane");
    if clear {
        glass.appearance.insert("radar".to_owned(), Appearance::Transparent);
    }
    let material = environment.add_material(glass).unwrap();
    let mesh = Mesh::cuboid("pane", Vec3::ZERO, Vec3::new(width, 0.02, 1.6), material).unwrap();
    let pose = Pose { translation: least, ..Pose::IDENTITY };
    environment.insert(NewObject::new("pane", pose, mesh.into())).unwrap();
    environment
}

fn found(place: &Place, log: &str) -> (Outcome, Vec<(String, String)>) {
    let done = place.run(&format!("update {log} --map map.presight {CHANGE} --out found"));
    let of = |line: &Value| {
        (line["op"].as_str().unwrap().to_owned(), line["object"].as_str().unwrap_or_default().to_owned())
    };
    let lines = changes(place, "found").iter().map(of).filter(|(op, _)| op != "group").collect();
    (done, lines)
}

/// The cosine of the incidence of a ray on a pane that faces y, for a robot that heads along x.
fn cosine(ray: usize) -> f64 {
    let (azimuth, elevation) = (-180.0 + 2.0 * (ray % 180) as f64, -20.0 + 2.0 * (ray / 180) as f64);
    (azimuth.to_radians().sin() * elevation.to_radians().cos()).abs()
}

/// A pane that flat rays meet and steep ones pass is glass, absent for lasers, not gone. A pane that no ray meets is gone, unless its
/// material says that some class sees through it.
#[test]
fn a_pane_that_is_met_flat_is_glass() {
    // From both ends of the drive all of it is met flat.
    let pane = with_pane(false, DVec3::new(4.0, 3.7, 0.2), 1.0);
    let place = site_of(&pane, &pane);
    drive(&place, &room(None, None), "open");
    let (_, open) = frames(&place, "open");
    rewrite(&place, "log", "glass.jsonl", |frame, ray, range| {
        if cosine(ray) < 0.45 { range.clone() } else { open[frame]["range"][ray].clone() }
    });
    let (done, lines) = found(&place, "glass.jsonl");
    assert_eq!(lines, [("set_mark".to_owned(), "pane".to_owned())], "{done:?}");
    assert!(done.stdout.contains("1 seen through") && changes(&place, "found")[0]["class"] == "laser", "{done:?}");
    let (done, lines) = found(&place, "open/scans.jsonl");
    assert_eq!(lines, [("delete_object".to_owned(), "pane".to_owned())], "{done:?}");
}

/// A mirror shows the room behind itself. Its material is see-through to a class, so it is absent for lasers, and what it shows
/// becomes no object.
#[test]
fn a_mirror_shows_nothing_new() {
    let pane = with_pane(true, DVec3::new(3.4, 4.4, 0.2), 1.8);
    let place = site_of(&pane, &pane);
    // The room as the mirror at y = 4.4 m shows it.
    let mut shown = Environment::new();
    shown.add_material(Material::named("paint")).unwrap();
    let mut add = |min: DVec3, max: DVec3| {
        let mesh = Mesh::cuboid("shown", min.as_vec3(), max.as_vec3(), 0).unwrap();
        shown.insert(NewObject::new("shown", Pose::IDENTITY, mesh.into())).unwrap();
    };
    // Wall, sides, floor and ceiling of the room, and the crates before the mirror.
    for (min, max) in [
        ([0.0, 8.8, 0.0], [9.0, 8.9, 2.6]),
        ([-0.1, 0.0, 0.0], [0.0, 8.8, 2.6]),
        ([9.0, 0.0, 0.0], [9.1, 8.8, 2.6]),
        ([0.0, 0.0, -0.1], [9.0, 8.8, 0.0]),
        ([0.0, 0.0, 2.6], [9.0, 8.8, 2.7]),
    ] {
        add(DVec3::from_array(min), DVec3::from_array(max));
    }
    let map = room(None, None);
    for b in map.objects().iter().skip(1).map(|object| object.world_bounds()).filter(|b| b.max.y < 4.4) {
        add(DVec3::new(b.min.x, 8.8 - b.max.y, b.min.z), DVec3::new(b.max.x, 8.8 - b.min.y, b.max.z));
    }
    drive(&place, &shown, "behind");
    drive(&place, &room(None, None), "open");
    let ((_, behind), (_, open)) = (frames(&place, "behind"), frames(&place, "open"));
    // Where the pane changes a reading, the mirror does.
    rewrite(&place, "log", "mirror.jsonl", |frame, ray, range| {
        let (with, without) = (range.as_f64(), open[frame]["range"][ray].as_f64());
        let hits = with.zip(without).is_some_and(|(with, without)| without - with > 0.1);
        if hits { behind[frame]["range"][ray].clone() } else { range.clone() }
    });
    let (done, lines) = found(&place, "mirror.jsonl");
    assert_eq!(lines, [("set_mark".to_owned(), "pane".to_owned())], "{done:?}");
    assert!(done.stdout.contains("0 gone, 0 moved, 0 new, 0 parts gone, 1 seen through"), "{done:?}");
}

/// A robot that turns about in one place drives on never, so its views wait. No more of them wait than are kept: memory is bounded.
#[test]
fn a_robot_that_turns_in_place_keeps_few_views() {
    use presight::PoseEstimate;
    use presight::files::LogFrames;
    use presight::measured::OdometryNoise;
    use presight::update::{LearnOptions, Learner};
    let place = site(None, None);
    let world = store::read_world(&place.path("map.presight"), &presight::environment::IndexKind::default()).unwrap();
    let mut log = LogFrames::open(&place.path("log/scans.jsonl"), None, &OdometryNoise::default()).unwrap();
    let frame = log.next().unwrap().unwrap().frame;
    let mut learner = Learner::new(LearnOptions::default().with_views(10)).unwrap();
    for turn in 0..50 {
        let pose = Pose::from_xyz_rpy(DVec3::new(1.0, 2.6, 0.0), 0.0, 0.0, 0.3 * f64::from(turn));
        learner.observe_at(&world, &[&frame], &PoseEstimate::of_sigmas(RobotPose::new(pose), 0.005, 0.002)).unwrap();
    }
    assert_eq!((learner.tally().views, learner.tally().discarded), (50, 40));
}
