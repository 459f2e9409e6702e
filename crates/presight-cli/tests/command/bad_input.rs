//! Unusable input: the command prints one line that names the file, the place and the remedy, and writes no output.

use super::{Place, VIEW, WALL, WALL_INDICES, bad, camera, check, predict, wall};
use assert_cmd::Command;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;

/// Broken scenes, each with the words that its message must contain in addition to the file name.
fn broken_scenes() -> Vec<(&'static str, Vec<u8>, Vec<&'static str>)> {
    let changed = |change: fn(&mut Value)| wall(change, WALL, WALL_INDICES);
    let moved = |to: f32| {
        let mut positions = WALL;
        positions[2][1] = to;
        wall(|_| (), positions, WALL_INDICES)
    };
    let whole = wall(|_| (), WALL, WALL_INDICES);
    vec![
        ("truncated.glb", whole[..whole.len() - 20].to_vec(), vec!["truncated"]),
        ("empty.glb", Vec::new(), vec![]),
        ("text.glb", b"solid this is STL\n".to_vec(), vec!["glTF"]),
        ("index.glb", wall(|_| (), WALL, [0, 1, 2, 0, 2, 9]), vec!["9"]),
        ("nan.glb", moved(f32::NAN), vec!["mesh", "NaN"]),
        ("infinite.glb", moved(f32::INFINITY), vec!["mesh", "inf"]),
        ("flat.glb", changed(|r| r["nodes"][0]["scale"] = json!([1, 0, 1])), vec!["wall", "scale"]),
        ("cycle.glb", changed(|r| r["nodes"][0]["children"] = json!([0])), vec!["node"]),
        (
            "extension.glb",
            changed(|r| {
                r["extensionsRequired"] = json!(["ACME_nurbs"]);
                r["extensionsUsed"] = json!(["ACME_nurbs"]);
            }),
            vec!["ACME_nurbs"],
        ),
        ("claim.glb", changed(|r| r["accessors"][1]["count"] = json!(3_000_000_000_u64)), vec!["3000000000"]),
        ("nothing.glb", changed(|r| r["scenes"][0]["nodes"] = json!([])), vec!["scene"]),
        ("version.glb", changed(|r| r["asset"]["version"] = json!("3.0")), vec!["3.0"]),
    ]
}

#[test]
fn bad_scenes() {
    let place = Place::new();
    let mut cases = vec![bad(predict("missing.glb"), 1, &["missing.glb: ", "; check the path"])];
    for (name, bytes, names) in broken_scenes() {
        place.write(name, &bytes);
        for line in [predict(name), format!("inspect {name}")] {
            let mut all = vec![name, "; "];
            all.extend(&names);
            cases.push(bad(line, 1, &all));
        }
    }
    place.write(
        "nobin.gltf",
        br#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[0]}],"scene":0,"nodes":[{"mesh":0}],
        "buffers":[{"byteLength":48,"uri":"gone.bin"}],"bufferViews":[{"buffer":0,"byteLength":48}],
        "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}],
        "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]}"#,
    );
    cases.push(bad(predict("nobin.gltf"), 1, &["gone.bin", "; "]));
    check(&place, cases);
}

#[test]
fn bad_sensors() {
    let place = Place::new();
    place.write("zero.toml", camera(0, 10).as_bytes());
    place.write("huge.toml", camera(100_000, 10).as_bytes());
    place.write("area.toml", camera(16_384, 16_384).as_bytes());
    place.write("key.toml", (camera(10, 10) + "colour = \"red\"\n").as_bytes());
    place.write("newer.toml", camera(10, 10).replace("format = 1", "format = 99").as_bytes());
    let with =
        |sensor: &str| format!("predict wall.glb --sensor {sensor} --pose 0,0,1,0,0,0 --backend cpu --out out.exr");
    check(
        &place,
        vec![
            bad(with("zero.toml"), 1, &["zero.toml", "0 x 10", "; give sides"]),
            bad(with("huge.toml"), 1, &["huge.toml", "100000 x 10", "; give sides"]),
            bad(with("area.toml"), 1, &["area.toml", "16384 x 16384", "; "]),
            bad(with("key.toml"), 1, &["key.toml", "colour", "; "]),
            bad(with("newer.toml"), 1, &["newer.toml", "99", "; "]),
            bad(with("gone.toml"), 1, &["gone.toml", "; check the path"]),
            bad(with("no-such-preset"), 2, &["no-such-preset", "; choose"]).until(
                "no-such-preset",
                "video-camera",
                "video-camera",
            ),
            bad("sensors no-such-preset", 2, &["no-such-preset", "; choose"]).until(
                "no-such-preset",
                "vlp-16",
                "vlp-16",
            ),
        ],
    );
}

#[test]
fn wrong_usage() {
    let place = Place::new();
    place.write("poses.tum", b"0 0 0 1 0 0 0 1\n");
    let with = |rest: &str| format!("predict wall.glb --sensor laser-scanner --backend cpu --out out.exr {rest}");
    let posed = |rest: &str| with(&format!("--pose 0,0,1,0,0,0 {rest}"));
    check(
        &place,
        vec![
            bad(with("--pose nan,0,1,0,0,0"), 2, &["--pose nan,0,1,0,0,0", "not finite"]).until(
                "nan",
                "0",
                "; give x,y,z,roll",
            ),
            bad(with("--pose 0,0,1,0,0,-inf"), 2, &["--pose", "not finite"]).until("-inf", "90", "; give x,y,z,roll"),
            bad(with("--pose 0,0,1"), 2, &["--pose 0,0,1", "3 numbers"]).until(
                "0,0,1",
                "0,0,1,0,0,0",
                "; give x,y,z,roll",
            ),
            bad(with("--pose 0,0,1,0,0,0,0"), 2, &["--pose", "quaternion of length 0"]).until(
                "0,0,0,0",
                "0,0,0,1",
                "qx,qy,qz,qw",
            ),
            bad(with(""), 2, &["--pose is missing"]).until(
                "out.exr",
                "out.exr --pose 0,0,1,0,0,0",
                "; give x,y,z,roll",
            ),
            bad(posed("--outputs range,colour"), 2, &["colour"]).until(
                "range,colour",
                "range,echo",
                "choose from range, depth_z, polygon_id, object_id, cos_incidence, echo",
            ),
            bad(posed("--outputs depth_z"), 2, &["depth_z", "not a camera"]).until("depth_z", "range", "; use range"),
            bad(posed("--png-of range"), 2, &["; see presight predict --help"]).until(
                "--png-of",
                "--png a.png --png-of",
                "not provided: --png <FILE.png>",
            ),
            bad(posed("--points cloud.xyz"), 2, &["cloud.xyz"]).until(".xyz", ".pcd", "; end the name in .ply or .pcd"),
            bad(posed("--png view.exr"), 2, &["view.exr", "writes .png"]).until(
                "view.exr",
                "view.png",
                "; end the name in .png",
            ),
            bad(posed("--ids source --merge-tolerance 1e-6"), 2, &["--merge-tolerance"]).until(
                "--ids source",
                "",
                "; drop --merge-tolerance or --ids source",
            ),
            bad(posed("--merge-tolerance nan"), 2, &["merge tolerance"]).until(
                "nan",
                "1e-6",
                "; give a share of the object's size, such as 1e-6",
            ),
            bad("predict wall.glb --sensor laser-scanner --pose 0,0,1,0,0,0 --backend cuda", 2, &["cuda", "; see"])
                .until("cuda", "cpu", "auto, cpu, gpu"),
            bad(posed("--index r-tree"), 2, &["r-tree", "; see"]).until("r-tree", "grid", "choose from none, grid"),
            bad(posed("--threads 100000"), 2, &["100000 threads", "; give at most"]).until(
                "100000",
                "0",
                "or 0 for all cores",
            ),
            bad("index wall.glb --count 0", 2, &["--count", "; see presight index --help"]),
            bad("index wall.glb --count 3", 1, &["free poses"]).until(
                "--count 3",
                "--poses poses.tum",
                "; give --poses FILE.tum",
            ),
            bad("index wall.glb --poses none.tum", 1, &["none.tum"]).until("none.tum", "poses.tum", "; check the path"),
            bad(posed("--repeat 0"), 2, &["--repeat", "; see"]).until("--repeat 0", "--repeat 1", "not in 1..=1000000"),
            bad("predikt wall.glb", 2, &["predikt", "; see"]),
        ],
    );
}

#[test]
fn unwritable_outputs() {
    let place = Place::new();
    fs::create_dir(place.path("folder")).unwrap();
    let mut cases = Vec::new();
    for flag in
        ["--out X.exr", "--png X.png", "--depth-png X.png", "--points X.ply", "--points X.pcd", "--stats X.json"]
    {
        let (flag, name) = flag.split_once(" X").unwrap();
        let line = format!("predict wall.glb {VIEW} {flag} none/out{name}");
        cases.push(bad(line, 4, &["none/out", "cannot write", "; create the folder"]));
    }
    cases.push(bad(format!("predict wall.glb {VIEW} --out folder"), 4, &["folder"]).until(
        "folder",
        "a.exr",
        "; name a file",
    ));
    if Path::new("/dev/full").exists() {
        cases.push(bad(
            format!("predict wall.glb {VIEW} --out /dev/full"),
            4,
            &["/dev/full", "; free some disk space"],
        ));
    }
    check(&place, cases);
    place.write("old.exr", b"earlier content");
    let outcome = place.run("predict missing.glb --sensor laser-scanner --pose 0,0,1,0,0,0 --out old.exr");
    assert_eq!((outcome.status, fs::read(place.path("old.exr")).unwrap()), (Some(1), b"earlier content".to_vec()));
}

#[test]
fn bad_comparisons() {
    let place = Place::new();
    place.done(&format!("predict wall.glb {VIEW} --out a.exr"));
    place.done("predict wall.glb --sensor microwave-radar-scan --pose 0,0,1,0,0,0 --backend cpu --out b.exr");
    let whole = fs::read(place.path("a.exr")).unwrap();
    place.write("cut.exr", &whole[..whole.len() / 2]);
    place.write("text.exr", b"no image at all");
    place.write("other.glb", &wall(|_| (), WALL, [0, 1, 2, 0, 2, 1]));
    check(
        &place,
        vec![
            bad("compare a.exr gone.exr", 1, &["gone.exr", "; check the path"]),
            bad("compare text.exr a.exr", 1, &["text.exr", "not a valid EXR", "; "]),
            bad("compare a.exr cut.exr", 1, &["cut.exr", "; "]),
            bad("compare a.exr a.exr --scene other.glb", 1, &["other.glb", "a.exr"]).until(
                "other.glb",
                "wall.glb",
                "; give the original wall.glb",
            ),
            bad("compare a.exr a.exr --json none/verdict.json", 4, &["none/verdict.json", "; create the folder"]),
            bad("compare a.exr", 2, &["OTHER", "; see presight compare --help"]),
        ],
    );
    let outcome = place.run("compare a.exr b.exr");
    assert_eq!(outcome.status, Some(1));
    assert!(outcome.stderr.contains("b.exr: 361 x 1 pixels against 3600 x 1"), "{}", outcome.stderr);
}

/// A pipe without a writer is refused at once; the command does not wait for it.
#[cfg(unix)]
#[test]
fn pipes_and_devices_are_refused_as_scene_files() {
    let place = Place::new();
    for name in ["pipe.glb", "pipe.gltf", "pipe.presight", "pipe.rhai", "pipe.json", "wall.materials.toml"] {
        assert!(std::process::Command::new("mkfifo").arg(place.path(name)).status().unwrap().success());
    }
    let pose = "--sensor laser-scanner --pose 0,0,1,0,0,0 --backend cpu";
    let mut lines: Vec<String> = ["glb", "gltf", "presight", "rhai"].map(|e| format!("inspect pipe.{e}")).to_vec();
    lines.extend(["inspect wall.glb".to_owned(), "inspect /dev/zero".to_owned()]);
    for line in &lines {
        let outcome = place.run(line);
        assert_eq!((outcome.status, outcome.stdout.as_str()), (Some(1), ""), "{line}: {}", outcome.stderr);
        assert!(
            outcome.stderr.contains("no file") || outcome.stderr.contains("not a file"),
            "{line}: {}",
            outcome.stderr
        );
    }
    fs::remove_file(place.path("wall.materials.toml")).unwrap();
    let outcome = place.run(&format!("predict wall.glb {pose} --layer pipe.json"));
    assert!(outcome.status == Some(1) && outcome.stderr.contains("pipe.json: this is a pipe"), "{}", outcome.stderr);
    // A pipe on stdin, which the caller opened for this process, is read.
    let layer = r#"{"format": 1, "class": "laser", "features": [{"id": 1, "kind": "point", "points": [[2, 0, 1]]}]}"#;
    let mut command = Command::cargo_bin("presight").unwrap();
    let args = format!("predict wall.glb {pose} --layer /dev/stdin --features f.json");
    command.current_dir(place.folder.path()).args(args.split(' ')).write_stdin(layer).assert().success();
}
