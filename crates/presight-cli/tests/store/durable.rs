//! A store after a power cut, which keeps only synced data, has every acknowledged change.
//!
//! A library loaded before the C library (`shim.c`) records each write, sync, creation and removal of a child that
//! applies changes, and each acknowledgement. The test rebuilds the disk after a power cut at any moment: each file and
//! the folder have the state of their last sync. It also rebuilds the other extreme, a disk on which every operation
//! but the last went through. Planted faults: no syncs at all, and no syncs of the folder.

use super::common::skip::skip;
use super::{create, note, numbered, presight, small};
use presight::World;
use presight::store;
use presight::store::Store;
use std::collections::{BTreeMap, HashMap};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

const CHANGES: u64 = 40;
const CHILD: &str = "PRESIGHT_TEST_UNSYNCED_STORE";

/// Returns the compiled shim.
#[cfg(target_os = "linux")]
fn shim() -> Option<&'static Path> {
    static BUILT: OnceLock<Option<(tempfile::TempDir, PathBuf)>> = OnceLock::new();
    let built = BUILT.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("shim.so");
        let source = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/store/shim.c");
        let mut cc = Command::new("cc");
        cc.args(["-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o"]).arg(&path).arg(source).arg("-ldl");
        match cc.status() {
            Ok(status) => {
                assert!(status.success(), "the shim does not compile");
                Some((folder, path))
            }
            Err(_) => None,
        }
    });
    if built.is_none() {
        skip("there is no C compiler");
    }
    built.as_ref().map(|(_, path)| path.as_path())
}

#[cfg(not(target_os = "linux"))]
fn shim() -> Option<&'static Path> {
    None
}

/// An operation that the shim recorded.
enum Event {
    Write { path: String, offset: usize, data: Vec<u8> },
    Truncate { path: String, size: usize },
    Sync { path: String },
    Create { path: String },
    Remove { path: String },
    SyncFolder,
    Acknowledged(u64),
}

fn events(trace: &Path) -> Vec<Event> {
    let bytes = std::fs::read(trace).unwrap();
    let (mut rest, mut events, mut printed) = (&bytes[..], Vec::new(), String::new());
    let word = |b: &[u8]| u64::from_le_bytes(b[..8].try_into().unwrap()) as usize;
    while !rest.is_empty() {
        let kind = rest[0];
        let n = u32::from_le_bytes(rest[1..5].try_into().unwrap()) as usize;
        let path = String::from_utf8(rest[5..5 + n].to_vec()).unwrap();
        rest = &rest[5 + n..];
        let (offset, length) = (word(rest), word(&rest[8..]));
        let data = rest[16..16 + length].to_vec();
        rest = &rest[16 + length..];
        events.push(match kind {
            b'W' => Event::Write { path, offset, data },
            b'T' => Event::Truncate { path, size: offset },
            b'S' => Event::Sync { path },
            b'C' => Event::Create { path },
            b'U' => Event::Remove { path },
            b'D' => Event::SyncFolder,
            b'A' => {
                printed += &String::from_utf8(data).unwrap();
                let whole = printed.rfind('\n').map_or("", |end| &printed[..end]);
                let mut acks = whole.lines().rev().filter_map(|l| l.strip_prefix("ack ")?.parse().ok());
                match acks.next() {
                    Some(k) => Event::Acknowledged(k),
                    None => continue,
                }
            }
            _ => panic!("record {kind}"),
        });
    }
    events
}

/// A disk with its cache.
#[derive(Default)]
struct Disk {
    files: HashMap<String, File>,
    /// The names in the folder at its last sync.
    names: BTreeMap<String, bool>,
}

#[derive(Clone, Default)]
struct File {
    now: Vec<u8>,
    synced: Vec<u8>,
    there: bool,
}

impl Disk {
    fn with(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        let name = path.to_str().unwrap().to_owned();
        let file = File { now: bytes.clone(), synced: bytes, there: true };
        Self { files: [(name.clone(), file)].into(), names: [(name, true)].into() }
    }

    fn see(&mut self, event: &Event) {
        match event {
            Event::Write { path, offset, data } => {
                let file = self.files.entry(path.clone()).or_default();
                let end = offset + data.len();
                file.now.resize(file.now.len().max(end), 0);
                file.now[*offset..end].copy_from_slice(data);
            }
            Event::Truncate { path, size } => self.files.entry(path.clone()).or_default().now.resize(*size, 0),
            Event::Sync { path } => {
                let file = self.files.entry(path.clone()).or_default();
                file.synced = file.now.clone();
            }
            Event::Create { path } => {
                self.files.insert(path.clone(), File { there: true, ..File::default() });
            }
            Event::Remove { path } => self.files.entry(path.clone()).or_default().there = false,
            Event::SyncFolder => {
                for (name, file) in &self.files {
                    self.names.insert(name.clone(), file.there);
                }
            }
            Event::Acknowledged(_) => {}
        }
    }

    /// Writes the folder's state after a power cut: only synced data, or all operations.
    fn after_power_cut(&self, all: bool, to: &Path) -> PathBuf {
        for (name, file) in &self.files {
            let there = if all { file.there } else { self.names.get(name) == Some(&true) };
            if there {
                let name = Path::new(name).file_name().unwrap();
                std::fs::write(to.join(name), if all { &file.now } else { &file.synced }).unwrap();
            }
        }
        to.join("env.presight")
    }
}

/// Returns the content hash after each number of changes.
fn expected() -> Vec<String> {
    let mut world = World::new(small());
    let hash = |w: &World| w.environment().content_hash().to_string();
    let mut all = vec![hash(&world)];
    for k in 1..=CHANGES {
        world.apply(numbered(k).0).unwrap();
        all.push(hash(&world));
    }
    all
}

/// Cuts the power after each event, and describes each failure.
fn lost_after_power_cuts(mut disk: Disk, events: &[Event]) -> Vec<String> {
    let (expected, mut wrong, mut acknowledged) = (expected(), Vec::new(), 0);
    let mut cuts = 0;
    for (i, event) in events.iter().enumerate() {
        disk.see(event);
        if let Event::Acknowledged(k) = event {
            acknowledged = *k;
        }
        // Between two writes the stored data does not change.
        let next_writes = matches!(events.get(i + 1), Some(Event::Write { .. }));
        if matches!(event, Event::Write { .. }) && next_writes && i % 7 != 0 {
            continue;
        }
        for all in [false, true] {
            let folder = tempfile::tempdir().unwrap();
            let path = disk.after_power_cut(all, folder.path());
            cuts += 1;
            match store::info(&path) {
                Ok(info) => {
                    let n = info.changes;
                    let same = expected.get(n as usize) == Some(&info.environment.content_hash().to_string());
                    if n < acknowledged || !same {
                        wrong.push(format!("event {i}: {n} changes, {acknowledged} acknowledged, same {same}"));
                    }
                }
                Err(e) => wrong.push(format!("event {i}: {e}")),
            }
        }
    }
    assert!(acknowledged == CHANGES && cuts > 100, "{acknowledged} acknowledged, {cuts} cuts");
    wrong
}

fn traced(command: &mut Command, shim: &Path, folder: &Path) -> PathBuf {
    let trace = folder.with_extension("trace");
    command.env("LD_PRELOAD", shim).env("SHIM_FOLDER", folder).env("SHIM_TRACE", &trace);
    trace
}

#[test]
fn acknowledged_changes_survive_a_power_cut() {
    let Some(shim) = shim() else { return };
    let outer = tempfile::tempdir().unwrap();
    let folder = outer.path().join("disk");
    std::fs::create_dir(&folder).unwrap();
    let path = create(&folder, &small());
    let disk = Disk::with(&path);
    let mut command = presight();
    command.args(["env", "apply"]).arg(&path).arg("-").stdin(Stdio::piped()).stdout(Stdio::null());
    let trace = traced(&mut command, shim, &folder);
    let mut child = command.spawn().unwrap();
    let mut stdin = child.stdin.take().unwrap();
    for k in 1..=CHANGES {
        writeln!(stdin, "{}", numbered(k).1).unwrap();
        // Batches of one change and of several.
        if k % 3 == 0 {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
    }
    drop(stdin);
    assert!(child.wait().unwrap().success());
    let events = events(&trace);
    assert!(events.iter().any(|e| matches!(e, Event::SyncFolder)), "the folder is synced");
    let wrong = lost_after_power_cuts(disk, &events);
    assert!(wrong.is_empty(), "{} of them: {:#?}", wrong.len(), &wrong[..wrong.len().min(5)]);

    // Planted fault: a disk that loses the folder's syncs, as with synchronous=FULL.
    let disk = Disk::with(&{
        let fresh = outer.path().join("fresh");
        std::fs::create_dir(&fresh).unwrap();
        create(&fresh, &small())
    });
    let renamed = disk.files.into_values().map(|f| (path.to_str().unwrap().to_owned(), f)).collect();
    let disk = Disk { files: renamed, names: [(path.to_str().unwrap().to_owned(), true)].into() };
    let mut creations_synced = events;
    // Creations are synced, removals are not.
    let mut after_removal = false;
    creations_synced.retain(|e| {
        match e {
            Event::Remove { .. } => after_removal = true,
            Event::Create { .. } => after_removal = false,
            _ => {}
        }
        !(matches!(e, Event::SyncFolder) && after_removal)
    });
    assert!(!lost_after_power_cuts(disk, &creations_synced).is_empty(), "a journal that reappears reverts changes");
}

#[test]
fn changes_without_syncs_are_caught() {
    let Some(shim) = shim() else { return };
    let outer = tempfile::tempdir().unwrap();
    let folder = outer.path().join("disk");
    std::fs::create_dir(&folder).unwrap();
    let path = create(&folder, &small());
    let disk = Disk::with(&path);
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["durable::unsynced_child", "--exact", "--nocapture"]).env(CHILD, &path).stdout(Stdio::null());
    let trace = traced(&mut command, shim, &folder);
    assert!(command.status().unwrap().success());
    let wrong = lost_after_power_cuts(disk, &events(&trace));
    assert!(wrong.iter().any(|w| w.contains("acknowledged")), "{wrong:?}");
}

/// Runs only as a child of the test above.
#[test]
fn unsynced_child() {
    let Some(path) = std::env::var_os(CHILD) else { return };
    let mut store = Store::open(Path::new(&path)).unwrap();
    store.without_sync().unwrap();
    for k in 1..=CHANGES {
        store.apply(numbered(k).0, &note(k as f64)).unwrap();
        let mut out = std::io::stdout().lock();
        out.write_all(format!("\nack {k}\n").as_bytes()).unwrap();
        out.flush().unwrap();
    }
}

#[test]
fn a_full_disk_is_refused_and_harmless() {
    let Some(shim) = shim() else { return };
    let mut refused = 0;
    for room in [0, 100, 600, 4_000, 9_000, 20_000, 45_000] {
        let folder = tempfile::tempdir().unwrap();
        let path = create(folder.path(), &small());
        let mut command = presight();
        command.args(["env", "apply"]).arg(&path).arg("-").stdin(Stdio::piped());
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command.env("LD_PRELOAD", shim).env("SHIM_FOLDER", folder.path()).env("SHIM_FULL", room.to_string());
        let mut child = command.spawn().unwrap();
        let mut stdin = child.stdin.take().unwrap();
        // A child that has given up no longer reads.
        let _ = (1..=CHANGES).try_for_each(|k| {
            writeln!(stdin, "{}", numbered(k).1)?;
            std::thread::sleep(std::time::Duration::from_millis(2));
            stdin.flush()
        });
        drop(stdin);
        let output = child.wait_with_output().unwrap();
        let (out, err) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
        assert_eq!(output.status.code(), Some(4), "room {room}: {err}");
        assert!(err.contains("disk"), "{err}");
        let last = out.lines().last().map_or(0, |l| l.rsplit(' ').next().unwrap().parse::<usize>().unwrap());
        let info = store::check(&path).unwrap();
        assert!(info.changes as usize >= last, "room {room}");
        assert_eq!(info.environment.content_hash().to_string(), expected()[info.changes as usize], "room {room}");
        refused += 1;
    }
    assert_eq!(refused, 7);
}
