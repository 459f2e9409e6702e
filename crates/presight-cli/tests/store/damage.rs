//! Flipped bytes and truncation.

use super::{create, environment_of, hospital, note, numbered, small};
use presight::store;
use presight::store::Store;
use std::path::Path;

/// Returns the content that must not change unnoticed.
fn told(path: &Path) -> presight::Result<(String, String, u64)> {
    let info = store::info(path)?;
    Ok((info.environment.content_hash().to_string(), info.head, info.changes))
}

/// Creates a store with a log in small pages, so that few bytes are unused.
fn small_pages(folder: &Path) -> std::path::PathBuf {
    let path = create(folder, &small());
    let mut store = Store::open(&path).unwrap();
    for k in 1..=4 {
        store.apply(numbered(k).0, &note(k as f64)).unwrap();
    }
    drop(store);
    let connection = rusqlite::Connection::open(&path).unwrap();
    connection.execute_batch("PRAGMA page_size = 512; VACUUM").unwrap();
    connection.close().unwrap();
    path
}

/// Returns how many flips were noticed, and how many changed nothing in the content.
fn sweep(path: &Path, positions: impl Iterator<Item = usize>) -> (usize, usize) {
    let before = told(path).unwrap();
    let bytes = std::fs::read(path).unwrap();
    let copy = path.with_extension("flipped");
    let (mut noticed, mut harmless) = (0, 0);
    for at in positions {
        let mut flipped = bytes.clone();
        // Flips each of the eight bits in turn, and sometimes all of them.
        flipped[at] ^= if at % 3 == 0 { 0xff } else { 1 << (at % 8) };
        std::fs::write(&copy, &flipped).unwrap();
        match told(&copy) {
            Ok(after) => {
                assert_eq!(after, before, "byte {at} of {}", bytes.len());
                harmless += 1;
            }
            Err(e) => {
                assert!(!e.remedy().is_empty() && !e.to_string().contains('\n'), "byte {at}: {e}");
                noticed += 1;
            }
        }
        let _ = std::fs::remove_file(copy.with_extension("flipped-journal"));
    }
    (noticed, harmless)
}

#[test]
fn every_flipped_byte_is_noticed_or_harmless() {
    let folder = tempfile::tempdir().unwrap();
    let path = small_pages(folder.path());
    let size = std::fs::metadata(&path).unwrap().len() as usize;
    let (noticed, harmless) = sweep(&path, 0..size);
    // The harmless bytes are free space inside pages and counters.
    assert!(noticed > size / 2, "{noticed} of {size} noticed, {harmless} harmless");
}

#[test]
fn every_truncation_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let path = small_pages(folder.path());
    let bytes = std::fs::read(&path).unwrap();
    let cut = folder.path().join("cut.presight");
    for length in (0..bytes.len()).step_by(64).chain(bytes.len() - 20..bytes.len()) {
        std::fs::write(&cut, &bytes[..length]).unwrap();
        assert!(told(&cut).is_err(), "{length} of {} bytes", bytes.len());
    }
    // Appended bytes are also damage.
    std::fs::write(&cut, [&bytes[..], &[0; 512]].concat()).unwrap();
    if let Ok(after) = told(&cut) {
        assert_eq!(after, told(&path).unwrap());
    }
}

#[test]
fn flipped_bytes_of_a_large_store_are_noticed() {
    let Some(scene) = hospital() else { return };
    let folder = tempfile::tempdir().unwrap();
    let environment = environment_of(scene);
    let path = create(folder.path(), &environment);
    let size = std::fs::metadata(&path).unwrap().len() as usize;
    let mut random = 0x2545_F491_4F6C_DD1Du64;
    let positions = (0..40).map(|_| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (random >> 20) as usize % size
    });
    let (noticed, harmless) = sweep(&path, positions.collect::<Vec<_>>().into_iter());
    assert!(noticed > 30, "{noticed} noticed, {harmless} harmless");
}

/// The planted fault: SQLite alone notices almost no flips, which is why rows have hashes.
#[test]
fn sqlite_alone_would_not_notice() {
    let folder = tempfile::tempdir().unwrap();
    let path = small_pages(folder.path());
    let mut bytes = std::fs::read(&path).unwrap();
    // A digit of a pose.
    let pose = b"[4.0,2.0,";
    let at = bytes.windows(pose.len()).position(|w| w == pose).unwrap();
    bytes[at + 1] = b'5';
    std::fs::write(&path, &bytes).unwrap();
    let connection = rusqlite::Connection::open(&path).unwrap();
    let verdict: String = connection.query_row("PRAGMA integrity_check", [], |row| row.get(0)).unwrap();
    assert_eq!(verdict, "ok");
    drop(connection);
    let e = told(&path).unwrap_err();
    assert!(e.to_string().contains("damaged"), "{e}");
}
