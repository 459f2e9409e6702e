//! The scene's up axis and unit of length, and meshes that cannot be scenes.

use super::{Outcome, Place, VIEW, WALL, WALL_INDICES, wall};
use serde_json::Value;
use std::fs;

/// The wall as a z-up exporter writes it: (x, y, z) instead of glTF's (x, z, -y).
fn z_up() -> Vec<u8> {
    wall(|_| (), WALL.map(|[x, y, z]| [x, -z, y]), WALL_INDICES)
}

fn range(place: &Place, line: &str) -> Vec<f32> {
    place.done(&format!("predict {line} {VIEW} --out a.exr"));
    place.images("a.exr").images.range
}

fn refused(outcome: &Outcome, status: i32, words: &[&str]) {
    assert_eq!((outcome.status, outcome.stderr.lines().count()), (Some(status), 1), "{words:?}: {outcome:?}");
    assert!(words.iter().all(|word| outcome.stderr.contains(word)), "{words:?}: {}", outcome.stderr);
}

#[test]
fn flags_and_sidecars_set_the_up_axis() {
    let place = Place::new();
    place.write("z.glb", &z_up());
    let upright = range(&place, "wall.glb");
    assert_eq!(upright[180], 2.0);
    assert_ne!(range(&place, "z.glb"), upright, "the scene lies on its side");
    assert_eq!(range(&place, "z.glb --up z"), upright);
    place.write("z.materials.toml", b"format = 1\nup = \"z\"\n");
    assert_eq!(range(&place, "z.glb"), upright);
    assert_ne!(range(&place, "z.glb --up y"), upright, "the flag wins");
    // The file is in centimetres: at scale 0.01 the wall is 2 cm away, at scale 1 it is 2 m away.
    assert_eq!(range(&place, "z.glb --scale 0.5 --pose-of sensor")[180], 1.0);
    place.write("z.materials.toml", b"format = 1\nup = \"z\"\nscale = 3\nworld_from_scene = [1, 0, 0, 0, 0, 0]\n");
    assert_eq!(range(&place, "z.glb")[180], 7.0);
    // The same pose in the file's own axes, in the world's axes, and in the y-up file's axes.
    let pose = "--sensor laser-scanner --backend cpu --outputs range --world-frame gltf";
    place.write("z.materials.toml", b"format = 1\nup = \"z\"\n");
    place.done(&format!("predict z.glb {pose} --pose 0,0,1,0,0,0 --out b.exr"));
    assert_eq!(place.images("b.exr").images.range, upright);
}

#[test]
fn every_command_takes_the_up_axis_and_stores_record_it() {
    let place = Place::new();
    place.write("z.glb", &z_up());
    for line in [
        "inspect z.glb --up z",
        "index z.glb --up z --poses p.tum --repeat 1 --sensor laser-scanner",
        "features z.glb --up z --scale 2 --class video",
        "features pick z.glb --up z --sensor laser-scanner --pose 0,0,1,0,0,0 --pixel 180,0",
        "compare a.exr a.exr --scene z.glb --up z",
    ] {
        place.write("p.tum", b"0 0 0 1 0 0 0 1\n");
        place.done(&format!("predict z.glb --up z {VIEW} --out a.exr"));
        place.done(line);
    }
    #[cfg(feature = "store")]
    {
        place.done("env create s.presight z.glb --up z --scale 2");
        let info: Value = serde_json::from_str(&place.done("env info s.presight --json")).unwrap();
        assert_eq!(info["cause"], "create of z.glb (up z, scale 2)");
        assert_eq!(range(&place, "s.presight")[180], 4.0);
        for flag in ["--up z", "--scale 2"] {
            let outcome = place.run(&format!("predict s.presight {flag} {VIEW}"));
            refused(&outcome, 2, &["s.presight", flag.split(' ').next().unwrap(), "; drop"]);
        }
    }
}

#[test]
fn inspection_reports_the_up_axis_and_suspicious_sizes() {
    let place = Place::new();
    // A hall of 20 m x 15 m, 4 m high, as two walls; z is up in the file.
    let hall = [[0.0, 0.0, 0.0], [20.0, 0.0, 0.0], [20.0, 15.0, 4.0], [0.0, 15.0, 4.0]];
    place.write("hall.glb", &wall(|_| (), hall, WALL_INDICES));
    let inspect = |rest: &str| -> Value {
        serde_json::from_str(&place.done(&format!("inspect hall.glb --json {rest}"))).unwrap()
    };
    let told = inspect("");
    assert_eq!((&told["up"], &told["scale"]), (&"y".into(), &1.0.into()));
    assert!(told["hints"][0].as_str().unwrap().ends_with("give --up z"), "{}", told["hints"]);
    assert_eq!(inspect("--up z")["hints"].as_array().unwrap().len(), 0);
    let low = inspect("--up z --scale 0.001");
    assert!(low["hints"][0].as_str().unwrap().contains("--scale, such as 1"), "{}", low["hints"]);
    let words = place.done("inspect hall.glb");
    assert!(words.contains("y of the file is up, its unit is 1 m") && words.contains("--up z"), "{words}");
}

#[test]
fn wrong_frames_and_meshes_are_refused_with_a_remedy() {
    let place = Place::new();
    for name in ["hall.obj", "hall.STL", "hall.ply"] {
        place.write(name, b"o hall\n");
        refused(&place.run(&format!("inspect {name}")), 1, &[name, "import trimesh", ".export('hall.glb')"]);
    }
    refused(&place.run("inspect none.obj"), 1, &["none.obj", "; check the path"]);
    refused(&place.run("inspect wall.glb --scale 0"), 2, &["--scale", "0 is not a valid scale", "; give"]);
    refused(&place.run("inspect wall.glb --scale inf"), 2, &["--scale", "inf is not a valid scale"]);
    refused(&place.run("inspect wall.glb --up x"), 2, &["--up", "y or z"]);
    refused(&place.run("inspect wall.glb --scale 1e15"), 1, &["wall.glb: node 0", "; give every axis"]);
    place.write("wall.materials.toml", b"format = 1\nscale = 0\nupp = \"z\"\n[material.gone]\nreflection = 0.5\n");
    let outcome = place.run("inspect wall.glb");
    refused(&outcome, 1, &["wall.materials.toml: 3 mistakes", "line 3", "0 is not a valid scale", "\"gone\""]);
    fs::remove_file(place.path("wall.materials.toml")).unwrap();
    #[cfg(feature = "script")]
    {
        place.write("a.rhai", b"place(\"box\", box(1, 1, 1), at(0, 0, 0));\n");
        refused(&place.run("inspect a.rhai --up z"), 2, &["a.rhai", "--up: a script", "; drop"]);
    }
}

#[test]
fn remedies_name_the_intended_flag() {
    let place = Place::new();
    let predict = "predict wall.glb --sensor video-camera --backend cpu";
    refused(&place.run(&format!("{predict} --pose 0,0,1,0,0,0 --outputs depth")), 2, &["use depth_z (planar"]);
    let blanks = place.run_args(&["predict", "wall.glb", "--sensor", "laser-scanner", "--pose", " 0 0 1 0 0 0"]);
    assert_eq!(blanks.status, Some(0), "{}", blanks.stderr);
    // The parser's suggestions go by spelling; the remedy must name the flag for the purpose.
    for wrong in ["--depth", "--output range", "--image a.png"] {
        let outcome = place.run(&format!("{predict} --pose 0,0,1,0,0,0 {wrong}"));
        refused(&outcome, 2, &["unexpected argument", "; see presight predict --help"]);
        assert!(!outcome.stderr.contains("tip"), "{}", outcome.stderr);
    }
    let fisheye = |model: &str| {
        let lens = format!("[distortion]\nmodel = \"{model}\"\ncoefficients = [0.1, 0, 0, 0]\n");
        place.write("eye.toml", [super::camera(64, 48), lens].concat().as_bytes());
        place.done("predict wall.glb --sensor eye.toml --pose 0,0,1,0,0,0 --backend cpu --out a.exr");
        place.images("a.exr").images.range
    };
    assert_eq!(fisheye("fisheye"), fisheye("equidistant"));
}
