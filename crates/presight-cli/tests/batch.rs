//! Runs `presight batch` as a process and checks its files and messages.

use assert_cmd::cargo::cargo_bin;
use presight::files;
use presight::sensor::Noise;
use presight::{Pose, Sensor};
use presight_testkit::scenes;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

/// A folder with a room, poses, a scanner and a log recorded by it.
struct Place(tempfile::TempDir);

const POSES: usize = 12;

fn pose(i: usize) -> Pose {
    let at = glam::DVec3::new(0.05 * i as f64, 0.02 * i as f64, 1.25);
    Pose::from_xyz_rpy(at, 0.0, 0.0, 0.1 * i as f64)
}

fn tum(count: usize) -> String {
    let mut text = "# time tx ty tz qx qy qz qw\n".to_owned();
    for i in 0..count {
        let (p, q) = (pose(i).translation, pose(i).rotation);
        writeln!(text, "{}.5 {} {} {} {} {} {} {}", i, p.x, p.y, p.z, q.x, q.y, q.z, q.w).unwrap();
    }
    text
}

fn scanner() -> Sensor {
    let spec = presight::preset("laser-scanner").unwrap().spec().clone();
    Sensor::new(spec.with_noise(Noise { range_sigma: 0.05, ..Noise::default() })).unwrap()
}

impl Place {
    fn new() -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        files::write_glb(&place.path("room.glb"), &scenes::room(4, 20)).unwrap();
        place.write("a.tum", &tum(POSES));
        place.write("s.toml", &files::sensor_to_toml(scanner().spec()));
        let frame = |time: f64, range: f32| files::LogFrame::new(time, vec![range; 361]);
        let lines = [1.0, 2.0].map(|t| files::range_log_line(&frame(t, 1.5 * t as f32)).unwrap());
        place.write("run.jsonl", &format!("{}\n{}\n", files::range_log_header(scanner().spec()), lines.join("\n")));
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).unwrap();
    }

    fn command(&self, line: &str) -> Command {
        let mut command = Command::new(cargo_bin("presight"));
        command.current_dir(self.0.path()).args(line.split_whitespace()).args(["--backend", "cpu", "--threads", "2"]);
        command
    }

    fn run(&self, line: &str) -> Output {
        self.command(line).output().unwrap()
    }

    /// Runs a command line that must succeed, and returns its stderr.
    fn done(&self, line: &str) -> String {
        let output = self.run(line);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success() && output.stdout.is_empty(), "{line}: {said}");
        said
    }

    /// Runs a command line that must fail with this exit status and one line of message that contains `what`.
    fn fails(&self, line: &str, status: i32, what: &str) {
        let output = self.run(line);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(status), "{line}: {said}");
        assert!(said.contains(what) && said.lines().count() == 1 && said.contains("; "), "{line}: {said}");
    }

    /// Returns all files of a folder except the batch record and temporary files of a killed process.
    fn files(&self, folder: &str) -> BTreeMap<String, Vec<u8>> {
        let entries = std::fs::read_dir(self.path(folder)).unwrap().map(|e| e.unwrap());
        let files = entries.map(|e| (e.file_name().into_string().unwrap(), std::fs::read(e.path()).unwrap()));
        files.filter(|(name, _)| name != "batch.json" && !name.starts_with(".presight-")).collect()
    }

    fn rows(&self, table: &str) -> Vec<Vec<String>> {
        let text = std::fs::read_to_string(self.path(table)).unwrap();
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some("pose,time,x,y,z,qx,qy,qz,qw,image,heading_deg,log_likelihood"));
        lines.map(|line| line.split(',').map(str::to_owned).collect()).collect()
    }
}

#[test]
fn images_and_table_equal_single_predictions() {
    let place = Place::new();
    assert_eq!(place.done("batch room.glb --poses a.tum --sensor vlp-16 --out all"), "");
    let rows = place.rows("all/poses.csv");
    assert_eq!((rows.len(), place.files("all").len()), (POSES, POSES + 1));
    assert_eq!(rows[7][..3], ["7", "7.5", "0.35000000000000003"]);
    assert_eq!(rows[7][9..], ["000007.exr", "", ""]);
    for i in [0, 7] {
        let (p, q) = (pose(i).translation, pose(i).rotation);
        let pose = format!("{},{},{},{},{},{},{}", p.x, p.y, p.z, q.x, q.y, q.z, q.w);
        place.done(&format!("predict room.glb --sensor vlp-16 --pose={pose} --out one.exr"));
        let (one, many) =
            (files::read_exr(&place.path("one.exr")), files::read_exr(&place.path(&format!("all/{i:06}.exr"))));
        let (one, many) = (one.unwrap(), many.unwrap());
        assert_eq!(one.images.range.len(), 1800 * 16);
        assert!(one.images.range == many.images.range && one.images.polygon_id == many.images.polygon_id);
        assert_eq!(one.attributes, many.attributes);
    }
    // The second run has nothing left to do.
    assert!(place.done("batch room.glb --poses a.tum --sensor vlp-16 --out all").contains("already finished"));
}

#[test]
fn parts_make_the_whole() {
    let place = Place::new();
    let line = "batch room.glb --poses a.tum --sensor s.toml --likelihood run.jsonl#1 --outputs range";
    place.done(&format!("{line} --out all"));
    let whole = place.rows("all/poses.csv");
    assert!(whole.iter().all(|row| row[11].parse::<f64>().unwrap().is_finite()));
    for i in 1..=5 {
        place.done(&format!("{line} --out parts --shard {i}/5"));
    }
    let parts: Vec<_> = (1..=5).flat_map(|i| place.rows(&format!("parts/poses-{i}-of-5.csv"))).collect();
    assert_eq!(parts, whole);
    let images = |folder: &str| place.files(folder).into_iter().filter(|(name, _)| name.ends_with(".exr"));
    assert!(images("all").eq(images("parts")) && images("all").count() == POSES);
}

#[test]
fn each_heading_is_a_row_and_the_best_equals_the_single_result() {
    let place = Place::new();
    let line = "batch room.glb --poses a.tum --sensor s.toml --likelihood run.jsonl#0 --out";
    place.done(&format!("{line} turned --headings 72 --cell-deg 0"));
    let turned = place.rows("turned/poses.csv");
    assert_eq!(turned.len(), 72 * POSES);
    assert_eq!((turned[73][0].as_str(), turned[73][10].as_str()), ("1", "5"));
    // A single-pose batch at the pose in that row gives the same weight.
    let row = &turned[3 * 72 + 17];
    place.write("one.tum", &format!("0 {}\n", row[2..9].join(" ")));
    place.done(&line.replace("a.tum", "one.tum").replace("--out", "--out one"));
    let one: f64 = place.rows("one/poses.csv")[0][11].parse().unwrap();
    let heading: f64 = row[11].parse().unwrap();
    assert!((one - heading).abs() < 1e-5 * 361.0, "{one} {heading}");
}

#[test]
fn a_killed_batch_resumes() {
    let place = Place::new();
    place.write("a.tum", &tum(400));
    let line = "batch room.glb --poses a.tum --sensor laser-range-camera --outputs range --out";
    place.done(&format!("{line} whole"));
    let mut child = place.command(&format!("{line} killed")).spawn().unwrap();
    let start = Instant::now();
    while !place.path("killed/000050.exr").exists() && start.elapsed() < Duration::from_secs(60) {
        assert!(child.try_wait().unwrap().is_none(), "the batch ended before it was killed");
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(!place.path("killed/poses.csv").exists() && place.path("killed/poses.csv.part").exists());
    // Loses one image more, and cuts the table in the middle of a row.
    let part = std::fs::read_to_string(place.path("killed/poses.csv.part")).unwrap();
    assert!(part.lines().count() > 20, "{part}");
    std::fs::remove_file(place.path("killed/000017.exr")).unwrap();
    let said = place.done(&format!("{line} killed"));
    assert!(said.contains("17 of 400 poses are already finished"), "{said}");
    let (killed, whole) = (place.files("killed"), place.files("whole"));
    let names = |files: &BTreeMap<String, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
    assert!(names(&killed) == names(&whole), "{:?}", names(&killed));
    let other: Vec<_> = whole.iter().filter(|(name, bytes)| killed[*name] != **bytes).map(|(name, _)| name).collect();
    assert!(other.is_empty(), "{other:?}");
}

/// A limit on the file size makes writing the table fail as on a full disk.
#[cfg(unix)]
#[test]
fn a_batch_resumes_after_a_full_disk() {
    let place = Place::new();
    place.write("a.tum", &tum(400));
    let line = "batch room.glb --poses a.tum --sensor s.toml --likelihood run.jsonl#0 --out";
    place.done(&format!("{line} whole"));
    let command = place.command(&format!("{line} full"));
    let mut limited = Command::new("bash");
    limited.args(["-c", "ulimit -f 16 && exec \"$@\"", "bash"]).arg(command.get_program()).args(command.get_args());
    let output = limited.current_dir(place.0.path()).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && said.contains("poses.csv.part"), "{said}");
    assert_eq!(said.lines().filter(|line| !line.starts_with("note: ")).count(), 1, "{said}");
    assert!(!place.path("full/poses.csv").exists());
    let said = place.done(&format!("{line} full"));
    assert!(said.contains("are already finished"), "{said}");
    assert!(place.files("full") == place.files("whole"));
}

#[test]
fn a_different_batch_in_the_same_folder_is_refused() {
    let place = Place::new();
    let line = "batch room.glb --poses a.tum --sensor s.toml --likelihood run.jsonl#0 --out all";
    place.done(line);
    let before = place.files("all");
    place.fails(&line.replace("#0", "#1"), 1, "another measured image");
    place.fails(&format!("{line} --cell-m 0.5"), 1, "other flags");
    place.fails(&format!("{line} --pose-of robot"), 1, "other flags");
    let mut on_gpu = Command::new(cargo_bin("presight"));
    on_gpu.current_dir(place.0.path()).args(line.split_whitespace()).args(["--backend", "gpu"]);
    let said = String::from_utf8(on_gpu.output().unwrap().stderr).unwrap();
    assert!(said.contains("batch.json: this batch began with another --backend"), "{said}");
    place.write("a.tum", &tum(POSES + 1));
    place.fails(line, 1, "other poses");
    place.write("a.tum", &tum(POSES));
    let toml = std::fs::read_to_string(place.path("s.toml")).unwrap();
    place.write("s.toml", &toml.replace("0.05", "0.06"));
    place.fails(line, 1, "another sensor");
    place.write("s.toml", &toml);
    files::write_glb(&place.path("room.glb"), &scenes::room(5, 20)).unwrap();
    place.fails(line, 1, "the scene has changed");
    assert!(place.files("all") == before);
    place.write("all/batch.json", "{");
    place.fails(line, 1, "not a valid record of a batch");
}

#[test]
fn errors_are_reported_before_anything_is_written() {
    let place = Place::new();
    let line = "batch room.glb --poses a.tum --sensor s.toml --out all";
    let weigh = format!("{line} --likelihood run.jsonl#0");
    let good = tum(3);
    let poses = [
        ("", "the file has no poses"),
        ("# none\n\n", "the file has no poses"),
        ("0 1 2", "line 1"),
        ("NaN 0 0 0 0 0 0 1\n", "line 1"),
        ("0 0 0 inf 0 0 0 1\n", "line 1"),
        ("0 0 0 0 0 0 0 0\n", "line 1"),
    ];
    for (text, what) in poses {
        place.write("b.tum", text);
        place.fails(&line.replace("a.tum", "b.tum"), 1, what);
        place.write("b.tum", &format!("{good}{text}"));
        if !text.is_empty() && !text.starts_with('#') {
            place.fails(&line.replace("a.tum", "b.tum"), 1, "line 5");
        }
    }
    place.fails(&line.replace("a.tum", "none.tum"), 1, "none.tum");
    place.fails(&weigh.replace("#0", "#2"), 2, "there is no frame 2: the log has 2");
    place.fails(&weigh.replace("run.jsonl#0", "run.jsonl"), 1, "run.jsonl");
    let silent = scanner().spec().clone().with_noise(Noise::default());
    place.write("silent.toml", &files::sensor_to_toml(&silent));
    place.fails(&weigh.replace("s.toml", "silent.toml"), 1, "noise of ranges");
    place.fails(&weigh.replace("s.toml", "vlp-16"), 1, "rays of the log's sensor differ");
    place.fails(&format!("{weigh} --headings 16385"), 2, "16385 headings");
    place.fails(&format!("{weigh} --headings 360 --pose-of robot"), 2, "--headings");
    place.fails(&format!("{weigh} --cell-m=-1"), 1, "pose cell");
    place.write("b.tum", &format!("{good}9 0 0 1 0 0.1 0 1\n"));
    place.fails(&format!("{} --headings 360", weigh.replace("a.tum", "b.tum")), 2, "b.tum: pose 3: all headings");
    place.fails(&format!("{line} --outputs depth_z"), 2, "not a camera");
    place.fails(&format!("{line} --outputs feature_id"), 2, "no features");
    for shard in ["0/3", "4/3", "1", "a/b"] {
        place.fails(&format!("{line} --shard {shard}"), 2, "--shard");
    }
    place.done("predict room.glb --sensor vlp-16 --pose 0,0,1,0,0,0 --out small.exr --outputs range");
    place.fails(&line.replace("--out", "--likelihood small.exr --out"), 1, "28800 measured values");
    place.done("predict room.glb --sensor s.toml --pose 0,0,1,0,0,0 --out ids.exr --outputs object_id");
    place.fails(&line.replace("--out", "--likelihood ids.exr --out"), 1, "no range image");
    assert!(!place.path("all").exists());
    std::fs::create_dir(place.path("all")).unwrap();
    std::fs::rename(place.path("small.exr"), place.path("all/000003.exr")).unwrap();
    let own = "batch room.glb --poses a.tum --sensor s.toml --out all --likelihood all/000003.exr";
    place.fails(&own.replace("s.toml", "t.toml"), 1, "t.toml");
    place.done("predict room.glb --sensor s.toml --pose 0,0,1,0,0,0 --out all/000003.exr --outputs range");
    place.fails(own, 2, "would overwrite");
}
