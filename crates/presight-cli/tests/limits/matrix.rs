//! Every command under every limit: it does its work, or it fails with a documented status and one line. It leaves only
//! whole files.

use super::process::{Limits, Out, When, can_limit};
use super::rows::{ENDLESS, FOREIGN, LARGE, LONG, Pantry, ROWS, Row, STUDIES};
use super::whole::{May, faults};
use presight_testkit::{Random, env_number};
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;

/// Failures because the system refused a resource.
const REFUSED: May = May::Fail(&[4]);
const SIGINT: May = May::EndBy(2);

/// Runs rows one after another and reports all faults together.
struct Check {
    faults: Vec<String>,
}

impl Check {
    /// Returns `None`, counted as skipped, where processes cannot be limited.
    fn new() -> Option<Self> {
        can_limit().then(|| Self { faults: Vec::new() })
    }

    /// Runs a row in a folder of its own.
    fn run(&mut self, row: &Row, what: &str, limits: &Limits, may: May) {
        let folder = Pantry::get().folder_for(row);
        self.run_in(folder.path(), row, what, limits, may);
    }

    fn run_in(&mut self, folder: &Path, row: &Row, what: &str, limits: &Limits, may: May) {
        let ended = Pantry::get().run(row, folder, limits);
        let found = faults(row, &ended, folder, may, limits.stdout);
        if !found.is_empty() {
            let said: String = ended.stderr.chars().take(600).collect();
            self.faults.push(format!("{what}: presight {}\n    {}\n    {said}", row.line, found.join("; ")));
        }
    }

    fn all(&mut self, rows: &[Row], what: &str, limits: &Limits, may: May) {
        rows.iter().for_each(|row| self.run(row, what, limits, may));
    }

    fn end(self) {
        assert!(self.faults.is_empty(), "{} faults:\n{}", self.faults.len(), self.faults.join("\n"));
    }
}

/// Limits of one to three tasks: no worker thread, one of the pool's two, and the whole pool but no further thread.
#[test]
fn threads() {
    let Some(mut check) = Check::new() else { return };
    for tasks in 1..=3 {
        check.all(ROWS, "threads", &Limits::of(&format!("--nproc={tasks}")), REFUSED);
    }
    for rows in [STUDIES, ENDLESS] {
        check.all(rows, "threads", &Limits::of("--nproc=1"), REFUSED);
    }
    check.end();
}

#[test]
fn memory() {
    let Some(mut check) = Check::new() else { return };
    let limits = Limits::of("--as=500000000");
    check.all(ROWS, "memory", &limits, REFUSED);
    Pantry::get().make_large();
    check.all(LARGE, "memory", &limits, REFUSED);
    check.end();
}

#[test]
fn open_files() {
    let Some(mut check) = Check::new() else { return };
    for files in [16, 5] {
        check.all(ROWS, "open files", &Limits::of(&format!("--nofile={files}")), REFUSED);
    }
    check.end();
}

#[test]
fn length_of_files() {
    let Some(mut check) = Check::new() else { return };
    for bytes in [0, 4096, 100_000] {
        check.all(ROWS, "length of files", &Limits::of(&format!("--fsize={bytes}")), REFUSED);
    }
    check.end();
}

#[test]
fn standard_output() {
    let Some(mut check) = Check::new() else { return };
    for stdout in [Out::Left, Out::Closed, Out::Full] {
        let limits = Limits { stdout, ..Limits::default() };
        check.all(ROWS, &format!("stdout {stdout:?}"), &limits, REFUSED);
    }
    check.end();
}

#[test]
fn folder_without_write_permission() {
    let Some(mut check) = Check::new() else { return };
    for row in ROWS {
        let folder = Pantry::get().folder_for(row);
        fs::set_permissions(folder.path(), Permissions::from_mode(0o555)).unwrap();
        check.run_in(folder.path(), row, "read-only folder", &Limits::default(), REFUSED);
        fs::set_permissions(folder.path(), Permissions::from_mode(0o755)).unwrap();
    }
    check.end();
}

/// `PRESIGHT_SEED` selects other random times.
#[test]
fn interrupted() {
    let Some(mut check) = Check::new() else { return };
    let mut random = Random(env_number("PRESIGHT_SEED", 1));
    let often = LONG.iter().cycle().take(12);
    for row in ROWS.iter().chain(ROWS).chain(often).chain(STUDIES).chain(ENDLESS) {
        let delay = Pantry::get().time(row).mul_f64(random.uniform(0.0, 1.0));
        let limits = Limits { interrupt: Some(When::After(delay)), ..Limits::default() };
        check.run(row, &format!("interrupted after {delay:?}"), &limits, SIGINT);
    }
    // Few random delays hit a write, so these interrupts wait for one.
    for row in ROWS.iter().filter(|row| !row.outputs.is_empty()).chain(LONG.iter().cycle().take(6)) {
        let limits = Limits { interrupt: Some(When::Writing), ..Limits::default() };
        check.run(row, "interrupted while it writes", &limits, SIGINT);
    }
    check.end();
}

/// A small file system in memory, unmounted when the value is dropped.
struct Disk(tempfile::TempDir);

impl Disk {
    /// Returns `None`, counted as skipped, where it cannot be mounted.
    fn new() -> Option<Self> {
        let folder = super::process::open_folder();
        let mut mount = std::process::Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", "size=2m,mode=755", "presight-limits"]).arg(folder.path());
        match mount.output() {
            Ok(output) if output.status.success() => Some(Self(folder)),
            _ => {
                presight_testkit::skip::skip("a small disk cannot be mounted without more rights");
                None
            }
        }
    }

    /// Fills the disk until `free` bytes are left, in pages of 4096 bytes.
    fn fill(&self, free: usize) {
        let path = self.0.path().join("filler");
        // A write that does not fit writes as many bytes as there is room for.
        let _ = fs::write(&path, vec![1; 4 << 20]);
        let length = fs::metadata(&path).unwrap().len();
        let file = fs::OpenOptions::new().write(true).open(&path).unwrap();
        file.set_len(length.saturating_sub(free as u64)).unwrap();
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        let _ = std::process::Command::new("umount").arg("-l").arg(self.0.path()).status();
    }
}

#[test]
fn full_disk() {
    let Some(mut check) = Check::new() else { return };
    let Some(disk) = Disk::new() else { return };
    for free in [0, 8192, 65_536] {
        for row in ROWS {
            let folder = disk.0.path().join("work");
            fs::create_dir(&folder).unwrap();
            Pantry::get().fill(row, &folder);
            disk.fill(free);
            check.run_in(&folder, row, &format!("{free} bytes free"), &Limits::default(), REFUSED);
            fs::remove_dir_all(&folder).unwrap();
            fs::remove_file(disk.0.path().join("filler")).unwrap();
        }
    }
    check.end();
}

/// Foreign drivers may crash under a limit; even then no file is half written and no command hangs.
#[cfg(feature = "gpu")]
#[test]
fn drivers() {
    let Some(mut check) = Check::new() else { return };
    if !presight_testkit::has_adapter() {
        return presight_testkit::skip::no_adapter("none is listed");
    }
    let mut random = Random(env_number("PRESIGHT_SEED", 1));
    for row in FOREIGN {
        for option in ["--nproc=1", "--nproc=3", "--as=500000000", "--nofile=16", "--fsize=4096"] {
            let limits = Limits { drivers: true, ..Limits::of(option) };
            check.run(row, option, &limits, May::BeForeign);
        }
        let delay = Duration::from_secs_f64(random.uniform(0.0, 1.0));
        let limits = Limits { drivers: true, interrupt: Some(When::After(delay)), ..Limits::default() };
        check.run(row, &format!("interrupted after {delay:?}"), &limits, May::BeForeign);
    }
    check.end();
}
