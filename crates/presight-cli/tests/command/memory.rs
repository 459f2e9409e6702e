//! Commands state the memory that they need, take about that much, and refuse at the start where less is available.

use super::{Place, camera, glb};
use serde_json::json;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Runs the command with its address space limited to this many kilobytes.
fn under(place: &Place, kilobytes: u64, line: &str) -> (Option<i32>, String) {
    let mut command = Command::new("sh");
    command.args(["-c", &format!("ulimit -v {kilobytes} && exec \"$@\""), "sh", env!("CARGO_BIN_EXE_presight")]);
    let output = command.args(line.split(' ')).current_dir(place.folder.path()).output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

/// Returns the peak memory of a run of the command, in bytes, as the system reports it.
fn peak(place: &Place, line: &str) -> u64 {
    let mut command = Command::new(env!("CARGO_BIN_EXE_presight"));
    command.args(line.split(' ')).current_dir(place.folder.path()).stdout(Stdio::null());
    let mut child = command.spawn().unwrap();
    let status = format!("/proc/{}/status", child.id());
    let mut most = 0;
    loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|l| l.strip_prefix("VmHWM:"));
        let kilobytes = line.and_then(|l| l.split_whitespace().next()?.parse::<u64>().ok());
        most = most.max(kilobytes.unwrap_or(0) * 1024);
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success(), "{line:?}");
            return most;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// Returns the memory that a refusal states as needed, in bytes.
fn said(message: &str) -> f64 {
    let (_, rest) = message.split_once("needs about ").unwrap_or_else(|| panic!("{message}"));
    let mut words = rest.split(' ');
    let number: f64 = words.next().unwrap().parse().unwrap();
    number * if words.next() == Some("GB") { 1e9 } else { 1e6 }
}

/// An address space in kilobytes: less than the work needs, more than the command uses before it checks.
const LITTLE: u64 = 420_000;

/// Checks that the command refuses under a limit and that the need it states is within a fifth of its peak without one.
fn check(place: &Place, line: &str, least: u64) {
    let names = place.names();
    let (status, message) = under(place, LITTLE, line);
    assert_eq!((status, message.lines().count()), (Some(4), 1), "{line}: {message}");
    assert!(message.contains("address space (ulimit -v) leaves "), "{line}: {message}");
    assert_eq!(place.names(), names, "{line}");
    let (said, peak) = (said(&message), (peak(place, line) - least) as f64);
    assert!((0.8..1.2).contains(&(said / peak)), "{line}: {said:.3e} stated, {peak:.3e} taken");
}

fn square(width: u32, height: u32, more: &str) -> String {
    camera(width, height).replace("fx = 100.0\nfy = 100.0", "fx = 3000.0\nfy = 3000.0") + more
}

#[test]
fn predictions_take_the_memory_they_state() {
    let place = Place::new();
    place.write("large.toml", square(4096, 4096, "").as_bytes());
    place.write("tiny.toml", square(16, 16, "").as_bytes());
    let scanner = "format = 1\nkind = \"scanner\"\n[azimuth]\nstart_deg = -180\nstep_deg = 0.0219\ncount = 16384\n\
        [elevation]\nstart_deg = -40\nstep_deg = 0.07\ncount = 1024\n";
    place.write("scanner.toml", scanner.as_bytes());
    let predict = |sensor: &str, rest: &str| {
        format!("predict wall.glb --pose 0,0,1,0,0,0 --backend cpu --threads 2 --sensor {sensor}.toml {rest}")
    };
    let least = peak(&place, &predict("tiny", "--out tiny.exr"));
    for (sensor, rest) in [
        ("large", "--out a.exr"),
        ("large", "--outputs range,echo --explain"),
        ("large", "--outputs range --png a.png"),
        ("large", "--outputs range --depth-png a.png"),
        ("large", "--outputs range --points a.ply"),
        ("large", "--repeat 2 --stats a.json"),
        ("large", "--outputs range --virtual free-floor --floor-z 0"),
        ("scanner", "--out a.exr"),
    ] {
        check(&place, &predict(sensor, rest), least);
        ["a.exr", "a.png", "a.ply", "a.json"].iter().for_each(|name| drop(std::fs::remove_file(place.path(name))));
    }
    let lens = "[distortion]\nmodel = \"plumb_bob\"\ncoefficients = [0.01, 0.001, 0, 0, 0]\n";
    place.write("lens.toml", square(4096, 4096, lens).as_bytes());
    // The ray table is allocated before the images: 24 bytes a listed ray and 1,633 bytes a tile of 64 rays.
    let (status, message) = under(&place, LITTLE, &predict("lens", "--explain"));
    assert!(
        status == Some(4) && (said(&message) / (4096.0 * 4096.0 * (24.0 + 1633.0 / 64.0)) - 1.0).abs() < 0.2,
        "{message}"
    );
}

/// Builds wavy ground of `side` x `side` squares without two coplanar triangles.
fn ground(side: u32) -> Vec<u8> {
    let height = |i: u32, j: u32| (f64::from(i) * 0.37).sin() * (f64::from(j) * 0.23).cos() * 0.3;
    let mut bin = Vec::new();
    for (i, j) in (0..=side).flat_map(|i| (0..=side).map(move |j| (i, j))) {
        let p =
            [f64::from(i) * 0.05, height(i, j) + f64::from((i * 7919 + j * 104_729) % 97) * 1e-3, f64::from(j) * 0.05];
        p.iter().for_each(|c| bin.extend((*c as f32).to_le_bytes()));
    }
    let vertices = bin.len();
    for (i, j) in (0..side).flat_map(|i| (0..side).map(move |j| (i, j))) {
        let a = i * (side + 1) + j;
        [a, a + 1, a + side + 1, a + 1, a + side + 2, a + side + 1].iter().for_each(|k| bin.extend(k.to_le_bytes()));
    }
    let root = json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "name": "ground", "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
        "buffers": [{ "byteLength": bin.len() }],
        "bufferViews": [
            { "buffer": 0, "byteLength": vertices },
            { "buffer": 0, "byteOffset": vertices, "byteLength": bin.len() - vertices },
        ],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": vertices / 12, "type": "VEC3",
              "min": [0, -1, 0], "max": [1000, 1, 1000] },
            { "bufferView": 1, "componentType": 5125, "count": 6 * side * side, "type": "SCALAR" },
        ],
    });
    glb(&root, &bin)
}

#[test]
fn imports_take_the_memory_they_state() {
    let place = Place::new();
    let ground = ground(1000);
    place.write("ground.glb", &ground);
    let least = peak(&place, "inspect wall.glb");
    // The file itself is in memory when its meshes are allocated.
    check(&place, "inspect ground.glb", least + ground.len() as u64);
    #[cfg(feature = "store")]
    {
        place.done("env create ground.presight ground.glb");
        let (line, least) = ("inspect ground.presight", peak(&place, "inspect wall.glb"));
        let (status, message) = under(&place, 250_000, line);
        assert_eq!(status, Some(4), "{message}");
        let (said, peak) = (said(&message), (peak(&place, line) - least) as f64);
        assert!((0.8..1.2).contains(&(said / peak)), "{line}: {said:.3e} stated, {peak:.3e} taken");
    }
}

/// Trees take more than the polygons of a stored environment: under the least limit that opens it there are none.
#[cfg(feature = "store")]
#[test]
fn the_raster_serves_where_memory_does_not_suffice_for_trees() {
    let place = Place::new();
    place.write("ground.glb", &ground(500));
    place.done("env create ground.presight ground.glb");
    let line = "predict ground.presight --sensor laser-scanner --pose 12,-12,1,0,5,0 --backend cpu --threads 1 --way";
    let by_tiles = format!("{line} tiles --out tiles.exr");
    let limits = (150_000..900_000).step_by(20_000);
    let (_, message) =
        limits.map(|limit| under(&place, limit, &by_tiles)).find(|(status, _)| *status == Some(0)).unwrap();
    assert!(message.contains("the raster drew in place of tiles: this needs about "), "{message}");
    place.done(&format!("{line} raster --out raster.exr"));
    place.done("compare tiles.exr raster.exr");
}

#[test]
fn comparisons_take_the_memory_they_state() {
    let place = Place::new();
    place.write("large.toml", square(4096, 4096, "").as_bytes());
    let view = "--pose 0,0,1,0,0,0 --backend cpu --sensor large.toml";
    place.done(&format!("predict wall.glb {view} --out a.exr"));
    let (status, message) = under(&place, LITTLE, "compare a.exr a.exr");
    assert_eq!((status, message.lines().count()), (Some(4), 1), "{message}");
    // The refusal names the first of the two images. Both images need the same amount.
    assert!((said(&message) / (4096.0 * 4096.0 * 16.0) - 1.0).abs() < 0.01, "{message}");
    let twice = (peak(&place, "compare a.exr a.exr") - peak(&place, "inspect wall.glb")) as f64;
    assert!((0.8..1.2).contains(&(2.0 * said(&message) / twice)), "{message} {twice:.3e}");
}

/// Images just above a limit of 3 GB are refused at once; the system does not end the command half-way.
#[test]
fn a_large_camera_is_refused_with_both_figures() {
    let place = Place::new();
    place.write("huge.toml", square(16_384, 4096, "").as_bytes());
    let line = "predict wall.glb --pose 0,0,1,0,0,0 --backend cpu --sensor huge.toml --out a.exr";
    let (status, message) = under(&place, 3_000_000, line);
    assert_eq!((status, message.lines().count()), (Some(4), 1), "{message}");
    // 48.5 bytes a pixel: buffers of 16 bytes, four images, and their copies for the file.
    assert!(message.starts_with("error: ") && message.contains("about 3.25 GB of memory"), "{message}");
    assert!(message.contains("leaves 2.") && message.contains("; raise the limit"), "{message}");
    assert!(!place.path("a.exr").exists());
}
