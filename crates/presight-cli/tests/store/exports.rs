//! `presight env export`, and importing the export again.

use super::command::{json, refusal, run, scene};
use super::{create, environment_of, presight, small};
use presight::environment::Environment;
use presight::store;
use presight::{Change, World};
use std::path::Path;

#[test]
fn an_export_gives_everything_back() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    run(here, &["env", "create", "room.presight", scene().to_str().unwrap()]);
    // The object is rotated, moved and scaled: every digit of its pose must survive.
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
    for (out, scene, layer) in
        [("dir", "dir/scene.glb", "dir/a%2Fb.layer.json"), ("x.glb", "x.glb", "x.a%2Fb.layer.json")]
    {
        assert_eq!(run(here, &["env", "export", "room.presight", out]), format!("{scene}\n{layer}\n"));
        let again = format!("{out}.presight");
        run(here, &["env", "create", &again, scene]);
        assert_ne!(hash(&again), hash("room.presight"), "the layer is missing");
        run(here, &["env", "import", &again, layer]);
        assert_eq!(hash(&again), hash("room.presight"));
    }
    // A change by another program takes precedence over our extras.
    let moved = std::fs::read(here.join("x.glb")).unwrap();
    let text = String::from_utf8_lossy(&moved).into_owned();
    let at = text.find("\"blake3\":\"").unwrap() + 10;
    let mut changed = moved.clone();
    changed[at] = if changed[at] == b'0' { b'1' } else { b'0' };
    std::fs::write(here.join("x.glb"), changed).unwrap();
    let problems = json(&run(here, &["inspect", "x.glb", "--json"]))["problems"].clone();
    assert!(problems.to_string().contains("its triangles are used"), "{problems}");
}

/// The same holds for any environment that glTF can represent.
#[test]
fn an_exported_environment_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("e.glb");
    let again = |environment: &Environment| {
        presight::files::write_glb(&path, environment).unwrap();
        let mut again = environment_of(&path);
        environment.layers().iter().for_each(|l| again.add_layer(l.clone()).unwrap());
        again
    };
    assert_eq!(again(&small()).content_hash(), small().content_hash());
    let Some(hospital) = super::hospital() else { return };
    let hospital = environment_of(hospital);
    let back = again(&hospital);
    assert_eq!(back.content_hash(), hospital.content_hash());
    assert_eq!((hospital.groups().len(), back.groups()), (143, hospital.groups()));
    // Planted fault: a lost frame is noticed.
    let mut without = hospital.clone();
    let path = hospital.framed_groups().last().unwrap().0.to_owned();
    without.set_frame(&path, None).unwrap();
    assert_ne!(again(&without).content_hash(), hospital.content_hash());
}

/// A move by another program also takes precedence for groups.
#[test]
fn a_group_that_another_program_moved_stays_moved() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("e.glb");
    presight::files::write_glb(&path, &small()).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let at = |text: &str| bytes.windows(text.len()).position(|w| w == text.as_bytes()).unwrap();
    // The replacement has the same length: y of the group in the matrix, z in glTF.
    let (number, from) = (b",-0.5,1.0]", at("\"world_from_group\""));
    let from = from + bytes[from..].windows(number.len()).position(|w| w == number).unwrap();
    let mut moved = bytes.clone();
    moved[from + 2..from + 5].copy_from_slice(b"7.5");
    std::fs::write(&path, moved).unwrap();
    let again = environment_of(&path);
    let frame = again.frame("g/h").unwrap().translation;
    assert!((frame - glam::DVec3::new(-3.0, 7.5, 0.0)).length() < 1e-12, "{frame}");
    assert_eq!(again.frame("g/h/y"), small().frame("g/h/y"));
}

/// An environment that cannot be imported again is not exported.
#[test]
fn an_environment_without_polygons_is_not_exported() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    create(here, &Environment::new());
    for out in ["x.glb", "dir"] {
        let output = presight().args(["env", "export", "env.presight", out]).current_dir(here).output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(
            output.status.code() == Some(1) && message.contains("env.presight: the environment has no polygons"),
            "{message}"
        );
        assert!(!here.join("x.glb").exists() && !here.join("dir/scene.glb").exists());
    }
}

/// Classes whose names differ only in special characters get separate files.
#[test]
fn classes_with_similar_names_are_exported_separately() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let mut world = World::new(small());
    for (class, x) in [("a/b", 0.25), ("a_b", 0.75)] {
        world.apply(Change::InsertFeature { class: class.into(), feature: super::point(1, x, None) }).unwrap();
    }
    create(here, world.environment());
    let told = run(here, &["env", "export", "env.presight", "x.glb"]);
    assert_eq!(told, "x.glb\nx.a%2Fb.layer.json\nx.a_b.layer.json\nx.video.layer.json\n");
    run(here, &["env", "create", "y.presight", "x.glb"]);
    for layer in told.lines().skip(1) {
        run(here, &["env", "import", "y.presight", layer]);
    }
    assert_eq!(store::read(&here.join("y.presight")).unwrap().content_hash(), world.environment().content_hash());
}

/// Two boxes; `c` has a feature on its top and is moved away.
pub(super) fn with_a_lost_feature(here: &Path) {
    std::fs::write(here.join("d.rhai"), "place(\"c\", box(1,1,1)); place(\"d\", box(2,2,2), pose(5,0,0));").unwrap();
    run(here, &["env", "create", "s.presight", "d.rhai"]);
    let feature = |id: u32, x: f64, z: f64| {
        format!(
            r#"{{"op":"insert_feature","class":"video","feature":{{"id":{id},"kind":"point","points":[[{x},0.25,{z}]]}}}}"#
        )
    };
    let lines =
        [feature(1, 0.25, 1.0), feature(2, 5.25, 2.0), r#"{"op":"move","object":"c","pose":[9,9,0,0,0,0]}"#.to_owned()];
    std::fs::write(here.join("c.jsonl"), lines.join("\n")).unwrap();
    run(here, &["env", "apply", "s.presight", "c.jsonl"]);
}

#[test]
fn features_that_lost_their_surface_travel_marked() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    with_a_lost_feature(here);
    run(here, &["env", "export", "s.presight", "out"]);
    let layer = std::fs::read_to_string(here.join("out/video.layer.json")).unwrap();
    assert_eq!(layer.matches(r#""surface":"lost""#).count(), 1, "{layer}");
    assert_eq!(presight::files::parse_layer(&layer).unwrap().lost, [1]);
    let hash = |store: &str| store::read(&here.join(store)).unwrap().content_hash();
    for from in ["out/video.layer.json", "s.presight"] {
        run(here, &["env", "create", "t.presight", "out/scene.glb"]);
        run(here, &["env", "import", "t.presight", from]);
        assert_eq!(hash("t.presight"), hash("s.presight"), "{from}");
        assert_eq!(run(here, &["env", "import", "t.presight", from]), "nothing to change\n");
        std::fs::remove_file(here.join("t.presight")).unwrap();
    }
    let predict = ["predict", "out/scene.glb", "--sensor", "video-camera", "--pose", "3,0,1,0,0,0", "--backend", "cpu"];
    let told = presight()
        .args([&predict[..], &["--layer", "out/video.layer.json", "--features", "f.json"]].concat())
        .current_dir(here)
        .output()
        .unwrap();
    let notice = String::from_utf8_lossy(&told.stderr).into_owned();
    assert!(told.status.success() && notice.contains("1 feature for class \"video\" left out"), "{notice}");
    // Planted faults: without the mark the feature is refused, and so is another feature off its surface. Changes
    // cannot carry marks.
    run(here, &["env", "create", "t.presight", "out/scene.glb"]);
    let unmarked = layer.replace(r#","surface":"lost""#, "");
    std::fs::write(here.join("u.layer.json"), &unmarked).unwrap();
    let other = layer.replace("[[5.25,", "[[7.25,");
    assert_ne!(other, layer);
    std::fs::write(here.join("o.layer.json"), &other).unwrap();
    for (file, id) in [("u.layer.json", "feature 1"), ("o.layer.json", "feature 2")] {
        let e = refusal(here, &["env", "import", "t.presight", file], 1);
        assert!(e.contains(id), "{e}");
        let e = refusal(here, &[&predict[..], &["--layer", file]].concat(), 1);
        assert!(e.contains(id), "{e}");
    }
    let line = r#"{"op":"insert_feature","class":"video","feature":{"id":3,"kind":"point","points":[[0,0,9]],"surface":"lost"}}"#;
    std::fs::write(here.join("m.jsonl"), line).unwrap();
    let e = refusal(here, &["env", "apply", "t.presight", "m.jsonl"], 1);
    assert!(e.contains("is only for layer files"), "{e}");
    // A mark on a feature that does lie on a polygon is harmless.
    std::fs::write(
        here.join("all.layer.json"),
        layer.replace("[[5.25,0.25,2.0]]", r#"[[5.25,0.25,2.0]],"surface":"lost""#),
    )
    .unwrap();
    run(here, &["env", "import", "t.presight", "all.layer.json"]);
    assert_eq!(hash("t.presight"), hash("s.presight"));
}

#[test]
fn layers_of_an_earlier_export_are_refused_or_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    with_a_lost_feature(here);
    for (out, scene, layer) in
        [("out", "out/scene.glb", "out/video.layer.json"), ("x.glb", "x.glb", "x.video.layer.json")]
    {
        run(here, &["env", "export", "s.presight", out]);
        // The export over its own earlier files.
        run(here, &["env", "export", "s.presight", out]);
        run(here, &["env", "create", "t.presight", scene]);
        let before = std::fs::read(here.join(scene)).unwrap();
        std::fs::write(here.join("one.rhai"), "place(\"c\", box(1,1,1));").unwrap();
        run(here, &["env", "create", "one.presight", "one.rhai"]);
        let e = refusal(here, &["env", "export", "one.presight", out], 1);
        assert!(e.contains("video.layer.json") && e.contains("move or delete them"), "{e}");
        assert_eq!(std::fs::read(here.join(scene)).unwrap(), before, "nothing was written");
        std::fs::remove_file(here.join(layer)).unwrap();
        run(here, &["env", "export", "one.presight", out]);
        std::fs::remove_file(here.join("t.presight")).unwrap();
        std::fs::remove_file(here.join("one.presight")).unwrap();
    }
    // The layers of x.y.glb do not belong to x.glb.
    run(here, &["env", "export", "s.presight", "x.y.glb"]);
    run(here, &["env", "create", "one.presight", "one.rhai"]);
    run(here, &["env", "export", "one.presight", "x.glb"]);
}
