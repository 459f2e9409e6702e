//! Every command with its inputs and its outputs.

use super::process::{Ended, Limits, open_folder, run};
use presight::files;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::time::Duration;

/// A command line. `IN` is the folder of inputs. Outputs are named relative to the working folder.
pub struct Row {
    pub line: &'static str,
    /// The text for its stdin.
    pub input: &'static str,
    /// The files that it writes.
    pub outputs: &'static [&'static str],
    /// True if it works on a copy of the store `hall.presight`.
    pub on_store: bool,
}

const fn row(line: &'static str, outputs: &'static [&'static str]) -> Row {
    Row { line, input: "", outputs, on_store: false }
}

const fn on_store(line: &'static str, input: &'static str, outputs: &'static [&'static str]) -> Row {
    Row { line, input, outputs, on_store: true }
}

const VIEW: &str = "--sensor IN/small.toml --pose 0,0,1.2,0,5,20 --backend cpu";

const CHANGES: &str = r#"{"op":"move","object":"table","pose":[1,1,0,0,0,30]}
{"op":"move","object":"table","pose":[1,1,0,0,0,40],"id":"again"}
{"op":"move","object":"post","pose":[2,1,0,0,0,50]}
"#;

/// Every command; `VIEW` is replaced by a small camera at a pose.
pub const ROWS: &[Row] = &[
    row(
        "predict IN/hall.glb VIEW --out a.exr --png a.png --depth-png d.png --points a.ply --stats s.json \
         --layer IN/hall.layer.json --features f.json",
        &["a.exr", "a.png", "d.png", "a.ply", "s.json", "f.json"],
    ),
    row("predict IN/hall.rhai VIEW --out a.exr --points a.pcd --index s3d --threads 2", &["a.exr", "a.pcd"]),
    row("predict IN/hall.presight VIEW --virtual free-floor --features f.json --png a.png", &["f.json", "a.png"]),
    row("predict IN/hall.glb VIEW --explain", &[]),
    row(
        "predict IN/hall.glb --sensor IN/small.toml --poses IN/drive.tum --backend cpu --outputs range --out {i}.exr --npy r.npy",
        &["0.exr", "1.exr", "r.npy"],
    ),
    row("inspect IN/hall.glb --json", &[]),
    row("sensors", &[]),
    row("index IN/hall.glb --count 1 --repeat 1 --sensor IN/small.toml --out study", &["study/index.csv"]),
    row("compare IN/a.exr IN/a.exr --scene IN/hall.glb --json verdict.json", &["verdict.json"]),
    row("features IN/hall.glb --class video --out l.layer.json", &["l.layer.json"]),
    row("features pick IN/hall.rhai --sensor IN/small.toml --pose 0,0,1.2,0,5,20 --pixel 80,60", &[]),
    row("features schema", &[]),
    row("doctor", &[]),
    row("env create new.presight IN/hall.rhai", &["new.presight"]),
    on_store("env import hall.presight IN/hall.layer.json", "", &[]),
    on_store("env apply hall.presight -", CHANGES, &[]),
    on_store("env export hall.presight out", "", &["out/scene.glb", "out/video.layer.json"]),
    on_store("env undo hall.presight 3", "", &[]),
    on_store("env info hall.presight --json", "", &[]),
    on_store("env log hall.presight", "", &[]),
    on_store("env check hall.presight", "", &[]),
];

/// A command that writes for long enough to be interrupted meanwhile.
pub const LONG: &[Row] = &[row(
    "predict IN/hall.glb --sensor IN/wide.toml --pose 0,0,1.2,0,5,20 --backend cpu --out a.exr --png a.png --depth-png d.png \
     --points a.ply",
    &["a.exr", "a.png", "d.png", "a.ply"],
)];

/// A command that takes seconds and is therefore run less often.
pub const STUDIES: &[Row] = &[row(
    "report IN/hall.glb --quick --sensor IN/tiny.toml --out study",
    &["study/index.html", "study/work_precision.csv", "study/approximations.csv", "study/report.json"],
)];

/// A command that cannot finish within the test.
pub const ENDLESS: &[Row] =
    &[row("report --stability --quick --out study", &["study/index.html", "study/stability.csv", "study/report.json"])];

/// Commands that load a graphics driver.
pub const FOREIGN: &[Row] = &[
    row("predict IN/hall.glb --sensor IN/small.toml --pose 0,0,1.2,0,5,20 --out a.exr", &["a.exr"]),
    row(
        "predict IN/hall.glb --sensor IN/small.toml --pose 0,0,1.2,0,5,20 --backend gpu --out a.exr --layer \
         IN/hall.layer.json --features f.json",
        &["a.exr", "f.json"],
    ),
    row("doctor", &[]),
];

/// Commands that need more memory than the limit allows.
pub const LARGE: &[Row] = &[
    row("predict IN/hall.glb --sensor IN/large.toml --pose 0,0,1,0,0,0 --backend cpu --out a.exr", &["a.exr"]),
    row("predict IN/hall.glb --sensor IN/large.toml --pose 0,0,1,0,0,0 --backend cpu --png a.png", &["a.png"]),
    row("predict IN/hall.glb --sensor IN/large.toml --pose 0,0,1,0,0,0 --backend cpu --points a.ply", &["a.ply"]),
    row("compare IN/large.exr IN/large.exr --json verdict.json", &["verdict.json"]),
    row("inspect IN/balls.rhai", &[]),
    row("env create new.presight IN/balls.rhai", &["new.presight"]),
    row("features IN/balls.rhai --class video --out l.layer.json", &["l.layer.json"]),
];

const HALL: &str = r#"
    material("steel", #{ reflection: 0.6 });
    place("floor", box(10, 10, 0.1).made_of("steel"), pose(0, 0, -0.1));
    place("walls/east", box(0.2, 10, 3), pose(5, 0, 0));
    place("walls/north", box(10, 0.2, 3), pose(0, 5, 0));
    place("table", box(1, 2, 0.8).point("video", [0.5, 0, 0.8], #{ name: "spot" }), pose(2, 1, 0));
    place("post", cylinder(0.1, 2, 24), pose(3, -1, 0));
    "#;

const BALLS: &str = r#"
    for i in 1..5 { place("ball", sphere(i, 1024), pose(10 * i, 0, 0)); }
    "#;

fn camera(width: u32, height: u32, focal: f64) -> String {
    let (cx, cy) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
    format!(
        "format = 1\nkind = \"camera\"\nname = \"camera\"\nclass = \"video\"\nwidth = {width}\nheight = {height}\n\
         fx = {focal:.1}\nfy = {focal:.1}\ncx = {cx:.1}\ncy = {cy:.1}\n"
    )
}

/// The inputs of the commands, and each command's output without limits.
pub struct Pantry {
    folder: tempfile::TempDir,
    pub usual: BTreeMap<&'static str, Usual>,
}

/// The result of an unlimited run.
pub struct Usual {
    pub ended: Ended,
    pub files: BTreeMap<String, Vec<u8>>,
}

impl Pantry {
    /// Prepares the inputs at the first call.
    pub fn get() -> &'static Self {
        static PANTRY: OnceLock<Pantry> = OnceLock::new();
        PANTRY.get_or_init(Self::new)
    }

    fn new() -> Self {
        let mut pantry = Self { folder: open_folder(), usual: BTreeMap::new() };
        let write = |name: &str, text: &str| fs::write(pantry.folder.path().join(name), text).unwrap();
        write("hall.rhai", HALL);
        write("balls.rhai", BALLS);
        write("changes.jsonl", CHANGES);
        write("small.toml", &camera(160, 120, 80.0));
        write("drive.tum", "0 0 0 1.2 0 0 0 1\n1 0.1 0 1.2 0 0 0 1\n");
        write("tiny.toml", &camera(32, 24, 16.0));
        write("wide.toml", &camera(1024, 1024, 512.0));
        write("large.toml", &camera(16_384, 4096, 4096.0));
        for line in [
            "env create IN/hall.presight IN/hall.rhai",
            "env apply IN/hall.presight IN/changes.jsonl",
            "env export IN/hall.presight IN/hall.glb",
            "features IN/hall.glb --class video --min-length 1 --out IN/hall.layer.json",
            "predict IN/hall.glb VIEW --out IN/a.exr",
        ] {
            // Runs as the current user, so that the folder keeps its owner.
            let args = pantry.args(line);
            let made = std::process::Command::new(env!("CARGO_BIN_EXE_presight")).args(args).output().unwrap();
            assert!(made.status.success(), "{line}: {}", String::from_utf8_lossy(&made.stderr));
        }
        for row in ROWS.iter().chain(LONG).chain(STUDIES) {
            let folder = pantry.folder_for(row);
            let ended = pantry.run(row, folder.path(), &Limits::default());
            assert_eq!(ended.status, Some(0), "{}: {}", row.line, ended.stderr);
            pantry.usual.insert(row.line, Usual { ended, files: files(folder.path()) });
        }
        pantry
    }

    /// Makes images that are large in memory and small on the disk, at the first call.
    pub fn make_large(&self) {
        let mut images = presight::Images::default();
        let range = presight::Outputs::of(&[presight::Output::Range]);
        images.prepare(16_384, 4096, range);
        files::write_exr(&self.folder.path().join("large.exr"), &images, range, &files::ExrAttributes::default())
            .unwrap();
    }

    fn args(&self, line: &str) -> Vec<String> {
        let path = self.folder.path().display().to_string();
        let line = line.replace("VIEW", VIEW).replace("IN/", &format!("{path}/"));
        line.split_whitespace().map(str::to_owned).collect()
    }

    /// Makes a folder for a row to run in.
    pub fn folder_for(&self, row: &Row) -> tempfile::TempDir {
        let folder = open_folder();
        self.fill(row, folder.path());
        folder
    }

    /// Copies the files that the row changes into the folder.
    pub fn fill(&self, row: &Row, folder: &Path) {
        if row.on_store {
            fs::copy(self.folder.path().join("hall.presight"), folder.join("hall.presight")).unwrap();
        }
    }

    pub fn run(&self, row: &Row, folder: &Path, limits: &Limits) -> Ended {
        run(folder, &self.args(row.line), row.input, limits)
    }

    /// The usual duration of a row.
    pub fn time(&self, row: &Row) -> Duration {
        self.usual.get(row.line).map_or(Duration::from_secs(1), |usual| usual.ended.time)
    }
}

pub fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut all = BTreeMap::new();
    let mut folders = vec![PathBuf::new()];
    while let Some(below) = folders.pop() {
        for entry in fs::read_dir(folder.join(&below)).unwrap() {
            let name = below.join(entry.unwrap().file_name());
            let path = folder.join(&name);
            if path.is_dir() {
                folders.push(name);
            } else {
                all.insert(name.display().to_string(), fs::read(path).unwrap());
            }
        }
    }
    all
}
