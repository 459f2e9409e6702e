//! Many poses: the command against the library and against a command for each pose, and how fast arrays are written.
//!
//! ```sh
//! cargo bench -p presight-cli --bench poses [-- SCENE.glb]      # default: the hospital of the shared data
//! ```

#![expect(clippy::print_stdout, reason = "a bench reports")]

use presight::files;
use presight::predict::free_poses;
use presight::{Backend, Images, Options, Output, Outputs, Pose, Predictor, Request, Scene, SensorPose};
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

const POSES: usize = 1000;
/// Commands of one pose that are timed.
const SINGLE: usize = 20;
/// Turns of library and command, of which the fastest counts.
const TURNS: usize = 5;

fn main() {
    let given = std::env::args().skip(1).find(|arg| !arg.starts_with("--"));
    let root = std::env::var_os("PRESIGHT_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"), PathBuf::from);
    let scene = given.map_or_else(|| root.join("env/hospital.glb"), PathBuf::from);
    if !scene.exists() {
        println!("skipped: there is no {}", scene.display());
        return;
    }
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() }.expect("a folder");
    let world = Scene::open(&scene).unwrap_or_else(|e| panic!("{e}")).world;
    let poses = free_poses(&world, POSES, 1).unwrap_or_else(|e| panic!("{e}"));
    let trajectory = folder.path().join("drive.tum");
    std::fs::write(&trajectory, text(&poses)).expect("the trajectory is written");

    let (mut library, mut command) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..TURNS {
        library = library.min(by_library(&scene, &poses));
        let args = ["--poses".as_ref(), trajectory.as_os_str(), "--npy".as_ref(), "all.npy".as_ref()];
        command = command.min(by_command(&scene, folder.path(), &args));
    }
    let numbers = |pose: &Pose| {
        let (t, q) = (pose.translation, pose.rotation);
        format!("{},{},{},{},{},{},{}", t.x, t.y, t.z, q.x, q.y, q.z, q.w)
    };
    let one = |pose: &Pose| {
        let pose = format!("--pose={}", numbers(pose));
        by_command(&scene, folder.path(), &[pose.as_ref(), "--npy".as_ref(), "one.npy".as_ref()])
    };
    let single = poses.iter().take(SINGLE).map(one).sum::<f64>() / SINGLE as f64 * POSES as f64;
    println!("{POSES} poses of vlp-16 in {}, seconds, opening the scene included", scene.display());
    println!("library                  {library:8.2}");
    println!("one command              {command:8.2}  {:.3} of the library's rate", library / command);
    println!("a command for each pose  {single:8.2}  {:.1} times as long", single / command);
    arrays(folder.path());
}

fn text(poses: &[Pose]) -> String {
    let mut text = String::new();
    for (i, Pose { translation: t, rotation: q }) in poses.iter().enumerate() {
        let _ = writeln!(text, "{i} {} {} {} {} {} {} {}", t.x, t.y, t.z, q.x, q.y, q.z, q.w);
    }
    text
}

/// Opens the scene and predicts; nothing is written.
fn by_library(scene: &Path, poses: &[Pose]) -> f64 {
    let start = Instant::now();
    let predict = || -> presight::Result<()> {
        let world = Scene::open(scene)?.world;
        let sensor = presight::preset("vlp-16")?;
        let mut predictor = Predictor::new(Options::new(Backend::Cpu))?;
        let request = Request::of(Outputs::of(&[Output::Range]));
        let mut prediction = predictor.predict(&world, &sensor, &SensorPose::new(poses[0]), &request)?;
        poses[1..].iter().try_for_each(|pose| predictor.predict_again(&world, &SensorPose::new(*pose), &mut prediction))
    };
    predict().unwrap_or_else(|e| panic!("{e}"));
    start.elapsed().as_secs_f64()
}

fn by_command(scene: &Path, folder: &Path, args: &[&std::ffi::OsStr]) -> f64 {
    let start = Instant::now();
    let mut command = Command::new(env!("CARGO_BIN_EXE_presight"));
    command.arg("predict").arg(scene).args(["--sensor", "vlp-16", "--backend", "cpu", "--outputs", "range"]).args(args);
    assert!(command.current_dir(folder).status().expect("presight runs").success());
    start.elapsed().as_secs_f64()
}

/// Writes large arrays, and the small ones of a scanner.
fn arrays(folder: &Path) {
    for (count, rows, columns) in [(8, 4096, 8192), (2000, 16, 1800)] {
        let mut images = Images::default();
        (images.width, images.height) = (columns, rows);
        images.range = (0..rows * columns).map(|i| i as f32).collect();
        let start = Instant::now();
        for i in 0..count {
            let path = folder.join(format!("{}.npy", i % 4));
            files::write_npy(&path, &images, Output::Range).unwrap_or_else(|e| panic!("{e}"));
        }
        let bytes = 4 * u64::from(count * rows) * u64::from(columns);
        let rate = bytes as f64 / 1e6 / start.elapsed().as_secs_f64();
        println!("{count} arrays of {rows} x {columns} f32: {rate:.0} MB/s");
    }
}
