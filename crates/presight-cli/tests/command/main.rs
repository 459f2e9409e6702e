//! Runs the command as a process and checks its files, its messages and its exit status.

mod bad_input;
#[cfg(feature = "ros")]
mod bags;
#[cfg(all(feature = "ros", feature = "report"))]
mod bags_bad;
mod bags_out;
mod cameras;
mod cases_scanners;
mod deadline;
mod driver_logs;
#[cfg(all(feature = "gpu", target_os = "linux"))]
mod drivers;
#[cfg(feature = "edit")]
mod edit;
#[cfg(feature = "store")]
mod explore;
mod features;
mod frames;
mod hidden;
mod localize;
#[cfg(target_os = "linux")]
mod memory;
mod messages;
mod motion;
#[cfg(unix)]
mod outputs;
#[cfg(unix)]
mod poses;
#[cfg(feature = "script")]
mod reflectors;
mod scene_notices;
#[cfg(feature = "script")]
mod scripts;
#[cfg(unix)]
mod signals;
mod special;
#[cfg(feature = "script")]
mod supervise;
#[cfg(feature = "store")]
mod update;
#[cfg(feature = "store")]
mod update_faults;
#[cfg(feature = "store")]
mod update_inputs;
#[cfg(feature = "store")]
mod update_known;
#[cfg(feature = "store")]
mod update_minor;
mod virtual_sensors;

use assert_cmd::Command;
use presight::files;
use serde_json::{Value, json};
use std::fs;
use std::path::PathBuf;
use tempfile::TempDir;

/// A folder with a scene: a 2 m x 2 m wall of two triangles at x = 2 m, y from -1 to 1, z from 0 to 2.
struct Place {
    folder: TempDir,
}

/// The wall's corners in glTF's frame, (x, z, -y).
const WALL: [[f32; 3]; 4] = [[2.0, 0.0, 1.0], [2.0, 0.0, -1.0], [2.0, 2.0, -1.0], [2.0, 2.0, 1.0]];
const WALL_INDICES: [u16; 6] = [0, 1, 2, 0, 2, 3];

impl Place {
    fn new() -> Self {
        let place = Self { folder: tempfile::tempdir().unwrap() };
        place.write("wall.glb", &wall(|_| (), WALL, WALL_INDICES));
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) {
        fs::write(self.path(name), bytes).unwrap();
    }

    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(self.folder.path()).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// Runs the command in the folder. Arguments are separated by spaces.
    fn run(&self, line: &str) -> Outcome {
        self.run_args(&line.split_whitespace().collect::<Vec<_>>())
    }

    fn run_args(&self, args: &[&str]) -> Outcome {
        let mut command = Command::cargo_bin("presight").unwrap();
        command.current_dir(self.folder.path()).args(args);
        // Hides every Vulkan driver, so that the tests give the same results on every machine.
        for variable in ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"] {
            command.env(variable, "/nonexistent");
        }
        let output = command.output().unwrap();
        Outcome {
            status: output.status.code(),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    /// Runs a command line that must succeed with an empty stderr, and returns its stdout.
    fn done(&self, line: &str) -> String {
        let outcome = self.run(line);
        assert_eq!((outcome.status, outcome.stderr.as_str()), (Some(0), ""), "{line}\n{}", outcome.stdout);
        outcome.stdout
    }

    fn images(&self, name: &str) -> files::ImageFile {
        files::read_exr(&self.path(name)).unwrap()
    }

    fn json(&self, name: &str) -> Value {
        serde_json::from_slice(&fs::read(self.path(name)).unwrap()).unwrap()
    }
}

#[derive(Debug)]
struct Outcome {
    status: Option<i32>,
    stdout: String,
    stderr: String,
}

/// Builds a .glb of one mesh; `change` edits its JSON.
fn wall<const I: usize>(change: impl FnOnce(&mut Value), positions: [[f32; 3]; 4], indices: [u16; I]) -> Vec<u8> {
    let mut bin: Vec<u8> = positions.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
    bin.extend(indices.iter().flat_map(|i| i.to_le_bytes()));
    let mut root = json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "name": "wall", "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
        "buffers": [{ "byteLength": bin.len() }],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": 48 },
            { "buffer": 0, "byteOffset": 48, "byteLength": 2 * I },
        ],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
              "min": [2.0, 0.0, -1.0], "max": [2.0, 2.0, 1.0] },
            { "bufferView": 1, "componentType": 5123, "count": I, "type": "SCALAR" },
        ],
    });
    change(&mut root);
    glb(&root, &bin)
}

fn glb(root: &Value, bin: &[u8]) -> Vec<u8> {
    let padded = |bytes: &[u8], with: u8| {
        let mut bytes = bytes.to_vec();
        bytes.resize(bytes.len().next_multiple_of(4), with);
        bytes
    };
    let (json, bin) = (padded(root.to_string().as_bytes(), b' '), padded(bin, 0));
    let mut all = b"glTF".to_vec();
    let total = 12 + 8 + json.len() + 8 + bin.len();
    all.extend([2u32, total as u32, json.len() as u32].iter().flat_map(|v| v.to_le_bytes()));
    all.extend(b"JSON");
    all.extend(json);
    all.extend((bin.len() as u32).to_le_bytes());
    all.extend(b"BIN\0");
    all.extend(bin);
    all
}

const VIEW: &str = "--sensor laser-scanner --pose 0,0,1,0,0,0 --backend cpu";

#[test]
fn a_prediction_is_written_with_its_provenance() {
    let place = Place::new();
    assert_eq!(place.done(&format!("predict wall.glb {VIEW} --out a.exr")), "");
    let file = place.images("a.exr");
    assert_eq!((file.images.width, file.images.height), (361, 1));
    // Azimuth -90 + 180 x 0.5 = 0 looks at the wall; -90 and +90 look along it.
    assert_eq!(file.images.range[180], 2.0);
    assert_eq!([file.images.range[0], file.images.range[360]], [f32::INFINITY; 2]);
    assert_eq!((file.images.polygon_id[180], file.images.object_id[180], file.images.cos_incidence[180]), (1, 1, 1.0));
    assert!(file.images.depth_z.is_empty());
    let attributes = file.attributes;
    assert_eq!(attributes.objects.get(&1).map(String::as_str), Some("wall"));
    assert_eq!(attributes.scene.as_deref(), Some("wall.glb"));
    assert_eq!(attributes.scene_blake3.map(|hash| hash.len()), Some(64));
    assert_eq!(attributes.pose.unwrap().world_from_sensor().translation.to_array(), [0.0, 0.0, 1.0]);
    fs::write(place.path("again.toml"), attributes.sensor.unwrap()).unwrap();
    place.done("predict wall.glb --sensor again.toml --pose 0,0,1,0,0,0 --backend cpu --out b.exr");
    let (a, b) = (place.images("a.exr").images, place.images("b.exr").images);
    assert_eq!((a.range, a.polygon_id), (b.range, b.polygon_id));
}

#[test]
fn only_requested_outputs_are_written() {
    let place = Place::new();
    place.done(&format!("predict wall.glb {VIEW} --outputs range --out a.exr --png a.png"));
    let names: Vec<_> = place.images("a.exr").images.outputs().iter().map(|o| o.name()).collect();
    assert_eq!(names, ["range"]);
}

#[test]
fn source_ids_number_triangles() {
    let place = Place::new();
    place.done(&format!("predict wall.glb {VIEW} --ids source --out a.exr"));
    let ids = place.images("a.exr").images.polygon_id;
    assert!(ids.contains(&1) && ids.contains(&2) && !ids.contains(&3));
}

#[test]
fn every_form_of_a_pose_gives_the_same_images() {
    let place = Place::new();
    let base = "predict wall.glb --sensor video-camera --backend cpu";
    place.done(&format!("{base} --pose -1,0.25,1,0,0,0 --out body.exr"));
    let body = place.images("body.exr").images;
    assert!(body.polygon_id.contains(&1));
    // The same pose as a quaternion, as the optical frame's pose (roll -90, yaw -90), and in the file's y-up world (x,
    // z, -y) with the sensor rotated back by -90 about x.
    let ways = [
        "--pose -1,0.25,1,0,0,0,1",
        "--pose=-1,0.25,1,-0.5,0.5,-0.5,0.5 --pose-frame optical",
        "--pose -1,1,-0.25,-90,0,0 --world-frame gltf",
        "--pose -1,0.25,1,0,0,0 --pose-of robot",
    ];
    for way in ways {
        place.done(&format!("{base} {way} --out other.exr"));
        let outcome = place.run("compare body.exr other.exr --scene wall.glb --precision f64");
        assert_eq!(outcome.status, Some(0), "{way}: {}", outcome.stdout);
    }
    place.done(&format!("{base} --pose 1,0.25,1,0,0,0 --out other.exr"));
    assert_eq!(place.run("compare body.exr other.exr --scene wall.glb").status, Some(1));
}

#[test]
fn without_an_output_flag_there_is_one_line() {
    let place = Place::new();
    let summary = place.done(&format!("predict wall.glb {VIEW}"));
    assert_eq!(summary.lines().count(), 1);
    for word in ["laser-scanner 361 x 1", "% of rays hit", "1 of 1 objects", "ms on cpu"] {
        assert!(summary.contains(word), "{word:?} in {summary}");
    }
    assert_eq!(place.names(), ["wall.glb"]);
}

#[test]
fn statistics_and_explanation_report_the_cost() {
    let place = Place::new();
    let told = place.done(&format!("predict wall.glb {VIEW} --threads 1 --repeat 5 --stats s.json --explain"));
    for word in ["engine", "stages", "left out", "depth_z image: not requested"] {
        assert!(told.contains(word), "{word:?} in {told}");
    }
    let stats = place.json("s.json");
    let ms = |name: &str| stats["prediction_ms"][name].as_f64().unwrap();
    assert!(0.0 < ms("min") && ms("min") <= ms("median") && ms("median") <= ms("p95"));
    assert_eq!((&stats["repeat"], &stats["engine"], &stats["threads"]), (&json!(5), &json!("cpu"), &json!(1)));
    assert_eq!(stats["versions"]["presight"], json!(env!("CARGO_PKG_VERSION")));
    for key in ["stages_ms", "counts", "left_out", "notices", "adapter", "outputs"] {
        assert!(stats.get(key).is_some(), "{key}");
    }
    assert_eq!(stats["counts"]["polygons selected"], 1, "{}", stats["counts"]);
    assert!(stats["counts"].as_object().unwrap().keys().all(|name| !name.contains('_')), "{}", stats["counts"]);
}

#[test]
fn pictures_and_points_are_written() {
    let place = Place::new();
    for output in ["range", "polygon_id", "object_id", "cos_incidence", "depth_z"] {
        let view = "--sensor video-camera --pose -1,0,1,0,0,0 --backend cpu";
        place.done(&format!("predict wall.glb {view} --png {output}.png --png-of {output} --depth-png depth.png"));
        assert!(image::open(place.path(&format!("{output}.png"))).unwrap().width() > 500);
    }
    let depth = image::open(place.path("depth.png")).unwrap().into_luma16();
    assert_eq!(
        (depth.width(), depth.height(), depth.get_pixel(256, 256).0, depth.get_pixel(0, 0).0),
        (512, 512, [3000], [0])
    );
    place.done(&format!("predict wall.glb {VIEW} --points a.ply"));
    place.done(&format!("predict wall.glb {VIEW} --points a.pcd --points-frame world"));
    assert!(fs::read(place.path("a.ply")).unwrap().starts_with(b"ply\nformat binary_little_endian 1.0\n"));
    assert!(fs::read(place.path("a.pcd")).unwrap().starts_with(b"# .PCD v0.7"));
}

#[test]
fn comparison_finds_a_fault_and_locates_it() {
    let place = Place::new();
    place.done(&format!("predict wall.glb {VIEW} --out a.exr"));
    place.done(&format!("predict wall.glb {VIEW} --out same.exr"));
    assert!(place.done("compare a.exr same.exr").contains("361 same"));
    let mut file = place.images("a.exr");
    file.images.range[180] += 0.01;
    files::write_exr(&place.path("off.exr"), &file.images, file.images.outputs(), &file.attributes).unwrap();
    for scene in ["", "--scene wall.glb"] {
        let outcome = place.run(&format!("compare a.exr off.exr --json verdict.json {scene}"));
        assert_eq!((outcome.status, outcome.stderr.as_str()), (Some(1), ""));
        assert!(outcome.stdout.contains("1 faults") && outcome.stdout.contains("pixel (180, 0)"), "{}", outcome.stdout);
        let verdict = place.json("verdict.json");
        assert_eq!((&verdict["fault"], &verdict["faults"][0]["column"]), (&json!(1), &json!(180)));
    }
}

#[test]
fn presets_print_a_sensor_file() {
    let place = Place::new();
    let listed = place.done("sensors");
    assert_eq!(listed.lines().count(), 12);
    for line in listed.lines() {
        let name = line.split_whitespace().next().unwrap();
        place.write("mine.toml", place.done(&format!("sensors {name}")).as_bytes());
        place.done("predict wall.glb --sensor mine.toml --pose 0,0,1,0,0,0 --backend cpu");
    }
}

#[test]
fn inspection_counts_in_words_and_json() {
    let place = Place::new();
    let words = place.done("inspect wall.glb");
    assert!(words.contains("objects    1") && words.contains("from 2 triangles"), "{words}");
    let json: Value = serde_json::from_str(&place.done("inspect wall.glb --json")).unwrap();
    assert_eq!((&json["objects"][0]["name"], &json["triangles_in_scene"]), (&json!("wall"), &json!(2)));
    let low: Vec<f64> = serde_json::from_value(json["bounds"]["min"].clone()).unwrap();
    assert!((0..3).all(|i| (low[i] - [2.0, -1.0, 0.0][i]).abs() < 1e-9), "{low:?}");
}

#[test]
fn indexes_are_measured() {
    let place = Place::new();
    place.write("poses.tum", b"# t x y z qx qy qz qw\n0 0 0 1 0 0 0 1\n1 5 0 1 0 0 0 1\n");
    let words = place.done("index wall.glb --poses poses.tum --repeat 1 --sensor laser-range-camera --out study");
    assert!(words.starts_with("1 polygons, 2 poses"), "{words}");
    let csv = fs::read_to_string(place.path("study/index.csv")).unwrap();
    let lines: Vec<Vec<&str>> = csv.lines().map(|l| l.split(',').collect()).collect();
    let columns = "scheme,query,poses,seed,build_ms,bytes,access_us,needed,returned,selectivity,prediction_ms";
    assert_eq!(lines[0][..11].join(","), columns);
    let schemes: Vec<&str> = lines[1..].iter().step_by(2).map(|l| l[0]).collect();
    assert_eq!(schemes, ["none", "grid", "plop", "s2d", "s3d", "two-level"]);
    for line in &lines[1..] {
        // The polygon is in view from the first pose only: the medians are 0.5, and nothing needless is returned.
        assert_eq!((line[2], line[3], line[7], line[8], line[9]), ("2", "", "0.5", "0.5", "1.0000"), "{line:?}");
        assert_eq!(line[10].is_empty(), line[1] == "sector", "{line:?}");
    }
}

#[test]
fn any_index_predicts_the_same() {
    let place = Place::new();
    let line = |index: &str| format!("predict wall.glb {VIEW} --index {index} --out {index}.exr");
    for index in ["none", "grid", "plop", "s2d", "s3d", "two-level"] {
        place.done(&line(index));
        place.done(&format!("compare none.exr {index}.exr"));
    }
}

#[test]
fn help_has_examples_and_survives_a_closed_pipe() {
    let place = Place::new();
    for command in ["", "predict", "inspect", "sensors", "compare"] {
        assert!(place.done(&format!("{command} --help")).contains("Examples:"), "{command}");
    }
    let mut child = std::process::Command::new(assert_cmd::cargo::cargo_bin("presight"))
        .arg("sensors")
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!((output.status.code(), output.stderr.as_slice()), (Some(0), b"".as_slice()));
}

/// A bad input: its arguments, its exit status, the words that its one line must contain, the number of notices before
/// that line, and the change of the arguments that its remedy names.
struct Bad {
    line: String,
    status: i32,
    names: Vec<&'static str>,
    notices: usize,
    change: Option<[&'static str; 3]>,
}

fn bad(line: impl Into<String>, status: i32, names: &[&'static str]) -> Bad {
    Bad { line: line.into(), status, names: names.to_vec(), notices: 0, change: None }
}

impl Bad {
    /// The log is read before the fault is found, so the notice on its readings comes first.
    fn after_a_notice(self) -> Self {
        Self { notices: 1, ..self }
    }

    /// The command succeeds with `to` in place of the last `from`, and the remedy names that change in these words.
    fn until(self, from: &'static str, to: &'static str, remedy: &'static str) -> Self {
        Self { change: Some([from, to, remedy]), ..self }
    }
}

/// Checks each case: the exit status, one line on stderr with all words, an empty stdout, and no new file. Then follows
/// the remedy.
fn check(place: &Place, cases: Vec<Bad>) {
    let before = place.names();
    for case in cases {
        let outcome = place.run(&case.line);
        let mut said = outcome.stderr.as_str();
        for _ in 0..case.notices {
            let (notice, rest) = said.split_once('\n').expect("a notice has its line");
            assert!(notice.starts_with("note: "), "{}: {notice}", case.line);
            said = rest;
        }
        assert_eq!(outcome.status, Some(case.status), "{}: {said}", case.line);
        assert_eq!((said.lines().count(), outcome.stdout.as_str()), (1, ""), "{}: {said}", case.line);
        assert!(said.starts_with("error: ") && said.ends_with('\n'), "{}: {said}", case.line);
        for name in case.names {
            assert!(said.contains(name), "{}: {name:?} is not in: {said}", case.line);
        }
        assert_eq!(place.names(), before, "{}", case.line);
        let Some([from, to, remedy]) = case.change else { continue };
        assert!(said.contains(remedy), "{}: {remedy:?} is not in: {said}", case.line);
        let (before_it, after_it) = case.line.rsplit_once(from).expect("the line has it");
        let changed = format!("{before_it}{to}{after_it}");
        let outcome = place.run(&changed);
        assert_eq!(outcome.status, Some(0), "{changed}: {}", outcome.stderr);
        for name in place.names().into_iter().filter(|name| !before.contains(name)) {
            fs::remove_file(place.path(&name)).unwrap();
        }
    }
}

fn camera(width: u32, height: u32) -> String {
    format!(
        "format = 1\nkind = \"camera\"\nwidth = {width}\nheight = {height}\nfx = 100.0\nfy = 100.0\ncx = 1.0\ncy = 1.0\n"
    )
}

fn predict(scene: &str) -> String {
    format!("predict {scene} {VIEW} --out out.exr")
}

#[test]
fn without_vulkan_gpu_is_refused_and_auto_uses_the_cpu() {
    let place = Place::new();
    let line = "predict wall.glb --sensor laser-scanner --pose 0,0,1,0,0,0 --out out.exr --backend gpu";
    check(&place, vec![bad(line, 3, &[]).until("gpu", "cpu", "use --backend cpu")]);
    let outcome = place.run("predict wall.glb --sensor laser-scanner --pose 0,0,1,0,0,0 --backend auto");
    assert_eq!(outcome.status, Some(0), "{}", outcome.stderr);
    assert!(outcome.stdout.contains("on cpu"), "{}", outcome.stdout);
}

#[test]
fn doctor_lists_engines_and_the_one_in_use() {
    let place = Place::new();
    let outcome = place.run("doctor");
    assert_eq!(outcome.status, Some(0), "{}", outcome.stdout);
    assert!(
        outcome.stdout.contains("CPU engine") && outcome.stdout.contains("--backend auto takes"),
        "{}",
        outcome.stdout
    );
    assert!(outcome.stdout.matches("right: ").count() >= 4 && !outcome.stdout.contains("WRONG"), "{}", outcome.stdout);
    assert!(outcome.stdout.contains("tiles of rays are searched in"), "{}", outcome.stdout);
    let looks_for_drivers = cfg!(all(feature = "gpu", target_os = "linux"));
    assert_eq!(outcome.stdout.contains("VK_DRIVER_FILES=/nonexistent is set"), looks_for_drivers, "{}", outcome.stdout);
}

/// Rays in the order of time: a row that no picture holds, with the same image both ways.
#[test]
fn a_long_row_of_listed_rays_is_an_image_but_no_picture() {
    let place = Place::new();
    let ray = |i: u32| {
        let (fast, slow) = ((f64::from(i) * 0.731).sin_cos(), (f64::from(i) * -0.4873).sin_cos());
        format!("1,{},{}\n", 0.3 * (fast.0 + slow.0), 0.3 * (fast.1 + slow.1))
    };
    place.write("rays.csv", (0..20_000).map(ray).collect::<String>().as_bytes());
    place.write("rays.toml", b"format = 1\nkind = \"rays\"\nwidth = 20000\nheight = 1\nfile = \"rays.csv\"\n");
    let line = "predict wall.glb --sensor rays.toml --pose 0,0,1,0,0,0";
    let explained = place.done(&format!("{line} --out tiles.exr --explain --backend cpu"));
    assert!(explained.contains("way       tiles") && explained.contains("the sensor's rays are listed"), "{explained}");
    place.done(&format!("{line} --out raster.exr --way raster --backend cpu"));
    let [tiles, raster] = ["tiles.exr", "raster.exr"].map(|name| place.images(name).images);
    assert_eq!((tiles.range.len(), &tiles.range), (20_000, &raster.range));
    assert!(tiles.range.iter().any(|range| range.is_finite()));
    check(&place, vec![bad(format!("{line} --png out.png"), 2, &["--png", "20000 rays"])]);
}

#[test]
fn help_explains_scenes() {
    let place = Place::new();
    let help = place.done("--help");
    assert!([".glb", ".rhai", ".presight"].iter().all(|kind| help.contains(kind)), "{help}");
    assert!(help.contains("locked"), "{help}");
}
