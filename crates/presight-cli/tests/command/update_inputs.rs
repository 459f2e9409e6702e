//! `presight update` with bad and hostile inputs and with several sensors, and a learner that follows a localizer.

use super::update::{CHANGE, LIDAR, POSES, changes, crates, drive, room, site, site_of};
use super::{Place, bad, check};
use presight::environment::Environment;
use presight::store;
use std::fs;
use std::process::{Command, Stdio};
use std::time::Duration;

fn stored(place: &Place) -> store::Info {
    store::check(&place.path("map.presight")).unwrap()
}

fn bytes(place: &Place) -> Vec<u8> {
    fs::read(place.path("map.presight")).unwrap()
}

/// Killed at any moment, the store has no change or all that were acknowledged, and the file of evidence is whole or missing. The
/// next run goes on.
#[test]
fn a_killed_run_leaves_store_and_evidence_whole() {
    let place = site(Some(2), Some(5));
    let line = format!("update log/scans.jsonl --map map.presight {CHANGE} --evidence e.json --out found --apply");
    for ms in [3, 40, 80, 120, 160, 200, 240, 300] {
        let mut run = Command::new(env!("CARGO_BIN_EXE_presight"));
        run.current_dir(place.path("")).args(line.split(' ')).stdout(Stdio::null()).stderr(Stdio::null());
        let mut child = run.spawn().unwrap();
        std::thread::sleep(Duration::from_millis(ms));
        child.kill().unwrap();
        child.wait().unwrap();
        let count = stored(&place).changes;
        assert!(count == 0 || count >= 3, "three changes are committed together: {count}");
        if let Ok(text) = fs::read_to_string(place.path("e.json")) {
            assert!(serde_json::from_str::<serde_json::Value>(&text).is_ok(), "after {ms} ms");
        }
    }
    let done = place.run(&line);
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    assert!(stored(&place).environment.object("crate 2").is_none());
    assert!(!place.path("map.presight-update").exists() && !place.path("e.json-update").exists());
}

/// The second of two updates of one store, or of one file of evidence, is refused. A store that is read-only is refused before
/// the drive is read; without --apply it serves.
#[test]
fn what_cannot_be_written_is_refused_at_once() {
    let place = site(Some(2), None);
    let line = |rest: &str| format!("update log/scans.jsonl --map map.presight {POSES} --out found {rest}");
    for (name, rest) in [("map.presight", "--apply"), ("e.json", "--evidence e.json")] {
        let claim = fs::File::create(place.path(&format!("{name}-update"))).unwrap();
        claim.lock().unwrap();
        check(&place, vec![bad(line(rest), 4, &[name, "another presight update"])]);
        drop(claim);
        fs::remove_file(place.path(&format!("{name}-update"))).unwrap();
    }
    let mut permissions = fs::metadata(place.path("map.presight")).unwrap().permissions();
    permissions.set_readonly(true);
    fs::set_permissions(place.path("map.presight"), permissions).unwrap();
    check(&place, vec![bad(line("--apply"), 4, &["map.presight", "read-only", "--apply"])]);
    assert_eq!(place.run(&line("")).status, Some(0));
}

/// With no time, nothing is applied; it waits in the file of changes.
#[test]
fn what_has_no_time_waits_in_the_file_of_changes() {
    let place = site(Some(2), Some(5));
    let line =
        |ms: &str| format!("update log/scans.jsonl --map map.presight {CHANGE} --out found --apply --deadline-ms {ms}");
    check(&place, vec![bad(line("-1"), 2, &["--deadline-ms"]), bad(line("nan"), 2, &["--deadline-ms"])]);
    let done = place.run(&line("0"));
    assert!(done.status == Some(0) && done.stderr.contains("3 of 3 changes wait"), "{done:?}");
    assert_eq!(stored(&place).changes, 0);
    assert_eq!(place.done("env apply map.presight found/changes.jsonl"), "ack 1\nack 2\nack 3\n");
}

/// A log of another sensor than the one that is named.
#[test]
fn a_log_of_another_sensor_is_named() {
    let place = site(None, None);
    place.write("other.toml", LIDAR.replace("count = 180", "count = 90").as_bytes());
    let line = format!("update log/scans.jsonl --map map.presight --sensor other.toml {POSES} --out found");
    let done = place.run(&line);
    assert!(done.status == Some(2) && done.stderr.contains("scans.jsonl") && done.stderr.contains("180"), "{done:?}");
}

/// A mount whose yaw is 3 degrees off pulls every view the same way: that is said, and nothing is changed.
#[test]
fn a_yaw_of_the_mount_is_no_change_of_the_site() {
    let place = site(Some(2), None);
    place.write("wrong.toml", format!("{LIDAR}rpy_deg = [0.0, 0.0, 3.0]\n").as_bytes());
    let before = bytes(&place);
    let line = format!("update log/scans.jsonl --map map.presight --sensor wrong.toml {CHANGE} --out found --apply");
    let done = place.run(&line);
    assert!(done.status == Some(1) && done.stderr.contains("the model is not changed: "), "{done:?}");
    assert!(done.stderr.contains("mount"), "{done:?}");
    assert!(changes(&place, "found").is_empty());
    assert_eq!(bytes(&place), before);
}

/// A map that is mirrored, and one of another place: with the poses known nothing is changed, and with the localizer's own either
/// nothing is learnt or nothing is changed. The store is untouched byte for byte.
#[test]
fn a_wrong_map_is_untouched() {
    let mirrored = crates(None, |_, x| 8.3 - x, None);
    let mut hall = Environment::new();
    hall.add_cuboid("hall", presight::Pose::IDENTITY, glam::DVec3::splat(90.0)).unwrap();
    for (map, starts) in
        [(mirrored, &[POSES, "--from 18 --init reference"][..]), (hall, &["--from 18 --init reference"])]
    {
        let place = site_of(&map, &room(None, None));
        let before = bytes(&place);
        for start in starts {
            let done = place
                .run(&format!("update log/scans.jsonl --map map.presight {start} --policy change --out found --apply"));
            assert!(changes(&place, "found").is_empty(), "{start}: {done:?}");
            assert!(
                done.stderr.contains("never certain") || done.stderr.contains("the model is not changed"),
                "{start}: {done:?}"
            );
            assert_eq!(bytes(&place), before, "{start}");
        }
    }
}

/// A door that opens and closes every hour of a day ends as uncertain once. Seen open and closed in one run it comes and goes.
#[test]
fn a_door_is_uncertain_once() {
    let place = site(Some(2), None);
    drive(&place, &room(None, None), "closed");
    for hour in 0..24 {
        let log = if hour % 2 == 0 { "log" } else { "closed" };
        let time = 1.7e9 + 3600.0 * f64::from(hour);
        let line = format!(
            "update {log}/scans.jsonl --map map.presight {POSES} --time {time} --evidence e.json --out found --apply"
        );
        let done = place.run(&line);
        assert_eq!(done.status, Some(0), "{}", done.stderr);
    }
    let marks: Vec<String> = stored(&place).environment.marks().map(|(_, m)| m.object.clone()).collect();
    assert_eq!(marks, ["crate 2"]);
    assert_eq!(place.done("env log map.presight").matches("crate 2 is not").count(), 1);
    let place = site(Some(2), None);
    drive(&place, &room(None, None), "closed");
    let done = place.run(&format!("update log/scans.jsonl closed/scans.jsonl --map map.presight {CHANGE} --out found"));
    assert!(done.stdout.contains("0 gone, 0 moved, 0 new, 0 parts gone, 0 seen through, 1 come and go"), "{done:?}");
    let lines = changes(&place, "found");
    assert_eq!((&lines[0]["op"], &lines[0]["kind"]), (&"set_mark".into(), &"uncertain".into()));
}

/// A crate of glass that the laser sees through is absent for lasers; it is not gone.
#[test]
fn glass_is_absent_for_its_class() {
    let place = site_of(&crates(None, |_, x| x, Some(2)), &room(Some(2), None));
    let done = place.run(&format!("update log/scans.jsonl --map map.presight {CHANGE} --out found --apply"));
    assert!(done.stdout.contains("0 gone, 0 moved, 0 new, 0 parts gone, 1 seen through"), "{done:?}");
    let environment = stored(&place).environment;
    assert!(environment.object("crate 2").is_some());
    let marks: Vec<_> = environment.marks().map(|(_, m)| (m.object.as_str(), m.class.as_deref())).collect();
    assert_eq!(marks, [("crate 2", Some("laser"))]);
    let again = place.run(&format!("update log/scans.jsonl --map map.presight {CHANGE} --out again"));
    assert!(again.stdout.contains("0 gone, 0 moved, 0 new, 0 parts gone, 0 seen through"), "{again:?}");
}

/// Two sensors of one robot in one drive find what one of them finds, and more views speak.
#[test]
fn the_sensors_of_a_robot_learn_together() {
    let place = site(Some(2), Some(5));
    let low = LIDAR.replace("xyz = [0.0, 0.0, 1.0]", "xyz = [0.1, 0.0, 0.6]");
    place.write("low.toml", low.as_bytes());
    let made = place.run("simulate log.presight --sensor low.toml --poses drive.tum --out low");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    place.write(
        "robot.toml",
        b"format = 1\n[[sensors]]\nname = \"high\"\nsensor = \"lidar.toml\"\n[[sensors]]\nname = \"low\"\nsensor = \"low.toml\"\n",
    );
    let logs = "high=log/scans.jsonl low=low/scans.jsonl";
    for start in [CHANGE, "--init reference --policy change"] {
        let done = place.run(&format!("update {logs} --robot robot.toml --map map.presight {start} --out found"));
        assert_eq!(done.status, Some(0), "{}", done.stderr);
        assert!(done.stdout.contains("1 gone, 1 moved, 0 new"), "{start}: {done:?}");
        let views = changes(&place, "found")[0]["evidence"]["views"].as_u64().unwrap();
        let alone = place.run(&format!("update log/scans.jsonl --map map.presight {start} --out alone"));
        assert_eq!(alone.status, Some(0), "{}", alone.stderr);
        assert!(views > changes(&place, "alone")[0]["evidence"]["views"].as_u64().unwrap(), "{start}");
    }
    check(
        &place,
        vec![
            bad(
                format!("update log/scans.jsonl --robot robot.toml --map map.presight {POSES} --out x"),
                2,
                &["NAME=LOG"],
            ),
            bad(
                format!("update top=log/scans.jsonl --robot robot.toml --map map.presight {POSES} --out x"),
                2,
                &["\"top\"", "high"],
            ),
        ],
    );
}

/// A learner that gets the steps of a localizer decides as the command does on the same log.
#[test]
fn beside_a_localizer_it_decides_as_the_command() {
    use presight::PoseEstimate;
    use presight::files::LogFrames;
    use presight::localize::{EstimateOptions, Estimator};
    use presight::localize::{LocalizeOptions, Localizer};
    use presight::measured::OdometryNoise;
    use presight::update::{LearnOptions, Learner, Policy};
    use presight::{Backend, Options, Predictor};
    let place = site(Some(2), Some(5));
    let done = place.run("update log/scans.jsonl --map map.presight --init reference --policy change --out found");
    assert!(done.status == Some(0) && done.stdout.contains("1 gone, 1 moved, 0 new"), "{done:?}");
    let world = store::read_world(&place.path("map.presight"), &presight::environment::IndexKind::default()).unwrap();
    let mut log = LogFrames::open(&place.path("log/scans.jsonl"), None, &OdometryNoise::default()).unwrap().peekable();
    let start = log.peek().unwrap().as_ref().unwrap().reference.unwrap();
    let predictor = Predictor::new(Options::new(Backend::Cpu)).unwrap();
    let options = EstimateOptions::default().with_offset_sigma(1e-3);
    let prior = PoseEstimate::of_sigmas(start, 0.05, 2f64.to_radians());
    let mut localizer = Localizer::new(Estimator::new(predictor, options), prior, LocalizeOptions::default());
    let mut learner = Learner::new(LearnOptions::default()).unwrap();
    for observation in log {
        let frame = observation.unwrap().frame;
        let step = localizer.step(&world, &frame).unwrap();
        learner.observe(&world, &step, &[&frame]).unwrap();
    }
    learner.end_drive();
    let findings = learner.findings(&world);
    let policy = Policy::parse("change").unwrap();
    let proposed = learner.changes(&findings, &world, ("x", 0.0), &policy).unwrap();
    let of = |line: &serde_json::Value| (line["op"].clone(), line["object"].clone(), line["evidence"].clone());
    let own: Vec<_> =
        proposed.iter().map(|change| of(&serde_json::from_str(&change.line().unwrap()).unwrap())).collect();
    let commands: Vec<_> = changes(&place, "found").iter().map(of).collect();
    assert_eq!(own, commands);
}

/// A replay shows how evidence grows, frame by frame.
#[cfg(feature = "report")]
#[test]
fn a_replay_shows_what_each_frame_teaches() {
    let place = site(Some(2), None);
    let done = place.run("replay log/scans.jsonl --map map.presight --init reference --learn --out page");
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    let page = fs::read_to_string(place.path("page/index.html")).unwrap();
    let said: Vec<f64> =
        page.split("crate 2 -").skip(1).filter_map(|rest| rest.split(' ').next()?.parse().ok()).collect();
    assert!(said.len() > 5 && said.windows(2).all(|pair| pair[1] >= pair[0]), "{said:?}");
    assert!(said.last().unwrap() >= &9.0, "{said:?}");
}
