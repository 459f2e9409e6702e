//! `presight explore` and `presight occupancy`: a drive is simulated and explored.

use super::{Place, bad, check};
use glam::DVec3;
use presight::environment::{MarkKind, Object};
use presight::store::info;
use presight_testkit::judge::is_blocked;
use std::fs;

const CAMERA: &str = "format = 1\nkind = \"camera\"\nclass = \"laser\"\nwidth = 120\nheight = 90\nfx = 75.0\nfy = 75.0\ncx = 59.5\n\
    cy = 44.5\nrange_max = 10.0\n[noise]\nrange_sigma = 0.003\n[mount]\nxyz = [0.1, 0.0, 0.3]\nrpy_deg = [0.0, 12.0, 0.0]\n";

/// A place with a room and the log of a robot that turns once in it.
fn drive() -> Place {
    let place = Place::new();
    let room = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb");
    fs::copy(room, place.path("room.glb")).unwrap();
    place.write("camera.toml", CAMERA.as_bytes());
    let line = |k: usize| {
        let half = 0.5 * 0.13 * k as f64;
        format!("{} {} 0.35 1.35 0 0 {} {}\n", 10 + k, 0.3 + 0.005 * k as f64, half.sin(), half.cos())
    };
    place.write("drive.tum", (0..48).map(line).collect::<String>().as_bytes());
    let made = place.run("simulate room.glb --sensor camera.toml --poses drive.tum --out log");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    place
}

/// Poses of a robot at another place of the room.
fn other_poses() -> String {
    let line = |k: usize| {
        let half = 0.5 * (0.1 * k as f64 + 0.2);
        format!("{} {} 0.5 1.35 0 0 {} {}\n", 100 + k, 2.0 + 0.03 * k as f64, half.sin(), half.cos())
    };
    (0..8).map(line).collect()
}

/// Another log, with poses or without, adds to the store and rebuilds nothing. Each run can be undone.
#[test]
fn what_is_explored_is_explored_on_and_undone() {
    let place = drive();
    place.write("other.tum", other_poses().as_bytes());
    place.done("simulate room.glb --sensor camera.toml --poses other.tum --out other");
    let first = place.run("explore log --sensor log/sensor.toml --detail 0.05 --out room.presight --time 1");
    assert_eq!(first.status, Some(0), "{}", first.stderr);
    assert!(first.stdout.contains("change 1"), "{}", first.stdout);
    let areas = first.stdout.lines().nth(1).unwrap();
    let square_metres: Vec<f64> = areas.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    assert!(areas.contains("unobserved") && square_metres.iter().all(|area| *area > 0.1), "{areas}");
    let known = info(&place.path("room.presight")).unwrap().environment;
    assert!(known.object("floor/0001").is_some() && known.object("wall/0001").is_some());
    assert!(known.trust("wall/0001").unwrap().p0 > 0.8);
    assert!(known.marks().len() > 0 && known.layer("laser").unwrap().pose_covariances.len() > 2);
    fs::copy(place.path("room.presight"), place.path("copy.presight")).unwrap();
    let on = |options: &str, store: &str| {
        let ran = place
            .run(&format!("explore other --sensor log/sensor.toml --detail 0.05 {options} --out {store} --time 2"));
        assert!(ran.stdout.contains("change 2"), "{}{}", ran.stdout, ran.stderr);
        let now = info(&place.path(store)).unwrap().environment;
        let is_kept =
            |old: &Object| now.object(&old.name).is_some_and(|o| o.world_from_object == old.world_from_object);
        let old = || known.objects().iter().filter(|o| !o.is_deleted());
        assert!(old().all(is_kept) && now.objects().iter().any(|o| known.object(&o.name).is_none()), "{}", ran.stdout);
        place.done(&format!("env undo {store} 2"));
        let back = info(&place.path(store)).unwrap().environment;
        assert_eq!(back.content_hash(), known.content_hash());
    };
    on("", "room.presight");
    fs::remove_file(place.path("other/poses.txt")).unwrap();
    on("--init 2,0.5,1.35,0,0,11.459", "copy.presight");
    place.run("env undo room.presight 1 --cascade");
    let empty = info(&place.path("room.presight")).unwrap().environment;
    assert_eq!(empty.objects().iter().filter(|o| !o.is_deleted()).count(), 0);
}

/// A pane that reflects in two frames of twelve, as glass does at right angles, leaves the window open; one that always reflects is a wall.
#[cfg(feature = "script")]
#[test]
fn glass_leaves_an_open_window_in_the_store() {
    let place = Place::new();
    place.write("camera.toml", CAMERA.as_bytes());
    let scene = |glass: &str| {
        format!(
            "material(\"glass\", #{{ {glass} }}); let wall = box(0.1, 1.5, 3).translate(2, -1.25, 0) + box(0.1, 1.5, 3).translate(2, 1.25, 0) \
             + box(0.1, 1, 1).translate(2, 0, 0) + box(0.1, 1, 1).translate(2, 0, 2); place(\"wall\", wall); \
             place(\"back\", box(0.1, 8, 5).translate(4, 0, -1)); place(\"pane\", box(0.01, 1, 1).translate(2, 0, 1).made_of(\"glass\"));"
        )
    };
    place.write("clear.rhai", scene("transparent: [\"laser\"]").as_bytes());
    place.write("glare.rhai", scene("").as_bytes());
    let poses = |from: usize, count: usize| {
        let line = |k: usize| format!("{k} 0 {} 1.2 0 0 0 1\n", 0.05 * k as f64 - 0.3);
        (from..from + count).map(line).collect::<String>()
    };
    place.write("clear.tum", [poses(0, 5), poses(7, 5)].concat().as_bytes());
    place.write("glare.tum", poses(5, 2).as_bytes());
    place.write("all.tum", poses(0, 12).as_bytes());
    for (scene, poses, log) in [("clear", "clear", "clear"), ("glare", "glare", "glare"), ("glare", "all", "always")] {
        place.done(&format!("simulate {scene}.rhai --sensor camera.toml --poses {poses}.tum --out {log}"));
    }
    let blocked = |logs: &str, store: &str| {
        let ran = place.run(&format!("explore {logs} --sensor clear/sensor.toml --out {store}"));
        assert_eq!(ran.status, Some(0), "{}", ran.stderr);
        let found = info(&place.path(store)).unwrap().environment;
        let at = |k: usize| DVec3::new(1.0, 0.08 * (k % 11) as f64 - 0.4, 1.1 + 0.08 * (k / 11) as f64);
        assert!(is_blocked(&found, DVec3::new(1.0, 0.8, 1.5), DVec3::new(2.2, 0.8, 1.5)), "there is no wall");
        (0..121).filter(|k| is_blocked(&found, at(*k), at(*k) + 1.3 * DVec3::X)).count()
    };
    assert_eq!(blocked("clear glare", "clear.presight"), 0);
    assert_eq!(blocked("always", "always.presight"), 121, "planted");
}

/// Scans of one row become walls of the requested height, and everything beyond the scan plane is marked as assumed.
#[test]
fn planar_scans_become_walls_of_the_height_that_is_given() {
    let place = drive();
    let scanner = "format = 1\nkind = \"scanner\"\nclass = \"laser\"\nrange_max = 20.0\n[azimuth]\nstart_deg = -180.0\nstep_deg = 1.0\n\
        count = 360\n[elevation]\nstart_deg = 0.0\nstep_deg = 0.0\ncount = 1\n[noise]\nrange_sigma = 0.01\n";
    place.write("scanner.toml", scanner.as_bytes());
    place.write("scans.tum", other_poses().as_bytes());
    place.done("simulate room.glb --sensor scanner.toml --poses scans.tum --out scans");
    let ran = place
        .run("explore scans/scans.jsonl --sensor scans/sensor.toml --wall-height 2.2 --floor 0.1 --out walls.presight");
    assert_eq!(ran.status, Some(0), "{}", ran.stderr);
    let walls = info(&place.path("walls.presight")).unwrap().environment;
    let bounds: Vec<_> = walls.objects().iter().filter(|o| !o.is_deleted()).map(|o| o.world_bounds()).collect();
    assert!(bounds.len() > 8, "{}", bounds.len());
    assert!(bounds.iter().all(|b| (b.min.z - 0.1).abs() < 1e-6 && (b.max.z - 2.3).abs() < 1e-6), "{bounds:?}");
    let assumed = walls.marks().filter(|(_, mark)| mark.kind == MarkKind::Uncertain).count();
    assert_eq!(assumed, 2 * bounds.len());
}

#[test]
fn an_explored_store_gives_an_occupancy_grid() {
    let place = drive();
    assert_eq!(place.run("explore log --sensor log/sensor.toml --detail 0.05 --out room.presight").status, Some(0));
    let made = place.run("occupancy room.presight --cell 0.1 --out grid.yaml");
    let said = &made.stdout;
    assert!(made.status == Some(0) && said.contains("free") && said.contains("occupied"), "{made:?}");
    assert!(made.stderr.contains("this grid is of level 1; --level N takes another one"), "{made:?}");
    let yaml = fs::read_to_string(place.path("grid.yaml")).unwrap();
    assert!(yaml.contains("image: \"grid.pgm\"\n") && yaml.contains("resolution: 0.1\n"), "{yaml}");
    assert!(fs::read(place.path("grid.pgm")).unwrap().starts_with(b"P5\n"));
}

#[test]
fn wrong_use_is_refused_in_one_line() {
    let place = drive();
    fs::remove_file(place.path("log/poses.txt")).unwrap();
    assert_eq!(place.run("explore log --sensor log/sensor.toml --poses drive.tum --out a.presight").status, Some(0));
    place.write("far.tum", b"1000 0 0 0 0 0 0 1\n");
    check(
        &place,
        vec![
            bad("explore log --sensor log/sensor.toml --out b.presight", 1, &["log", "no frame has a pose", "--poses"]),
            bad("explore log --sensor log/sensor.toml --poses far.tum --out b.presight", 1, &["no frame has a pose"]),
            bad(
                "explore log --sensor log/sensor.toml --poses drive.tum --map room.glb --out a.presight",
                2,
                &["a.presight", "--map"],
            ),
            bad(
                "explore log --sensor log/sensor.toml --poses drive.tum --map site.yaml --out b.presight",
                1,
                &["site.yaml"],
            ),
            bad("explore log --detail 0 --out b.presight", 2, &["--detail"]),
            bad("explore missing --out b.presight", 1, &["missing"]),
            bad("occupancy room.glb --cell 1e-6 --out b.yaml", 1, &["room.glb", "--cell"]),
            bad("occupancy room.glb --from-height 2 --to-height 1 --out b.yaml", 2, &["--from-height"]),
        ],
    );
    assert!(!place.path("b.presight").exists());
}

/// The lines of a file of poses with x moved, for the lines from this one on.
fn shifted(poses: &str, metres: f64, from: usize) -> String {
    let line = |(k, line): (usize, &str)| {
        let mut words: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
        if k >= from && words.len() == 8 {
            words[1] = (words[1].parse::<f64>().unwrap() + metres).to_string();
        }
        words.join(" ") + "\n"
    };
    poses.lines().enumerate().map(line).collect()
}

#[test]
fn what_is_strange_about_poses_and_models_is_said() {
    let place = drive();
    let explore = "explore log --sensor log/sensor.toml --detail 0.1 --stride 2";
    let poses = fs::read_to_string(place.path("drive.tum")).unwrap();
    place.write("jump.tum", shifted(&poses, 1.0, 24).as_bytes());
    let jumped = place.run(&format!("{explore} --poses jump.tum --out jump.presight"));
    assert_eq!(jumped.status, Some(0), "{}", jumped.stderr);
    assert!(jumped.stderr.contains("the poses jump by 1.0"), "{}", jumped.stderr);
    // A plate on the floor explains little.
    place.write("plate.rhai", b"place(\"plate\", box(1.5, 1.5, 0.1), pose(1.0, 1.5, -0.1));");
    let plate = place.run(&format!("{explore} --map plate.rhai --out plate.presight"));
    assert_eq!(plate.status, Some(0), "{}", plate.stderr);
    assert!(plate.stderr.contains("is it of this place, in metres"), "{}", plate.stderr);
    let right = place.run(&format!("{explore} --map room.glb --out right.presight"));
    assert!(right.status == Some(0) && !right.stderr.contains("explains"), "{}", right.stderr);
}

#[test]
fn places_that_no_frame_joins_are_parts_of_their_own() {
    let place = drive();
    assert_eq!(place.run("simulate room.glb --sensor camera.toml --poses drive.tum --out far").status, Some(0));
    let poses = fs::read_to_string(place.path("far/poses.txt")).unwrap();
    fs::write(place.path("far/poses.txt"), shifted(&poses, 100.0, 0)).unwrap();
    let explore = |logs: &str, store: &str| {
        let options = "--sensor log/sensor.toml --detail 0.1 --stride 2";
        let ran = place.run(&format!("explore {logs} {options} --out {store}"));
        assert_eq!(ran.status, Some(0), "{}", ran.stderr);
        ran.stdout
    };
    let one = explore("log", "one.presight");
    assert!(!one.contains("parts that no chain"), "{one}");
    let two = explore("log far", "two.presight");
    assert!(two.contains("2 parts that no chain of frames joins: "), "{two}");
}

#[test]
fn frames_without_a_reading_are_refused() {
    let place = Place::new();
    let frame = |t: f64| format!("{{\"t\": {t}, \"range\": [null, null, null], \"reference\": [0, 0, 0, 0, 0, 0]}}\n");
    let sensor = "format = 1\\nkind = \\\"scanner\\\"\\nclass = \\\"laser\\\"\\nazimuth = { start_deg = -10, step_deg = 10, count = 3 }\\n\
        elevation = { start_deg = 0, step_deg = 1, count = 1 }\\n";
    let head = format!("{{\"format\": 1, \"kind\": \"range-log\", \"sensor\": \"{sensor}\"}}\n");
    place.write("nan.jsonl", [head, frame(1.0), frame(2.0)].concat().as_bytes());
    let ran = place.run("explore nan.jsonl --out b.presight");
    let last = ran.stderr.lines().last().unwrap_or_default().to_owned();
    assert!(ran.status == Some(1) && last.starts_with("error: "), "{}", ran.stderr);
    assert!(!place.path("b.presight").exists());
}

/// Killed at any time, the store is as far as it was acknowledged, and the same command goes on.
#[cfg(unix)]
#[test]
fn a_killed_run_goes_on_with_the_same_command() {
    let place = drive();
    let explore = "explore log --sensor log/sensor.toml --detail 0.1 --stride 2 --map room.glb --time 1 --out";
    let clock = std::time::Instant::now();
    place.run(&format!("{explore} whole.presight"));
    let seconds = clock.elapsed();
    let whole = info(&place.path("whole.presight")).unwrap();
    for part in [0.3, 0.6, 0.8, 0.9, 1.0] {
        let store = place.path("killed.presight");
        let mut child = std::process::Command::new(assert_cmd::cargo::cargo_bin("presight"))
            .current_dir(place.folder.path())
            .args(format!("{explore} killed.presight").split_whitespace())
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(seconds.mul_f64(part));
        child.kill().unwrap();
        child.wait().unwrap();
        let changes = if store.exists() { info(&store).unwrap().changes } else { 0 };
        let again = place.run(&format!("{explore} killed.presight"));
        if changes == 0 {
            assert_eq!(again.status, Some(0), "{part}: {}", again.stderr);
        } else {
            // The change was made: a rough model is not taken twice.
            assert!(again.status == Some(2) && again.stderr.contains("explore on"), "{part}: {}", again.stderr);
        }
        let now = info(&store).unwrap();
        assert_eq!((now.changes, now.environment.content_hash()), (1, whole.environment.content_hash()), "{part}");
        fs::remove_file(&store).unwrap();
    }
}

/// A disk that is full is an error of one line, and the store stays as it was.
#[cfg(unix)]
#[test]
fn a_full_disk_leaves_the_store_as_it_was() {
    let place = drive();
    let explore = "explore log --sensor log/sensor.toml --detail 0.05 --time 1 --out";
    let limited = |blocks: u32, store: &str| {
        let mut shell = std::process::Command::new("sh");
        shell.current_dir(place.folder.path()).args(["-c", &format!("ulimit -f {blocks}; exec \"$@\""), "sh"]);
        let ended =
            shell.arg(assert_cmd::cargo::cargo_bin("presight")).args(explore.split_whitespace()).arg(store).output();
        let ended = ended.unwrap();
        (ended.status.code(), String::from_utf8(ended.stderr).unwrap())
    };
    let is_error = |(status, said): (Option<i32>, String), store: &str| {
        let lines = said.lines().filter(|l| l.starts_with(&format!("error: {store}"))).count();
        assert!(status == Some(4) && lines == 1, "{status:?} {said}");
    };
    is_error(limited(8, "new.presight"), "new.presight");
    assert_eq!(place.run(&format!("{explore} old.presight --polygons 100")).status, Some(0));
    let before = info(&place.path("old.presight")).unwrap();
    let blocks = fs::metadata(place.path("old.presight")).unwrap().len() / 512 + 4;
    is_error(limited(blocks as u32, "old.presight"), "old.presight");
    let after = info(&place.path("old.presight")).unwrap();
    assert_eq!((after.changes, after.environment.content_hash()), (before.changes, before.environment.content_hash()));
}

/// Poses found on the way from a first frame that sees only the floor: nothing says how far along the floor the robot goes.
#[test]
fn frames_that_see_only_a_floor_are_named() {
    let place = drive();
    fs::remove_file(place.path("log/poses.txt")).unwrap();
    let line = |k: usize| format!("{k} {} 1.5 1.3 0 0.642788 0 0.766044\n", 2.0 + 0.02 * k as f64);
    place.write("down.tum", (0..6).map(line).collect::<String>().as_bytes());
    place.write("floor.rhai", b"place(\"floor\", box(30, 30, 0.1), pose(0, 0, -0.1));");
    place.done("simulate floor.rhai --sensor camera.toml --poses down.tum --out down");
    fs::remove_file(place.path("down/poses.txt")).unwrap();
    let without = place.run("explore down --sensor down/sensor.toml --init reference --out a.presight");
    assert!(without.status == Some(1) && without.stderr.contains("--init x,y,z"), "{}", without.stderr);
    let ran = place.run("explore down --sensor down/sensor.toml --init 2,1.5,1.3,0,80,0 --out a.presight");
    assert_eq!(ran.status, Some(0), "{}", ran.stderr);
    assert!(ran.stderr.contains("show no known surface and are left out: "), "{}", ran.stderr);
    assert!(ran.stderr.contains("3 s, 4 s, 5 s"), "{}", ran.stderr);
}

/// Runs the commands of the guide in order. Returns each with its output.
fn walked(page: &str) -> Vec<(String, String)> {
    let place = Place::new();
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");
    fs::create_dir(place.path("scenes")).unwrap();
    fs::copy(format!("{root}/scenes/room.glb"), place.path("scenes/room.glb")).unwrap();
    let block = page.split("```sh\n").nth(1).and_then(|rest| rest.split("```").next()).unwrap();
    let command = |line: &str| {
        let ended = match line.strip_prefix("presight ") {
            Some(arguments) => {
                let ran = place.run(arguments);
                assert_eq!(ran.status, Some(0), "{line}: {}", ran.stderr);
                format!("{}{}", ran.stdout, ran.stderr)
            }
            None => {
                let shell =
                    std::process::Command::new("sh").current_dir(place.folder.path()).args(["-c", line]).output();
                let shell = shell.unwrap();
                assert!(shell.status.success(), "{line}: {}", String::from_utf8_lossy(&shell.stderr));
                String::new()
            }
        };
        (line.to_owned(), ended)
    };
    block.lines().map(command).collect()
}

#[cfg(unix)]
#[test]
fn the_drive_of_the_guide_ends_where_the_guide_says() {
    let page = fs::read_to_string(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/explore.md")).unwrap();
    let said = walked(&page);
    let commands: Vec<&str> = said.iter().map(|(line, _)| line.split_whitespace().nth(1).unwrap()).collect();
    assert_eq!(commands[1..], ["simulate", "explore", "localize"]);
    let localized = &said[3].1;
    assert!(localized.contains("40 of 40 frames have a pose"), "{localized}");
    let words: Vec<&str> = localized.split("poses: RMS ").nth(1).unwrap().split_whitespace().collect();
    let [metres, degrees] = [words[0], words[2]].map(|number| number.parse::<f64>().unwrap());
    assert!(metres < 0.005 && degrees < 0.15, "{localized}");
}

/// Two logs of different places without poses: the second one is a group of its own, and is left out.
#[test]
fn another_place_without_poses_is_another_group() {
    let place = drive();
    let line = |k: usize| format!("{} {} 0.4 1.3 0 0 {} 1\n", 100 + k, 0.5 + 0.01 * k as f64, 0.02 * k as f64);
    place.write("other.tum", (0..5).map(line).collect::<String>().as_bytes());
    place.write(
        "other.rhai",
        b"place(\"floor\", box(9, 7, 0.1), pose(0, 0, -0.1)); place(\"wall\", box(0.1, 7, 3), pose(3.4, 0, 0)); \
          place(\"side\", box(9, 0.1, 3), pose(0, -2.6, 0)); place(\"far\", box(9, 0.1, 3), pose(0, 2.9, 0)); \
          place(\"chest\", box(0.7, 0.5, 0.9), pose(2.2, -0.8, 0)); place(\"post\", cylinder(0.15, 2.5, 12), pose(2.6, 1.4, 0));",
    );
    place.done("simulate other.rhai --sensor camera.toml --poses other.tum --out other");
    let poses = fs::read_to_string(place.path("drive.tum")).unwrap();
    let some: String = poses.lines().take(6).map(|line| line.to_owned() + "\n").collect();
    place.write("start.tum", some.as_bytes());
    place.done("simulate room.glb --sensor camera.toml --poses start.tum --out start");
    let explore = |logs: &str, store: &str| {
        let ran = place.run(&format!("explore {logs} --sensor start/sensor.toml --init reference --out {store}"));
        assert_eq!(ran.status, Some(0), "{}", ran.stderr);
        (ran, info(&place.path(store)).unwrap().environment)
    };
    let (_, alone) = explore("start", "alone.presight");
    let (both, environment) = explore("start other", "both.presight");
    let group = "5 frames from 100 s to 104 s are left out, because no frame connects them with the first frame";
    assert!(both.stderr.contains(group), "{}", both.stderr);
    assert!(both.stdout.starts_with("6 frames: "), "{}", both.stdout);
    assert_eq!(environment.content_hash(), alone.content_hash());
}
