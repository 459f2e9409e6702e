//! Logs as drivers write them, faults late in a log, answers through pipes, and objects that are left out. The inputs
//! are in `tests/files/cases`.

use super::{Outcome, Place, WALL, WALL_INDICES, bad, check, wall};
use presight::files;
use serde_json::{Value, json};
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// A place with the files of a case.
fn case(name: &str) -> Place {
    fn copy(from: &Path, to: &Path) {
        for entry in fs::read_dir(from).unwrap() {
            let (from, to) = (entry.as_ref().unwrap().path(), to.join(entry.unwrap().file_name()));
            if from.is_dir() {
                fs::create_dir(&to).unwrap();
                copy(&from, &to);
            } else {
                fs::copy(from, to).unwrap();
            }
        }
    }
    let place = Place::new();
    copy(&Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/files/cases").join(name), place.folder.path());
    place
}

fn text(place: &Place, name: &str) -> String {
    fs::read_to_string(place.path(name)).unwrap()
}

/// The position at each time of a trajectory.
fn positions(place: &Place, name: &str) -> Vec<(f64, [f64; 3])> {
    files::read_tum(&place.path(name)).unwrap().iter().map(|s| (s.time, s.pose.translation.to_array())).collect()
}

fn near(found: &[(f64, [f64; 3])], expected: &[(f64, [f64; 3])], within: f64) {
    assert_eq!(found.len(), expected.len(), "{found:?}");
    for (f, e) in found.iter().zip(expected) {
        let off = (0..3).map(|i| (f.1[i] - e.1[i]).abs()).fold(0.0, f64::max);
        assert!(f.0 == e.0 && off < within, "{f:?} for {e:?}");
    }
}

fn localized(place: &Place, args: &str) -> Outcome {
    let done = place.run(&format!("localize {args} --out out.tum"));
    assert_eq!(done.status, Some(0), "{args}: {}", done.stderr);
    done
}

/// A ring does not hold the turn about its middle, 1 m away: the pose is the mean of hypotheses along an arc, and is off by no more
/// than it says. Its distance from the wall ahead is held.
fn check_in_ring(place: &Place) {
    let details: Value = serde_json::from_str(text(place, "out.jsonl").lines().next().unwrap()).unwrap();
    let sigma = |k: usize| details["covariance"][k][k].as_f64().unwrap().sqrt();
    let [(time, at)] = positions(place, "out.tum")[..] else { panic!("one frame") };
    let off = [at[0] - 1.0, at[1]];
    assert!(time == 1.0 && off[0].abs() < 2.6 * sigma(0) && off[1].abs() < 2.6 * sigma(1), "{at:?}: {details}");
    assert!(off[0].abs() < 5e-3 && sigma(0) < 0.05 && sigma(1) < 0.1, "{at:?}: {details}");
    assert_eq!(details["weak"], json!(["yaw"]), "{details}");
}

/// REP-117 and sensor_msgs/LaserScan: whatever a driver writes for no measurement, the pose has the same bits.
#[test]
fn readings_that_are_none_are_left_out_however_they_are_written() {
    let place = case("scan-no-return");
    let none = "presight takes 1 as no measurement";
    let missing = "(1 x null or NaN)";
    let outside = "(1 x outside of 0..16 m)";
    let follow = |log: &str| localized(&place, &format!("{log} --map ring.glb --init 1,0,0,0,0,0"));
    let over = text(&place, "over.json");
    assert_eq!(over.matches("65.533").count(), 1);
    let mut files = Vec::new();
    for (value, how) in [
        ("65.533", outside),
        ("16.0001", outside),
        ("-1", outside),
        ("1e300", outside),
        ("null", missing),
        ("NaN", missing),
        ("-nan", missing),
        ("\"nan\"", missing),
        ("0.0", "(1 x 0)"),
        ("0", "(1 x 0)"),
    ] {
        place.write("log.json", over.replace("65.533", value).as_bytes());
        let said = follow("log.json").stderr;
        assert_eq!(said, format!("note: log.json: of 720 readings, {none} {how}\n"), "{value}");
        files.push((text(&place, "out.tum"), text(&place, "out.jsonl")));
    }
    assert!(files.iter().all(|f| *f == files[0]), "{files:?}");
    check_in_ring(&place);
    // The same in format 1, whose header holds the same limits.
    let document: Value = serde_json::from_str(&over).unwrap();
    let sensor = "format=1\nkind=\"scanner\"\nrange_max=16\n[azimuth]\nstart_deg=-180\nstep_deg=0.5\ncount=720\n[elevation]\nangles_deg=[0]\n";
    let header = json!({ "format": 1, "kind": "range-log", "sensor": sensor }).to_string();
    let line = json!({ "t": 1, "range": document["scans"][0]["ranges"] }).to_string();
    for (value, how) in [("65.533", outside), ("NaN", missing), ("0.0", "(1 x 0)")] {
        place.write("log.jsonl", format!("{header}\n{}\n", line.replace("65.533", value)).as_bytes());
        let said = follow("log.jsonl").stderr;
        assert_eq!(said, format!("note: log.jsonl: of 720 readings, {none} {how}\n"), "{value}");
        assert_eq!(text(&place, "out.tum"), files[0].0, "{value}");
    }
}

/// A word for infinity says that nothing is within reach, in quotes and without.
#[test]
fn infinite_readings_keep_their_meaning() {
    let place = case("scan-no-return");
    let inf = text(&place, "text.json");
    assert_eq!(inf.matches("\"inf\"").count(), 1);
    let mut files = Vec::new();
    for word in ["\"inf\"", "inf", "Infinity", "\"Infinity\"", "-inf", "-Infinity", "\"-inf\""] {
        place.write("log.json", inf.replace("\"inf\"", word).as_bytes());
        let said = localized(&place, "log.json --map ring.glb --init 1,0,0,0,0,0").stderr;
        let meaning = if word.contains('-') { "too near (-inf)" } else { "nothing within reach (inf)" };
        assert_eq!(said, format!("note: log.json: of 720 readings, presight takes 1 as {meaning}\n"), "{word}");
        check_in_ring(&place);
        let details: Value = serde_json::from_str(&text(&place, "out.jsonl")).unwrap();
        files.push((word.contains('-'), details["verdicts"].clone()));
    }
    // The ray passed through a surface, or ended before one.
    for (is_near, verdicts) in files {
        let expected = if is_near { (1, 0) } else { (0, 1) };
        let counts = (verdicts["nearer"].as_u64().unwrap(), verdicts["farther"].as_u64().unwrap());
        assert_eq!((counts, verdicts["no_return"].as_u64()), (expected, Some(0)), "{verdicts}");
    }
}

/// A depth of 65535 and one of 0 are the same: the frame is tracked, and costs no search of the map.
#[test]
fn saturated_depths_are_no_measurement() {
    let place = case("depth-65535");
    let follow = || localized(&place, "log --map hall.glb --init 3.0,3.5,1.2,0,15,200");
    let said = follow().stderr;
    let truth = [(0.0, [3.0, 3.5, 1.2]), (1.0, [3.06, 3.52, 1.2])];
    near(&positions(&place, "out.tum"), &truth, 1e-3);
    let (poses, mut saturated) = (text(&place, "out.tum"), 0);
    for name in ["000000.png", "000001.png"] {
        let path = place.path("log/depth").join(name);
        let mut image = image::open(&path).unwrap().into_luma16();
        for pixel in image.pixels_mut().filter(|p| p.0 == [u16::MAX]) {
            pixel.0 = [0];
            saturated += 1;
        }
        image.save(path).unwrap();
    }
    let said_of =
        |how: &str| format!("note: log: of 38400 readings, presight takes {saturated} as no measurement ({how})\n");
    assert_eq!(said, said_of(&format!("{saturated} x 65535")));
    assert_eq!(follow().stderr, said_of(&format!("{saturated} x 0")));
    assert_eq!(text(&place, "out.tum"), poses);
}

/// The drive of the hall: 0.25 m along x and 0.05 m along y a second.
fn hall(count: usize) -> Vec<(f64, [f64; 3])> {
    (0..count).map(|k| (k as f64, [1.5 + 0.25 * k as f64, 3.5 + 0.05 * k as f64, 0.0])).collect()
}

#[test]
fn a_late_fault_keeps_the_frames_before() {
    let place = case("localize-error-keeps-nothing");
    for (log, count, words) in [
        ("cut.jsonl", 8, "line 10: the line is cut in the middle"),
        ("odd.jsonl", 6, "line 8: 179 ranges for 180 rays"),
    ] {
        let line = format!("localize {log} --map hall.glb --init 1.5,3.5,0,0,0,5 --out out.tum");
        let outcome = place.run(&line);
        assert_eq!((outcome.status, outcome.stdout.as_str()), (Some(1), ""), "{outcome:?}");
        assert!(outcome.stderr.starts_with(&format!("error: {log}: {words}; ")), "{}", outcome.stderr);
        assert_eq!(outcome.stderr.lines().count(), 1, "{}", outcome.stderr);
        near(&positions(&place, "out.tum"), &hall(count), 0.02);
        assert_eq!(text(&place, "out.jsonl").lines().count(), count);
        // The same log without the fault gives the same lines.
        let kept = (text(&place, "out.tum"), text(&place, "out.jsonl"));
        let sound: String = text(&place, log).lines().take(1 + count).map(|line| line.to_owned() + "\n").collect();
        place.write("sound.jsonl", sound.as_bytes());
        localized(&place, "sound.jsonl --map hall.glb --init 1.5,3.5,0,0,0,5");
        assert_eq!((text(&place, "out.tum"), text(&place, "out.jsonl")), kept);
        // A fault in the first frame leaves the files of an earlier run.
        let first = sound.lines().next().unwrap().to_owned() + "\n{\"t\": 0, \"range\": [1]}\n";
        place.write("sound.jsonl", first.as_bytes());
        let outcome = place.run(&line.replace(log, "sound.jsonl"));
        assert!(outcome.status == Some(1) && outcome.stderr.contains("line 2: 1 ranges"), "{outcome:?}");
        assert_eq!((text(&place, "out.tum"), text(&place, "out.jsonl")), kept);
    }
}

fn started(place: &Place, line: &str) -> Child {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("presight"));
    command.current_dir(place.folder.path()).args(line.split_whitespace());
    command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Waits until a file has this number of lines.
#[cfg(unix)]
fn wait_for(place: &Place, name: &str, lines: usize) {
    let start = Instant::now();
    while fs::read_to_string(place.path(name)).unwrap_or_default().lines().count() < lines {
        assert!(start.elapsed() < Duration::from_secs(120), "no line {lines} of {name}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// A log through a pipe is answered line by line, before its end; a signal leaves the lines.
#[cfg(unix)]
#[test]
fn a_log_from_a_pipe_is_answered_as_it_comes_and_a_signal_keeps_it() {
    let place = case("localize-error-keeps-nothing");
    let log = text(&place, "odd.jsonl");
    let mut child = started(&place, "localize /dev/stdin --map hall.glb --init 1.5,3.5,0,0,0,5 --out out.tum");
    let mut stdin = child.stdin.take().unwrap();
    for (k, line) in log.lines().take(4).enumerate() {
        writeln!(stdin, "{line}").unwrap();
        if k > 0 {
            wait_for(&place, "out.tum", k);
            wait_for(&place, "out.jsonl", k);
        }
    }
    assert!(Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap().success());
    assert!(!child.wait().unwrap().success());
    for name in ["out.tum", "out.jsonl"] {
        let kept = text(&place, name);
        assert!(kept.lines().count() == 3 && kept.ends_with('\n'), "{kept}");
    }
    near(&positions(&place, "out.tum"), &hall(3), 0.02);
    drop(stdin);
}

/// A device or pipe gets the poses alone: no second file can stand in its folder.
#[cfg(target_os = "linux")]
#[test]
fn poses_go_to_stdout_as_they_come() {
    let place = case("localize-error-keeps-nothing");
    let before = place.names();
    let line = "localize cut.jsonl --map hall.glb --init 1.5,3.5,0,0,0,5 --out /dev/stdout";
    let outcome = place.run(line);
    assert_eq!((outcome.status, outcome.stdout.lines().count()), (Some(1), 8), "{outcome:?}");
    assert!(outcome.stdout.starts_with("0 1.5") && place.names() == before, "{outcome:?}");
    assert!(!Path::new("/dev/stdout.jsonl").exists());
}

#[test]
fn poses_from_a_pipe_are_answered_as_they_come() {
    let place = Place::new();
    let mut child =
        started(&place, "predict wall.glb --sensor laser-scanner --poses - --backend cpu --outputs range --json");
    let mut stdin = child.stdin.take().unwrap();
    let (stdout, (answered, answers)) = (BufReader::new(child.stdout.take().unwrap()), mpsc::channel());
    // A command that waits for the end of its input must fail the test, not stop it.
    std::thread::spawn(move || stdout.lines().try_for_each(|line| answered.send(line.unwrap())));
    for (k, x) in [0.0, 0.5, -1.0].into_iter().enumerate() {
        // Blank lines and comments are skipped.
        writeln!(stdin, "# next\n\n{k}.50 {x} 0 1 0 0 0 1").unwrap();
        let answer = answers.recv_timeout(Duration::from_secs(60)).expect("an answer before the next pose");
        let answer: Value = serde_json::from_str(&answer).unwrap();
        assert_eq!((&answer["pose"], &answer["stamp"]), (&json!(k), &json!(format!("{k}.50"))));
        assert_eq!(answer["nearest_m"], 2.0 - x);
    }
    writeln!(stdin, "3 0 0 1 0 0 0").unwrap();
    let ended = child.wait_with_output().unwrap();
    let said = String::from_utf8(ended.stderr).unwrap();
    assert_eq!(ended.status.code(), Some(1), "{said}");
    assert!(said.starts_with("error: /dev/stdin: line 10: there are fewer than eight numbers; "), "{said}");
    assert_eq!(said.lines().count(), 1, "{said}");
    let empty = started(&place, "predict wall.glb --sensor laser-scanner --poses - --backend cpu");
    let ended = empty.wait_with_output().unwrap();
    assert!(ended.status.code() == Some(1) && String::from_utf8_lossy(&ended.stderr).contains("has no poses"));
}

/// Poses of a document are x, y and yaw. They stand on the floor that is given, in errors against them too.
#[test]
fn the_reference_of_planar_scans_stands_on_the_floor() {
    let place = case("scan-reference-on-a-floor");
    let said = localized(&place, "scans.json --map hall.glb --init reference --floor 512").stdout;
    assert!(said.starts_with("4 of 4 frames have a pose\n"), "{said}");
    let expected: Vec<_> = hall(4).into_iter().map(|(t, [x, y, _])| (t, [x, y, 512.0])).collect();
    near(&positions(&place, "out.tum"), &expected, 0.02);
    let error: f64 = said.split("RMS ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!(error < 0.02, "{said}");
}

/// A wall at x = 2 m, a robot whose body is at x = 1 m, and its arm at x = 0.5 m.
fn robot(place: &Place) {
    let nodes = json!([
        { "name": "wall", "mesh": 0 },
        { "name": "robot", "mesh": 0, "translation": [-1.0, 0.0, 0.0], "children": [2] },
        { "name": "arm", "mesh": 0, "translation": [-0.5, 0.0, 0.0] },
    ]);
    let add = |root: &mut Value| {
        root["nodes"] = nodes;
        root["scenes"][0]["nodes"] = json!([0, 1]);
    };
    place.write("robot.glb", &wall(add, WALL, WALL_INDICES));
}

#[test]
fn excluded_objects_are_not_predicted() {
    let place = Place::new();
    robot(&place);
    let line = "predict robot.glb --sensor laser-scanner --pose 0,0,1,0,0,0 --backend cpu --outputs range,object_id --out a.exr";
    for (exclude, range, id) in [
        ("", 0.5, 3),
        ("--exclude robot/arm", 1.0, 2),
        ("--exclude robot", 2.0, 1),
        ("--exclude robot robot/arm", 2.0, 1),
        ("--exclude robot --exclude wall", f32::INFINITY, 0),
    ] {
        place.done(&format!("{line} {exclude}"));
        let images = place.images("a.exr").images;
        assert_eq!((images.range[180], images.object_id[180]), (range, id), "{exclude}");
    }
    place.write("one.tum", b"0 0 0 1 0 0 0 1\n");
    let told = place.done("predict robot.glb --sensor laser-scanner --poses one.tum --backend cpu --exclude robot");
    assert!(told.contains("1 of 1 objects seen"), "{told}");
    // Features on excluded objects are left out, whether they are given in the object's frame or in the world's.
    let made = place.run("features robot.glb --class laser --out all.json");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    let in_world = json!({ "format": 1, "class": "laser", "features": [
        { "id": 1, "kind": "point", "points": [[0.5, 0, 1]] }, { "id": 2, "kind": "point", "points": [[2, 0, 1]] },
    ]});
    place.write("world.json", in_world.to_string().as_bytes());
    // A plate has four edges, four corners and a patch.
    for (layer, all, kept) in [("all.json", 27, 9), ("world.json", 2, 1)] {
        let view = format!("predict robot.glb --sensor laser-scanner --pose 0,0,1,0,0,0 --backend cpu --layer {layer}");
        let count = |exclude: &str| {
            let Outcome { status, stdout, stderr } = place.run(&format!("{view} {exclude}"));
            assert_eq!(status, Some(0), "{stderr}");
            // The object of a feature of the world is not known, so its loss is said.
            assert_eq!(stderr.contains("left out: the surface below is gone (1)"), !exclude.is_empty() && all == 2);
            stdout.split(" of ").last().unwrap().split(' ').next().unwrap().parse::<usize>().unwrap()
        };
        assert_eq!((count(""), count("--exclude robot")), (all, kept), "{layer}");
    }
    let words =
        ["robot.glb", "--exclude: there is no object \"robto\"", "; did you mean \"robot\"? presight inspect lists"];
    let line = "predict robot.glb --sensor laser-scanner --pose 0,0,1,0,0,0 --exclude robot robto";
    check(&place, vec![bad(line, 2, &words)]);
    let line = "localize a.exr --map robot.glb --init 0,0,1,0,0,0 --out x.tum --exclude robot robto";
    check(&place, vec![bad(line, 2, &words).after_a_notice()]);
}

/// The robot's own body is in the map, but not in what its sensor measures.
#[test]
fn localization_leaves_out_the_robot() {
    let place = Place::new();
    robot(&place);
    place.done(
        "predict wall.glb --sensor laser-scanner --pose 0,0,1,0,0,0 --backend cpu --outputs range --out scan.exr",
    );
    // The arm is as large as the wall: if it is not left out, the scan fits where the arm is 2 m ahead.
    for (exclude, x) in [("", -1.5), ("--exclude robot", 0.0)] {
        localized(&place, &format!("scan.exr --map robot.glb --init reference {exclude}"));
        near(&positions(&place, "out.tum"), &[(0.0, [x, 0.0, 1.0])], 1e-3);
    }
}

/// Every command that follows or reads a log takes `--skip-bad`; one bad line of each kind is planted.
#[test]
fn bad_lines_are_left_out_and_named_by_every_command() {
    let place = Place::new();
    let header = files::range_log_header(presight::preset("laser-scanner").unwrap().spec());
    let ranges = vec!["1.5"; 361].join(",");
    let line = |t: f64| format!(r#"{{"t": {t}, "range": [{ranges}], "reference": [0, 0, 1, 0, 0, 0]}}"#);
    let short = format!(r#"{{"t": 5, "range": [{}]}}"#, "1.5,1.5");
    let bad = ["{\"t\": 2, \"ran", "{\"t\": 3}", &short, &line(0.5)];
    let lines = [&[line(0.0), line(1.0)][..], &bad.map(str::to_owned), &[line(6.0), line(7.0)]].concat();
    place.write("a.jsonl", format!("{header}\n{}\n", lines.join("\n")).as_bytes());
    for command in [
        "localize a.jsonl --map wall.glb --init reference --out followed.tum",
        "replay a.jsonl --map wall.glb --init reference --out shown",
        "explore a.jsonl --out explored.presight",
    ] {
        let ended = place.run(command);
        assert!(ended.status == Some(1) && ended.stderr.contains("a.jsonl: line 4: "), "{command}: {}", ended.stderr);
        let _half_written = fs::remove_file(place.path("followed.resume"));
        let kept = place.run(&format!("{command} --skip-bad"));
        let said = &kept.stderr;
        assert_eq!(kept.status, Some(0), "{command}: {said}");
        assert!(said.contains("a.jsonl: 4 of 8 frames are left out: "), "{command}: {said}");
        for line in [
            "line 4 (",
            "line 5 (not a valid frame: missing field `range`",
            "line 6 (2 ranges for 361 rays)",
            "line 7 (",
        ] {
            assert!(said.contains(line), "{command}: {line} in {said}");
        }
    }
}
