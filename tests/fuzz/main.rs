//! Runs the fuzz bodies on their corpora and on generated inputs.
//!
//! `PRESIGHT_FUZZ_SECONDS` sets the time of each target (default 1) and `PROPTEST_RNG_SEED` the seed of the inputs,
//! which is fixed by default. A failing input is written to a file, which the message names. `PRESIGHT_FUZZ_INPUT=FILE
//! cargo test --test fuzz TARGET` runs that one input again.

#![expect(clippy::print_stderr, reason = "the tests print how much was run")]

mod bodies;
use presight_testkit as common;
mod mutate;

use common::env_number;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

/// The longest time for one input on a busy machine; readers take less than a hundredth of it for the corpora's sizes.
const SLOW: Duration = Duration::from_secs(20);
/// The largest memory of the process, all targets together, in bytes: the same limit as for the command.
const MEMORY: u64 = 500_000_000;

/// The current input, for the guard and the message.
#[derive(Default)]
struct Running {
    input: Vec<u8>,
    since: Option<Instant>,
}

struct Target {
    name: &'static str,
    body: fn(&[u8]) -> bool,
    words: &'static [&'static str],
}

/// Writes a failing input to the build folder.
fn keep(name: &str, input: &[u8]) -> PathBuf {
    let hash = input.iter().fold(0xcbf2_9ce4_8422_2325_u64, |h, b| (h ^ u64::from(*b)).wrapping_mul(0x100_0000_01b3));
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("fuzz-{name}-{hash:016x}"));
    match std::fs::write(&path, input) {
        Ok(()) => path,
        Err(e) => panic!("{name}: cannot keep the input: {e}: {input:?}"),
    }
}

/// The resident memory of this process, where the system reports it.
fn resident() -> u64 {
    let pages = || std::fs::read_to_string("/proc/self/statm").ok()?.split(' ').nth(1)?.parse::<u64>().ok();
    pages().unwrap_or(0) * 4096
}

/// Ends the process at an input that takes too long or too much memory, because nothing else would stop it.
fn guard(name: &'static str, running: Arc<Mutex<Running>>, ended: Arc<AtomicBool>) {
    while !ended.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_millis(100));
        let now = running.lock().expect("nothing panics with the lock");
        let slow = now.since.is_some_and(|since| since.elapsed() > SLOW);
        if slow || resident() > MEMORY {
            let what = if slow { "takes too long" } else { "may be what takes too much memory" };
            eprintln!("{name}: the input {what}: {}", keep(name, &now.input).display());
            std::process::exit(101);
        }
    }
}

impl Target {
    fn corpus(&self) -> Vec<Vec<u8>> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus").join(self.name);
        let mut paths: Vec<PathBuf> = folder.read_dir().expect("a corpus").map(|e| e.expect("a file").path()).collect();
        paths.sort();
        paths.iter().map(|path| std::fs::read(path).expect("a readable file")).collect()
    }

    fn once(&self, input: &[u8], running: &Mutex<Running>) -> bool {
        {
            let mut running = running.lock().expect("nothing panics with the lock");
            running.input.clear();
            running.input.extend_from_slice(input);
            running.since = Some(Instant::now());
        }
        let sound = catch_unwind(AssertUnwindSafe(|| (self.body)(input))).unwrap_or_else(|panic| {
            eprintln!("{}: the input at fault: {}", self.name, keep(self.name, input).display());
            resume_unwind(panic)
        });
        running.lock().expect("nothing panics with the lock").since = None;
        sound
    }

    fn run(&self) {
        let running = Arc::new(Mutex::new(Running::default()));
        let ended = Arc::new(AtomicBool::new(false));
        if let Some(path) = std::env::var_os("PRESIGHT_FUZZ_INPUT") {
            self.once(&std::fs::read(path).expect("a readable file"), &running);
            return;
        }
        let (name, shared, end) = (self.name, running.clone(), ended.clone());
        let guard = std::thread::spawn(move || guard(name, shared, end));
        let corpus = self.corpus();
        let sound = corpus.iter().filter(|input| self.once(input, &running)).count();
        // A corpus that is accepted or refused as a whole tests little.
        assert!(sound > 0 && sound < corpus.len(), "{name}: {sound} of {} inputs are sound", corpus.len());
        let seconds = env_number("PRESIGHT_FUZZ_SECONDS", 1);
        let (start, mut made, mut accepted) = (Instant::now(), 0u64, 0u64);
        let mut mutator = mutate::Mutator::new(&corpus, self.words, env_number("PROPTEST_RNG_SEED", 1));
        let mut input = Vec::new();
        while start.elapsed() < Duration::from_secs(seconds) {
            mutator.next(&mut input);
            accepted += u64::from(self.once(&input, &running));
            made += 1;
        }
        eprintln!(
            "{name}: {} inputs of the corpus and {made} made of them in {seconds} s, {accepted} sound",
            corpus.len()
        );
        ended.store(true, Ordering::Relaxed);
        guard.join().expect("the guard");
    }
}

macro_rules! targets {
    ($($(#[$attribute:meta])* $name:ident: $words:expr;)*) => {
        $($(#[$attribute])* #[test]
        fn $name() {
            Target { name: stringify!($name), body: bodies::$name, words: $words }.run();
        })*
    };
}

targets! {
    gltf: &["\"mesh\"", "\"nodes\"", "\"children\"", "\"matrix\"", "\"extras\"", "\"sparse\"", "\"indices\"", "\"mode\"", "5126"];
    #[cfg(feature = "script")]
    script: &["for ", "while true {", "box(", "place(", "import(", "loop {", "range(", "fn f(", "turn(", "scale(", "PI()"];
    sensor_toml: &["format", "kind", "width", "angles_deg", "[noise]", "[mount]", "quaternion", "[distortion]", "file"];
    camera_info: &["%YAML:1.0\n", "!!opencv-matrix", "cam0:", "P:", "R:", "intrinsics", "resolution", "image_width", "K:", "D:", "data", "---", "&a", "*a", "binning_x", "roi", "<<", "!!", "|", ">", "- "];
    ouster: &["\"beam_altitude_angles\"", "\"beam_intrinsics\"", "\"pixel_shift_by_row\"", "\"column_window\"", "\"512x10\"", "\"lidar_to_sensor_transform\"", "1e308", "null", "[]", "-1"];
    velodyne: &["lasers:\n", "laser_id: 0", "rot_correction", "vert_offset_correction", "num_lasers: 16", ".nan", ".inf", "*a", "&a", "- {"];
    pattern: &["azimuth_deg", "elevation_deg", "time_s", "x,y,z", "\n", ",", "nan", "1e308", "-90", "#"];
    layer: &["features", "\"kind\"", "covariances", "cross_covariance", "\"remove\"", "\"object\"", "\"points\"", "tolerance"];
    #[cfg(feature = "store")]
    store: &["CREATE TABLE", "SQLite format 3\0", "objects"];
    #[cfg(feature = "store")]
    changes: &["\"op\"", "group", "delete_object", "insert_object", "move", "set_pose", "\"like\"", "covariance", "\"id\"", "set_group", "\"group\""];
    #[cfg(feature = "store")]
    edit: &["\n", "state {}", "undo {\"version\":2}", "null", "-1", "1e308", "[]", "{}", "\"id\":", "4294967295", "\"points\"", "\"version\":1", "insert_feature"];
    poses: &["-180", ",", " ", "1e308", "0,0,0,1"];
    trajectory: &["-180", "\n", " ", "1e308", "0 0 0 1", "#"];
    pose_covariance: &["0,0,0,0,0,0,", "1e-300"];
    corridor: &["polyline_in_robot", "half_width", "z_min", "[0,0]"];
    materials: &["[material.\"a\"]", "reflection", "classes", "world_from_scene", "one_sided", "transparent"];
    robot: &["[[sensors]]", "sensor", "mount", "eye.toml", "cam.yaml", "laser-scanner", "xyz", "rpy_deg"];
    cloud: &["property uint t\n", "property double timestamp\n", "FIELDS x y z t\n", "SIZE 4 4 4 8\n", "TYPE F F F U\n", "DATA binary\n", "1e9", "nan", "-0.1", "WIDTH 2\nHEIGHT 2\n"];
    log: &["\n", "null", "\"inf\"", "\"-inf\"", "{\"t\":2,\"range\":[1,2,3]}", "\"odometry\"", "\"reference\"", "\"times\":[0,0.1,0.2]", "\"twist\":[1,0,0,0,0,1]", "\"stamp\":\"last\"", "turn_s", "range_max", "1e308", "\"scans\"", "\"valid\""];
    #[cfg(feature = "ros")]
    messages: &["\0\x01\0\0", "\0\0\0\0", "\x01\0\0\0", "/laser\0", "odom\0", "base_link\0"];
    #[cfg(feature = "ros")]
    bag: &["MCAP0\r\n", "sensor_msgs/msg/LaserScan", "/tf", "cdr", "ros2msg", "zstd", "lz4", "topics", "messages"];
    exr: &["range\0", "polygon_id\0", "presight:format\0", "string\0", "channels\0", "dataWindow\0", "box2i\0", "tiledesc\0"];
    scenes: &[];
}
