//! Changes that wait for time, and for other writers.

use glam::DVec3;
use presight_model::change::Change;
use presight_model::environment::Environment;
use presight_model::geometry::Pose;
use presight_store::{Edit, Note, ProposedChange, Store, create};
use presight_update::PendingChanges;
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

fn delete(k: usize) -> Edit {
    Edit::from(Change::DeleteObject { name: format!("crate {k}") })
}

/// A group of two deletions.
fn change(k: usize) -> ProposedChange {
    let edit = Edit::Group(vec![delete(2 * k), delete(2 * k + 1)]);
    ProposedChange { id: k.to_string(), cause: "gone".to_owned(), evidence: None, was: Vec::new(), edit }
}

fn ids<'a>(changes: impl Iterator<Item = &'a ProposedChange>) -> Vec<String> {
    changes.map(|change| change.id.clone()).collect()
}

/// With little time, changes are applied from the first on, each group completely. The rest waits in order and follows
/// later.
#[test]
fn changes_wait_for_time_in_order() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = Store::open(&store(&folder)).unwrap();
    let (mut pending, note) = (PendingChanges::default(), Note::new("test", 7.0));
    pending.add((0..10).map(change));
    let mut rounds = 0;
    while pending.iter().len() > 0 {
        let before = ids(pending.iter());
        let done = pending.apply(&mut store, &note, Duration::from_micros(300)).unwrap();
        assert_eq!([ids(done.changes.iter()), ids(pending.iter())].concat(), before, "in order, none lost");
        let left = store.world().environment().objects().iter().filter(|o| !o.is_deleted()).count();
        assert_eq!(left, 2 * pending.iter().len(), "each group is complete");
        assert!(done.refused.is_empty());
        rounds += 1;
    }
    assert!(rounds >= 1 && store.changes() == 10);
    // A change that was applied before does nothing. A change that does not apply any more is refused by name.
    let again = ProposedChange { id: "again".to_owned(), edit: delete(4), ..change(4) };
    pending.add([change(3), again]);
    let done = pending.apply(&mut store, &note, Duration::MAX).unwrap();
    assert!(done.changes.is_empty() && done.refused.len() == 1, "{done:?}");
    assert!(done.refused[0].1.to_string().contains("crate 4"), "{done:?}");
}

/// The store is locked only for a commit. While another writer has the lock, no change is applied, and all stay
/// pending.
#[test]
fn a_locked_store_leaves_all_changes_pending() {
    let folder = tempfile::tempdir().unwrap();
    let path = store(&folder);
    let mut own = Store::open(&path).unwrap();
    let mut pending = PendingChanges::default();
    let note = Note::new("test", 7.0);
    pending.add([change(0)]);
    pending.apply(&mut own, &note, Duration::MAX).unwrap();
    let _other = Store::open(&path).unwrap();
    pending.add([change(1)]);
    let error = pending.apply(&mut own, &note, Duration::MAX).unwrap_err();
    assert!(error.to_string().contains("site.presight"), "{error}");
    assert_eq!(ids(pending.iter()), ["1"]);
}

/// A change and its line are the same change to a store.
#[test]
fn a_line_is_the_same_change() {
    let folder = tempfile::tempdir().unwrap();
    let mut store = Store::open(&store(&folder)).unwrap();
    let note = Note::new("test", 7.0);
    let change = ProposedChange::new(delete(3), "gone", None, Vec::new(), "v1").unwrap();
    let mut batch = store.batch().unwrap();
    assert!(batch.apply_proposed(&change, &note).unwrap().1);
    assert!(!batch.apply_line(&change.line().unwrap(), ".".as_ref(), &note).unwrap().1);
    batch.commit().unwrap();
}
