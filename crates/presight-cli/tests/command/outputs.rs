//! No command overwrites its input or writes two outputs to one file, and file names determine formats.

use super::{Place, VIEW};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::process::{Command, Stdio};

/// Every file below a folder with its bytes, and every link with its target.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.display().to_string();
        match fs::symlink_metadata(&path).unwrap().file_type() {
            kind if kind.is_symlink() => {
                all.insert(name, fs::read_link(&path).unwrap().into_os_string().into_encoded_bytes());
            }
            kind if kind.is_dir() => all.extend(contents(&path)),
            kind if kind.is_file() => drop(all.insert(name, fs::read(&path).unwrap())),
            _ => drop(all.insert(name, Vec::new())),
        }
    }
    all
}

/// Checks that each line is wrong usage, reported in one line with these words, and that the files stay unchanged.
fn refused(place: &Place, lines: &[(String, &[&str])]) {
    let before = contents(place.folder.path());
    for (line, words) in lines {
        let outcome = place.run(line);
        assert_eq!(outcome.status, Some(2), "{line}: {}{}", outcome.stdout, outcome.stderr);
        let error = outcome.stderr.lines().filter(|l| l.starts_with("error: ")).collect::<Vec<_>>();
        assert_eq!(error.len(), 1, "{line}: {}", outcome.stderr);
        assert!(words.iter().all(|w| error[0].contains(w)), "{line}: {words:?} in {}", outcome.stderr);
        assert!(contents(place.folder.path()) == before, "{line}: files are not as before");
    }
}

const LAYER: &str =
    r#"{"format": 1, "class": "laser", "features": [{"id": 1, "kind": "point", "points": [[2, 0, 1]]}]}"#;

fn predict(scene: &str, rest: &str) -> String {
    format!("predict {scene} {VIEW} {rest}")
}

#[test]
fn nothing_named_is_overwritten() {
    let place = Place::new();
    let here = place.folder.path();
    fs::create_dir(place.path("sub")).unwrap();
    fs::copy(place.path("wall.glb"), place.path("scene.png")).unwrap();
    place.write("l.json", LAYER.as_bytes());
    place.write(
        "path.json",
        br#"{"polyline_in_robot": [[0, 0], [3, 0]], "half_width": 0.4, "z_min": 0.1, "z_max": 1.9}"#,
    );
    place.write("cov.json", format!("[{}]", ["0"; 36].join(",")).as_bytes());
    place.done(&predict("wall.glb", "--out a.exr --png b.png"));
    fs::copy(place.path("a.exr"), place.path("a.json")).unwrap();
    fs::copy(place.path("a.exr"), place.path("b.exr")).unwrap();
    fs::hard_link(place.path("scene.png"), place.path("hard.png")).unwrap();
    symlink(here.join("scene.png"), place.path("link.png")).unwrap();
    symlink("none.png", place.path("dangling.png")).unwrap();
    place.write(
        "s.toml",
        b"format = 1\nkind = \"camera\"\nwidth = 9\nheight = 9\nfx = 9.0\nfy = 9.0\ncx = 4.0\ncy = 4.0\n",
    );
    symlink("s.toml", place.path("s.json")).unwrap();
    place.write("index.csv", b"1 0 0 1 0 0 0 1\n");
    let lines: [(String, &[&str]); 20] = [
        (predict("scene.png", "--png scene.png"), &["--png scene.png", "overwrite scene.png", "; write elsewhere"]),
        (predict("scene.png", "--png ./scene.png"), &["--png ./scene.png", "overwrite scene.png"]),
        (predict("sub/../scene.png", "--depth-png scene.png"), &["--depth-png scene.png"]),
        (predict("scene.png", "--png link.png"), &["--png link.png", "overwrite scene.png"]),
        (predict("hard.png", "--png scene.png"), &["overwrite hard.png"]),
        (predict("link.png", &format!("--png {}", here.join("hard.png").display())), &["overwrite link.png"]),
        (predict("wall.glb", "--layer l.json --features l.json"), &["--features l.json"]),
        (predict("wall.glb", "--layer new.json --features ./new.json"), &["--features ./new.json"]),
        (predict("wall.glb", "--layer l.json --pose-cov cov.json --features cov.json"), &["--features cov.json"]),
        (predict("wall.glb", "--virtual radar-nearest --corridor path.json --stats path.json"), &["--stats path.json"]),
        ("predict wall.glb --sensor s.toml --pose 0,0,1,0,0,0 --stats s.json".into(), &["--stats s.json", "s.toml"]),
        (predict("wall.glb", "--png b.png --depth-png b.png"), &["--depth-png b.png", "same file as --png b.png"]),
        (predict("wall.glb", "--png new.png --depth-png ./sub/../new.png"), &["same file as --png new.png"]),
        (predict("wall.glb", "--png none.png --depth-png dangling.png"), &["--depth-png dangling.png"]),
        (predict("wall.glb", "--png scene.png --depth-png hard.png"), &["--depth-png hard.png"]),
        (predict("wall.glb", "--features f.json --stats f.json"), &["--stats f.json"]),
        (predict("wall.glb", "--virtual free-floor --floor 0 --mask m.png --png m.png"), &["--mask m.png"]),
        ("compare a.json b.exr --json a.json".into(), &["--json a.json"]),
        ("compare b.exr a.json --json ./a.json".into(), &["--json ./a.json"]),
        ("index wall.glb --poses index.csv --out .".into(), &["index.csv"]),
    ];
    refused(&place, &lines);
}

/// These files are known only after the scene has been read.
#[test]
fn nothing_included_is_overwritten() {
    let place = Place::new();
    let whole = fs::read(place.path("wall.glb")).unwrap();
    let json_end = 20 + u32::from_le_bytes(whole[12..16].try_into().unwrap()) as usize;
    let mut root: serde_json::Value = serde_json::from_slice(&whole[20..json_end]).unwrap();
    root["buffers"][0]["uri"] = "bin.json".into();
    place.write("apart.gltf", root.to_string().as_bytes());
    place.write("bin.json", &whole[json_end + 8..]);
    place.write("wall.materials.toml", b"format = 1\n");
    symlink("wall.materials.toml", place.path("sidecar.json")).unwrap();
    place.write("rays.png", b"1,0,0\n");
    place.write("table.toml", b"format = 1\nkind = \"rays\"\nwidth = 1\nheight = 1\nfile = \"rays.png\"\n");
    place.done("predict wall.glb --sensor table.toml --pose 0,0,1,0,0,0 --backend cpu");
    place.write("robot.toml", b"format = 1\n[[sensors]]\nsensor = \"table.toml\"\n");
    place.write("poses.tum", b"0 0 0 1 0 0 0 1\n");
    let lines: [(String, &[&str]); 4] = [
        (predict("apart.gltf", "--png before.png --stats bin.json"), &["--stats bin.json"]),
        ("predict wall.glb --robot robot.toml --poses poses.tum --backend cpu --png rays.png".into(), &["rays.png"]),
        (
            predict("wall.glb", "--out before.exr --stats sidecar.json"),
            &["--stats sidecar.json", "wall.materials.toml"],
        ),
        (
            "predict wall.glb --sensor table.toml --pose 0,0,1,0,0,0 --backend cpu --png rays.png".into(),
            &["--png rays.png"],
        ),
    ];
    refused(&place, &lines);
}

/// The scene's images are never read but still belong to it, including missing ones.
#[test]
fn no_image_of_a_scene_is_overwritten() {
    let place = Place::new();
    let whole = fs::read(place.path("wall.glb")).unwrap();
    let json_end = 20 + u32::from_le_bytes(whole[12..16].try_into().unwrap()) as usize;
    let mut root: serde_json::Value = serde_json::from_slice(&whole[20..json_end]).unwrap();
    root["buffers"][0]["uri"] = "wall.bin".into();
    root["images"] = serde_json::json!([
        {"uri": "wood%2Epng"}, {"uri": "tex/brick.png"}, {"uri": "sub/../../tex/tile.PNG"}, {"uri": "a%zz.png"},
        {"uri": "data:image/png;base64,AAAA"}, {"uri": "http://a.example/b.png"}, {"bufferView": 0, "mimeType": "image/png"},
    ]);
    fs::create_dir_all(place.path("scene/sub")).unwrap();
    fs::create_dir(place.path("scene/tex")).unwrap();
    fs::create_dir(place.path("tex")).unwrap();
    place.write("scene/wall.gltf", root.to_string().as_bytes());
    place.write("scene/wall.bin", &whole[json_end + 8..]);
    for image in ["scene/wood.png", "tex/tile.PNG", "scene/a%zz.png"] {
        place.write(image, b"an image");
    }
    symlink("scene/wood.png", place.path("link.png")).unwrap();
    place.write("wood.png", b"of nobody");
    let scene = "scene/wall.gltf";
    let mut lines: Vec<(String, &[&str])> = vec![
        (
            predict(scene, "--png scene/wood.png"),
            &["--png scene/wood.png", "overwrite scene/wood.png", "; write elsewhere"],
        ),
        (predict(scene, "--out before.exr --depth-png link.png"), &["--depth-png link.png", "scene/wood.png"]),
        (predict(scene, "--png tex/../scene/tex/brick.png"), &["--png tex/../scene/tex/brick.png", "brick.png"]),
        (predict(scene, "--png tex/tile.PNG"), &["--png tex/tile.PNG"]),
        (predict(scene, "--png scene/a%zz.png"), &["--png scene/a%zz.png"]),
    ];
    if cfg!(feature = "store") {
        lines.push((format!("env create scene/wood.png {scene}"), &["scene/wood.png"]));
    }
    if cfg!(feature = "script") {
        place.write("scene/hall.rhai", b"place(\"a\", import_gltf(\"wall.gltf\"));");
        lines.push((predict("scene/hall.rhai", "--png scene/tex/brick.png"), &["--png scene/tex/brick.png"]));
    }
    refused(&place, &lines);
    place.done(&predict(scene, "--png wood.png --depth-png tex/brick.png --out scene/tile.exr"));
}

#[cfg(feature = "script")]
#[test]
fn nothing_that_a_script_includes_is_overwritten() {
    let place = Place::new();
    fs::rename(place.path("wall.glb"), place.path("part.png")).unwrap();
    place.write("module.rhai", b"export const WIDTH = 1;\n");
    symlink("module.rhai", place.path("module.json")).unwrap();
    place.write("scene.rhai", b"import \"module\" as m; place(\"a\", import_gltf(\"part.png\"));\n");
    place.done(&predict("scene.rhai", ""));
    let lines: [(String, &[&str]); 3] = [
        (predict("scene.rhai", "--png part.png"), &["--png part.png"]),
        (predict("scene.rhai", "--out before.exr --stats module.json"), &["--stats module.json", "module.rhai"]),
        ("features scene.rhai --class video --out module.json".into(), &["--out module.json"]),
    ];
    refused(&place, &lines);
}

#[cfg(feature = "store")]
#[test]
fn no_store_is_overwritten() {
    let place = Place::new();
    fs::create_dir(place.path("d")).unwrap();
    place.write("l.json", LAYER.as_bytes());
    place.done("env create h.presight wall.glb");
    place.done("env import h.presight l.json");
    for name in ["h.exr", "h.json", "d/scene.glb", "d/laser.layer.json", "index.csv", "report.json"] {
        fs::copy(place.path("h.presight"), place.path(name)).unwrap();
    }
    let mut lines: Vec<(String, &[&str])> = vec![
        (predict("h.presight", "--out h.presight"), &["--out h.presight"]),
        (predict("h.exr", "--out ./h.exr"), &["--out ./h.exr", "overwrite h.exr"]),
        ("features h.json --class video --out h.json".into(), &["--out h.json"]),
        ("env export d/scene.glb d".into(), &["d/scene.glb"]),
        ("env export d/scene.glb ./d/scene.glb".into(), &["d/scene.glb"]),
        // The file name of a class is known only after the store has been read.
        ("env export d/laser.layer.json d".into(), &["d/laser.layer.json"]),
        ("env create wall.glb wall.glb".into(), &["wall.glb"]),
        ("index index.csv --out .".into(), &["index.csv"]),
    ];
    if cfg!(feature = "report") {
        lines.push(("report report.json --out . --quick".into(), &["report.json"]));
    }
    refused(&place, &lines);
}

#[test]
fn names_determine_the_format() {
    let place = Place::new();
    place.write("old.npz", b"old");
    place.done(&predict("wall.glb", "--out a.exr"));
    let lines: [(String, &[&str]); 12] = [
        (predict("wall.glb", "--out a.npz"), &["--out a.npz", "; end the name in .exr"]),
        (predict("wall.glb", "--out old.npz"), &["--out old.npz", "; end the name in .exr"]),
        (predict("wall.glb", "--out a"), &["--out a:", "; end the name in .exr"]),
        (predict("wall.glb", "--out .exr"), &["--out .exr:", "; end the name in .exr"]),
        (predict("wall.glb", "--png a.jpg"), &["; end the name in .png"]),
        (predict("wall.glb", "--depth-png a.exr"), &["; end the name in .png"]),
        (
            predict("wall.glb", "--virtual free-floor --floor 0 --mask a.bmp"),
            &["--mask a.bmp", "; end the name in .png"],
        ),
        (predict("wall.glb", "--points a.xyz"), &["; end the name in .ply or .pcd"]),
        (predict("wall.glb", "--stats a.txt"), &["; end the name in .json"]),
        (predict("wall.glb", "--features a.yaml"), &["; end the name in .json"]),
        ("compare a.exr a.exr --json a".into(), &["; end the name in .json"]),
        ("features wall.glb --class video --out a.layer".into(), &["; end the name in .json"]),
    ];
    refused(&place, &lines);
    place.done(&predict("wall.glb", "--out A.EXR --png b.Png --depth-png c.pNG --points d.PCD --stats e.JSON"));
    assert!(fs::read(place.path("d.PCD")).unwrap().starts_with(b"# .PCD"));
}

#[test]
fn a_dash_is_not_a_file_name() {
    let place = Place::new();
    place.done(&predict("wall.glb", "--out a.exr"));
    let mut lines: Vec<(String, &[&str])> = vec![
        ("compare a.exr a.exr --json -".into(), &["--json -:", "/dev/stdout"]),
        ("features wall.glb --class video --out -".into(), &["--out -:", "/dev/stdout"]),
        ("index wall.glb --out -".into(), &["-:", "/dev/stdout"]),
    ];
    for flag in ["--out", "--png", "--depth-png", "--points", "--stats", "--features"] {
        lines.push((predict("wall.glb", &format!("{flag} -")), &["-: ", "; use /dev/stdout"]));
    }
    if cfg!(feature = "store") {
        lines.push(("env create - wall.glb".into(), &["-:", "./-"]));
        lines.push(("env export none.presight -".into(), &["-:", "./-"]));
    }
    if cfg!(feature = "report") {
        lines.push(("report wall.glb --out -".into(), &["-:", "./-"]));
    }
    refused(&place, &lines);
}

#[test]
fn devices_and_pipes_take_any_name() {
    let place = Place::new();
    place.done(&predict("wall.glb", "--out a.exr --points a.ply"));
    let whole = fs::read(place.path("a.exr")).unwrap();
    place.done(&predict("wall.glb", "--out /dev/null --png /dev/null --points /dev/null"));
    let pipe = place.path("pipe");
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    let reader = std::thread::spawn(move || fs::read(pipe).unwrap());
    place.done(&predict("wall.glb", "--out pipe"));
    assert!(reader.join().unwrap() == whole);
    let run = |stdout: Stdio| {
        let mut command = Command::new(assert_cmd::cargo::cargo_bin("presight"));
        let line = predict("wall.glb", "--out /dev/stdout");
        command.current_dir(place.folder.path()).args(line.split_whitespace()).stdout(stdout).spawn().unwrap()
    };
    let mut child = run(Stdio::piped());
    let mut bytes = Vec::new();
    child.stdout.take().unwrap().read_to_end(&mut bytes).unwrap();
    assert!(child.wait().unwrap().success() && bytes == whole);
    // A file that stdout was redirected to is appended to.
    let mut file = File::create(place.path("log")).unwrap();
    file.write_all(b"before").unwrap();
    assert!(run(file.into()).wait().unwrap().success());
    assert!(fs::read(place.path("log")).unwrap() == [b"before".as_slice(), whole.as_slice()].concat());
    // This holds even if the file's name conflicts with the scene's.
    let file = File::options().append(true).open(place.path("wall.glb")).unwrap();
    assert_eq!(run(file.into()).wait().unwrap().code(), Some(2));
}

#[test]
fn a_file_keeps_its_permissions() {
    let place = Place::new();
    let mode = |name: &str| fs::metadata(place.path(name)).unwrap().permissions().mode() & 0o7777;
    let line = predict("wall.glb", "--out a.exr");
    place.done(&line);
    for bits in [0o600, 0o640, 0o666, 0o755, 0o200] {
        fs::set_permissions(place.path("a.exr"), fs::Permissions::from_mode(bits)).unwrap();
        place.done(&line);
        assert_eq!(mode("a.exr"), bits, "{bits:o}");
    }
    place.write("kept.exr", b"kept");
    fs::set_permissions(place.path("kept.exr"), fs::Permissions::from_mode(0o444)).unwrap();
    let outcome = place.run(&predict("wall.glb", "--out kept.exr"));
    assert_eq!(outcome.status, Some(4), "{}", outcome.stderr);
    assert!(outcome.stderr.starts_with("error: kept.exr: cannot write: the file is read-only; "), "{}", outcome.stderr);
    assert_eq!((mode("kept.exr"), fs::read(place.path("kept.exr")).unwrap()), (0o444, b"kept".to_vec()));
    symlink("new.exr", place.path("link.exr")).unwrap();
    place.done(&predict("wall.glb", "--out link.exr"));
    assert!(fs::symlink_metadata(place.path("link.exr")).unwrap().is_symlink());
    assert!(fs::symlink_metadata(place.path("new.exr")).unwrap().is_file());
}
