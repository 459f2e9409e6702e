//! Files that are not stores, and stores that may not be written.

use super::{create, presight, small};
use presight::ErrorKind;
use presight::store;
use presight::store::{Note, Store};
use std::path::{Path, PathBuf};
use std::process::Output;

fn run(args: &[&str], path: &Path) -> Output {
    presight().args(args).arg(path).output().unwrap()
}

/// The exit status and the one-line message.
fn refused(args: &[&str], path: &Path) -> (Option<i32>, String) {
    let output = run(args, path);
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.starts_with("error: ") && message.trim_end().lines().count() == 1, "{message}");
    assert!(message.contains(path.file_name().unwrap().to_str().unwrap()), "{message}");
    (output.status.code(), message)
}

fn folder_with_store() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = create(folder.path(), &small());
    (folder, path)
}

#[test]
fn a_newer_version_is_refused() {
    let (_folder, path) = folder_with_store();
    rusqlite::Connection::open(&path).unwrap().execute_batch("PRAGMA user_version = 6").unwrap();
    for args in [&["env", "info"][..], &["env", "check"], &["inspect"]] {
        let (status, message) = refused(args, &path);
        assert!(status == Some(1) && message.contains("format 6") && message.contains("update presight"), "{message}");
    }
    assert_eq!(store::read(&path).unwrap_err().kind(), ErrorKind::Unsupported);
}

#[test]
fn a_foreign_sqlite_file_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["other.presight", "other.db"] {
        let path = folder.path().join(name);
        rusqlite::Connection::open(&path).unwrap().execute_batch("CREATE TABLE t(x)").unwrap();
        let (status, message) = refused(&["inspect"], &path);
        assert!(status == Some(1) && message.contains("not a presight store"), "{message}");
    }
}

#[test]
fn files_that_are_not_databases_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("text.presight");
    for bytes in [&b""[..], b"x", &[b'x'; 5000], b"SQLite format 3\0"] {
        std::fs::write(&path, bytes).unwrap();
        assert_eq!(refused(&["env", "info"], &path).0, Some(1));
        assert_eq!(std::fs::read(&path).unwrap(), bytes, "the file stays unchanged");
    }
    assert_eq!(refused(&["env", "info"], &folder.path().join("none.presight")).0, Some(1));
    assert!(!folder.path().join("none.presight").exists());
    let e = store::read(folder.path()).unwrap_err();
    assert_eq!(e.kind(), ErrorKind::Invalid);
}

#[test]
fn a_locked_store_is_refused_and_intact() {
    let (folder, path) = folder_with_store();
    let before = std::fs::read(&path).unwrap();
    let changes = folder.path().join("c.jsonl");
    std::fs::write(&changes, "{\"op\":\"delete_object\",\"object\":\"a\"}\n").unwrap();
    for lock in ["BEGIN IMMEDIATE", "BEGIN EXCLUSIVE"] {
        let connection = rusqlite::Connection::open(&path).unwrap();
        connection.execute_batch(lock).unwrap();
        let output = presight().args(["env", "apply"]).args([&path, &changes]).output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(4) && message.contains("locked"), "{message}");
        assert!(output.stdout.is_empty());
        drop(connection);
        assert_eq!(std::fs::read(&path).unwrap(), before);
    }
}

/// Permissions do not bind root, so the command runs as nobody.
#[cfg(target_os = "linux")]
#[test]
fn a_read_only_store_or_folder_is_refused_and_intact() {
    use std::os::unix::fs::{MetadataExt, PermissionsExt};
    use std::os::unix::process::CommandExt;
    let (folder, path) = folder_with_store();
    let command = folder.path().join("presight");
    std::fs::copy(env!("CARGO_BIN_EXE_presight"), &command).unwrap();
    let root = std::fs::metadata("/proc/self").unwrap().uid() == 0;
    let changes = folder.path().join("c.jsonl");
    std::fs::write(&changes, "{\"op\":\"delete_object\",\"object\":\"a\"}\n").unwrap();
    let before = std::fs::read(&path).unwrap();
    let mode = |path: &Path, mode| std::fs::set_permissions(path, PermissionsExt::from_mode(mode)).unwrap();
    for (of_folder, of_file) in [(0o555, 0o666), (0o777, 0o444), (0o555, 0o444)] {
        mode(&path, of_file);
        mode(folder.path(), of_folder);
        let run = |args: &[&str], files: &[&Path]| {
            let mut command = std::process::Command::new(&command);
            if root {
                command.uid(65534).gid(65534);
            }
            command.args(args).args(files).output().unwrap()
        };
        let output = run(&["env", "apply"], &[&path, &changes]);
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(
            output.status.code() == Some(4) && message.contains("permission"),
            "{of_folder:o} {of_file:o}: {message}"
        );
        assert_eq!(std::fs::read(&path).unwrap(), before);
        let reads = run(&["env", "info"], &[&path]);
        assert!(reads.status.success(), "reading failed: {}", String::from_utf8_lossy(&reads.stderr));
        let created = run(&["env", "create"], &[&folder.path().join("new.presight"), &path]);
        assert_eq!(created.status.code() == Some(4), of_folder == 0o555);
        let _ = std::fs::remove_file(folder.path().join("new.presight"));
        mode(folder.path(), 0o777);
    }
}

#[test]
fn lines_that_are_not_changes_are_reported_with_their_place() {
    let (folder, path) = folder_with_store();
    let before = store::read(&path).unwrap().content_hash();
    let changes = folder.path().join("c.jsonl");
    let cases = [
        (r#"{"op":"move","object":"door","pose":[0,0,0,0,0,0]}"#, "no object \"door\""),
        (r#"{"op":"move","object":"a","pose":[0,0,0]}"#, "3 numbers"),
        (r#"{"op":"move","object":"a","pose":[1e999,0,0,0,0,0]}"#, "line 2"),
        (r#"{"op":"move","object":"a","pose":[1e300,0,0,0,0,0]}"#, "too far"),
        (r#"{"op":"fly","object":"a"}"#, "fly"),
        (r#"{"op":"move","object":"a","pose":[0,0,0,0,0,0],"speed":1}"#, "speed"),
        (r#"{"op":"move""#, "line 2"),
        ("[1]", "line 2"),
        (r#"{"op":"delete_object","object":"a","id":{}}"#, "id"),
        (r#"{"op":"insert_object","object":"a","like":"b"}"#, "already exists"),
        (r#"{"op":"insert_object","object":"x","like":"door"}"#, "no object \"door\""),
        (r#"{"op":"insert_object","object":"x","mesh":1}"#, "no shape"),
        (r#"{"op":"insert_object","object":"x"}"#, "no shape"),
        (r#"{"op":"insert_object","object":"","like":"a"}"#, "0 bytes"),
        (r#"{"op":"insert_object","object":"x","from":"none.glb"}"#, "none.glb"),
        (r#"{"op":"insert_object","object":"x","vertices":[[0,0,0],[1,0,0]],"polygons":[[0,1,2]]}"#, "out of range"),
        (
            r#"{"op":"insert_object","object":"x","vertices":[[0,0,0],[1,0,0],[0,1,0]],"polygons":[[0,1,2]],"material":"wood"}"#,
            "wood",
        ),
        (r#"{"op":"add_material","name":"x","reflection":2}"#, "reflection"),
        (r#"{"op":"insert_feature","class":"video","feature":{"id":2,"kind":"point","points":[[0,0,0]]}}"#, "in use"),
        (r#"{"op":"delete_feature","class":"video","feature":77}"#, "77"),
        (r#"{"op":"restore_feature","class":"video","feature":{"id":2,"kind":"blob"}}"#, "blob"),
        (r#"{"op":"set_pose_covariance","class":"video","object":"a","covariance":[1]}"#, "36"),
        (
            r#"{"op":"group","changes":[{"op":"delete_object","object":"a"},{"op":"delete_object","object":"a"}]}"#,
            "change 2",
        ),
        (r#"{"op":"move","object":"a","pose":[1,0,0,0,0,0],"pose":[2,0,0,0,0,0]}"#, "\"pose\" is given twice"),
        (r#"{"op":"group","changes":[{"op":"delete_object","object":"a","object":"b"}]}"#, "\"object\" is given twice"),
        (r#"{"op":"move","object":"a","pose":[0,0,0,0,0,0,0]}"#, "length"),
        (r#"{"op":"move","object":"g/","pose":[0,0,0,0,0,0]}"#, "no object \"g/\""),
        (r#"{"op":"set_group","group":"a","pose":[0,0,0,0,0,0]}"#, "this path is an object"),
        (r#"{"op":"set_group","group":"","pose":[0,0,0,0,0,0]}"#, "0 bytes"),
        (r#"{"op":"set_group","group":"g","pose":[0,0]}"#, "2 numbers"),
        (
            r#"{"op":"insert_feature","class":"video","feature":{"id":9,"kind":"point","points":[[0.5,0.5,7]]}}"#,
            "class \"video\": feature 9: the point is 6.000000 m off its polygons",
        ),
        (
            r#"{"op":"set_feature","class":"video","feature":{"id":2,"kind":"point","object":"a","points":[[0.5,0.5,7]]}}"#,
            "feature 2: the point is 6.000000 m off its polygons at [0.5, 0.5, 7] in the frame of object \"a\"",
        ),
        (
            r#"{"op":"restore_feature","class":"video","feature":{"id":9,"kind":"point","points":[[0.5,0.5,7]]}}"#,
            "off its polygons",
        ),
        (
            r#"{"op":"group","changes":[{"op":"insert_feature","class":"video","feature":{"id":9,"kind":"point","points":[[0,0,0]]}},{"op":"delete_object","object":"floor"}]}"#,
            "class \"video\": feature 9",
        ),
        (
            r#"{"op":"insert_feature","class":"video","feature":{"id":9,"kind":"fiducial","points":[[0,0,1],[0,0.5,1],[0,0.5,0.5],[0,0,0.5]],"properties":{"family":"tag36h11","code":1}}}"#,
            "family \"tag36h11\": OpenCV has no such dictionary",
        ),
    ];
    for (line, part) in cases {
        std::fs::write(&changes, format!("{{\"op\":\"group\",\"changes\":[]}}\n{line}\n")).unwrap();
        let output = presight().args(["env", "apply"]).args([&path, &changes]).output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{line}: {message}");
        assert!(message.contains(part) && message.contains("c.jsonl: line 2: "), "{line}: {message}");
        assert!(message.trim_end().lines().count() == 1 && message.contains("; "), "{message}");
        assert_eq!(output.stdout, b"ack 1\n", "{line}");
        assert_eq!(store::read(&path).unwrap().content_hash(), before, "{line}");
    }
}

/// Whatever is wrong with a line, the lines before it are stored and acknowledged.
#[test]
fn lines_before_one_that_cannot_be_read_are_stored() {
    let long = format!("{{\"op\":\"{}\"}}\n", "x".repeat(presight::tools::MAX_LINE_BYTES as usize));
    for (bad, says) in [(&b"{\"op\":\"\xff\"}\n"[..], "UTF-8"), (long.as_bytes(), "bytes long"), (b"{\n", "EOF")] {
        let (folder, path) = folder_with_store();
        let good: String = (1..=99).map(|k| super::numbered(k).1 + "\n").collect();
        let changes = folder.path().join("c.jsonl");
        std::fs::write(&changes, [good.as_bytes(), bad, good.as_bytes()].concat()).unwrap();
        let output = presight().args(["env", "apply"]).args([&path, &changes]).output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(1) && message.contains("c.jsonl: line 100: "), "{message}");
        assert!(message.contains(says) && message.len() < 1000, "{message}");
        let acks: String = (1..=99).map(|k| format!("ack {k}\n")).collect();
        assert_eq!(String::from_utf8(output.stdout).unwrap(), acks, "{says}");
        assert_eq!(store::info(&path).unwrap().changes, 99, "{says}");
    }
}

/// An error in a file that a line names gives the line in the file of changes and the place in the named file.
#[test]
fn errors_in_a_file_that_a_line_names_give_the_place_in_that_file() {
    let (folder, path) = folder_with_store();
    std::fs::write(folder.path().join("p.gltf"), "{\n\n x").unwrap();
    let changes = folder.path().join("c.jsonl");
    std::fs::write(&changes, "{\"op\":\"insert_object\",\"object\":\"x\",\"from\":\"p.gltf\"}\n").unwrap();
    let (status, message) = refused_apply(&path, &changes);
    let (of_changes, of_file) = message.split_once("c.jsonl: line 1: ").expect("the line comes first");
    assert!(status == Some(1) && of_changes.starts_with("error: "), "{message}");
    assert!(of_file.starts_with("object \"x\": ") && of_file.contains("p.gltf: JSON line 3, column 2: "), "{message}");
}

fn refused_apply(path: &Path, changes: &Path) -> (Option<i32>, String) {
    let output = presight().args(["env", "apply"]).args([path, changes]).output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn an_id_or_a_cause_of_null_counts_as_absent() {
    let (folder, path) = folder_with_store();
    let changes = folder.path().join("c.jsonl");
    let line = "{\"op\":\"group\",\"changes\":[],\"id\":null,\"cause\":null}\n";
    std::fs::write(&changes, line.repeat(2)).unwrap();
    assert_eq!(refused_apply(&path, &changes), (Some(0), String::new()));
    let mut entries = Vec::new();
    store::log(&path, |entry| {
        entries.push((entry.id, entry.cause.ends_with(&format!("line {}", entry.number))));
        Ok(())
    })
    .unwrap();
    assert_eq!(entries, [(None, true), (None, true)], "the second must not count as a repetition of the first");
}

/// SQLite notices that the file at the path is no longer the one that it opened.
#[cfg(target_os = "linux")]
#[test]
fn a_store_that_was_moved_away_is_reported() {
    use std::io::{BufRead, BufReader, Write};
    for whole_folder in [false, true] {
        let (folder, _) = folder_with_store();
        let inner = folder.path().join("inner");
        std::fs::create_dir(&inner).unwrap();
        let path = create(&inner, &small());
        let mut command = presight();
        command.args(["env", "apply"]).arg(&path).arg("-");
        let piped = std::process::Stdio::piped;
        let mut child = command.stdin(piped()).stdout(piped()).stderr(piped()).spawn().unwrap();
        let (mut stdin, mut stdout) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
        let mut ack = String::new();
        writeln!(stdin, "{}", super::numbered(1).1).unwrap();
        stdout.read_line(&mut ack).unwrap();
        assert_eq!(ack, "ack 1\n");
        let from = if whole_folder { &inner } else { &path };
        std::fs::rename(from, folder.path().join("moved")).unwrap();
        let _ = writeln!(stdin, "{}", super::numbered(2).1);
        drop(stdin);
        let output = child.wait_with_output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.code() == Some(4) && message.contains("was moved"), "{whole_folder}: {message}");
        assert!(!message.contains("permission") && message.trim_end().lines().count() == 1, "{message}");
    }
}

#[test]
fn a_store_is_not_written_over() {
    let (_folder, path) = folder_with_store();
    let before = std::fs::read(&path).unwrap();
    assert_eq!(store::create(&path, &small(), &Note::new("", 0.0)).unwrap_err().kind(), ErrorKind::Usage);
    assert_eq!(std::fs::read(&path).unwrap(), before);
    let e = store::create(Path::new("/proc/none/x.presight"), &small(), &Note::new("", 0.0)).unwrap_err();
    assert_eq!(e.kind(), ErrorKind::System);
    let e = store::create(&path.with_extension("b"), &small(), &Note::new("", f64::NAN)).unwrap_err();
    assert_eq!(e.kind(), ErrorKind::Invalid);
}

/// The file was made when its format was new. Later builds must read it and append to it.
#[test]
fn a_stored_environment_is_read_for_good() {
    let old = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/store/version-4.presight");
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("old.presight");
    std::fs::copy(&old, &path).unwrap();
    let info = store::check(&path).unwrap();
    assert_eq!((info.changes, info.created, info.cause.as_str()), (5, 1.5, "test"));
    let told = std::fs::read_to_string(old.with_extension("txt")).unwrap();
    assert_eq!(told, format!("{}\n{}\n", info.environment.content_hash(), info.head));
    let mut store = Store::open(&path).unwrap();
    assert_eq!((store.changes(), store.world().environment().content_hash()), (5, info.environment.content_hash()));
    store.apply(super::numbered(6).0, &super::note(6.0)).unwrap();
    let hash = store.world().environment().content_hash();
    drop(store);
    let after = store::check(&path).unwrap();
    assert_eq!((after.changes, after.environment.content_hash()), (6, hash));
}

/// Formats 1 to 3 belong to versions before the first release.
#[test]
fn formats_that_are_no_longer_read_are_refused_with_a_remedy() {
    for version in [1, 2, 3] {
        let (_folder, path) = folder_with_store();
        let connection = rusqlite::Connection::open(&path).unwrap();
        connection.execute_batch(&format!("PRAGMA user_version = {version}")).unwrap();
        drop(connection);
        let before = std::fs::read(&path).unwrap();
        for e in [store::read(&path).err(), store::check(&path).err(), Store::open(&path).err()] {
            let e = e.unwrap();
            assert_eq!((e.kind(), e.file()), (ErrorKind::Unsupported, Some(path.as_path())), "{e}");
            let told = e.to_string();
            assert!(told.contains(&format!("format {version}")) && e.remedy().contains("presight env create"), "{e}");
            assert!(!told.contains('\n'));
        }
        assert_eq!(std::fs::read(&path).unwrap(), before);
    }
}

/// Writes the file for `a_stored_environment_is_read_for_good`, once for each version. Run it with
/// `PRESIGHT_BLESS_STORE=1`.
#[test]
fn bless_a_version() {
    if std::env::var_os("PRESIGHT_BLESS_STORE").is_none() {
        return;
    }
    let (_folder, path) = folder_with_store();
    let mut store = Store::open(&path).unwrap();
    for k in 1..=5 {
        store.apply(super::numbered(k).0, &super::note(k as f64)).unwrap();
    }
    drop(store);
    let info = store::check(&path).unwrap();
    let to = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/store");
    std::fs::copy(&path, to.join("version-5.presight")).unwrap();
    std::fs::write(to.join("version-5.txt"), format!("{}\n{}\n", info.environment.content_hash(), info.head)).unwrap();
    panic!("made; run again without PRESIGHT_BLESS_STORE");
}
