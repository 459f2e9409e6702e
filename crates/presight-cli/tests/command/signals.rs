//! Signals and the file-size limit: no half-written file stays.

use super::{Place, VIEW};
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

/// Images that are large enough for a signal to arrive while they are written.
const LARGE: &str =
    "format = 1\nkind = \"camera\"\nwidth = 5000\nheight = 4000\nfx = 2500.0\nfy = 2500.0\ncx = 2499.5\ncy = 1999.5\n";

fn start(place: &Place, line: &str) -> Child {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin("presight"));
    command.current_dir(place.folder.path()).args(line.split_whitespace());
    command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

/// Returns true if SIGINT is ignored, as shells arrange for commands in a script's background.
pub fn interrupts_pass() -> bool {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 2 != 0)
}

fn parts(place: &Place) -> Vec<String> {
    place.names().into_iter().filter(|name| name.ends_with(".part")).collect()
}

/// Waits for a temporary file, then sends the signal. Returns false if the command ended before.
fn interrupt(place: &Place, child: &mut Child, signal: &str) -> bool {
    let start = Instant::now();
    while parts(place).is_empty() {
        assert!(start.elapsed() < Duration::from_secs(120), "nothing is written");
        if child.try_wait().unwrap().is_some() {
            return false;
        }
    }
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
    true
}

/// How often an interrupt must hit while a file is written. On a busy machine a signal may come too late.
const HITS: usize = 4;
const TRIES: usize = 60;

fn ends_by(place: &Place, line: &str, signal: &str, number: i32) {
    let mut hits = 0;
    for _ in 0..TRIES {
        if hits == HITS {
            break;
        }
        let mut child = start(place, line);
        interrupt(place, &mut child, signal);
        let ended = child.wait_with_output().unwrap();
        assert_eq!(parts(place), [""; 0], "{line}");
        match ended.status.signal() {
            Some(by) => {
                assert_eq!(by, number, "{line}");
                assert_eq!(String::from_utf8(ended.stderr).unwrap(), "", "{line}");
                hits += 1;
            }
            None => assert!(ended.status.success(), "{line}"),
        }
        for made in place.names().iter().filter(|name| name.starts_with("out")) {
            fs::remove_file(place.path(made)).unwrap();
        }
    }
    assert!(hits > 0, "{line}: never interrupted");
}

#[test]
fn an_interrupt_leaves_nothing_half_written() {
    let place = Place::new();
    place.write("large.toml", LARGE.as_bytes());
    let line = "predict wall.glb --sensor large.toml --pose 0,0,1,0,0,0 --backend cpu --outputs range --out out.exr --png out.png";
    if !interrupts_pass() {
        ends_by(&place, line, "-INT", 2);
    }
    ends_by(&place, line, "-TERM", 15);
}

#[cfg(feature = "store")]
#[test]
fn an_interrupt_leaves_no_half_a_store() {
    let place = Place::new();
    fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb"), place.path("room.glb")).unwrap();
    ends_by(&place, "env create out.presight room.glb", "-TERM", 15);
}

/// Shells start background commands with SIGINT ignored.
#[cfg(target_os = "linux")]
#[test]
fn an_ignored_interrupt_stays_ignored() {
    let place = Place::new();
    place.write("large.toml", LARGE.as_bytes());
    let line = "predict wall.glb --sensor large.toml --pose 0,0,1,0,0,0 --backend cpu --outputs range --out out.exr";
    let mut shell = Command::new("sh");
    shell.current_dir(place.folder.path()).args(["-c", "trap '' INT; exec \"$@\"", "sh"]);
    shell.arg(assert_cmd::cargo::cargo_bin("presight")).args(line.split_whitespace());
    let mut child = shell.spawn().unwrap();
    assert!(interrupt(&place, &mut child, "-INT"));
    assert!(child.wait().unwrap().success());
    assert_eq!((parts(&place), place.path("out.exr").exists()), (vec![], true));
}

/// The system sends SIGXFSZ beyond `ulimit -f`.
#[test]
fn a_file_beyond_the_size_limit_is_an_error() {
    let place = Place::new();
    place.write("large.toml", LARGE.as_bytes());
    fs::copy(concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb"), place.path("room.glb")).unwrap();
    let large = "predict wall.glb --sensor large.toml --pose 0,0,1,0,0,0 --backend cpu --outputs range,depth_z";
    let mut lines = vec![
        format!("{large} --out out.exr"),
        format!("{large} --depth-png out.png"),
        format!("{large} --points out.ply"),
        format!("{large} --points out.pcd"),
        "features room.glb --class video --out out.json".to_owned(),
    ];
    if cfg!(feature = "store") {
        lines.push("env create out.presight room.glb".to_owned());
    }
    let before = place.names();
    for line in lines {
        let mut shell = Command::new("sh");
        shell.current_dir(place.folder.path()).args(["-c", "ulimit -f 8; exec \"$@\"", "sh"]);
        let ended = shell.arg(assert_cmd::cargo::cargo_bin("presight")).args(line.split_whitespace()).output().unwrap();
        let stderr = String::from_utf8(ended.stderr).unwrap();
        assert_eq!(ended.status.code(), Some(4), "{line}: {stderr} {}", ended.status);
        assert_eq!(stderr.lines().filter(|l| l.starts_with("error: out.")).count(), 1, "{line}: {stderr}");
        assert!(!stderr.contains(".part"), "{line}: {stderr}");
        assert_eq!(place.names(), before, "{line}");
    }
}

#[test]
fn leftovers_of_a_killed_command_are_removed_by_the_next() {
    let place = Place::new();
    let (old, young, other) = (".presight-killed.part", ".presight-young0.part", "presight-killed.part");
    for name in [old, young, other] {
        place.write(name, b"half");
    }
    let aged = |name: &str| {
        let file = fs::File::options().write(true).open(place.path(name)).unwrap();
        file.set_modified(SystemTime::now() - Duration::from_secs(100)).unwrap();
    };
    aged(old);
    aged(other);
    place.done(&format!("predict wall.glb {VIEW} --out a.exr"));
    assert_eq!(place.names(), [young, "a.exr", other, "wall.glb"]);
}
