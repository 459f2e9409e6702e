//! Changes that wait for time, and for other writers.

use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::geometry::Pose;
use presight_store::{Note, Store, create};
use presight_update::Waiting;
use std::path::PathBuf;
use std::time::Duration;

fn store(folder: &tempfile::TempDir) -> PathBuf {
    let path = folder.path().join("site.presight");
    let mut environment = Environment::new();
    for k in 0..20 {
        environment.add_cuboid(&format!("crate {k}"), Pose::IDENTITY, DVec3::ONE).unwrap();
    }
    create(&path, &environment, &Note::new("new", 0.0)).unwrap();
    path
}

/// A group of two deletions.
fn line(k: usize) -> String {
    let delete = |k: usize| format!(r#"{{"op":"delete_object","object":"crate {k}"}}"#);
    format!(r#"{{"op":"group","changes":[{},{}],"id":"{k}"}}"#, delete(2 * k), delete(2 * k + 1))
}

/// With little time, lines are applied from the first on, each group whole; the rest waits in order and follows later.
#[test]
fn what_has_no_time_waits_in_order_and_whole() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = Store::open(&store(&folder)).unwrap();
    let (mut waiting, note) = (Waiting::default(), Note::new("test", 7.0));
    waiting.add((0..10).map(line));
    let mut rounds = 0;
    while waiting.lines().len() > 0 {
        let before: Vec<String> = waiting.lines().map(str::to_owned).collect();
        let done = waiting.apply(&mut store, &note, Duration::from_micros(300)).unwrap();
        let after: Vec<String> = waiting.lines().map(str::to_owned).collect();
        assert_eq!([done.lines.clone(), after].concat(), before, "in order, none lost");
        let left = store.world().environment().objects().iter().filter(|o| !o.is_deleted()).count();
        assert_eq!(left, 2 * waiting.lines().len(), "each whole");
        assert!(done.refused.is_empty());
        rounds += 1;
    }
    assert!(rounds >= 1 && store.changes() == 10);
    // Lines that were applied before are done, and one that does not apply any more is refused by name.
    waiting.add([line(3), r#"{"op":"delete_object","object":"crate 4","id":"again"}"#.to_owned()]);
    let done = waiting.apply(&mut store, &note, Duration::MAX).unwrap();
    assert!(done.lines.is_empty() && done.refused.len() == 1, "{done:?}");
    assert!(done.refused[0].1.to_string().contains("crate 4"), "{done:?}");
}

/// The store is locked for a commit only. While another writer holds it, nothing is applied, and everything waits as before.
#[test]
fn a_locked_store_keeps_all_waiting() {
    let folder = tempfile::tempdir().unwrap();
    let path = store(&folder);
    let mut own = Store::open(&path).unwrap();
    let mut waiting = Waiting::default();
    let note = Note::new("test", 7.0);
    waiting.add([line(0)]);
    waiting.apply(&mut own, &note, Duration::MAX).unwrap();
    let _other = Store::open(&path).unwrap();
    waiting.add([line(1)]);
    let error = waiting.apply(&mut own, &note, Duration::MAX).unwrap_err();
    assert!(error.to_string().contains("site.presight"), "{error}");
    assert_eq!(waiting.lines().collect::<Vec<_>>(), [line(1)]);
}
