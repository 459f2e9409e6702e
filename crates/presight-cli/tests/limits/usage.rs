//! Arguments and variables that no system could fulfil.

use assert_cmd::Command;
use std::ffi::OsStr;
use std::time::Duration;

const SCENE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb");

/// Checks that the command refuses at once, in one line and with this status. Returns the line.
fn refused(status: i32, threads: Option<&str>, args: &[&OsStr]) -> String {
    let mut command = Command::cargo_bin("presight").unwrap();
    command.args(args).env_remove("RAYON_NUM_THREADS").timeout(Duration::from_secs(20));
    command.envs(threads.map(|threads| ("RAYON_NUM_THREADS", threads)));
    let output = command.output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(status), "{args:?}: {said}");
    assert_eq!((said.lines().count(), output.stdout.as_slice()), (1, b"".as_slice()), "{args:?}: {said}");
    assert!(said.starts_with("error: "), "{args:?}: {said}");
    said
}

fn words(line: &str) -> Vec<&OsStr> {
    line.split(' ').map(|word| OsStr::new(if word == "SCENE" { SCENE } else { word })).collect()
}

const PREDICT: &str = "predict SCENE --sensor laser-scanner --pose 1,1,1,0,0,0 --backend cpu";

#[test]
fn too_many_threads_are_refused_at_once() {
    let cores = std::thread::available_parallelism().unwrap().get();
    let most = (2 * cores).max(64);
    for line in [PREDICT, "index SCENE --count 1 --repeat 1 --sensor laser-scanner"] {
        for count in [most + 1, 100_000] {
            let said = refused(2, None, &words(&format!("{line} --threads {count}")));
            assert!(said.contains(&format!("{count} threads")) && said.contains(&format!("at most {most}")), "{said}");
        }
    }
    let mut command = Command::cargo_bin("presight").unwrap();
    command.args(words(&format!("{PREDICT} --threads {most}"))).assert().success();
}

#[test]
fn the_variable_for_threads_is_checked_by_every_command_that_works_in_parallel() {
    let mut lines = vec![PREDICT, "inspect SCENE", "features SCENE --class video", "doctor"];
    lines.push("features pick SCENE --sensor laser-scanner --pose 1,1,1,0,0,0 --pixel 0,0");
    lines.push("index SCENE --count 1 --repeat 1 --sensor laser-scanner");
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out").display().to_string();
    let study = format!("report SCENE --quick --sensor laser-scanner --out {out}");
    if cfg!(feature = "report") {
        lines.push(&study);
    }
    for threads in ["100000", "many", "-1"] {
        for line in &lines {
            let said = refused(2, Some(threads), &words(line));
            assert!(said.contains(&format!("RAYON_NUM_THREADS={threads}")), "{line}: {said}");
        }
    }
    for threads in ["", "0", "2"] {
        let mut command = Command::cargo_bin("presight").unwrap();
        command.args(words("inspect SCENE")).env("RAYON_NUM_THREADS", threads).assert().success();
    }
}

/// Paths may be any bytes; other arguments must be UTF-8.
#[cfg(unix)]
#[test]
fn arguments_that_are_not_utf_8_are_refused() {
    use std::os::unix::ffi::OsStrExt;
    let odd = OsStr::from_bytes(b"\xff");
    let [scene, inspect, report] = [SCENE, "inspect", "report"].map(OsStr::new);
    refused(2, None, &[odd]);
    refused(2, None, &[odd, scene]);
    refused(1, None, &[inspect, odd]);
    let sensor = ["predict", SCENE, "--pose", "0,0,0,0,0,0", "--sensor"].map(OsStr::new);
    refused(2, None, &[&sensor[..], &[odd]].concat());
    if cfg!(feature = "report") {
        // The page of a study quotes the command line.
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join(odd);
        let args = ["--quick", "--sensor", "laser-scanner", "--out"].map(OsStr::new);
        let mut command = Command::cargo_bin("presight").unwrap();
        command.args([report, scene]).args(args).arg(&out).env("VK_DRIVER_FILES", "/nonexistent").assert().success();
        assert!(out.join("index.html").exists());
    }
}
