//! `presight env` and stores as scenes.

use super::{create, note, numbered, presight, small};
use presight::io::store::{self, Store};
use presight::{Change, Environment, World};
use std::path::Path;
use std::process::Stdio;

fn scene() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/room.glb"))
}

/// Runs it in a folder; stdout, if it succeeds.
fn run(folder: &Path, args: &[&str]) -> String {
    let output = presight().args(args).current_dir(folder).output().unwrap();
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn json(text: &str) -> serde_json::Value {
    serde_json::from_str(text).unwrap()
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
    run(here, &["compare", "a.exr", "b.exr"]);
    run(here, &["compare", "a.exr", "b.exr", "--scene", "room.presight"]);
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
fn an_export_gives_everything_back() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    run(here, &["env", "create", "room.presight", scene().to_str().unwrap()]);
    // Turned, moved and scaled: no digit of a pose may get lost.
    let object = json(&run(here, &["env", "info", "room.presight", "--json"]))["objects"][0].clone();
    let lines = [
        serde_json::json!({"op": "move", "object": object, "pose": [4469320.1, 5333710.7, 512.3, 10.1, 20.2, 30.3]}),
        serde_json::json!({"op": "insert_object", "object": "tent", "pose": [1, 2, 3, 40, 50, 60],
            "vertices": [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0.1, 0.2, 0.7]],
            "polygons": [[0, 3, 2, 1], [0, 1, 4], [2, 3, 4]]}),
        serde_json::json!({"op": "insert_feature", "class": "a/b", "feature":
            {"id": 7, "kind": "point", "object": "tent", "points": [[0.1, 0.2, 0.7]], "sigma": 0.1}}),
    ];
    let lines = lines.map(|l| l.to_string() + "\n").concat();
    std::fs::write(here.join("c.jsonl"), lines).unwrap();
    assert_eq!(run(here, &["env", "apply", "room.presight", "c.jsonl"]), "ack 1\nack 2\nack 3\n");
    let hash = |store: &str| store::read(&here.join(store)).unwrap().content_hash().to_string();
    for (out, scene, layer) in [("dir", "dir/scene.glb", "dir/a_b.layer.json"), ("x.glb", "x.glb", "x.a_b.layer.json")]
    {
        assert_eq!(run(here, &["env", "export", "room.presight", out]), format!("{scene}\n{layer}\n"));
        let again = format!("{out}.presight");
        run(here, &["env", "create", &again, scene]);
        assert_ne!(hash(&again), hash("room.presight"), "the layer is missing");
        run(here, &["env", "import", &again, layer]);
        assert_eq!(hash(&again), hash("room.presight"));
    }
    // What another program changed counts, not what we left in the extras.
    let moved = std::fs::read(here.join("x.glb")).unwrap();
    let text = String::from_utf8_lossy(&moved).into_owned();
    let at = text.find("\"blake3\":\"").unwrap() + 10;
    let mut changed = moved.clone();
    changed[at] = if changed[at] == b'0' { b'1' } else { b'0' };
    std::fs::write(here.join("x.glb"), changed).unwrap();
    let problems = json(&run(here, &["inspect", "x.glb", "--json"]))["problems"].clone();
    assert!(problems.to_string().contains("its triangles are used"), "{problems}");
}

/// The same of any environment that glTF can carry.
#[test]
fn an_exported_environment_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("e.glb");
    let again = |environment: &Environment| {
        presight::io::gltf::write_glb(&path, environment).unwrap();
        let mut again = presight::io::gltf::import(&path, &Default::default()).unwrap().environment;
        environment.layers().iter().for_each(|l| again.add_layer(l.clone()).unwrap());
        again
    };
    assert_eq!(again(&small()).content_hash(), small().content_hash());
    let Some(hospital) = super::hospital() else { return };
    let hospital = presight::io::gltf::import(hospital, &Default::default()).unwrap().environment;
    assert_eq!(again(&hospital).content_hash(), hospital.content_hash());
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
        // Durable, not just promised: another process sees it.
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
    // Twice in one file, with empty lines, as a number.
    std::fs::write(
        here.join("d.jsonl"),
        "\n{\"op\":\"group\",\"changes\":[],\"id\":7}\n{\"op\":\"fly\",\"id\":\"7\"}\n",
    )
    .unwrap();
    assert_eq!(run(here, &["env", "apply", "env.presight", "d.jsonl"]), "ack 1\nack 2\nack 3\n");
    assert_eq!(store::info(&here.join("env.presight")).unwrap().changes, 5);
}

#[test]
fn objects_come_from_files_and_from_each_other() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    create(here, &small());
    std::fs::create_dir(here.join("parts")).unwrap();
    presight::io::gltf::write_glb(&here.join("parts/p.glb"), &small()).unwrap();
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
fn log_undo_and_check_speak_of_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let path = create(here, &small());
    let (mut store, environment) = Store::open(&path).unwrap();
    let mut world = World::new(environment);
    for k in 1..=3 {
        store.apply(&mut world, numbered(k).0, &note(k as f64)).unwrap();
    }
    let hash = world.environment().content_hash().to_string();
    store.apply(&mut world, Change::DeleteObject { name: "a".into() }, &note(4.0)).unwrap();
    drop(store);
    assert_eq!(run(here, &["env", "undo", "env.presight", "4", "--cause", "oops", "--time", "12"]), "change 5\n");
    let log: Vec<_> = run(here, &["env", "log", "env.presight", "--json"]).lines().map(json).collect();
    assert_eq!(log.len(), 5);
    assert_eq!((&log[4]["cause"], &log[4]["time"], &log[4]["undoes"]), (&"oops".into(), &12.0.into(), &4.into()));
    assert_eq!(log[3]["inverse"], log[4]["change"]);
    let words = run(here, &["env", "log", "env.presight"]);
    assert!(words.contains("1970-01-01T00:00:12.000Z  oops (undoes 4)"), "{words}");
    assert!(run(here, &["env", "check", "env.presight"]).starts_with("sound: 3 objects, 5 changes"));
    let info = json(&run(here, &["env", "info", "env.presight", "--json"]));
    assert_eq!((&info["content_hash"], &info["head"]), (&hash.into(), &log[4]["hash"]));
    let refused = presight().args(["env", "undo", "env.presight", "1"]).current_dir(here).output().unwrap();
    assert_eq!(refused.status.code(), Some(1), "3 moved it again");
}

/// A model that was exported again: nothing is overwritten unasked, and asked for it is one change that can be undone.
#[test]
fn a_scene_imported_again_replaces_what_it_is_allowed_to() {
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
    assert_eq!(replaced.feature("laser", 7), changed.feature("laser", 7), "what was learned of the object stays");
    assert_eq!(run(here, &["env", "import", "room.presight", glb, "--replace"]), "nothing to change\n");
    assert_eq!(run(here, &["env", "undo", "room.presight", "5"]), "change 6\n");
    assert_eq!(store::read(&path).unwrap().content_hash(), changed.content_hash());
    run(here, &["env", "check", "room.presight"]);
    std::fs::write(here.join("l.json"), "{}").unwrap();
    let layer = presight().args(["env", "import", "room.presight", "l.json", "--replace"]).current_dir(here).output();
    assert_eq!(layer.unwrap().status.code(), Some(2), "layers have rules of their own");
}
