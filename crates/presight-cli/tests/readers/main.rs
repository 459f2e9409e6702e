//! Reads our files with the libraries that users have: NumPy, OpenEXR, Open3D, trimesh, a reader of PCL's
//! format, and two of ROS 2 bags.
#![cfg(unix)]

#[cfg(feature = "ros")]
mod bags;
mod clouds;
mod guides;
mod upright;

use assert_cmd::cargo::CommandCargoExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;

/// The Python interpreter of an environment with the packages of `requirements.txt`, created once, or the interpreter
/// that `PRESIGHT_PYTHON` names. `None`, counted as a skipped test, if the environment cannot be created.
fn python() -> Option<&'static Path> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let made = PYTHON.get_or_init(|| match std::env::var_os("PRESIGHT_PYTHON") {
        Some(path) => Ok(path.into()),
        None => environment(),
    });
    match made {
        Ok(path) => Some(path),
        Err(why) => {
            presight_testkit::skip::skip(why);
            None
        }
    }
}

fn environment() -> Result<PathBuf, String> {
    let list = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers/requirements.txt");
    let text = std::fs::read_to_string(&list).map_err(|e| e.to_string())?;
    let venv = Path::new(env!("CARGO_TARGET_TMPDIR")).join("readers");
    let (python, ready) = (venv.join("bin/python"), venv.join("ready"));
    if std::fs::read_to_string(&ready).is_ok_and(|made| made == text) {
        return Ok(python);
    }
    let does = |what: &str, command: &mut Command| match command.output() {
        Ok(output) if output.status.success() => Ok(()),
        Ok(output) => {
            let said = String::from_utf8_lossy(&output.stderr).trim().lines().last().unwrap_or_default().to_owned();
            Err(format!("Python {what}: {said}"))
        }
        Err(e) => Err(format!("there is no python3: {e}")),
    };
    does("cannot make an environment", Command::new("python3").args(["-m", "venv"]).arg(&venv))?;
    let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r"];
    does("cannot install the packages that read our files", Command::new(&python).args(pip).arg(&list))?;
    let load = ["-c", "import numpy, open3d, OpenEXR, pypcd4, trimesh, rosbags, mcap_ros2"];
    does("cannot load them (apt-get install libusb-1.0-0 libgomp1)", Command::new(&python).args(load))?;
    std::fs::write(&ready, text).map_err(|e| e.to_string())?;
    Ok(python)
}

/// A folder for commands and for the scripts of `tests/readers`.
struct Place {
    folder: tempfile::TempDir,
}

impl Place {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Runs presight. Arguments are separated by spaces; SCENES is replaced by the folder of the scenes.
    fn presight(&self, line: &str) -> Output {
        let scenes = concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes");
        let mut command = Command::cargo_bin("presight").unwrap();
        command
            .current_dir(self.folder.path())
            .args(line.split_whitespace().map(|word| word.replace("SCENES", scenes)));
        command.output().unwrap()
    }

    /// Runs a command line that must succeed with an empty stderr, and returns its stdout.
    fn done(&self, line: &str) -> String {
        let output = self.presight(line);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.is_empty(), "{line}: {said}");
        String::from_utf8(output.stdout).unwrap()
    }

    /// Runs a script of `tests/readers`.
    fn script(&self, python: &Path, name: &str, args: &[&str]) -> Output {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/readers").join(name);
        Command::new(python).arg(script).args(args).current_dir(self.folder.path()).output().unwrap()
    }

    /// Runs a script whose assertions must hold.
    fn holds(&self, python: &Path, name: &str, args: &[&str]) {
        let output = self.script(python, name, args);
        let all = [output.stdout, output.stderr].concat();
        assert!(output.status.success(), "{name} {args:?}: {}", String::from_utf8_lossy(&all));
        // Open3D warns on stdout about content that it skips.
        assert!(!String::from_utf8_lossy(&all).contains("WARNING"), "{name}: {}", String::from_utf8_lossy(&all));
    }

    /// Runs a script that must fail by an assertion.
    fn fails(&self, python: &Path, name: &str, args: &[&str]) {
        let output = self.script(python, name, args);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success() && said.contains("AssertionError"), "{name} {args:?} found nothing: {said}");
    }

    /// Changes the byte at this distance from the file's end.
    fn spoil(&self, name: &str, before_end: usize) {
        let mut bytes = std::fs::read(self.path(name)).unwrap();
        let at = bytes.len() - before_end;
        bytes[at] ^= 0x40;
        std::fs::write(self.path(name), bytes).unwrap();
    }
}
