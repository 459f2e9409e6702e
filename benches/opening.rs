//! Opens the stored hospital as a command does, once in a process, and compares that with its indispensable parts:
//! reading the file's bytes, and building the index. Processes take turns; each measures one of the three with its
//! threads started before. The bench `store` measures the same in a loop, with warm caches and memory.
#![expect(clippy::print_stdout, reason = "a bench prints its figures")]

use presight_model::index::{IndexKind, WorldIndex};
use presight_model::threads::Threads;
use presight_store as store;
use presight_store::Note;
use std::error::Error;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

const TURNS: usize = 60;
const MODES: [&str; 3] = ["bytes", "index", "open"];

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    if let [_, child, mode, path] = &arguments[..]
        && child == "--child"
    {
        println!("{}", once(mode, Path::new(path))?);
        return Ok(());
    }
    let root = std::env::var_os("PRESIGHT_DATA")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    let scene = root.join("env/hospital.glb");
    if !scene.exists() {
        println!("skipped: there is no {}", scene.display());
        return Ok(());
    }
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR"))?;
    let path = folder.path().join("hospital.presight");
    let environment = presight_read::gltf::import(scene, &Default::default())?.environment;
    store::create(&path, &environment, &Note::new("bench", 0.0))?;
    let mut times = MODES.map(|_| Vec::with_capacity(TURNS));
    for _ in 0..TURNS {
        for (mode, times) in MODES.iter().zip(&mut times) {
            let output = Command::new(std::env::current_exe()?).args(["--child", mode]).arg(&path).output()?;
            if !output.status.success() {
                return Err(String::from_utf8_lossy(&output.stderr).into_owned().into());
            }
            times.push(String::from_utf8(output.stdout)?.trim().parse::<f64>()?);
        }
    }
    let medians = times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        (times[TURNS / 4], times[TURNS / 2], times[3 * TURNS / 4])
    });
    for (mode, (low, median, high)) in MODES.iter().zip(medians) {
        println!("{mode}: median {median:.2} ms, quartiles {low:.2} and {high:.2}");
    }
    let [bytes, index, open] = medians.map(|m| m.1);
    println!("open / (bytes + index): {:.2}", open / (bytes + index));
    Ok(())
}

/// The milliseconds of one of the three.
fn once(mode: &str, path: &Path) -> Result<f64, Box<dyn Error>> {
    Threads::SHARED.run(|| rayon::broadcast(|_| ())).expect("threads");
    let kind = IndexKind::default();
    match mode {
        "bytes" => timed(|| Ok(std::fs::read(path)?)),
        "index" => {
            let environment = store::read(path)?;
            timed(|| Ok(WorldIndex::new(&environment, &kind)))
        }
        _ => timed(|| Ok(store::read_world(path, &kind)?)),
    }
}

/// The time to drop the result is excluded.
fn timed<T>(make: impl FnOnce() -> Result<T, Box<dyn Error>>) -> Result<f64, Box<dyn Error>> {
    let start = Instant::now();
    let made = black_box(make()?);
    let time = start.elapsed();
    drop(made);
    Ok(1e3 * time.as_secs_f64())
}
