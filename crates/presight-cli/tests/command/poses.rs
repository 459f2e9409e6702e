//! Many poses in one command: the same files as from one command for each pose, names from templates, and resumption.

use super::signals::interrupts_pass;
use super::{Outcome, Place, camera};
use presight::files;
use std::fs;

const TRAJECTORY: &str = "# t x y z q\n1305031102.175304 0 0 1 0 0 0 1\n\n1305031102.2 -0.5 0.25 1 0 0 0 1\n\
    1305031103 -1 0 1.25 0 0 0.1 0.995\n";
const POSES: [&str; 3] = ["0,0,1,0,0,0,1", "-0.5,0.25,1,0,0,0,1", "-1,0,1.25,0,0,0.1,0.995"];
const PREDICT: &str = "predict wall.glb --sensor small.toml --backend cpu";

fn place() -> Place {
    let place = Place::new();
    place.write("small.toml", camera(32, 24).as_bytes());
    place.write("drive.tum", TRAJECTORY.as_bytes());
    fs::create_dir(place.path("run")).unwrap();
    place
}

fn in_run(place: &Place) -> Vec<String> {
    let entries = fs::read_dir(place.path("run")).unwrap();
    let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn files_equal_those_of_a_command_for_each_pose() {
    let place = place();
    let outputs = "--outputs range,depth_z,polygon_id,object_id,cos_incidence,echo";
    let series = "--out run/{i}.exr --png run/{i}.png --depth-png run/{t}.d.png --points run/{i:03}.ply --npy run/{i}-{output}.npy";
    assert_eq!(place.done(&format!("{PREDICT} --poses drive.tum {outputs} {series}")), "");
    assert_eq!(in_run(&place).len(), 3 * (4 + 6));
    for (i, pose) in POSES.iter().enumerate() {
        let stamp = ["1305031102.175304", "1305031102.2", "1305031103"][i];
        let one = "--out a.exr --png a.png --depth-png d.png --points a.ply --npy a-{output}.npy";
        place.done(&format!("{PREDICT} --pose={pose} {outputs} {one}"));
        let same =
            |a: &str, b: &str| assert!(fs::read(place.path(a)).unwrap() == fs::read(place.path(b)).unwrap(), "{b}");
        same("a.exr", &format!("run/{i}.exr"));
        same("a.png", &format!("run/{i}.png"));
        same("d.png", &format!("run/{stamp}.d.png"));
        same("a.ply", &format!("run/{i:03}.ply"));
        for output in outputs.split_once(' ').unwrap().1.split(',') {
            same(&format!("a-{output}.npy"), &format!("run/{i}-{output}.npy"));
        }
    }
}

#[test]
fn poses_come_from_stdin_and_each_prints_a_line_without_output_files() {
    let place = place();
    let mut command = assert_cmd::Command::cargo_bin("presight").unwrap();
    let args = format!("{PREDICT} --poses - --json");
    let output =
        command.current_dir(place.folder.path()).args(args.split(' ')).write_stdin(TRAJECTORY).output().unwrap();
    let lines: Vec<serde_json::Value> =
        String::from_utf8(output.stdout).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines.len(), 3);
    // The 2 m x 2 m wall is 2 m ahead and the focal length is 100 pixels, so the wall fills the image.
    assert_eq!(
        (&lines[0]["pixels_hit"], &lines[0]["nearest_m"], &lines[0]["objects_seen"]),
        (&768.into(), &2.0.into(), &1.into())
    );
    assert_eq!((&lines[1]["pose"], &lines[1]["stamp"]), (&1.into(), &"1305031102.2".into()));
    let words = place.done(&format!("{PREDICT} --poses drive.tum"));
    assert!(words.lines().count() == 3 && words.starts_with("0: small 32 x 24, 100.0 % of rays hit"), "{words}");
    let one: serde_json::Value =
        serde_json::from_str(&place.done(&format!("{PREDICT} --pose 0,0,1,0,0,0 --json"))).unwrap();
    assert_eq!((&one["pixels_hit"], &one["format"]), (&768.into(), &1.into()));
    assert_eq!(place.names(), ["drive.tum", "run", "small.toml", "wall.glb"]);
}

#[test]
fn all_sensors_of_a_robot_predict_from_its_pose() {
    let place = place();
    let robot = "format = 1\n[[sensors]]\nname = \"front\"\nsensor = \"small.toml\"\nmount = { xyz = [0.5, 0, 0.2], rpy_deg = [0, 0, 0] }\n\
        [[sensors]]\nsensor = \"laser-scanner\"\n";
    place.write("kurt.toml", robot.as_bytes());
    let line = "predict wall.glb --robot kurt.toml --backend cpu";
    place.done(&format!("{line} --poses drive.tum --out run/{{sensor}}.{{i}}.exr --rays {{sensor}}.rays.npy"));
    assert_eq!(in_run(&place).len(), 6);
    let front = files::read_exr(&place.path("run/front.0.exr")).unwrap();
    assert_eq!(front.attributes.pose.unwrap().world_from_sensor().translation.to_array(), [0.5, 0.0, 1.2]);
    let scan = files::read_exr(&place.path("run/laser-scanner.0.exr")).unwrap();
    assert_eq!((scan.images.width, scan.images.range[180]), (361, 2.0));
    assert!(place.path("front.rays.npy").exists());
    let told = place.done(&format!("{line} --pose 0,0,1,0,0,0"));
    assert!(told.lines().count() == 2, "{told}");
    for (rest, words) in [
        ("--poses drive.tum --out run/{i}.exr", "--out: one name for 2 sensors; put {sensor}"),
        ("--poses drive.tum --rays a.npy", "--rays: one name for 2 sensors"),
        ("--pose 0,0,1,0,0,0 --pose-of sensor", "--pose-of sensor: the sensors"),
        ("--pose 0,0,1,0,0,0 --sensor small.toml", "--sensor"),
    ] {
        refused(&place.run(&format!("{line} {rest}")), 2, words);
    }
}

fn refused(outcome: &Outcome, status: i32, words: &str) {
    assert_eq!((outcome.status, outcome.stderr.lines().count()), (Some(status), 1), "{words}: {outcome:?}");
    assert!(outcome.stderr.starts_with("error: ") && outcome.stderr.contains(words), "{words}: {}", outcome.stderr);
}

#[test]
fn wrong_series_are_refused_before_any_work() {
    let place = place();
    for (name, text) in [
        ("empty.tum", "# nothing\n"),
        ("broken.tum", "0 0 0 1 0 0 0 1\n1 0 0 1 0 0 0\n"),
        ("nan.tum", "0 0 nan 1 0 0 0 1\n"),
        ("twice.tum", "1.0 0 0 1 0 0 0 1\n1.0 1 0 1 0 0 0 1\n"),
    ] {
        place.write(name, text.as_bytes());
    }
    for (line, status, words) in [
        ("--poses empty.tum", 1, "empty.tum: the file has no poses"),
        ("--poses broken.tum", 1, "broken.tum: line 2: there are fewer than eight numbers"),
        ("--poses nan.tum", 1, "nan.tum: line 1: \"nan\" is not a finite number"),
        ("--poses none.tum", 1, "none.tum"),
        ("--poses drive.tum --out run/a.exr", 2, "--out: one name for 3 poses; put {i} or {t} into it"),
        ("--poses drive.tum --out run/{i.exr", 2, "--out run/{i.exr"),
        ("--poses drive.tum --out run/{n}.exr", 2, "{n} is not a valid field"),
        ("--poses drive.tum --out run/{output}{i}.exr", 2, "{output} has no value here"),
        ("--poses drive.tum --npy run/{i}.npy", 2, "--npy: one name for 4 images; put {output}"),
        ("--pose 0,0,1,0,0,0 --npy run/a.npy", 2, "--npy: one name for 4 images"),
        ("--pose 0,0,1,0,0,0 --outputs range --npy run/{t}.npy", 2, "{t} has no value here"),
        ("--poses drive.tum --out run/{i}.txt", 2, "end the name in .exr"),
        ("--poses twice.tum --out run/{t}.exr", 2, "run/1.0.exr: the same file as --out run/1.0.exr"),
        ("--poses drive.tum --png run/{i}.png --depth-png run/{i}.png", 2, "the same file as --png"),
        ("--poses drive.tum --out none/{i}.exr", 4, "none/0.exr: cannot write: its folder does not exist; create"),
        ("--poses drive.tum --explain", 2, "--explain works for one"),
        ("--poses drive.tum --repeat 3", 2, "--repeat works for one"),
        ("--poses drive.tum --repeat 3 --reuse-visible", 2, "--repeat works for one"),
        ("--pose 0,0,1,0,0,0 --repeat 3 --reuse-visible", 2, "--poses"),
        ("--poses drive.tum --deadline-ms 5 --reuse-visible", 2, "--reuse-visible"),
        ("--poses drive.tum --pose 0,0,1,0,0,0", 2, "--pose"),
        ("--pose drive.tum", 2, "--pose drive.tum: this is a file, not a pose; presight predict --poses FILE"),
        ("--poses drive.tum --outputs range --npy /dev/null", 2, "only devices and pipes are named"),
    ] {
        refused(&place.run(&format!("{PREDICT} {line}")), status, words);
        assert!(in_run(&place).is_empty(), "{line}: {:?}", in_run(&place));
    }
    let stamped = place.run(&format!("{PREDICT} --poses drive.tum --out drive.tum"));
    assert_eq!((stamped.status, fs::read_to_string(place.path("drive.tum")).unwrap().as_str()), (Some(2), TRAJECTORY));
}

/// A folder blocks the file of the third pose. After its removal the same command resumes.
#[test]
fn a_series_that_was_stopped_resumes() {
    for (name, blocked, others) in [
        ("--out run/{i}.exr", "run/2.exr", ""),
        ("--outputs range --npy run/all.npy --png run/{i}.png", "run/2.png", "run/all.npy"),
    ] {
        let place = place();
        let line = format!("{PREDICT} --poses drive.tum {name}");
        fs::create_dir(place.path(blocked)).unwrap();
        refused(&place.run(&line), 4, blocked);
        assert!(others.is_empty() || !place.path(others).exists(), "whole files only");
        let first = blocked.replace('2', "0");
        fs::remove_dir(place.path(blocked)).unwrap();
        // Existing files are not written again.
        let written = |name: &str| fs::metadata(place.path(name)).unwrap().modified().unwrap();
        let before = written(&first);
        let outcome = place.run(&line);
        assert_eq!(outcome.status, Some(0), "{}", outcome.stderr);
        assert_eq!(outcome.stderr, "note: 2 of 3 poses are already finished; continuing with the rest\n");
        assert_eq!(written(&first), before);
        let left = in_run(&place).into_iter().filter(|n| n.starts_with('.') || n.ends_with("unfinished")).count();
        assert_eq!(left, 0, "{:?}", in_run(&place));
        // A complete series is computed again, with the same bytes.
        let all = || -> Vec<Vec<u8>> {
            in_run(&place).iter().map(|n| fs::read(place.path("run").join(n)).unwrap()).collect()
        };
        let stopped = all();
        assert_eq!(place.done(&line), "");
        assert!(written(&first) > before && all() == stopped);
    }
}

/// A signal ends the command at a random time. The files are the same as from an uninterrupted series.
#[test]
fn a_series_that_was_interrupted_resumes() {
    let place = place();
    let poses: String = (0..300).map(|i| format!("{i} {} 0 1 0 0 0 1\n", -0.001 * f64::from(i))).collect();
    place.write("long.tum", poses.as_bytes());
    let line = |folder: &str| {
        format!(
            "{PREDICT} --poses long.tum --outputs range,object_id --npy {folder}/{{output}}.npy --out {folder}/{{i:03}}.exr"
        )
    };
    fs::create_dir(place.path("whole")).unwrap();
    place.done(&line("whole"));
    let mut stopped = 0;
    for wanted in [3, 40, 120] {
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_presight"));
        let mut child = command.current_dir(place.folder.path()).args(line("run").split(' ')).spawn().unwrap();
        while in_run(&place).iter().filter(|n| n.ends_with(".exr")).count() < wanted {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        let (id, signal) = (child.id().to_string(), if interrupts_pass() { "-TERM" } else { "-INT" });
        assert!(std::process::Command::new("kill").args([signal, &id]).status().unwrap().success());
        stopped += usize::from(!child.wait().unwrap().success());
        assert!(!in_run(&place).iter().any(|name| name.ends_with(".part")), "{:?}", in_run(&place));
    }
    assert!(stopped > 0, "no run was interrupted");
    assert_eq!(place.run(&line("run")).status, Some(0));
    let mut names = in_run(&place);
    names.retain(|name| fs::read(place.path("run").join(name)).ok() != fs::read(place.path("whole").join(name)).ok());
    assert_eq!((in_run(&place).len(), names), (302, Vec::new()));
}

#[test]
fn another_series_starts_over_and_lost_files_are_written_again() {
    let place = place();
    let line = |more: &str| format!("{PREDICT} --poses drive.tum --out run/{{i}}.exr {more}");
    let stop = || {
        let _ = fs::remove_file(place.path("run/2.exr"));
        fs::create_dir(place.path("run/2.exr")).unwrap();
        refused(&place.run(&line("")), 4, "run/2.exr");
        fs::remove_dir(place.path("run/2.exr")).unwrap();
    };
    let first = || fs::metadata(place.path("run/0.exr")).unwrap().modified().unwrap();
    stop();
    let before = first();
    let other = place.run(&line("--outputs range"));
    assert_eq!(other.status, Some(0));
    assert!(other.stderr.starts_with("note: another series was left unfinished here"), "{}", other.stderr);
    assert!(first() > before);
    stop();
    let before = first();
    fs::remove_file(place.path("run/1.exr")).unwrap();
    let again = place.run(&line(""));
    assert!(again.stderr.starts_with("note: 1 of 3 poses"), "{}", again.stderr);
    assert!(place.path("run/1.exr").exists() && first() == before);
    // A file that another program has overwritten since is written again.
    stop();
    let sound = fs::read(place.path("run/1.exr")).unwrap();
    // The time stamps of file systems have a coarse resolution.
    std::thread::sleep(std::time::Duration::from_millis(50));
    fs::write(place.path("run/1.exr"), b"of another").unwrap();
    assert!(place.run(&line("")).stderr.starts_with("note: 1 of 3 poses"));
    assert_eq!(fs::read(place.path("run/1.exr")).unwrap(), sound);
    // A changed scene under the same name starts another series.
    stop();
    place.write(
        "wall.glb",
        &super::wall(
            |root| root["nodes"][0]["translation"] = serde_json::json!([0.5, 0, 0]),
            super::WALL,
            super::WALL_INDICES,
        ),
    );
    assert!(place.run(&line("")).stderr.contains("another series"));
}

/// The wall is 2 m ahead of the first poses and 98 m or more ahead of the others.
#[test]
fn notices_come_once_for_a_series() {
    let place = place();
    let line = |k: i32| format!("{k} {} 0 1 0 0 0 1\n", [0, 0, -96, -97, -98][k as usize]);
    place.write("drive.tum", (0..5).map(line).collect::<String>().as_bytes());
    let outcome = place.run(&format!("{PREDICT} --poses drive.tum --depth-png {{i}}.png"));
    let said = "note: 16-bit depth images: pixels beyond 65.535 m are written as 0\n";
    assert_eq!((outcome.status, outcome.stderr.as_str()), (Some(0), said));
    let one = place.run(&format!("{PREDICT} --pose=-96,0,1,0,0,0 --depth-png a.png"));
    assert_eq!((one.status, one.stderr.as_str()), (Some(0), said));
}
