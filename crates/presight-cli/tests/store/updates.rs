//! Updates of a store from a newer file: objects added, changed and left, and the pairing of equal names.

use super::command::{json, run};
use super::{at, block, note, point, presight};
use presight::Change;
use presight::environment::{Environment, Material, NewObject};
use presight::store;
use presight::store::{Existing, Note, Store};
use proptest::prelude::*;
use std::path::Path;

/// Makes a store of the older file of a case; returns the path of the newer one.
fn case(folder: &Path, name: &str) -> String {
    let files = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/files/cases").join(name);
    run(folder, &["env", "create", "cell.presight", files.join("old.glb").to_str().unwrap()]);
    files.join("new.glb").display().to_string()
}

/// Imports a file; returns stdout and stderr.
fn import(folder: &Path, file: &str, more: &[&str]) -> (String, String) {
    let output = presight().args(["env", "import", "cell.presight", file]).args(more).current_dir(folder).output();
    let output = output.unwrap();
    let [said, told] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert!(output.status.success(), "{told}");
    (said, told)
}

/// Names and places along x of all objects but the floor.
fn objects(folder: &Path) -> Vec<(String, f64)> {
    let environment = store::check(&folder.join("cell.presight")).unwrap().environment;
    let objects = environment.objects().iter().filter(|o| !o.is_deleted() && o.name != "floor");
    let mut objects: Vec<_> = objects.map(|o| (o.name.clone(), o.world_from_object.translation.x)).collect();
    objects.sort_by(|a, b| a.0.cmp(&b.0));
    objects
}

fn named(objects: &[(&str, f64)]) -> Vec<(String, f64)> {
    objects.iter().map(|(name, x)| ((*name).to_owned(), *x)).collect()
}

fn hash(folder: &Path) -> String {
    store::check(&folder.join("cell.presight")).unwrap().environment.content_hash().to_string()
}

fn apply(folder: &Path, lines: &[&str]) {
    std::fs::write(folder.join("c.jsonl"), lines.join("\n") + "\n").unwrap();
    run(folder, &["env", "apply", "cell.presight", "c.jsonl"]);
}

/// Chairs stand at -2, 0 and 2. The second goes, and the third, now the second of the file, keeps its name and feature.
#[test]
fn of_equal_names_the_one_that_is_there_stays() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let new = case(here, "update-equal-names");
    let feature = r#"{"op":"insert_feature","class":"video","feature":{"id":ID,"kind":"point","object":"chair#ID","points":[[0.25,0,0]],"sigma":0.1}}"#;
    apply(here, &[&feature.replace("ID", "2"), &feature.replace("ID", "3")]);
    let (said, told) = import(here, &new, &["--replace"]);
    assert_eq!(said, "nothing to change\n");
    let paired = "note: names are repeated; objects of file and store are paired by shape and place: \"chair#2\" is \
                  \"chair#3\"\n";
    let left = "note: 1 object left in the store, not in the file: \"chair#2\"; --mirror deletes what the file lacks\n";
    assert_eq!(told, format!("{paired}{left}"));
    assert_eq!(objects(here), named(&[("chair", -2.0), ("chair#2", 0.0), ("chair#3", 2.0)]));
    let before = hash(here);
    let (said, told) = import(here, &new, &["--mirror"]);
    assert_eq!(said, "change 3\n");
    let gone = "note: 1 object deleted that the file lacks: \"chair#2\"\n";
    let features = "note: 1 feature deleted with its object, class \"video\": 2\n";
    // The third is now the second of the file, so its triangles have the numbers of the deleted one.
    let numbers = "note: objects that got other numbers of source triangles only: 1\n";
    assert_eq!(told, format!("{paired}{gone}{features}{numbers}"));
    assert_eq!(objects(here), named(&[("chair", -2.0), ("chair#3", 2.0)]));
    let environment = store::read(&here.join("cell.presight")).unwrap();
    let of = |id| environment.feature("video", id).map(|f| f.object.clone().unwrap());
    assert_eq!((of(2), of(3)), (None, Some("chair#3".into())));
    assert_eq!(import(here, &new, &["--mirror"]), ("nothing to change\n".into(), paired.into()));
    run(here, &["env", "undo", "cell.presight", "3"]);
    assert_eq!(hash(here), before);
}

/// The shelf goes and the table moves from 2 to 2.5. The store then is the file, to the last bit.
#[test]
fn a_mirror_is_equal_to_its_file() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let new = case(here, "update-removed-object");
    let (said, told) = import(here, &new, &["--replace"]);
    assert_eq!(said, "change 1\n");
    let moved = "note: 1 object moved: \"table\"\n";
    let left = "note: 1 object left in the store, not in the file: \"shelf\"; --mirror deletes what the file lacks\n";
    assert_eq!(told, format!("{moved}{left}"));
    assert_eq!(objects(here), named(&[("shelf", 0.0), ("table", 2.5)]));
    // The shelf's triangles came before the table's, whose numbers in the file change with it.
    let (said, told) = import(here, &new, &["--mirror"]);
    assert_eq!(said, "change 2\n");
    assert!(told.contains("1 object deleted that the file lacks: \"shelf\""), "{told}");
    assert!(told.contains("objects that got other numbers of source triangles only: 1"), "{told}");
    let of_file = json(&run(here, &["inspect", &new, "--json"]));
    assert_eq!(hash(here), of_file["content_hash"]);
    assert_eq!(import(here, &new, &["--mirror"]), ("nothing to change\n".into(), String::new()));
    run(here, &["env", "undo", "cell.presight", "2"]);
    assert_eq!(objects(here), named(&[("shelf", 0.0), ("table", 2.5)]));
    run(here, &["env", "undo", "cell.presight", "1"]);
    assert_eq!(objects(here), named(&[("shelf", 0.0), ("table", 2.0)]));
    std::fs::write(here.join("l.json"), "{}").unwrap();
    let layer = presight().args(["env", "import", "cell.presight", "l.json", "--mirror"]).current_dir(here).output();
    assert_eq!(layer.unwrap().status.code(), Some(2), "layers have rules of their own");
}

/// An environment of cubes: name, size and place along x.
fn cubes(all: &[(&str, f32, f64)]) -> Environment {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    for (name, size, x) in all {
        environment.insert(NewObject::new(*name, at(*x, 0.0, 0.0), block("cube", *size, [0; 6]))).unwrap();
    }
    environment
}

fn merged(
    ours: &[(&str, f32, f64)],
    theirs: &[(&str, f32, f64)],
    existing: Existing,
) -> (store::SceneMerge, Environment) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("s.presight");
    store::create(&path, &cubes(ours), &Note::new("test", 1.0)).unwrap();
    let mut store = Store::open(&path).unwrap();
    let merge = store.merging_scene(&cubes(theirs), existing).unwrap();
    store.apply(merge.change.clone(), &note(2.0)).unwrap();
    drop(store);
    (merge, store::read(&path).unwrap())
}

/// The places along x of these objects.
fn places(environment: &Environment, names: &[&str]) -> Vec<f64> {
    names.iter().map(|name| environment.object(name).unwrap().world_from_object.translation.x).collect()
}

#[test]
fn repeated_names_are_paired_by_shape_then_by_the_least_sum_of_distances() {
    // By their numbers, each would take another one's place.
    let ours = [("c", 1.0, 0.0), ("c#2", 1.0, 4.0), ("c#3", 0.5, 20.0)];
    let theirs = [("c", 0.5, 21.0), ("c#2", 1.0, 4.5), ("c#3", 1.0, -1.0)];
    let (merge, now) = merged(&ours, &theirs, Existing::Replace);
    assert_eq!(places(&now, &["c", "c#2", "c#3"]), [-1.0, 4.5, 21.0]);
    assert_eq!((merge.moved.len(), merge.reshaped.len(), merge.ties.len()), (3, 0, 0));
    // By place alone, c and c#2 would change their shapes.
    let (merge, now) =
        merged(&[("c", 1.0, 0.0), ("c#2", 0.5, 1.0)], &[("c", 0.5, 0.1), ("c#2", 1.0, 0.9)], Existing::Replace);
    assert_eq!(places(&now, &["c", "c#2"]), [0.9, 0.1]);
    assert!(merge.reshaped.is_empty() && merge.ties.is_empty(), "{merge:?}");
    // One of each remains for the other, and a third one is new.
    let theirs = [("c", 2.0, 0.0), ("c#2", 1.0, 5.0), ("c#3", 1.0, 9.0)];
    let (merge, now) = merged(&[("c", 1.0, 9.0), ("c#2", 0.5, 0.0)], &theirs, Existing::Replace);
    assert_eq!((&merge.added[..], &merge.reshaped[..]), (&["c#3".to_owned()][..], &["c#2".to_owned()][..]));
    assert_eq!(places(&now, &["c", "c#2", "c#3"]), [9.0, 0.0, 5.0]);
}

#[test]
fn ties_are_reported_and_keep_names() {
    // The file's chair is as far from one as from the other.
    let (merge, _) = merged(&[("c", 1.0, 0.0), ("c#2", 1.0, 2.0)], &[("c", 1.0, 1.0)], Existing::Replace);
    assert_eq!((merge.ties, merge.missing), (vec!["c".to_owned()], vec!["c#2".to_owned()]));
    // Both ways to pair them are 2 m long; names decide.
    let ours = [("c", 1.0, 0.0), ("c#2", 1.0, 1.0)];
    let (merge, now) = merged(&ours, &[("c#2", 1.0, 3.0), ("c", 1.0, 2.0)], Existing::Replace);
    assert_eq!((merge.ties.len(), places(&now, &["c", "c#2"])), (1, vec![2.0, 3.0]));
    // What did not move is certain, and so are two that stand in each other.
    let (merge, now) = merged(&ours, &[("c", 1.0, 1.0), ("c#2", 1.0, 2.0)], Existing::Replace);
    assert_eq!((merge.ties.len(), places(&now, &["c", "c#2"])), (0, vec![2.0, 1.0]));
    let same = [("c", 1.0, 0.0), ("c#2", 1.0, 0.0)];
    let (merge, _) = merged(&same, &same, Existing::Replace);
    assert!(merge.ties.is_empty() && matches!(&merge.change, Change::Group(all) if all.is_empty()), "{merge:?}");
    let (merge, _) = merged(&same, &same[..1], Existing::Replace);
    assert_eq!((merge.ties.len(), merge.missing), (1, vec!["c#2".to_owned()]));
}

/// A repeated group is paired as a whole, and the names below it follow.
#[test]
fn repeated_groups_are_paired_as_a_whole() {
    let arm = |x: f64| [("hand", 1.0, x), ("finger", 0.5, x + 1.0), ("finger#2", 0.5, x + 2.0)];
    let names =
        |arm: &str, parts: [(&str, f32, f64); 3]| parts.map(|(part, size, x)| (format!("cell/{arm}/{part}"), size, x));
    let ours = [names("arm", arm(0.0)), names("arm#2", arm(10.0)), names("arm#3", arm(20.0))].concat();
    let theirs =
        [names("arm", arm(10.5)), names("arm#2", arm(20.0)), names("arm#3", arm(90.0)), names("arm#4", arm(-0.5))];
    let theirs = theirs.concat();
    fn lent(all: &[(String, f32, f64)]) -> Vec<(&str, f32, f64)> {
        all.iter().map(|(name, size, x)| (name.as_str(), *size, *x)).collect()
    }
    let (merge, now) = merged(&lent(&ours), &lent(&theirs), Existing::Mirror);
    let hands = ["cell/arm/hand", "cell/arm#2/hand", "cell/arm#3/hand", "cell/arm#4/hand"];
    assert_eq!(places(&now, &hands), [-0.5, 10.5, 20.0, 90.0]);
    let fingers = ["cell/arm#2/finger", "cell/arm#2/finger#2", "cell/arm#4/finger#2"];
    assert_eq!(places(&now, &fingers), [11.5, 12.5, 92.0]);
    assert_eq!((merge.added.len(), merge.moved.len(), merge.missing.len(), merge.ties.len()), (3, 6, 0, 0));
    // Numbers that are part of the names stay names: nothing is called "m".
    let (_, now) =
        merged(&[("m#2", 1.0, 0.0), ("m#3", 1.0, 5.0)], &[("m#2", 1.0, 5.0), ("m#3", 1.0, 0.0)], Existing::Mirror);
    assert_eq!(places(&now, &["m#2", "m#3"]), [5.0, 0.0]);
}

/// What a file says of its objects, without the numbers of repetitions.
fn content(environment: &Environment) -> Vec<(String, usize, String)> {
    let live = environment.objects().iter().filter(|o| !o.is_deleted());
    let size = |o: &presight::environment::Object| format!("{:?} {:?}", o.mesh.bounds(), o.world_from_object);
    let mut all: Vec<_> =
        live.map(|o| (o.name.split('#').next().unwrap().to_owned(), o.mesh.polygon_count(), size(o))).collect();
    all.sort();
    all
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    /// A mirror holds what the file holds, a second one changes nothing, and undoing it restores every bit.
    #[test]
    fn any_mirror_holds_its_file_and_can_be_undone(
        ours in proptest::collection::vec((0usize..3, 1u8..3, 0i8..6), 0..9),
        theirs in proptest::collection::vec((0usize..3, 1u8..3, 0i8..6), 0..9),
    ) {
        let environment = |all: &[(usize, u8, i8)]| {
            let mut count = [0; 3];
            let named = all.iter().map(|(name, size, x)| {
                count[*name] += 1;
                let number = if count[*name] > 1 { format!("#{}", count[*name]) } else { String::new() };
                (format!("{}{number}", ["a", "g/b", "g/c"][*name]), f32::from(*size), f64::from(*x))
            }).collect::<Vec<_>>();
            cubes(&named.iter().map(|(name, size, x)| (name.as_str(), *size, *x)).collect::<Vec<_>>())
        };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("s.presight");
        let (before, scene) = (environment(&ours), environment(&theirs));
        store::create(&path, &before, &Note::new("test", 1.0)).unwrap();
        let mut store = Store::open(&path).unwrap();
        let feature = before.objects().first().map(|o| point(1, 0.5, Some(&o.name)));
        if let Some(feature) = feature {
            let mut batch = store.batch().unwrap();
            batch.apply_unchecked(Change::InsertFeature { class: "video".into(), feature }, &note(2.0)).unwrap();
            batch.commit().unwrap();
        }
        let start = store.world().environment().content_hash();
        let merge = store.merging_scene(&scene, Existing::Mirror).unwrap();
        let number = store.apply(merge.change.clone(), &note(3.0)).unwrap();
        prop_assert_eq!(content(store.world().environment()), content(&scene));
        let live = |e: &Environment| e.objects().iter().filter(|o| !o.is_deleted()).count();
        prop_assert_eq!(merge.added.len() + live(&before), merge.missing.len() + live(&scene));
        let again = store.merging_scene(&scene, Existing::Mirror).unwrap();
        prop_assert!(matches!(&again.change, Change::Group(all) if all.is_empty()), "{:?}", again);
        store.undo(number, false, &note(4.0)).unwrap();
        prop_assert_eq!(store.world().environment().content_hash(), start);
    }
}
