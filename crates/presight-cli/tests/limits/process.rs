//! Runs the built command as a process of an unprivileged user under resource limits.

use presight_testkit::skip::skip;
use std::fs::{self, Permissions};
use std::io::{Read, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt, chown};
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// A command that runs longer than this hangs; none takes as long on the slowest machine.
const HANGS: Duration = Duration::from_secs(60);

/// The first of the unused user ids. Each process gets its own, so that threads of others do not count against its
/// limit. Where the tests may not change the user, this range is not used.
const FIRST_USER: u32 = 50_000;
const USERS: u32 = 10_000;

/// The resources that a process gets.
#[derive(Clone, Debug, Default)]
pub struct Limits {
    /// Options of `prlimit`, such as `--nofile=16`.
    pub options: Vec<String>,
    pub stdout: Out,
    /// When the process is interrupted.
    pub interrupt: Option<When>,
    /// True if it finds the real graphics drivers; otherwise it finds none.
    pub drivers: bool,
}

#[derive(Clone, Copy, Debug)]
pub enum When {
    /// This long after its start.
    After(Duration),
    /// As soon as a temporary file is in its folder.
    Writing,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Out {
    /// A pipe that the test reads.
    #[default]
    Read,
    /// A pipe whose reader has gone.
    Left,
    /// A closed descriptor.
    Closed,
    /// A full device.
    Full,
}

impl Limits {
    /// Limits with one `prlimit` option.
    pub fn of(option: &str) -> Self {
        Self { options: vec![option.to_owned()], ..Self::default() }
    }
}

/// How a process ended.
#[derive(Debug)]
pub struct Ended {
    /// Its exit status, if it exited.
    pub status: Option<i32>,
    /// The signal that ended it.
    pub signal: Option<i32>,
    /// True if it had to be killed after [`HANGS`].
    pub hung: bool,
    /// Its standard output.
    pub stdout: String,
    /// Its standard error.
    pub stderr: String,
    pub time: Duration,
}

/// A copy of the command that any user may run, and whether the tests can run it as another user.
struct Program {
    _folder: tempfile::TempDir,
    path: PathBuf,
    as_others: bool,
}

/// Returns `None`, counted as skipped, where processes cannot be limited, or where root cannot change the user: limits
/// do not bind root.
fn program() -> Option<&'static Program> {
    static PROGRAM: OnceLock<Result<Program, String>> = OnceLock::new();
    let program = PROGRAM.get_or_init(|| {
        let folder = open_folder();
        let path = folder.path().join("presight");
        let built = env!("CARGO_BIN_EXE_presight");
        fs::hard_link(built, &path).or_else(|_| fs::copy(built, &path).map(|_| ())).unwrap();
        let is_root = folder.path().metadata().unwrap().uid() == 0;
        let mut probe = Command::new("prlimit");
        probe.args(["--nproc=1", "--", "env", "--default-signal=INT", "true"]);
        if is_root {
            probe.uid(FIRST_USER).gid(FIRST_USER);
        }
        match probe.output() {
            Ok(output) if output.status.success() => Ok(Program { _folder: folder, path, as_others: is_root }),
            Ok(output) => Err(format!("prlimit failed: {}", String::from_utf8_lossy(&output.stderr).trim())),
            Err(e) => Err(format!("prlimit cannot be started as an unprivileged user: {e}")),
        }
    });
    program.as_ref().inspect_err(|why| skip(why)).ok()
}

/// Returns true if processes can be limited here; otherwise counts a skipped test.
pub fn can_limit() -> bool {
    program().is_some()
}

/// A temporary folder that every user may enter.
pub fn open_folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::set_permissions(folder.path(), Permissions::from_mode(0o755)).unwrap();
    folder
}

/// Runs the command in a folder and waits for its end. The folder and its content change to the process's user.
pub fn run(folder: &Path, args: &[String], input: &str, limits: &Limits) -> Ended {
    let program = program().expect("can_limit was checked");
    let mut command = Command::new("prlimit");
    command.args(&limits.options).arg("--");
    // Tests may run with interrupts ignored, and children inherit that.
    command.args(["env", "--default-signal=INT"]);
    if limits.stdout == Out::Closed {
        command.args(["sh", "-c", "exec \"$0\" \"$@\" >&-"]);
    }
    command.arg(&program.path).args(args).current_dir(folder);
    // The same number of threads on every machine.
    command.env("RAYON_NUM_THREADS", "2").env("TMPDIR", folder);
    if !limits.drivers {
        command.env("VK_DRIVER_FILES", "/nonexistent").env("VK_ICD_FILENAMES", "/nonexistent");
    }
    if program.as_others {
        static NEXT: AtomicU32 = AtomicU32::new(0);
        let user = FIRST_USER + (std::process::id() * 64 + NEXT.fetch_add(1, Ordering::Relaxed)) % USERS;
        give(folder, user);
        command.uid(user).gid(user);
    }
    command.stdin(Stdio::piped()).stderr(Stdio::piped()).stdout(match limits.stdout {
        Out::Full => fs::OpenOptions::new().write(true).open("/dev/full").unwrap().into(),
        _ => Stdio::piped(),
    });
    watch(&mut command, input, limits)
}

/// Changes the owner of a folder and its content; the permissions stay.
fn give(folder: &Path, user: u32) {
    chown(folder, Some(user), Some(user)).unwrap();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() { give(&path, user) } else { chown(&path, Some(user), Some(user)).unwrap() }
    }
}

fn watch(command: &mut Command, input: &str, limits: &Limits) -> Ended {
    let start = Instant::now();
    let mut child = command.spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    // The process may end before it reads.
    let _ = stdin.write_all(input.as_bytes());
    drop(stdin);
    let stdout = child.stdout.take().filter(|_| limits.stdout != Out::Left).map(collect);
    let stderr = child.stderr.take().map(collect);
    if let Some(when) = limits.interrupt {
        match when {
            When::After(delay) => thread::sleep(delay.saturating_sub(start.elapsed())),
            When::Writing => wait_until_it_writes(&mut child, command.get_current_dir().unwrap(), start),
        }
        // The child has not been waited for yet, so its process id cannot belong to another process.
        if child.try_wait().unwrap().is_none() {
            Command::new("kill").args(["-INT", &child.id().to_string()]).stderr(Stdio::null()).status().unwrap();
        }
    }
    let hung = !ends(&mut child, start);
    if hung {
        child.kill().unwrap();
    }
    let status = child.wait().unwrap();
    let text = |reader: Option<thread::JoinHandle<String>>| reader.map(|r| r.join().unwrap()).unwrap_or_default();
    let (stdout, stderr) = (text(stdout), text(stderr));
    Ended { status: status.code(), signal: status.signal(), hung, stdout, stderr, time: start.elapsed() }
}

/// Also returns when the process ends.
fn wait_until_it_writes(child: &mut Child, folder: &Path, start: Instant) {
    let is_part = |entry: fs::DirEntry| entry.file_name().to_string_lossy().ends_with(".part");
    while start.elapsed() < HANGS && child.try_wait().unwrap().is_none() {
        // Listing the folder may fail for a moment while its permissions change.
        if fs::read_dir(folder).is_ok_and(|entries| entries.flatten().any(is_part)) {
            return;
        }
    }
}

fn ends(child: &mut Child, start: Instant) -> bool {
    while start.elapsed() < HANGS {
        if child.try_wait().unwrap().is_some() {
            return true;
        }
        thread::sleep(Duration::from_millis(2));
    }
    false
}

fn collect(mut pipe: impl Read + Send + 'static) -> thread::JoinHandle<String> {
    thread::spawn(move || {
        let mut bytes = Vec::new();
        pipe.read_to_end(&mut bytes).unwrap();
        String::from_utf8_lossy(&bytes).into_owned()
    })
}
