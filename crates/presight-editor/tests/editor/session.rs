//! The session: frames, picks, steps, saving, crashes, stores and the map.

use super::{POSE, ask, parts, refusal, scene, session_of, session_with, step};
use presight::features::{GenerateOptions, generate};
use presight::files;
use presight::{Backend, Options, Pose, Predictor, Request, Scene, SensorPose};
use presight_editor::{Answer, Session};
use presight_studies::worth::{Worth, WorthOptions};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};

/// A folder with a generated layer of the room.
fn room() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.video.layer.json");
    let room = Scene::open(scene("room.glb")).unwrap();
    let made = generate(room.world.environment(), "video", &GenerateOptions::default()).unwrap();
    files::write_layer(&path, &made.layer).unwrap();
    (folder, path)
}

fn edit(path: &Path) -> Session {
    session_of(&scene("room.glb"), Some(path), path.parent().unwrap()).unwrap()
}

fn drop_of(ids: &[u32]) -> Value {
    let one = |id: &u32| json!({ "op": "delete_feature", "class": "video", "feature": id });
    json!({ "change": { "op": "group", "changes": ids.iter().map(one).collect::<Vec<_>>() }, "label": "drop" })
}

/// The pixel of the image's middle offers candidates; the first becomes a feature.
fn insert_one(session: &mut Session) -> (u32, Value) {
    let (picked, _) =
        parts(session.answer("pick", json!({ "pose": POSE, "pixel": [300, 330] }).to_string().as_bytes()));
    let id = ask(session, "state", Value::Null)["next_id"].as_u64().unwrap() as u32;
    let mut feature = picked["candidates"][0]["feature"].clone();
    feature["id"] = id.into();
    let change = json!({ "op": "insert_feature", "class": "video", "feature": feature });
    step(session, "change", json!({ "change": change, "label": "make one" }));
    (id, feature)
}

#[test]
fn frames_have_the_bits_of_predictions() {
    let (_folder, path) = room();
    let mut session = edit(&path);
    let asked = json!({ "pose": POSE, "outputs": ["range", "polygon_id"], "features": true, "seq": 7 });
    let (told, bytes) = parts(session.answer("frame", asked.to_string().as_bytes()));
    let room = Scene::open(scene("room.glb")).unwrap();
    let (sensor, _) = files::load_sensor("video-camera").unwrap();
    let [x, y, z, roll, pitch, yaw] = POSE;
    let [roll, pitch, yaw] = [roll, pitch, yaw].map(f64::to_radians);
    let pose = Pose::from_xyz_rpy(glam::DVec3::new(x, y, z), roll, pitch, yaw);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu)).unwrap();
    let images = predictor.predict(&room.world, &sensor, &SensorPose::new(pose), &Request::default()).unwrap().images;
    let range: Vec<u8> = images.range.iter().flat_map(|r| r.to_le_bytes()).collect();
    assert_eq!(told["seq"], 7);
    assert!(bytes[..range.len()] == range[..]);
    let ids: Vec<u8> = images.polygon_id.iter().flat_map(|r| r.to_le_bytes()).collect();
    assert!(bytes[range.len()..range.len() + ids.len()] == ids[..]);
    assert!(told["seen"].as_array().unwrap().len() > 20, "{}", told["seen"]);
    // Each visible feature has at least one line.
    let lines = told["strokes"].as_array().unwrap();
    assert!(told["seen"].as_array().unwrap().iter().all(|id| lines.iter().any(|line| line[0] == *id)));
    // By a switch the hidden parts as well, dashed.
    let asked = json!({ "pose": POSE, "outputs": ["range", "polygon_id"], "features": true, "hidden": true });
    let (all, _) = parts(session.answer("frame", asked.to_string().as_bytes()));
    let hidden = |told: &Value| told["strokes"].as_array().unwrap().iter().filter(|line| line[1] == "hidden").count();
    assert!(hidden(&all) > hidden(&told) && all["seen"] == told["seen"], "{} {}", hidden(&all), hidden(&told));
    // Half the rows and columns are every other pixel.
    let asked = json!({ "pose": POSE, "outputs": ["range"], "stride": 2 });
    let (told, half) = parts(session.answer("frame", asked.to_string().as_bytes()));
    let width = told["size"][0].as_u64().unwrap() as usize;
    let second = f32::from_le_bytes(half[4 * width..4 * width + 4].try_into().unwrap());
    assert_eq!((width, second), (images.width as usize / 2, images.range[2 * images.width as usize]));
}

/// A scan of one row is drawn from above: the sensor's place and the scale take each hit to the picture.
#[test]
fn a_scan_of_one_row_is_shown_from_above() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = session_with("laser-scanner", &scene("room.glb"), None, folder.path()).unwrap();
    let pose = [1.0, 1.5, 0.5, 0.0, 0.0, 0.0];
    let made = step(&mut session, "generate", json!({ "pose": pose }));
    assert!(made["features"].as_u64().unwrap() > 20, "{made}");
    let asked = json!({ "pose": pose, "outputs": ["range", "polygon_id"], "features": true });
    let (told, bytes) = parts(session.answer("frame", asked.to_string().as_bytes()));
    let above = &told["screen"]["above"];
    let scale = above["pixels_per_metre"].as_f64().unwrap();
    let number = |i: usize| f64::from(f32::from_le_bytes(bytes[4 * i..4 * i + 4].try_into().unwrap()));
    // 361 ranges, ids, and rays; beam 180 looks ahead.
    let (range, ray) = (number(180), [number(722 + 360), number(722 + 361)]);
    assert!((ray[0] - 1.0).abs() < 1e-6 && ray[1].abs() < 1e-6, "{ray:?}");
    let row = above["origin"][1].as_f64().unwrap() - range * scale;
    assert!(row > 0.0 && row < told["screen"]["size"][1].as_f64().unwrap());
    assert!(told["strokes"].as_array().unwrap().len() > 20);
    let regions = json!({ "pose": pose, "sigmas": [0.05, 0.05, 0, 0, 0, 2], "confidence": 0.99 });
    assert!(ask(&mut session, "regions", regions)["strokes"].as_array().unwrap().iter().all(|s| s[1] == "region"));
}

#[test]
fn a_saved_layer_keeps_what_was_not_touched_to_the_byte() {
    let (_folder, path) = room();
    // As a person may have written it: another order, notes for editors, and numbers with zeros.
    let text = fs::read_to_string(&path).unwrap();
    let (head, rest) = text.split_once("\"features\": [\n").unwrap();
    let list = rest.strip_suffix("\n  ]\n}\n").unwrap();
    let mut lines: Vec<String> = list.split(",\n").map(str::to_owned).collect();
    lines.rotate_left(3);
    let text = format!("{head}\"features\": [\n{}\n  ]\n}}\n", lines.join(",\n"));
    files::parse_layer(&text).unwrap();
    fs::write(&path, &text).unwrap();

    let mut session = edit(&path);
    let (id, made) = insert_one(&mut session);
    step(&mut session, "change", drop_of(&[2]));
    let answer = step(&mut session, "save", json!({}));
    assert!(answer["said"].as_str().unwrap().starts_with("saved"), "{answer}");
    let saved = fs::read_to_string(&path).unwrap();
    let mut expected: Vec<String> = lines.into_iter().filter(|l| !l.contains("{\"id\":2,")).collect();
    let feature = files::parse_layer(&saved).unwrap().layer.features.into_iter().find(|f| f.id == id).unwrap();
    expected.push(format!("    {}", serde_json::to_string(&files::layer_fields(&feature)).unwrap()));
    assert_eq!(saved, format!("{head}\"features\": [\n{}\n  ]\n}}\n", expected.join(",\n")));
    assert_eq!(serde_json::to_value(files::layer_fields(&feature)).unwrap()["points"], made["points"]);
    // The greatest id, once dropped, is not used again by later sessions.
    step(&mut session, "change", drop_of(&[id]));
    step(&mut session, "save", json!({}));
    drop(session);
    let saved = fs::read_to_string(&path).unwrap();
    assert!(saved.contains(&format!("{{\"id\":{id},\"remove\":true}}")));
    assert_eq!(ask(&mut edit(&path), "state", Value::Null)["next_id"], id + 1);
}

#[test]
fn undo_to_the_start_leaves_the_file_as_it_was() {
    let (folder, path) = room();
    let before = fs::read(&path).unwrap();
    let mut session = edit(&path);
    let count = ask(&mut session, "state", Value::Null)["features"].clone();
    insert_one(&mut session);
    step(&mut session, "change", drop_of(&[1, 2, 3, 4, 5]));
    let entry = ask(&mut session, "entry", json!({ "id": 9 }))["feature"].clone();
    let mut altered = entry.clone();
    altered["name"] = "left of the door".into();
    let change = json!({ "op": "set_feature", "class": "video", "feature": altered });
    let state = step(&mut session, "change", json!({ "change": change, "label": "name it" }));
    assert_eq!((state["unsaved"].as_u64(), state["undo"].as_str()), (Some(7), Some("name it")));
    for _ in 0..3 {
        step(&mut session, "undo", json!({}));
    }
    step(&mut session, "redo", json!({}));
    step(&mut session, "undo", json!({}));
    let state = ask(&mut session, "state", Value::Null);
    assert_eq!((&state["unsaved"], &state["features"], &state["undo"]), (&json!(0), &count, &Value::Null));
    assert_eq!(ask(&mut session, "entry", json!({ "id": 9 }))["feature"], entry);
    assert_eq!(step(&mut session, "save", json!({}))["said"], "nothing to save");
    assert_eq!(fs::read(&path).unwrap(), before);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "no journal is left");
}

#[test]
fn another_program_and_another_tab_are_noticed() {
    let (folder, path) = room();
    let mut session = edit(&path);
    let old = ask(&mut session, "state", Value::Null)["version"].clone();
    insert_one(&mut session);
    // A tab that has not seen the step.
    let late = json!({ "version": old, "change": drop_of(&[1])["change"], "label": "drop" });
    let Answer::Behind(state) = session.answer("change", late.to_string().as_bytes()) else { panic!() };
    assert!(state.contains("\"undo\":\"make one\""));
    // A second editor of the same layer.
    let busy = session_of(&scene("room.glb"), Some(&path), folder.path()).err().unwrap().to_string();
    assert!(busy.contains("another editor has this layer open"), "{busy}");
    let version = ask(&mut session, "state", Value::Null)["version"].clone();
    let save = |name: Value| json!({ "version": version, "name": name }).to_string();
    let text = fs::read_to_string(&path).unwrap();
    let theirs = text.replacen("  \"class\"", " \"class\"", 1);
    fs::write(&path, &theirs).unwrap();
    let said = refusal(&mut session, "save", &save(Value::Null));
    assert!(said.contains("another program has changed the file") && said.contains("another name"), "{said}");
    for name in ["../x.json", "a/b.json", "x.txt", "", ".json", "room.video.layer.json"] {
        refusal(&mut session, "save", &save(name.into()));
    }
    assert_eq!(fs::read_to_string(&path).unwrap(), theirs);
    fs::remove_file(&path).unwrap();
    assert!(refusal(&mut session, "save", &save(Value::Null)).contains("deleted while it was open"));
    let state = ask(&mut session, "save", json!({ "version": version, "name": "mine.layer.json" }));
    assert_eq!(state["unsaved"], 0);
    assert!(files::read_layer(&folder.path().join("mine.layer.json")).unwrap().layer.features.len() > 50);
    assert!(!path.exists());
}

#[test]
fn a_session_that_ends_before_it_saves_loses_no_step() {
    let (_folder, path) = room();
    let mut session = edit(&path);
    insert_one(&mut session);
    step(&mut session, "change", drop_of(&[3, 4]));
    step(&mut session, "change", drop_of(&[5]));
    step(&mut session, "undo", json!({}));
    let all = |session: &mut Session| ask(session, "features", Value::Null)["ids"].clone();
    let ids = all(&mut session);
    drop(session);
    let journal = path.with_file_name("room.video.layer.json.edits");
    // A step that was cut short, so never acknowledged.
    let mut text = fs::read_to_string(&journal).unwrap();
    text += "{\"op\":\"delete_fea";
    fs::write(&journal, &text).unwrap();

    let mut again = edit(&path);
    let state = ask(&mut again, "state", Value::Null);
    assert_eq!(state["offered"], json!({ "steps": 4, "fits": true }));
    let version = state["version"].clone();
    let early = json!({ "version": version, "change": drop_of(&[1])["change"], "label": "drop" });
    assert!(refusal(&mut again, "change", &early.to_string()).contains("steps of an earlier session"));
    step(&mut again, "restore", json!({ "keep": true }));
    assert_eq!(all(&mut again), ids);
    // Restored steps can be undone and saved, and survive a second crash.
    drop(again);
    let mut third = edit(&path);
    let state = step(&mut third, "restore", json!({ "keep": true }));
    assert_eq!((state["steps"].as_u64(), &state["offered"]), (Some(4), &Value::Null));
    step(&mut third, "save", json!({}));
    assert!(!journal.exists());
    assert_eq!(all(&mut third), ids);
    drop(third);

    // Steps for another version of the layer are offered as such, and taken as a whole or not at all.
    fs::write(&journal, text.replacen("edit of", "edit of another", 1)).unwrap();
    let mut other = edit(&path);
    let state = ask(&mut other, "state", Value::Null);
    assert_eq!(state["offered"]["fits"], false);
    let before = all(&mut other);
    let keep = json!({ "version": state["version"], "keep": true }).to_string();
    let said = refusal(&mut other, "restore", &keep);
    assert!(said.contains("step 1") && said.contains("in use"), "{said}");
    assert_eq!(all(&mut other), before);
    step(&mut other, "restore", json!({ "keep": false }));
    assert!(!journal.exists());
}

#[test]
fn steps_of_a_store_are_in_its_log_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("room.presight");
    let room = Scene::open(scene("room.glb")).unwrap();
    let note = presight::store::Note::new("made", 1.0);
    presight::store::create(&path, room.world.environment(), &note).unwrap();
    let mut session = session_of(&path, None, folder.path()).unwrap();
    assert_eq!(ask(&mut session, "state", Value::Null)["stored"], true);
    let (id, _) = insert_one(&mut session);
    step(&mut session, "change", drop_of(&[id]));
    step(&mut session, "undo", json!({}));
    let log = || {
        let mut causes = Vec::new();
        presight::store::log(&path, |entry| {
            causes.push(entry.cause);
            Ok(())
        })
        .unwrap();
        causes
    };
    assert_eq!(log(), ["edit: make one", "edit: drop", "edit: drop"]);
    let stored = Scene::open(&path).unwrap();
    assert_eq!(stored.world.environment().layer("video").unwrap().features[0].id, id);
    // The robot writes: the next step is refused, and the page gets the new version.
    let mut robot = presight::store::Store::open(&path).unwrap();
    robot.undo(2, true, &note).ok();
    robot.apply(presight::Change::NOTHING, &note).unwrap();
    drop(robot);
    let version = ask(&mut session, "state", Value::Null)["version"].clone();
    let late = json!({ "version": version, "change": drop_of(&[id])["change"], "label": "drop" });
    let Answer::Behind(state) = session.answer("change", late.to_string().as_bytes()) else { panic!() };
    assert!(state.contains("another program has changed the store"), "{state}");
    assert_ne!(ask(&mut session, "state", Value::Null)["version"], version);
    let count = log().len();
    insert_one(&mut session);
    assert_eq!(log().len(), count + 1);
}

#[test]
fn the_map_is_that_of_a_whole_study_after_every_change() {
    let (_folder, path) = room();
    let mut session = edit(&path);
    let asked = json!({ "spacing": 0.6, "floor": 0.0, "height": 1.0, "pixel_sigma": 1.0, "budget_ms": 1 });
    let mut cells = std::collections::BTreeMap::new();
    let mut since = 0;
    let mut finish = |session: &mut Session| loop {
        let mut asked = asked.clone();
        asked["since"] = since.into();
        let told = step(session, "worth", asked);
        since = told["stamp"].as_u64().unwrap();
        let places = told["places"].as_array().unwrap();
        if cells.is_empty() {
            let [column, row] = [0, 1].map(|i| places[0][i].as_u64().unwrap());
            assert!(column % 4 == 0 && row % 4 == 0, "every fourth column and row comes first, not {column}, {row}");
        }
        for place in places {
            cells.insert((place[1].as_u64().unwrap(), place[0].as_u64().unwrap()), place.clone());
        }
        if told["done"] == told["of"] {
            return cells.values().map(|c| [c[5].clone(), c[6].clone(), c[7].clone()]).collect::<Vec<_>>();
        }
    };
    let fresh = |path: &Path| {
        let room = Scene::open(scene("room.glb")).unwrap();
        let (sensor, _) = files::load_sensor("video-camera").unwrap();
        let mut spec = sensor.spec().clone();
        spec.noise.pixel_sigma = 1.0;
        spec.mount.translation.z = 1.0;
        let sensor = presight::Sensor::new(spec).unwrap();
        let placed = room.place(&files::read_layer(path).unwrap().layer).unwrap();
        let mut options = WorthOptions::default();
        options.spacing = 0.6;
        let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
        let worth = Worth::of(&room.world, &sensor, &placed, &options, &mut predictor, |_, _| {}).unwrap();
        let told = |p: &presight_studies::worth::WorthPlace| {
            [json!(p.features), json!(p.position_sigma), json!(p.heading_sigma.to_degrees())]
        };
        worth.places.iter().map(told).collect::<Vec<_>>()
    };
    let first = finish(&mut session);
    assert!(first.len() > 5);
    assert_eq!(first, fresh(&path));
    step(&mut session, "change", drop_of(&[1, 2, 3, 4, 5, 6, 7, 8, 9, 10]));
    insert_one(&mut session);
    step(&mut session, "undo", json!({}));
    step(&mut session, "redo", json!({}));
    let now = finish(&mut session);
    step(&mut session, "save", json!({}));
    assert_eq!(now, fresh(&path));
    assert_ne!(now, first);
}

#[test]
fn a_new_layer_is_named_at_the_first_save() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = session_of(&scene("room.glb"), None, folder.path()).unwrap();
    let made = step(&mut session, "generate", json!({ "pose": POSE, "kinds": ["corner", "contour"] }));
    assert!(made["features"].as_u64().unwrap() > 3, "{made}");
    // Nothing is made twice.
    let again = step(&mut session, "generate", json!({ "pose": POSE, "kinds": ["corner", "contour"] }));
    assert_eq!((&again["features"], &again["said"]), (&made["features"], &json!("0 features made")));
    step(&mut session, "save", json!({}));
    let saved = files::read_layer(&folder.path().join("room.video.layer.json")).unwrap();
    assert_eq!(saved.layer.features.len() as u64, made["features"].as_u64().unwrap());
    let regions = json!({ "pose": POSE, "sigmas": [0.05, 0.05, 0, 0, 0, 2], "confidence": 0.99 });
    assert!(ask(&mut session, "regions", regions)["boxes"].as_array().unwrap().len() > 3);
    let plan = ask(&mut session, "plan", json!({ "height": 1.0 }));
    assert!(plan["arrays"][0]["numbers"].as_u64().unwrap() > 40, "{plan}");
    let why = ask(&mut session, "why", json!({ "pose": [0.3, 0.35, 1.65, 0, 12, 218], "ids": [1, 2, 3] }));
    assert_eq!(why["features"].as_array().unwrap().len(), 3);
    assert!(why.to_string().contains("behind_sensor"), "{why}");
}

#[test]
fn bad_requests_are_refused_and_change_nothing() {
    let (_folder, path) = room();
    let mut session = edit(&path);
    let state = ask(&mut session, "state", Value::Null);
    let pose = json!(POSE);
    let mut off = ask(&mut session, "entry", json!({ "id": 1 }))["feature"].clone();
    off["id"] = state["next_id"].clone();
    off["points"] = json!([[90.0, 0.0, 0.0], [91.0, 0.0, 0.0]]);
    let v = &state["version"];
    let change = |change: Value| json!({ "version": v, "change": change, "label": "x" });
    let insert = |feature: &Value| change(json!({ "op": "insert_feature", "class": "video", "feature": feature }));
    let mut old = off.clone();
    old["id"] = 1.into();
    let worth = |key: &str, value: Value| {
        let mut asked = json!({ "version": v, "spacing": 1.0, "floor": 0.0, "height": 1.0, "pixel_sigma": 1.0 });
        asked[key] = value;
        asked
    };
    let requests = [
        ("frame", json!({ "pose": [0, 0, 0], "outputs": ["range"] })),
        ("frame", json!({ "pose": pose, "outputs": [] })),
        ("frame", json!({ "pose": pose, "outputs": ["feature_id"] })),
        ("frame", json!({ "pose": pose, "outputs": ["colour"] })),
        ("frame", json!({ "pose": pose, "outputs": ["range"], "stride": 3 })),
        ("frame", json!({ "pose": pose, "outputs": ["range"], "extra": 3 })),
        ("frame", json!({ "pose": [1e300, 0, 0, 0, 0, 0], "outputs": ["range"] })),
        ("regions", json!({ "pose": pose, "sigmas": [-1, 0, 0, 0, 0, 0], "confidence": 0.9 })),
        ("regions", json!({ "pose": pose, "sigmas": [0, 0, 0, 0, 0, 0], "confidence": 1.5 })),
        ("why", json!({ "pose": pose, "ids": vec![1; 501] })),
        ("pick", json!({ "pose": pose, "pixel": [640, 0] })),
        ("pick", json!({ "pose": pose, "pixel": [1, 1], "reach": 1e9 })),
        ("entry", json!({ "id": 4_000_000 })),
        ("plan", json!({ "height": "high" })),
        ("change", insert(&off)),
        ("change", insert(&old)),
        ("change", change(json!({ "op": "delete_feature", "class": "video", "feature": 4_000_000 }))),
        ("change", change(json!({ "op": "delete_feature", "class": "radar", "feature": 1 }))),
        ("change", change(json!({ "op": "delete_object", "object": "room/table" }))),
        (
            "change",
            change(
                json!({ "op": "group", "changes": [drop_of(&[1])["change"], { "op": "delete_feature", "class": "video", "feature": 1 }] }),
            ),
        ),
        ("change", json!({ "version": v })),
        ("generate", json!({ "version": v, "kinds": ["door"] })),
        ("generate", json!({ "version": v, "min_length": -1 })),
        ("undo", json!({ "version": v })),
        ("redo", json!({ "version": v })),
        ("worth", worth("spacing", json!(0))),
        ("worth", worth("spacing", json!(1e-7))),
        ("worth", worth("pixel_sigma", json!(0))),
        ("worth", worth("floor", json!(50))),
        ("save", json!({ "version": v, "name": "/etc/passwd" })),
    ];
    for (name, body) in requests {
        refusal(&mut session, name, &body.to_string());
    }
    for body in ["", "{", "[]", "null", "{\"pose\":NaN}", "\u{0}", "{\"version\":1e99}"] {
        for name in ["frame", "change", "worth", "save", "pick"] {
            refusal(&mut session, name, body);
        }
    }
    assert!(matches!(session.answer("../state", b""), Answer::Unknown));
    assert_eq!(ask(&mut session, "state", Value::Null), state);
    assert!(!path.with_file_name("room.video.layer.json.edits").exists());
}

/// Fields of JSON, cut, doubled and exchanged: no panic, and every refusal has a remedy.
#[test]
fn broken_requests_do_no_harm() {
    let (_folder, path) = room();
    let mut session = edit(&path);
    let mut random = presight_testkit::Random(presight_testkit::env_number("PROPTEST_RNG_SEED", 1));
    let seeds = [
        ("entry", json!({ "id": 3 })),
        ("why", json!({ "pose": POSE, "ids": [1, 2] })),
        (
            "change",
            json!({ "version": 1, "label": "x", "change": { "op": "delete_feature", "class": "video", "feature": 5 } }),
        ),
        (
            "change",
            json!({ "version": 1, "label": "x", "change": { "op": "insert_feature", "class": "video", "feature":
            { "id": 400, "kind": "point", "points": [[1.0, 2.0, 0.0]], "sigma": 0.01, "properties": { "normal": [0, 0, 1] } } } }),
        ),
        ("undo", json!({ "version": 1 })),
        ("save", json!({ "version": 1, "name": "a.json" })),
        ("restore", json!({ "version": 1, "keep": true })),
        ("plan", json!({ "height": 1.5 })),
    ];
    let words = ["null", "-1", "1e308", "\"\"", "[]", "{}", "4294967296", "true", "0.5", "\"video\"", "NaN"];
    let texts: Vec<String> = seeds.iter().map(|(_, body)| body.to_string()).collect();
    let seconds = presight_testkit::env_number("PRESIGHT_FUZZ_SECONDS", 1);
    let start = std::time::Instant::now();
    let mut count = 0;
    while start.elapsed().as_secs() < seconds {
        let mut draw = |below: usize| random.below(below);
        let which = draw(seeds.len());
        let mut text = texts[which].clone().into_bytes();
        for _ in 0..1 + draw(4) {
            let at = draw(text.len() + 1);
            match draw(4) {
                0 => text.truncate(at),
                1 => drop(text.splice(at..at, words[draw(words.len())].bytes())),
                2 if at < text.len() => text[at] = b"{}[],:\"0159-e.xnt \\"[draw(19)],
                _ => {
                    let end = (at + draw(12)).min(text.len());
                    drop(text.splice(at..end, words[draw(words.len())].bytes()));
                }
            }
        }
        if let Answer::Wrong(e) = session.answer(seeds[which].0, &text) {
            let text = String::from_utf8_lossy(&text).into_owned();
            assert!(!e.remedy().is_empty() && !e.to_string().contains('\n'), "{text}: {e}");
        }
        count += 1;
    }
    assert!(count > 100, "{count} requests");
}
