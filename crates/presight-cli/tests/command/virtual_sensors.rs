//! Runs `presight predict --virtual` as a process.

use assert_cmd::Command;
use serde_json::Value;
use std::path::Path;
use tempfile::TempDir;

/// Runs predict on the README's furnished room; returns status, stdout and stderr.
fn predict(folder: &TempDir, line: &str) -> (Option<i32>, String, String) {
    let mut command = Command::cargo_bin("presight").unwrap();
    let room = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/room.glb");
    command.current_dir(folder.path()).arg("predict").arg(room).args(line.split_whitespace());
    let output = command.args(["--backend", "cpu", "--threads", "1"]).output().unwrap();
    let text = |bytes| String::from_utf8(bytes).unwrap();
    (output.status.code(), text(output.stdout), text(output.stderr))
}

const POSE: &str = "--pose 0.3,0.35,1.65,0,25,38";

fn json(folder: &TempDir, name: &str) -> Value {
    serde_json::from_slice(&std::fs::read(folder.path().join(name)).unwrap()).unwrap()
}

#[test]
fn every_virtual_sensor_reports_in_a_line_and_in_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("way.json", r#"{"polyline_in_robot": [[0, 0], [3, 0]], "half_width": 0.3, "z_min": -1.5, "z_max": 0.2}"#);
    for class in ["video", "radar", "laser"] {
        // The feature is in free space before the sensor, where nothing hides it; the tolerance allows a feature off
        // every surface.
        let layer = format!(
            r#"{{"format": 1, "class": "{class}", "tolerance": 10, "features": [
                {{"id": 1, "kind": "segment", "points": [[0.7, 0.6, 1.3], [0.75, 0.7, 1.3]], "sigma": 0.01}},
                {{"id": 2, "kind": "reflector", "points": [[0.7, 0.65, 1.65]], "sigma": 0.01}},
                {{"id": 3, "kind": "reflector", "points": [[0.6, 0.75, 1.65]], "sigma": 0.01}}]}}"#
        );
        write(&format!("{class}.json"), &layer);
    }
    let dock = "format = 1\nkind = \"scanner\"\nname = \"dock\"\nclass = \"laser\"\n[azimuth]\nstart_deg = -90.0\n\
                step_deg = 0.5\ncount = 361\n[elevation]\nstart_deg = 0.0\nstep_deg = 0.0\ncount = 1\n\
                [noise]\nrange_sigma = 0.01\nangle_sigma_deg = 0.1\n";
    write("dock.toml", dock);
    let level = "--pose 0.3,0.35,1.65,0,0,38";
    for (name, sensor, pose, more, keys) in [
        ("free-floor", "video-camera", POSE, "--mask mask.png --png floor.png", vec!["area", "regions", "mask"]),
        ("edges", "video-camera", POSE, "--layer video.json", vec!["edges", "segments"]),
        ("radar-lines", "microwave-radar-scan", level, "--png lines.png", vec!["lines", "single_beams"]),
        ("radar-nearest", "microwave-radar-image", level, "--corridor way.json", vec!["directions", "corridor"]),
        ("radar-landmarks", "microwave-radar-scan", level, "--layer radar.json", vec!["landmarks", "known"]),
        ("depth-image", "laser-range-camera", POSE, "--points cloud.ply", vec!["points_robot", "points"]),
        ("vertical-planes", "laser-range-camera", level, "", vec!["planes", "pixels"]),
        ("docking", "dock.toml", level, "--layer laser.json", vec!["covariance", "unobservable", "freedom"]),
    ] {
        let line = format!("--virtual {name} --sensor {sensor} {pose} {more}");
        let (status, stdout, stderr) = predict(&folder, &line);
        assert_eq!((status, stderr.as_str()), (Some(0), ""), "{line}");
        assert!(stdout.starts_with(&format!("{name}: ")) && stdout.lines().count() == 1, "{stdout}");
        let (status, stdout, stderr) = predict(&folder, &format!("{line} --features {name}.json"));
        assert_eq!((status, stdout.as_str()), (Some(0), ""), "{stderr}");
        let file = json(&folder, &format!("{name}.json"));
        let answer = &file["virtual"];
        assert_eq!(
            (answer["name"].as_str(), answer["robot_from_sensor"].as_array().map(Vec::len)),
            (Some(name), Some(7))
        );
        assert!(keys.iter().all(|key| !answer[key].is_null()), "{answer}");
        // The layer's filter omits features that the task does not use.
        let kinds: Vec<_> = file["features"].as_array().unwrap().iter().map(|f| f["kind"].as_str().unwrap()).collect();
        let want = if more.contains("--layer") { if name == "edges" { 1 } else { 2 } } else { 0 };
        assert_eq!(kinds.len(), want, "{name}: {kinds:?}");
    }
    let floor = &json(&folder, "free-floor.json")["virtual"];
    assert!(floor["floor_z_world"].as_f64().unwrap().abs() < 1e-6 && floor["area"].as_f64().unwrap() > 1.0, "{floor}");
    let runs = floor["mask"]["runs"].as_array().unwrap();
    let marked: u64 = runs.iter().map(|r| r[2].as_u64().unwrap()).sum();
    assert_eq!(Some(marked), floor["pixels"].as_u64());
    for name in ["mask.png", "floor.png", "lines.png", "cloud.ply"] {
        assert!(folder.path().join(name).metadata().unwrap().len() > 100, "{name}");
    }
    assert_eq!(json(&folder, "docking.json")["virtual"]["freedom"], serde_json::json!(["x", "y", "yaw"]));
}

/// An empty area is printed as 0, not -0, in the text and in the file.
#[test]
fn no_floor_has_area_zero() {
    let folder = tempfile::tempdir().unwrap();
    let line = format!("--virtual free-floor --sensor video-camera {POSE} --floor -5");
    let (_, stdout, _) = predict(&folder, &line);
    assert!(stdout.starts_with("free-floor: 0.000 m2 of floor"), "{stdout}");
    predict(&folder, &format!("{line} --features f.json"));
    assert!(json(&folder, "f.json")["virtual"]["area"].as_f64().unwrap().is_sign_positive());
}

#[test]
fn wrong_usage_has_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("way.json"), r#"{"polyline_in_robot": [[0, 0]]}"#).unwrap();
    for (line, status, words) in [
        ("--virtual walls --sensor video-camera", 2, vec!["free-floor", "vertical-planes"]),
        ("--virtual free-floor --sensor laser-scanner", 2, vec!["class \"laser\"", "video-camera"]),
        ("--virtual radar-lines --sensor microwave-radar-image", 2, vec!["elevation 0", "microwave-radar-scan"]),
        ("--virtual docking --sensor laser-scanner", 2, vec!["angle_sigma_deg", "[noise]"]),
        ("--virtual edges --sensor video-camera", 2, vec!["--layer"]),
        ("--virtual radar-lines --sensor microwave-radar-scan --corridor way.json", 2, vec!["radar-nearest"]),
        ("--virtual radar-nearest --sensor microwave-radar-scan --floor 0", 2, vec!["free-floor"]),
        ("--virtual free-floor --sensor video-camera --floor nan", 2, vec!["finite"]),
        ("--sensor video-camera --mask m.png", 2, vec!["--virtual"]),
        (
            "--virtual radar-nearest --sensor microwave-radar-scan --corridor way.json",
            1,
            vec!["way.json", "half_width"],
        ),
        ("--virtual radar-nearest --sensor microwave-radar-scan --corridor none.json", 1, vec!["none.json"]),
    ] {
        let (got, _, stderr) = predict(&folder, &format!("{line} {POSE}"));
        assert_eq!(got, Some(status), "{line}: {stderr}");
        assert!(words.iter().all(|w| stderr.contains(w)) && stderr.lines().count() == 1, "{line}: {stderr}");
    }
    // Above the room there is no floor below the sensor.
    let above = "--virtual free-floor --sensor video-camera --pose 500,0,1,0,0,0";
    let (status, _, stderr) = predict(&folder, above);
    assert!(status == Some(2) && stderr.contains("--floor"), "{stderr}");
}
