//! Special and endless files are refused at once wherever a command reads a file.
#![cfg(unix)]

use super::Place;
use assert_cmd::Command;
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

const VIEW: &str = "--sensor laser-scanner --pose 0,0,1,0,0,0 --backend cpu";
/// Some of these files deliver gigabytes within this time, others block for ever.
const SOON: Duration = Duration::from_secs(15);

/// File names with the commands that read them.
fn readings() -> Vec<(&'static str, String)> {
    let predict = |rest: &str| format!("predict wall.glb {VIEW} {rest}");
    let seen_by = |sensor: &str| format!("predict wall.glb --sensor {sensor} --pose 0,0,1,0,0,0 --backend cpu");
    let mut all = vec![
        ("scene.glb", "inspect scene.glb".to_owned()),
        ("scene", "inspect scene".to_owned()),
        ("scene.glb", format!("predict scene.glb {VIEW}")),
        ("buffer.bin", "inspect outside.gltf".to_owned()),
        ("wall.materials.toml", "inspect wall.glb".to_owned()),
        ("eye.toml", seen_by("eye.toml")),
        ("eye.yaml", seen_by("eye.yaml")),
        ("rays.csv", seen_by("rays.toml")),
        ("l.json", predict("--layer l.json --features f.json")),
        ("c.json", seen_by("microwave-radar-scan") + " --virtual radar-nearest --corridor c.json"),
        ("cov.json", predict("--features f.json --layer sound.json --pose-cov cov.json")),
        ("poses.tum", "index wall.glb --poses poses.tum --repeat 1".to_owned()),
        ("a.exr", "compare a.exr sound.exr".to_owned()),
        ("a.exr", "compare sound.exr a.exr".to_owned()),
        ("scene.glb", "compare sound.exr sound.exr --scene scene.glb".to_owned()),
    ];
    if cfg!(feature = "script") {
        all.extend([
            ("scene.rhai", "inspect scene.rhai".to_owned()),
            ("m.rhai", "inspect asks.rhai".to_owned()),
            ("m.glb", "inspect imports.rhai".to_owned()),
        ]);
    }
    if cfg!(feature = "store") {
        all.extend([
            ("e.presight", "inspect e.presight".to_owned()),
            ("e.presight", "env info e.presight".to_owned()),
            ("scene.glb", "env create new.presight scene.glb".to_owned()),
            ("l.json", "env import sound.presight l.json".to_owned()),
        ]);
    }
    all
}

fn prepared() -> Place {
    let place = Place::new();
    place.done(&format!("predict wall.glb {VIEW} --out sound.exr"));
    place.write(
        "outside.gltf",
        br#"{"asset":{"version":"2.0"},"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],
            "meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],
            "accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}],
            "bufferViews":[{"buffer":0,"byteLength":36}],"buffers":[{"uri":"buffer.bin","byteLength":36}]}"#,
    );
    place.write("rays.toml", b"format = 1\nkind = \"rays\"\nwidth = 2\nheight = 1\nfile = \"rays.csv\"\n");
    place.write(
        "sound.json",
        br#"{"format": 1, "class": "laser", "features": [{"id": 1, "kind": "point", "points": [[2, 0, 1]]}]}"#,
    );
    place.write("asks.rhai", b"import \"m\" as m; place(\"a\", m::f());");
    place.write("imports.rhai", b"place(\"a\", import_gltf(\"m.glb\"));");
    if cfg!(feature = "store") {
        place.done("env create sound.presight wall.glb");
    }
    place
}

fn run(place: &Place, line: &str) -> (Option<i32>, String) {
    let mut command = Command::cargo_bin("presight").unwrap();
    command.current_dir(place.folder.path()).args(line.split_whitespace()).timeout(SOON);
    let start = Instant::now();
    let output = command.output().unwrap();
    assert!(start.elapsed() < SOON, "{line}: did not end");
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

/// Checks that every reading of a special file ends with one line that names a file.
fn refused_everywhere(make: impl Fn(&Path)) {
    let place = prepared();
    for (name, line) in readings() {
        let path = place.path(name);
        make(&path);
        let (status, stderr) = run(&place, &line);
        assert!(status == Some(1) || status == Some(4), "{line}: {status:?}: {stderr}");
        let errors = stderr.lines().filter(|l| l.starts_with("error: ")).count();
        assert!(errors == 1 && stderr.len() < 1000, "{line}: {stderr}");
        let named =
            [name, "asks.rhai", "imports.rhai", "rays.toml", "outside.gltf"].iter().any(|file| stderr.contains(file));
        assert!(named, "{line}: {stderr}");
        if path.is_dir() { fs::remove_dir(&path).unwrap() } else { fs::remove_file(&path).unwrap() }
    }
}

fn links_to(target: &str) -> impl Fn(&Path) {
    move |path| std::os::unix::fs::symlink(target, path).unwrap()
}

/// The system reports both as regular files of length 0: the first blocks for messages, the second is endless.
#[cfg(target_os = "linux")]
#[test]
fn virtual_files_of_the_system() {
    refused_everywhere(links_to("/proc/kmsg"));
    refused_everywhere(links_to("/proc/self/pagemap"));
}

#[test]
fn devices_and_folders() {
    refused_everywhere(links_to("/dev/zero"));
    refused_everywhere(|path| fs::create_dir(path).unwrap());
}

#[test]
fn pipes_without_a_writer() {
    refused_everywhere(|path| {
        assert!(std::process::Command::new("mkfifo").arg(path).status().unwrap().success());
    });
}

/// A sparse file of 1 TiB, far above every limit.
#[test]
fn endless_files() {
    refused_everywhere(|path| fs::File::create(path).unwrap().set_len(1 << 40).unwrap());
}

/// Changes may also come through pipes. The virtual file pagemap counts as empty.
#[cfg(all(target_os = "linux", feature = "store"))]
#[test]
fn changes_end_too() {
    let place = prepared();
    assert_eq!(run(&place, "env apply sound.presight /proc/self/pagemap"), (Some(0), String::new()));
    for (path, words) in [("/dev/zero", "line 1"), ("/", "a folder")] {
        let (status, stderr) = run(&place, &format!("env apply sound.presight {path}"));
        assert!(status == Some(1) && stderr.contains(words), "{stderr}");
    }
}
