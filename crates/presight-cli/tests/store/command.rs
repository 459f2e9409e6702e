//! `presight env`, and stores as scenes.

use super::exports::with_a_lost_feature;
use super::{create, note, numbered, presight, small};
use presight::store;
use presight::store::Store;
use presight::{Change, World};
use std::path::Path;
use std::process::Stdio;

pub(super) fn scene() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../scenes/room.glb"))
}

/// Runs the command in a folder; returns stdout if it succeeds.
pub(super) fn run(folder: &Path, args: &[&str]) -> String {
    let output = presight().args(args).current_dir(folder).output().unwrap();
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

pub(super) fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap()
}

/// Returns stderr of a command that ends with this status.
pub(super) fn refusal(folder: &Path, args: &[&str], status: i32) -> String {
    let output = presight().args(args).current_dir(folder).output().unwrap();
    let e = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(status), "{args:?}: {e}");
    e
}

/// Many deletions in one run leave the same store as several runs with a few deletions each. An invalid line at the end
/// does not revert them.
#[test]
fn many_deletions_at_once_equal_deletions_one_at_a_time() {
    let folder = tempfile::tempdir().unwrap();
    let (here, glb) = (folder.path(), scene().to_str().unwrap());
    run(here, &["env", "create", "whole.presight", glb]);
    run(here, &["features", "whole.presight", "--class", "video", "--out", "l.layer.json"]);
    run(here, &["env", "import", "whole.presight", "l.layer.json"]);
    let environment = Store::open(&here.join("whole.presight")).unwrap().world().environment().clone();
    let features = &environment.layer("video").unwrap().features;
    assert!(features.len() > 500 && environment.objects().len() > 100);
    let alone = features.iter().filter(|f| f.id % 7 == 0).take(60);
    let alone = alone.map(|f| format!(r#"{{"op":"delete_feature","class":"video","feature":{}}}"#, f.id));
    let objects = environment.objects().iter().take(60);
    let objects = objects.map(|o| format!(r#"{{"op":"delete_object","object":{:?}}}"#, o.name));
    let lines: Vec<String> = alone.chain(objects).collect();
    let apply = |store: &str, lines: &[String]| {
        std::fs::write(here.join("c.jsonl"), lines.join("\n") + "\n").unwrap();
        presight().args(["env", "apply", store, "c.jsonl"]).current_dir(here).output().unwrap()
    };
    for name in ["one.presight", "many.presight"] {
        std::fs::copy(here.join("whole.presight"), here.join(name)).unwrap();
    }
    for few in lines.chunks(20) {
        assert!(apply("one.presight", few).status.success());
    }
    let wrong = r#"{"op":"delete_object","object":"none"}"#.to_owned();
    let output = apply("many.presight", &[&lines[..], &[wrong]].concat());
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && said.contains("c.jsonl: line 121: "), "{said}");
    assert_eq!(String::from_utf8_lossy(&output.stdout).lines().count(), 120);
    let content = |name: &str| store::info(&here.join(name)).unwrap().environment.content_hash();
    assert_eq!(content("many.presight"), content("one.presight"));
    assert_ne!(content("many.presight"), content("whole.presight"));
    run(here, &["env", "check", "many.presight"]);
}

#[test]
fn a_store_is_a_scene() {
    let folder = tempfile::tempdir().unwrap();
    let (here, glb) = (folder.path(), scene().to_str().unwrap());
    run(here, &["env", "create", "room.presight", glb]);
    let told = |scene: &str| json(&run(here, &["inspect", scene, "--json"]));
    let (of_store, of_scene) = (told("room.presight"), told(glb));
    for key in ["content_hash", "objects", "materials", "bounds", "polygons_in_scene"] {
        assert_eq!(of_store[key], of_scene[key], "{key}");
    }
    let info = json(&run(here, &["env", "info", "room.presight", "--json"]));
    assert_eq!(info["content_hash"], of_scene["content_hash"]);
    assert_eq!(info["changes"], 0);
    assert_eq!(info["objects"].as_array().unwrap().len(), of_scene["objects"].as_array().unwrap().len());
    let pose = ["--sensor", "laser-range-camera", "--pose", "0.3,0.35,1.65,0,12,38", "--backend", "cpu"];
    for (scene, out) in [("room.presight", "a.exr"), (glb, "b.exr")] {
        run(here, &[&["predict", scene][..], &pose, &["--out", out]].concat());
    }
    // Store and file hold the same content, so nothing is said of different scenes, and either may be named.
    for more in [&[][..], &["--scene", "room.presight"], &["--scene", glb]] {
        let output =
            presight().args([&["compare", "a.exr", "b.exr"], more].concat()).current_dir(here).output().unwrap();
        assert_eq!((output.status.code(), output.stderr), (Some(0), Vec::new()), "{more:?}");
    }
    // After a change they do not.
    let change =
        serde_json::json!({"op": "move", "object": of_scene["objects"][0]["name"], "pose": [9, 9, 9, 0, 0, 0]});
    std::fs::copy(here.join("room.presight"), here.join("moved.presight")).unwrap();
    std::fs::write(here.join("c.jsonl"), format!("{change}\n")).unwrap();
    run(here, &["env", "apply", "moved.presight", "c.jsonl"]);
    run(here, &[&["predict", "moved.presight"][..], &pose, &["--out", "c.exr"]].concat());
    let output = presight().args(["compare", "a.exr", "c.exr"]).current_dir(here).output().unwrap();
    assert!(String::from_utf8_lossy(&output.stderr).contains("different sensors, poses or scenes"), "{output:?}");
    let said = refusal(here, &["compare", "a.exr", "b.exr", "--scene", "moved.presight"], 1);
    assert!(said.contains("is not the scene that a.exr was predicted from"), "{said}");
    run(here, &["features", "room.presight", "--class", "video", "--out", "l.layer.json"]);
    run(here, &["env", "import", "room.presight", "l.layer.json"]);
    assert_eq!(run(here, &["env", "import", "room.presight", "l.layer.json"]), "nothing to change\n");
    assert_eq!(run(here, &["env", "import", "room.presight", glb]), "nothing to change\n");
    run(
        here,
        &[&["predict", "room.presight"][..], &pose[2..], &["--sensor", "video-camera", "--features", "f.json"]]
            .concat(),
    );
    assert!(!json(&std::fs::read_to_string(here.join("f.json")).unwrap())["features"].as_array().unwrap().is_empty());
}

#[test]
fn each_line_is_acknowledged_before_the_next_is_sent() {
    use std::io::{BufRead, BufReader, Write};
    let folder = tempfile::tempdir().unwrap();
    let path = create(folder.path(), &small());
    let mut command = presight();
    command.args(["env", "apply"]).arg(&path).arg("-").stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let (mut stdin, mut stdout) = (child.stdin.take().unwrap(), BufReader::new(child.stdout.take().unwrap()));
    for k in 1..=10 {
        writeln!(stdin, "{}", numbered(k).1).unwrap();
        let mut ack = String::new();
        stdout.read_line(&mut ack).unwrap();
        assert_eq!(ack, format!("ack {k}\n"));
        // The change is durable: another process sees it.
        assert_eq!(store::info(&path).unwrap().changes, k);
    }
    drop(stdin);
    assert!(child.wait().unwrap().success());
}

#[test]
fn a_line_with_an_id_is_applied_once() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    create(here, &small());
    let with_id = |k: u64| numbered(k).1.replacen('{', &format!("{{\"id\":\"n{k}\","), 1);
    let lines: String = (1..=4).map(|k| with_id(k) + "\n").collect();
    std::fs::write(here.join("c.jsonl"), &lines).unwrap();
    let acks = "ack 1\nack 2\nack 3\nack 4\n";
    assert_eq!(run(here, &["env", "apply", "env.presight", "c.jsonl"]), acks);
    let once = store::info(&here.join("env.presight")).unwrap();
    assert_eq!(run(here, &["env", "apply", "env.presight", "c.jsonl"]), acks);
    let twice = store::info(&here.join("env.presight")).unwrap();
    assert_eq!((once.changes, once.head), (twice.changes, twice.head));
    // The same id twice in one file, with empty lines between, as a number.
    std::fs::write(
        here.join("d.jsonl"),
        "\n{\"op\":\"group\",\"changes\":[],\"id\":7}\n{\"id\":\"7\",\"changes\":[],\"op\":\"group\",\"cause\":\"again\"}\n",
    )
    .unwrap();
    assert_eq!(run(here, &["env", "apply", "env.presight", "d.jsonl"]), "ack 1\nack 2\nack 3\n");
    assert_eq!(store::info(&here.join("env.presight")).unwrap().changes, 5);
}

/// An id names one change: a different change under the same id is refused, never dropped silently.
#[test]
fn another_change_under_a_known_id_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    create(here, &small());
    presight::files::write_glb(&here.join("p.glb"), &small()).unwrap();
    let lines = [
        r#"{"id":"m","op":"move","object":"a","pose":[1,2,3,0,0,90]}"#,
        r#"{"id":"d","op":"delete_object","object":"b/lid"}"#,
        r#"{"id":"f","op":"insert_object","object":"x","from":"p.glb","from_object":"a"}"#,
        r#"{"id":"l","op":"insert_object","object":"y","like":"x"}"#,
        r#"{"id":"v","op":"insert_object","object":"z","vertices":[[0,0,0],[1,0,0],[0,1,0]],"polygons":[[0,1,2]]}"#,
        r#"{"id":"p","op":"insert_feature","class":"video","feature":{"id":7,"kind":"point","object":"z","points":[[0,0,0]],"sigma":1}}"#,
        r#"{"id":"g","op":"group","changes":[{"op":"add_material","name":"tin"},{"op":"delete_object","object":"x"}]}"#,
        r#"{"id":"s","op":"set_group","group":"g","pose":[1,0,0,0,0,0]}"#,
    ];
    let apply = |text: &str| {
        std::fs::write(here.join("c.jsonl"), text).unwrap();
        presight().args(["env", "apply", "env.presight", "c.jsonl"]).current_dir(here).output().unwrap()
    };
    let all = lines.map(|line| format!("{line}\n")).concat();
    let acks: String = (1..=lines.len()).map(|k| format!("ack {k}\n")).collect();
    let hash = || store::check(&here.join("env.presight")).unwrap().environment.content_hash();
    for _ in 0..2 {
        let output = apply(&all);
        assert_eq!(String::from_utf8_lossy(&output.stdout), acks, "{}", String::from_utf8_lossy(&output.stderr));
        assert_eq!(store::info(&here.join("env.presight")).unwrap().changes, lines.len() as u64);
    }
    let before = hash();
    // The same change written differently: keys in another order, another form of the pose, and a cause.
    let same = r#"{"pose":[1.0,2,3,0,0,0.7071067811865475,0.7071067811865476],"cause":"again","object":"a","op":"move","id":"m"}"#;
    let rotation = presight::Pose::from_xyz_rpy(glam::DVec3::ZERO, 0.0, 0.0, 90f64.to_radians()).rotation;
    let same =
        same.replace("0,0,0.7071067811865475,0.7071067811865476", &format!("0,0,{:?},{:?}", rotation.z, rotation.w));
    assert_eq!(apply(&same).stdout, b"ack 1\n", "{}", String::from_utf8_lossy(&apply(&same).stderr));
    let others = [
        (1, r#"{"id":"m","op":"move","object":"a","pose":[1,2,3,0,0,91]}"#),
        (1, r#"{"id":"m","op":"set_pose","object":"a","pose":[1,2,3,0,0,90]}"#),
        (2, r#"{"id":"d","op":"delete_object","object":"b"}"#),
        (3, r#"{"id":"f","op":"insert_object","object":"x","from":"p.glb","from_object":"b"}"#),
        (4, r#"{"id":"l","op":"insert_object","object":"y","like":"a"}"#),
        (
            5,
            r#"{"id":"v","op":"insert_object","object":"z","vertices":[[0,0,0],[2,0,0],[0,1,0]],"polygons":[[0,1,2]]}"#,
        ),
        (
            6,
            r#"{"id":"p","op":"insert_feature","class":"video","feature":{"id":7,"kind":"point","object":"z","points":[[0,0,0]],"sigma":2}}"#,
        ),
        (
            7,
            r#"{"id":"g","op":"group","changes":[{"op":"add_material","name":"zinc"},{"op":"delete_object","object":"x"}]}"#,
        ),
        (8, r#"{"id":"s","op":"set_group","group":"g"}"#),
    ];
    for (number, line) in others {
        let output = apply(&format!("\n{line}\n"));
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), output.stdout.as_slice()), (Some(1), &b"ack 1\n"[..]), "{line}: {message}");
        let id = &line[6..9];
        assert!(message.contains(&format!("c.jsonl: line 2: id {id} belongs to change {number}")), "{line}: {message}");
        assert_eq!(hash(), before, "{line}");
    }
}

/// The same holds for programs that use the library and for entries that older versions wrote.
#[test]
fn changes_of_the_library_are_known_by_their_ids() {
    let folder = tempfile::tempdir().unwrap();
    let path = create(folder.path(), &small());
    let mut store = Store::open(&path).unwrap();
    let named = |id: &str| store::Note { id: Some(id.to_owned()), ..note(1.0) };
    let new = |name: &str, size| {
        let mesh = super::block("new", size, [0; 6]);
        Change::InsertObject(presight::environment::NewObject::new(name, super::at(1.0, 0.0, 0.0), mesh))
    };
    let delete = |name: &str| Change::DeleteObject { name: name.into() };
    assert_eq!(store.apply(new("x", 1.0), &named("n")).unwrap(), 1);
    assert_eq!(store.apply(delete("a"), &named("d")).unwrap(), 2);
    // Creates the store again, as after a crash.
    assert_eq!(store.apply(new("x", 1.0), &named("n")).unwrap(), 1);
    assert_eq!(store.apply(delete("a"), &named("d")).unwrap(), 2);
    for (change, id) in [(new("x", 2.0), "n"), (new("z", 1.0), "n"), (delete("b"), "d"), (new("x", 1.0), "d")] {
        let e = store.apply(change, &named(id)).unwrap_err();
        assert!(
            e.kind() == presight::ErrorKind::Invalid && e.to_string().contains(&format!("id {id:?} belongs to change")),
            "{e}"
        );
    }
    assert_eq!(store.changes(), 2);
    // A line that repeats such an entry.
    let mut batch = store.batch().unwrap();
    let mut line = |text: &str| batch.apply_line(text, Path::new("."), &note(2.0));
    assert_eq!(line(r#"{"op":"delete_object","object":"a","id":"d"}"#).unwrap(), (2, false));
    assert!(line(r#"{"op":"delete_object","object":"b","id":"d"}"#).is_err());
    assert_eq!(
        line(r#"{"op":"insert_object","object":"x","pose":[1,0,-0.0,0,0,0,1],"like":"b","id":"n"}"#).unwrap(),
        (1, false)
    );
    assert!(line(r#"{"op":"insert_object","object":"y","like":"b","id":"n"}"#).is_err());
}

#[test]
fn objects_come_from_files_and_from_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    create(here, &small());
    std::fs::create_dir(here.join("parts")).unwrap();
    presight::files::write_glb(&here.join("parts/p.glb"), &small()).unwrap();
    let lines = r#"{"op":"insert_object","object":"x","pose":[1,2,3,0,0,0],"from":"p.glb","from_object":"b/lid"}
{"op":"insert_object","object":"y","pose":[1,2,4,0,0,0],"like":"x"}
{"op":"add_material","name":"tin","reflection":0.9,"classes":{"radar":"opaque","laser":"invisible"}}
{"op":"insert_object","object":"z","vertices":[[0,0,0],[1,0,0],[0,1,0]],"polygons":[[0,1,2]],"material":"tin"}
"#;
    std::fs::write(here.join("parts/c.jsonl"), lines).unwrap();
    run(here, &["env", "apply", "env.presight", "parts/c.jsonl"]);
    let environment = store::read(&here.join("env.presight")).unwrap();
    let object = |name: &str| environment.object(name).unwrap();
    assert!(std::sync::Arc::ptr_eq(&object("x").mesh, &object("y").mesh), "one mesh, stored once");
    assert_eq!(object("x").mesh.polygon_count(), 6);
    let tin = &environment.materials()[usize::from(object("z").mesh.material(0))];
    assert_eq!((tin.name.as_str(), tin.reflection), ("tin", 0.9));
}

#[test]
fn log_undo_and_check_use_the_same_numbers() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let path = create(here, &small());
    let mut store = Store::open(&path).unwrap();
    for k in 1..=3 {
        store.apply(numbered(k).0, &note(k as f64)).unwrap();
    }
    let hash = store.world().environment().content_hash().to_string();
    store.apply(Change::DeleteObject { name: "a".into() }, &note(4.0)).unwrap();
    drop(store);
    assert_eq!(run(here, &["env", "undo", "env.presight", "4", "--cause", "oops", "--time", "12"]), "change 5\n");
    let log: Vec<_> = run(here, &["env", "log", "env.presight", "--json"]).lines().map(json).collect();
    assert_eq!(log.len(), 5);
    assert_eq!((&log[4]["cause"], &log[4]["time"], &log[4]["undoes"]), (&"oops".into(), &12.0.into(), &4.into()));
    assert_eq!(log[3]["inverse"], log[4]["change"]);
    let words = run(here, &["env", "log", "env.presight"]);
    assert!(words.contains("1970-01-01T00:00:12.000Z  oops (undoes 4)"), "{words}");
    assert!(run(here, &["env", "check", "env.presight"]).starts_with("sound: 5 objects, 5 changes"));
    let info = json(&run(here, &["env", "info", "env.presight", "--json"]));
    assert_eq!((&info["content_hash"], &info["head"]), (&hash.into(), &log[4]["hash"]));
    let refused = presight().args(["env", "undo", "env.presight", "1"]).current_dir(here).output().unwrap();
    assert_eq!(refused.status.code(), Some(1), "3 moved it again");
}

/// Importing a re-exported model overwrites only with the flag, and then as one change, which can be undone.
#[test]
fn a_scene_imported_again_replaces_objects_only_on_request() {
    let folder = tempfile::tempdir().unwrap();
    let (here, glb) = (folder.path(), scene().to_str().unwrap());
    run(here, &["env", "create", "room.presight", glb]);
    let path = here.join("room.presight");
    let fresh = store::read(&path).unwrap();
    let [moved, reshaped] = [0, 1].map(|i| fresh.objects()[i].name.clone());
    let lines = [
        serde_json::json!({"op": "move", "object": moved, "pose": [1, 2, 3, 0, 0, 90]}),
        serde_json::json!({"op": "delete_object", "object": reshaped}),
        serde_json::json!({"op": "insert_object", "object": reshaped, "vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
            "polygons": [[0, 1, 2]]}),
        serde_json::json!({"op": "insert_feature", "class": "laser", "feature":
            {"id": 7, "kind": "point", "object": reshaped, "points": [[0, 0, 0]], "sigma": 0.1}}),
    ];
    std::fs::write(here.join("c.jsonl"), lines.map(|l| l.to_string() + "\n").concat()).unwrap();
    run(here, &["env", "apply", "room.presight", "c.jsonl"]);
    let changed = store::read(&path).unwrap();
    let refused = presight().args(["env", "import", "room.presight", glb]).current_dir(here).output().unwrap();
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(1));
    assert!(message.contains("--replace") && message.contains(&moved), "{message}");
    assert_eq!(store::read(&path).unwrap().content_hash(), changed.content_hash());
    assert_eq!(run(here, &["env", "import", "room.presight", glb, "--replace"]), "change 5\n");
    let replaced = store::read(&path).unwrap();
    for name in [&moved, &reshaped] {
        let [is, was] = [&replaced, &fresh].map(|e| e.object(name).unwrap());
        assert_eq!(is.world_from_object, was.world_from_object, "{name}");
        assert_eq!(is.mesh.vertices(), was.mesh.vertices(), "{name}");
    }
    assert_eq!(replaced.feature("laser", 7), changed.feature("laser", 7), "features learned on the object stay");
    assert_eq!(run(here, &["env", "import", "room.presight", glb, "--replace"]), "nothing to change\n");
    assert_eq!(run(here, &["env", "undo", "room.presight", "5"]), "change 6\n");
    assert_eq!(store::read(&path).unwrap().content_hash(), changed.content_hash());
    run(here, &["env", "check", "room.presight"]);
    std::fs::write(here.join("l.json"), "{}").unwrap();
    let layer = presight().args(["env", "import", "room.presight", "l.json", "--replace"]).current_dir(here).output();
    assert_eq!(layer.unwrap().status.code(), Some(2), "layers have rules of their own");
}

/// A feature whose surface moved away is kept but not predicted, and reported. A new feature must lie on a surface.
#[test]
fn features_that_lost_their_surface_are_kept_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    create(here, &small());
    let predict = |more: &[&str]| {
        let args =
            ["predict", "env.presight", "--sensor", "video-camera", "--pose", "-3,0,0.4,0,0,0", "--backend", "cpu"];
        presight().args([&args[..], more].concat()).current_dir(here).output().unwrap()
    };
    let seen = || {
        let output = predict(&["--features", "f.json", "--repeat", "2", "--stats", "s.json"]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let read = |name: &str| json(&std::fs::read_to_string(here.join(name)).unwrap());
        let ids: Vec<_> =
            read("f.json")["features"].as_array().unwrap().iter().map(|f| f["id"].as_u64().unwrap()).collect();
        let count = read("s.json")["counts"]["features off their polygons"].as_u64();
        (ids, count, String::from_utf8(output.stderr).unwrap())
    };
    assert_eq!(seen(), (vec![2, 5], None, String::new()));
    assert_eq!(run(here, &["env", "check", "env.presight"]), "sound: 5 objects, 0 changes\n");
    std::fs::write(here.join("c.jsonl"), "{\"op\":\"move\",\"object\":\"floor\",\"pose\":[0,0,-9,0,0,0]}\n").unwrap();
    run(here, &["env", "apply", "env.presight", "c.jsonl"]);
    let (ids, count, said) = seen();
    assert_eq!((ids, count), (vec![2], Some(1)));
    assert!(said.starts_with("note: 1 feature for class \"video\" left out") && said.contains("(5)"), "{said}");
    assert_eq!(said.lines().count(), 1, "{said}");
    let checked = run(here, &["env", "check", "env.presight"]);
    assert!(
        checked.starts_with("sound: 5 objects, 1 changes\n1 features that no longer lie on a polygon"),
        "{checked}"
    );
    assert!(checked.contains("class \"video\": feature 5 \"p5\": the point is"), "{checked}");
    let problems = json(&run(here, &["inspect", "env.presight", "--json"]))["problems"].clone();
    assert_eq!((&problems[0]["kind"], &problems[0]["total"]), (&"lost_feature".into(), &1.into()), "{problems}");
    // Undoing restores the feature.
    run(here, &["env", "undo", "env.presight", "1"]);
    assert_eq!(seen(), (vec![2, 5], None, String::new()));
    // A given layer file must be valid by its own tolerance, even together with the scene's features.
    let layer = |points: &str| {
        let text = format!(
            r#"{{"format":1,"class":"video","features":[{{"id":9,"kind":"point","name":"n","points":{points}}}]}}"#
        );
        std::fs::write(here.join("l.json"), text).unwrap();
    };
    layer("[[0.5,0.5,0]]");
    assert!(predict(&["--layer", "l.json"]).status.success());
    layer("[[0.5,0.5,3]]");
    for output in [
        predict(&["--layer", "l.json"]),
        presight().args(["env", "import", "env.presight", "l.json"]).current_dir(here).output().unwrap(),
    ] {
        let message = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(
            message.starts_with("error: l.json: ")
                && message.contains(": feature 9 \"n\": the point is 2.000000 m off"),
            "{message}"
        );
    }
    let object = r#"{"format":1,"class":"video","features":[],"pose_covariances":{"door":[1,0,0,0,0,0,0,1,0,0,0,0,0,0,1,0,0,0,0,0,0,1,0,0,0,0,0,0,1,0,0,0,0,0,0,1]}}"#;
    std::fs::write(here.join("l.json"), object).unwrap();
    let output = predict(&["--layer", "l.json"]);
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(
        output.status.code() == Some(1) && message.contains("l.json: pose covariance of object \"door\""),
        "{message}"
    );
}

/// A path that is only a group, not an object, can be moved and deleted with everything below it.
#[test]
fn groups_are_listed_moved_and_deleted() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    create(here, &small());
    let info = |key: &str| json(&run(here, &["env", "info", "env.presight", "--json"]))[key].clone();
    assert_eq!(info("groups"), serde_json::json!(["g", "g/h"]));
    assert!(run(here, &["env", "info", "env.presight"]).contains("groups     2\n"));
    assert!(run(here, &["inspect", "env.presight"]).contains("objects    5 in 2 groups\n"));
    let groups = json(&run(here, &["inspect", "env.presight", "--json"]))["groups"].clone();
    assert_eq!((&groups[1]["name"], &groups[1]["world_from_group"][1]), (&"g/h".into(), &0.5.into()));
    let before = store::read(&here.join("env.presight")).unwrap();
    let lines =
        "{\"op\":\"move\",\"object\":\"g\",\"pose\":[0,0,5,0,0,0]}\n{\"op\":\"delete_object\",\"object\":\"g/h\"}\n";
    std::fs::write(here.join("c.jsonl"), lines).unwrap();
    assert_eq!(run(here, &["env", "apply", "env.presight", "c.jsonl"]), "ack 1\nack 2\n");
    assert_eq!((info("groups"), info("objects").as_array().unwrap().len()), (serde_json::json!([]), 4));
    run(here, &["env", "undo", "env.presight", "2"]);
    let moved = store::read(&here.join("env.presight")).unwrap();
    for path in ["g", "g/h", "g/h/y"] {
        let [is, was] = [&moved, &before].map(|e| e.frame(path).unwrap().translation);
        assert!((is - was - glam::DVec3::new(0.0, 0.0, 5.0)).length() < 1e-12, "{path}: {is} {was}");
    }
    run(here, &["env", "undo", "env.presight", "1"]);
    assert_eq!(store::read(&here.join("env.presight")).unwrap().content_hash(), before.content_hash());
}

/// A merged scene brings its frames, which must match existing ones in the same way as objects must.
#[test]
fn a_scene_brings_its_groups_along() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    create(here, &small());
    let mut other = small();
    other.set_frame("g", Some(super::at(1.0, 2.0, 3.0))).unwrap();
    presight::files::write_glb(&here.join("o.glb"), &other).unwrap();
    assert_eq!(run(here, &["env", "import", "env.presight", "o.glb"]), "change 1\n");
    assert_eq!(run(here, &["env", "import", "env.presight", "o.glb"]), "nothing to change\n");
    let read = || store::check(&here.join("env.presight")).unwrap().environment;
    assert_eq!(read().frame("g"), Some(super::at(1.0, 2.0, 3.0)));
    other.set_frame("g", Some(super::at(1.0, 2.0, 4.0))).unwrap();
    presight::files::write_glb(&here.join("o.glb"), &other).unwrap();
    let refused = presight().args(["env", "import", "env.presight", "o.glb"]).current_dir(here).output().unwrap();
    let message = String::from_utf8(refused.stderr).unwrap();
    assert!(
        refused.status.code() == Some(1) && message.contains("o.glb: group \"g\"") && message.contains("--replace"),
        "{message}"
    );
    assert_eq!(run(here, &["env", "import", "env.presight", "o.glb", "--replace"]), "change 2\n");
    assert_eq!(read().content_hash(), other.content_hash());
}

#[test]
fn changes_come_with_marks_through_pipes_and_from_stdin() {
    use std::io::Write;
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    create(here, &small());
    let line = "{\"op\":\"delete_object\",\"object\":\"a\"}\n";
    std::fs::write(here.join("c.jsonl"), format!("\u{feff}{line}")).unwrap();
    assert_eq!(run(here, &["env", "apply", "env.presight", "c.jsonl"]), "ack 1\n");
    let given = |line: &str| {
        let mut command = presight();
        command.args(["env", "apply", "env.presight", "-"]).current_dir(here);
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        child.stdin.take().unwrap().write_all(line.as_bytes()).unwrap();
        child.wait_with_output().unwrap()
    };
    assert_eq!(given(&line.replace("\"a\"", "\"b\"")).stdout, b"ack 1\n");
    let message = String::from_utf8(given(line).stderr).unwrap();
    assert!(message.starts_with("error: stdin: line 1: "), "{message}");
    let log = run(here, &["env", "log", "env.presight"]);
    assert!(log.contains("  c.jsonl line 1: ") && log.contains("  stdin line 1: "), "{log}");
}

/// Deleted objects do not count as visible objects.
#[test]
fn deleted_objects_are_not_counted() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let mut world = World::new(small());
    for name in ["a", "b", "b/lid", "floor", "g", ""] {
        let _ = std::fs::remove_file(here.join("env.presight"));
        create(here, world.environment());
        let pose = ["--pose", "-9,0,0,0,0,180", "--backend", "cpu"];
        let told = run(here, &[&["predict", "env.presight", "--sensor", "laser-scanner"][..], &pose].concat());
        let there = world.environment().objects().iter().filter(|o| !o.is_deleted()).count();
        assert!(told.contains(&format!("0 of {there} objects seen")), "{told}");
        if !name.is_empty() {
            world.apply(Change::DeleteObject { name: name.into() }).unwrap();
        }
    }
}

#[test]
fn changes_of_a_group_see_those_before_them() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    with_a_lost_feature(here);
    let before = store::read(&here.join("s.presight")).unwrap().content_hash();
    let apply = |changes: &str, status: i32| {
        let line = format!(r#"{{"op":"group","changes":[{changes}]}}"#);
        std::fs::write(here.join("g.jsonl"), line).unwrap();
        if status == 0 {
            assert_eq!(run(here, &["env", "apply", "s.presight", "g.jsonl"]), "ack 1\n", "{changes}");
            return String::new();
        }
        refusal(here, &["env", "apply", "s.presight", "g.jsonl"], status)
    };
    let insert = |name: &str, like: &str| format!(r#"{{"op":"insert_object","object":"{name}","like":"{like}"}}"#);
    let delete = |name: &str| format!(r#"{{"op":"delete_object","object":"{name}"}}"#);
    let (c, d) = (delete("c"), delete("d"));
    for (changes, what) in [
        (format!("{d},{}", insert("z", "d")), "change 2 of the group: object \"z\": there is no object \"d\""),
        (
            format!("{},{}", insert("n", "d"), insert("n", "c")),
            "change 2 of the group: object \"n\": it already exists",
        ),
        (
            format!("{},{}", insert("m", "n"), insert("n", "d")),
            "change 1 of the group: object \"m\": there is no object",
        ),
        (format!("{c},{{\"op\":\"group\",\"changes\":[{}]}}", insert("z", "c")), "there is no object \"c\""),
        (insert("a//b", "d"), "is not a valid object name"),
        (insert("/a", "d"), "is not a valid object name"),
        (insert("a/", "d"), "is not a valid object name"),
        (insert("a\\u0000", "d"), "is not a valid object name"),
    ] {
        let e = apply(&changes, 1);
        assert!(e.contains(what), "{changes}: {e}");
        assert_eq!(store::read(&here.join("s.presight")).unwrap().content_hash(), before, "{changes}");
    }
    apply(&format!("{c},{}", insert("c", "d")), 0);
    apply(&format!("{},{}", insert("n", "d"), insert("m", "n")), 0);
    // A material of the group is found by its name and stored only once.
    let tent = r#"{"op":"insert_object","object":"tent","vertices":[[0,0,0],[1,0,0],[0,1,0]],"polygons":[[0,1,2]],"material":"tin"}"#;
    apply(
        &format!(r#"{{"op":"group","changes":[{{"op":"add_material","name":"tin"}},{}]}},{tent}"#, insert("l", "m")),
        0,
    );
    let after = store::read(&here.join("s.presight")).unwrap();
    let polygons = |name: &str| after.object(name).unwrap().mesh.polygon_count();
    assert!(["c", "n", "m", "l"].iter().all(|name| polygons(name) == polygons("d")));
    assert_eq!(after.materials().iter().filter(|m| m.name == "tin").count(), 1);
    // All changes can be undone and verified.
    for change in ["6", "5", "4"] {
        run(here, &["env", "undo", "s.presight", change]);
    }
    run(here, &["env", "check", "s.presight"]);
    assert_eq!(store::read(&here.join("s.presight")).unwrap().content_hash(), before);
}
