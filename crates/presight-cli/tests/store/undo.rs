//! The log: list, explain and undo changes; groups, ids and batches.

use super::{at, create, note, numbered, point, presight, small};
use presight::store;
use presight::store::{Note, Store};
use presight::{Change, ErrorKind};

fn mover(name: &str, x: f64) -> Change {
    Change::MoveObject { name: name.into(), world_from_object: at(x, 0.0, 0.5) }
}

fn delete(name: &str) -> Change {
    Change::DeleteObject { name: name.into() }
}

fn hash(store: &Store) -> String {
    store.world().environment().content_hash().to_string()
}

/// Returns a store and the content hash after each change.
fn opened(changes: Vec<Change>) -> (tempfile::TempDir, Store, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let path = create(folder.path(), &small());
    let mut store = Store::open(&path).unwrap();
    let mut hashes = vec![hash(&store)];
    for (change, k) in changes.into_iter().zip(1u64..) {
        assert_eq!(store.apply(change, &note(k as f64)).unwrap(), k);
        hashes.push(hash(&store));
    }
    (folder, store, hashes)
}

/// Checks that the file has the same content as the world in memory.
fn same_on_disk(store: Store) {
    let world = store.world().clone();
    let path = store.path().to_owned();
    let changes = store.changes();
    drop(store);
    let info = store::check(&path).unwrap();
    assert_eq!(info.environment.content_hash(), world.environment().content_hash());
    assert_eq!(info.changes, changes);
    assert_eq!(info.environment.slot_count(), world.environment().slot_count());
    for class in ["video", "radar"] {
        let retired = |e: &presight::environment::Environment| e.retired(class).collect::<Vec<_>>();
        assert_eq!(retired(&info.environment), retired(world.environment()));
    }
}

#[test]
fn undoing_appends_the_inverse_and_can_be_undone() {
    let (_folder, mut store, hashes) = opened(vec![mover("a", 1.0), delete("b"), mover("a", 2.0)]);
    assert_eq!(store.undo(3, false, &note(9.0)).unwrap(), [4]);
    assert_eq!(hash(&store), hashes[2]);
    // Changes 3 and 4 cancel each other.
    assert_eq!(store.undo(1, false, &note(9.0)).unwrap(), [5]);
    assert_eq!(store.undo(2, false, &note(9.0)).unwrap(), [6]);
    assert_eq!(hash(&store), hashes[0]);
    let e = store.undo(2, false, &note(9.0)).unwrap_err();
    assert!(e.to_string().contains("was undone by change 6"), "{e}");
    assert_eq!(store.undo(6, false, &note(9.0)).unwrap(), [7]);
    assert!(store.world().environment().object("b").is_none());
    assert!(store.undo(99, false, &note(9.0)).is_err());
    assert!(store.undo(0, false, &note(9.0)).is_err());
    same_on_disk(store);
}

#[test]
fn later_changes_of_the_same_object_block_an_undo() {
    let insert = Change::InsertFeature { class: "video".into(), feature: point(9, 0.5, Some("b")) };
    let (_folder, mut store, hashes) =
        opened(vec![mover("a", 1.0), mover("b", 1.0), mover("a", 2.0), insert, delete("b")]);
    let e = store.undo(1, false, &note(9.0)).unwrap_err().to_string();
    assert!(e.contains("3 (object \"a\")") && e.contains("cascade: true") && !e.contains("2 ("), "{e}");
    let e = store.undo(4, false, &note(9.0)).unwrap_err().to_string();
    assert!(e.contains('5'), "{e}");
    assert_eq!(store.changes(), 5, "nothing was appended");
    assert_eq!(store.undo(2, true, &note(9.0)).unwrap(), [6, 7]);
    assert_eq!(store.undo(1, true, &note(9.0)).unwrap(), [8, 9]);
    assert_eq!(store.undo(4, true, &note(9.0)).unwrap(), [10]);
    assert_eq!(hash(&store), hashes[0]);
    same_on_disk(store);
}

/// Undone features do not come back to make the undoing of their tolerance possible.
#[test]
fn cascading_does_no_more_than_it_must() {
    let insert = |id| Change::InsertFeature { class: "video".into(), feature: point(id, 0.5, Some("a")) };
    let tolerance = Change::SetTolerance { class: "video".into(), tolerance: 0.25 };
    let mut changes: Vec<Change> = (11..32).map(insert).collect();
    changes.push(tolerance);
    let (_folder, mut store, _) = opened(changes);
    let before = store.world().environment().layer("video").unwrap().tolerance;
    for number in 1..=21 {
        store.undo(number, false, &note(9.0)).unwrap();
    }
    assert_eq!(before, 0.25);
    assert_eq!(store.undo_plan(22, true).unwrap(), [22]);
    assert_eq!(store.undo(22, true, &note(9.0)).unwrap(), [44]);
    let layer = store.world().environment().layer("video").unwrap();
    assert_eq!((layer.tolerance, layer.features.len()), (1e-3, 2), "the initial layer of the store");
    // A live feature needs the tolerance and therefore blocks the undo.
    store.apply(Change::SetTolerance { class: "video".into(), tolerance: 0.5 }, &note(9.0)).unwrap();
    store.apply(insert(99), &note(9.0)).unwrap();
    let e = store.undo(45, false, &note(9.0)).unwrap_err().to_string();
    assert!(e.contains("before changes 46 (") && e.contains("appends 2 changes"), "{e}");
    assert_eq!(store.undo(45, true, &note(9.0)).unwrap(), [47, 48]);
    same_on_disk(store);
}

#[test]
fn a_parents_move_and_a_group_are_undone_whole() {
    let group = Change::Group(vec![mover("b", 1.0), delete("a"), mover("b/lid", 7.0)]);
    let (_folder, mut store, hashes) = opened(vec![group, mover("b", 3.0)]);
    assert_eq!(store.undo(2, false, &note(9.0)).unwrap(), [3]);
    assert_eq!(hash(&store), hashes[1]);
    store.undo(1, false, &note(9.0)).unwrap();
    assert_eq!(hash(&store), hashes[0]);
    same_on_disk(store);
}

#[test]
fn changes_of_groups_are_undone_whole_and_block_earlier_undos() {
    let (folder, mut store, hashes) =
        opened(vec![mover("g", 1.0), mover("a", 1.0), mover("g/h/y", 2.0), delete("g/h"), delete("b")]);
    let e = store.undo(1, false, &note(9.0)).unwrap_err().to_string();
    assert!(e.contains("3 (object \"g/h/y\")") && e.contains("4 (object") && !e.contains("2 ("), "{e}");
    assert_eq!(store.undo(5, false, &note(9.0)).unwrap(), [6]);
    assert_eq!(hash(&store), hashes[4]);
    assert_eq!(store.undo(1, true, &note(9.0)).unwrap(), [7, 8, 9]);
    assert_eq!(store.undo(2, false, &note(9.0)).unwrap(), [10]);
    assert_eq!(hash(&store), hashes[0]);
    // The same holds after reading the file.
    drop(store);
    let mut store = Store::open(&folder.path().join("env.presight")).unwrap();
    assert_eq!(hash(&store), hashes[0]);
    assert_eq!(store.undo(8, true, &note(9.0)).unwrap().len(), 2);
    store.undo(10, false, &note(9.0)).unwrap();
    let frames: Vec<_> = store.world().environment().framed_groups().map(|(path, _)| path.to_owned()).collect();
    assert_eq!(frames, ["g", "g/h"], "g was moved again");
    same_on_disk(store);
}

#[test]
fn a_failed_change_leaves_those_before_and_a_dropped_batch_nothing() {
    let (_folder, mut store, hashes) = opened(vec![mover("a", 1.0)]);
    let mut batch = store.batch().unwrap();
    batch.apply(mover("b", 1.0), &note(2.0)).unwrap();
    assert_eq!(batch.apply(delete("door"), &note(2.0)).unwrap_err().kind(), ErrorKind::Invalid);
    batch.apply(mover("b", 2.0), &note(2.0)).unwrap();
    batch.commit().unwrap();
    assert_eq!(store.changes(), 3);
    let (kept, slots) = (hash(&store), store.world().environment().slot_count());
    let mut batch = store.batch().unwrap();
    batch.apply(delete("a"), &Note { id: Some("x".into()), ..note(2.0) }).unwrap();
    batch.apply(numbered(5).0, &note(2.0)).unwrap();
    drop(batch);
    assert_eq!((hash(&store), store.world().environment().slot_count(), store.changes()), (kept, slots, 3));
    store.world().index().assert_well_formed(store.world().environment());
    // The id was never used.
    let number = store.apply(delete("a"), &Note { id: Some("x".into()), ..note(2.0) }).unwrap();
    assert_eq!(number, 4);
    assert_eq!(store.apply(delete("a"), &Note { id: Some("x".into()), ..note(2.0) }).unwrap(), 4);
    assert_ne!(hash(&store), hashes[1]);
    same_on_disk(store);
}

#[test]
fn a_second_writer_is_refused_and_readers_are_not() {
    let (_folder, mut store, _) = opened(vec![mover("a", 1.0)]);
    let path = store.path().to_owned();
    let Err(e) = Store::open(&path) else { panic!("a second writer") };
    assert!(e.kind() == ErrorKind::System && e.to_string().contains("another program"), "{e}");
    let output = presight().args(["env", "undo"]).arg(&path).arg("1").output().unwrap();
    assert_eq!(output.status.code(), Some(4));
    let before = store::read(&path).unwrap().content_hash();
    store.apply(mover("a", 5.0), &note(2.0)).unwrap();
    assert_ne!(store::read(&path).unwrap().content_hash(), before);
}

#[test]
fn the_log_has_time_and_cause() {
    let (_folder, mut store, _) = opened(vec![mover("a", 1.0)]);
    store.undo(1, false, &Note::new("it was right before", 7.25)).unwrap();
    let path = store.path().to_owned();
    drop(store);
    let mut entries = Vec::new();
    store::log(&path, |entry| {
        entries.push(entry);
        Ok(())
    })
    .unwrap();
    assert_eq!((entries[0].time, entries[0].cause.as_str(), entries[0].undoes), (1.0, "because", None));
    assert_eq!((entries[1].time, entries[1].cause.as_str(), entries[1].undoes), (7.25, "it was right before", Some(1)));
    assert_eq!(entries[0].inverse, entries[1].change);
}
