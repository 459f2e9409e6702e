//! Scanner logs with and without intensities: simulation, localization by reflectors, drawing, and refusals.

use super::Place;
use presight::files;
use std::fs;

/// A corridor of plain walls with three plates of foil across it, and the scene's layer.
const SCENE: &str = r#"
material("plaster", #{ reflection: 0.4 });
material("foil", #{ reflection: 1.0 });
place("left", box(60, 0.1, 2.5).translate(0, 1.05, 0).made_of("plaster"));
place("right", box(60, 0.1, 2.5).translate(0, -1.05, 0).made_of("plaster"));
let plate = box(0.01, 0.12, 0.4).made_of("foil").reflector("laser", [-0.005, 0, 0.2], #{ sigma: 0.003 });
place("plate 1", plate, pose(4.0, 0.9, 0.9));
place("plate 2", plate, pose(5.5, -0.9, 0.9));
place("plate 3", plate, pose(7.0, 0.9, 0.9));
"#;

const SCANNER: &str = "format = 1\nkind = \"scanner\"\nclass = \"laser\"\nrange_max = 20.0\nbeam_height_deg = 5.0\n[azimuth]\n\
    start_deg = -180.0\nstep_deg = 0.25\ncount = 1440\n[elevation]\nstart_deg = 0.0\nstep_deg = 0.0\ncount = 1\n[noise]\n\
    range_sigma = 0.01\n[mount]\nxyz = [0.1, 0.0, 0.3]\nrpy_deg = [0.0, 0.0, 0.0]\n";

fn corridor() -> Place {
    let place = Place::new();
    place.write("corridor.rhai", SCENE.as_bytes());
    place.write("scanner.toml", SCANNER.as_bytes());
    let line = |k: usize| format!("{} {} 0.1 0.8 0 0 0.02 0.9998\n", 10 + k, 0.2 * k as f64);
    place.write("drive.tum", (0..8).map(line).collect::<String>().as_bytes());
    let made = place.run("simulate corridor.rhai --sensor scanner.toml --intensities --poses drive.tum --out log");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    place
}

/// The largest error along the corridor, in metres.
fn worst(place: &Place, poses: &str) -> f64 {
    let (found, truth) =
        (files::read_tum(&place.path(poses)).unwrap(), files::read_tum(&place.path("drive.tum")).unwrap());
    assert_eq!(found.len(), truth.len());
    found.iter().zip(&truth).map(|(f, t)| (f.pose.translation.x - t.pose.translation.x).abs()).fold(0.0, f64::max)
}

#[test]
fn a_scanner_is_simulated_and_localized_by_reflectors() {
    let place = corridor();
    let log = fs::read_to_string(place.path("log/scans.jsonl")).unwrap();
    assert_eq!(log.lines().count(), 9);
    assert!(log.lines().skip(1).all(|l| l.contains("\"intensities\"") && l.contains("\"reference\"")));
    assert!(
        log.lines().nth(2).unwrap().contains("\"odometry\"") && !log.lines().nth(1).unwrap().contains("\"odometry\"")
    );
    let line = "localize log/scans.jsonl --map corridor.rhai --init 0.15,0.1,0.8,0,0,2.29 --init-sigma 0.2";
    let done = place.run(&format!("{line} --own-features --out run.tum"));
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    let text = fs::read_to_string(place.path("run.jsonl")).unwrap();
    let last: serde_json::Value = serde_json::from_str(text.lines().last().unwrap()).unwrap();
    assert!(last["features"]["matched"] == 3 && last["state"] == "tracking", "{last}");
    let with = worst(&place, "run.tum");
    assert!(with < 0.03, "{with}");
    // The same seed gives the same ranges without intensities.
    let made = place.run("simulate corridor.rhai --sensor scanner.toml --poses drive.tum --out bare");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    let ranges = |path: &str| -> Vec<serde_json::Value> {
        let text = fs::read_to_string(place.path(path)).unwrap();
        text.lines().skip(1).map(|l| serde_json::from_str::<serde_json::Value>(l).unwrap()["range"].clone()).collect()
    };
    assert_eq!(ranges("log/scans.jsonl"), ranges("bare/scans.jsonl"));
    let bare = line.replace("log/", "bare/");
    let done = place.run(&format!("{bare} --own-features --out bare.tum"));
    assert!(done.status == Some(0) && done.stderr.contains("no intensities"), "{done:?}");
    #[cfg(feature = "report")]
    {
        let line = line.replace("localize", "replay");
        for (args, folder) in [("--own-features", "with"), ("", "without")] {
            let shown = place.run(&format!("{line} {args} --out {folder}"));
            assert_eq!(shown.status, Some(0), "{}", shown.stderr);
        }
        let bytes = |folder: &str| fs::read(place.path(folder).join("frames/000007.png")).unwrap();
        assert_ne!(bytes("with"), bytes("without"));
        assert!(fs::read_to_string(place.path("with/index.html")).unwrap().contains("only_found"));
    }
}

#[test]
fn input_that_does_not_fit_a_scanner_is_refused() {
    let place = corridor();
    let camera = "format = 1\nkind = \"camera\"\nclass = \"laser\"\nwidth = 8\nheight = 6\nfx = 7.0\nfy = 7.0\ncx = 3.5\ncy = 2.5\n";
    place.write("camera.toml", camera.as_bytes());
    place.write("again.tum", b"1 0 0 0.8 0 0 0 1\n1 0 0 0.8 0 0 0 1\n");
    for (args, told) in [
        ("--sensor camera.toml --intensities --poses drive.tum", "--intensities: depth images"),
        ("--sensor scanner.toml --grey camera.toml --poses drive.tum", "--grey: logs of scans"),
        ("--sensor scanner.toml --intensities --intensity-noise 2 --poses drive.tum", "noise of intensities"),
        ("--sensor scanner.toml --intensity-noise 0.1 --poses drive.tum", "--intensities"),
        ("--sensor scanner.toml --poses again.tum", "a time of 1 s after one of 1 s"),
    ] {
        let refused = place.run(&format!("simulate corridor.rhai {args} --out none"));
        assert!(refused.status.is_some_and(|s| s > 0) && refused.stderr.contains(told), "{args}: {refused:?}");
        assert!(!place.path("none/scans.jsonl").exists());
    }
    // A layer of another sensor class.
    let layer = r#"{"format": 1, "class": "laser", "features": [{"id": 1, "kind": "reflector", "points": [[3.995, 0.9, 1.1]]}]}"#;
    place.write("laser.json", layer.as_bytes());
    place.write("radar.toml", SCANNER.replace("\"laser\"", "\"radar\"").as_bytes());
    let line = "localize log/scans.jsonl --map corridor.rhai --init reference --out x.tum";
    let refused = place.run(&format!("{line} --sensor radar.toml --layer laser.json"));
    assert!(refused.status == Some(2) && refused.stderr.contains("none of them of class \"radar\""), "{refused:?}");
    // A log cut in the middle of a line, and intensities of another sensor.
    let text = fs::read_to_string(place.path("log/scans.jsonl")).unwrap();
    place.write("cut.jsonl", &text.as_bytes()[..text.len() - 2000]);
    place.write("key.jsonl", text.replacen("\"format\":1", "\"format\":1,\"x\":2", 1).as_bytes());
    place.write("loud.jsonl", text.replacen("\"intensities\":[null", "\"intensities\":[255", 1).as_bytes());
    for (log, told) in [
        ("key.jsonl", "line 1: not a valid header: unknown field `x`"),
        ("cut.jsonl", "line 9: the line is cut"),
        ("loud.jsonl", "intensity 0: an intensity of 255"),
    ] {
        let refused = place.run(&line.replace("log/scans.jsonl", log));
        assert!(
            refused.status == Some(1) && refused.stderr.contains(told) && refused.stderr.contains(log),
            "{refused:?}"
        );
        // Only a late fault leaves the poses of the frames before it.
        assert_eq!(place.path("x.tum").exists(), log != "key.jsonl");
    }
}

/// A plate of foil was taken away, and another one put up: after a drive the first hardly exists and is deleted, the second is
/// found within 1 cm, and what stands is believed more.
#[cfg(feature = "store")]
#[test]
fn reflectors_that_are_gone_and_new_are_learnt() {
    use presight::features::FeatureShape;
    let place = Place::new();
    let plates = SCENE.split_inclusive('\n').collect::<Vec<_>>();
    let (walls, stay) = (plates[..6].concat(), plates[6..].concat());
    let plate = |name: &str, x: f64| format!("place(\"{name}\", plate, pose({x}, -0.9, 0.9));\n");
    let more = [plate("plate 4", 8.5), plate("plate 5", 10.0)].concat();
    place.write("map.rhai", format!("{walls}{stay}{more}{}", plate("taken", 2.5)).as_bytes());
    place.write("site.rhai", format!("{walls}{stay}{more}{}", plate("put up", 6.3)).as_bytes());
    place.write("scanner.toml", SCANNER.as_bytes());
    let line = |k: usize| format!("{} {} 0.1 0.8 0 0 0.02 0.9998\n", 10 + k, 0.3 * k as f64);
    place.write("drive.tum", (0..18).map(line).collect::<String>().as_bytes());
    let made = place.run("simulate site.rhai --sensor scanner.toml --intensities --poses drive.tum --out log");
    assert_eq!(made.status, Some(0), "{}", made.stderr);
    place.run("env create map.presight map.rhai");
    let layer = |of: &str| {
        let environment = presight::store::check(&place.path("map.presight")).unwrap().environment;
        let layer = environment.layer("laser").unwrap();
        let on = |f: &&std::sync::Arc<presight::features::Feature>| f.object.as_deref() == Some(of);
        layer.features.iter().find(on).cloned()
    };
    let all = || presight::store::check(&place.path("map.presight")).unwrap().environment;
    let before: Vec<u32> = all().layer("laser").unwrap().features.iter().map(|f| f.id).collect();
    assert!(layer("taken").is_some() && before.len() == 6);
    let learn = "update log/scans.jsonl --map map.presight --own-features --init reference --out found --apply";
    let done = place.run(learn);
    assert_eq!(done.status, Some(0), "{}", done.stderr);
    assert!(layer("taken").is_none_or(|f| f.existence.p0 < 0.05), "{:?}", layer("taken"));
    assert!(layer("plate 3").is_some_and(|f| f.existence.p0 > 0.95 && f.existence.confirmed > 0.0));
    let environment = all();
    let new: Vec<_> = environment.layer("laser").unwrap().features.iter().filter(|f| !before.contains(&f.id)).collect();
    assert_eq!(new.len(), 1, "{new:?}");
    let FeatureShape::Reflector { at, .. } = new[0].shape else { panic!("{new:?}") };
    let object = environment.object(new[0].object.as_deref().unwrap()).unwrap();
    let found = object.world_from_object.transform_point(at);
    // The scan measures x and y; the height is where its row meets the plate.
    let off = (found - glam::DVec3::new(6.295, -0.9, found.z)).length();
    assert!(off < 0.01, "{found} is {off} m off");
}
