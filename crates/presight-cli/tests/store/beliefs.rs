//! Marks on objects and trust in them: kept, undone, exported with a notice, and honoured by predictions and verdicts.

use super::{at, block, create, note, presight, small};
use presight::environment::{Aabb, Environment, Mark, MarkKind, Material, NewObject};
use presight::measured::{Frame, Measurement};
use presight::predict::{BatchRequest, PoseCell, RangeLikelihood};
use presight::store;
use presight::store::Store;
use presight::verdict::{Verdict, of_frame};
use presight::{Backend, Change, Options, Pose, PoseEstimate, Predictor, Request, RobotPose, SensorPose, World};
use std::path::Path;

const LINES: &str = r#"{"op":"set_mark","mark":"door","object":"a","kind":"uncertain","box":[[0,0,0],[1,1,2]],"id":"m1","evidence":{"views":4,"L":-9.5}}
{"op":"group","changes":[{"op":"set_mark","mark":"glass","object":"b","kind":"absent","class":"laser"},{"op":"set_trust","object":"b","trust":{"existence":0.9,"confirmed":1e9}}]}
{"op":"set_trust","object":"a","trust":{"existence":0.25}}
{"op":"remove_mark","mark":"door"}
{"op":"delete_object","object":"b"}
"#;

fn json(output: std::process::Output) -> Vec<serde_json::Value> {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    serde_json::Deserializer::from_str(&text).into_iter().map(Result::unwrap).collect()
}

fn run(args: &[&str], path: &Path) -> std::process::Output {
    presight().args(args).arg(path).output().unwrap()
}

#[test]
fn marks_and_trust_are_kept_and_undone() {
    let folder = tempfile::tempdir().unwrap();
    let path = create(folder.path(), &small());
    let changes = folder.path().join("changes.jsonl");
    std::fs::write(&changes, LINES).unwrap();
    let apply = || presight().args(["env", "apply"]).args([&path, &changes]).output().unwrap();
    assert!(apply().status.success());
    let info = store::check(&path).unwrap();
    assert_eq!((info.changes, info.environment.marks().len()), (5, 0));
    assert_eq!(info.environment.trust("a").unwrap().p0, 0.25);
    let log = json(run(&["env", "log", "--json"], &path));
    assert_eq!((&log[0]["evidence"]["views"], &log[1]["evidence"]), (&4.into(), &serde_json::Value::Null));
    let mut store = Store::open(&path).unwrap();
    store.undo(5, false, &note(9.0)).unwrap();
    let environment = store.world().environment().clone();
    let glass = Mark { object: "b".into(), kind: MarkKind::Absent, class: Some("laser".into()), bounds: None };
    assert_eq!(environment.marks().collect::<Vec<_>>(), [("glass", &glass)]);
    assert_eq!(environment.trust("b").unwrap().confirmed, 1e9);
    drop(store);
    let said = &json(run(&["env", "info", "--json"], &path))[0];
    assert_eq!((&said["marks"][0]["class"], &said["trust"][1]["existence"]), (&"laser".into(), &0.9.into()));
    // An export says which content it leaves out.
    let out = presight().args(["env", "export"]).args([&path, &folder.path().join("out")]).output().unwrap();
    assert!(String::from_utf8_lossy(&out.stderr).contains("1 marks and the trust in 2 objects"), "{out:?}");
    // All undone, newest first, and the first content is back.
    for change in ["4", "3", "2", "1"] {
        let out = presight().args(["env", "undo"]).arg(&path).arg(change).output().unwrap();
        assert!(out.status.success(), "{change}: {out:?}");
    }
    assert_eq!(store::check(&path).unwrap().environment.content_hash(), small().content_hash());
}

#[test]
fn marks_that_cannot_be_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = create(folder.path(), &small());
    let before = std::fs::read(&path).unwrap();
    for (line, word) in [
        (r#"{"op":"set_mark","mark":"m","object":"a","kind":"gone"}"#, "uncertain, absent or unseen"),
        (r#"{"op":"set_mark","mark":"m","object":"none","kind":"absent"}"#, "none"),
        (r#"{"op":"set_mark","mark":"","object":"a","kind":"absent"}"#, "bytes"),
        (r#"{"op":"set_mark","mark":"m","object":"a","kind":"absent","class":""}"#, "class"),
        (r#"{"op":"set_mark","mark":"m","object":"a","kind":"absent","box":[[1,0,0],[0,1,1]]}"#, "corner"),
        (r#"{"op":"remove_mark","mark":"m"}"#, "no mark"),
        (r#"{"op":"set_trust","object":"a","trust":{"existence":1.5}}"#, "existence"),
        (r#"{"op":"set_trust","object":"none","trust":null}"#, "none"),
    ] {
        let changes = folder.path().join("changes.jsonl");
        std::fs::write(&changes, line).unwrap();
        let out = presight().args(["env", "apply"]).args([&path, &changes]).output().unwrap();
        let said = String::from_utf8_lossy(&out.stderr);
        assert!(out.status.code() == Some(1) && said.lines().count() == 1 && said.contains(word), "{line}: {said}");
    }
    assert_eq!(std::fs::read(&path).unwrap(), before);
}

/// Opening a store of format 4 changes nothing; the first change gives it the tables of format 5.
#[test]
fn the_first_write_upgrades_format_4() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("old.presight");
    std::fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/store/version-4.presight"), &path).unwrap();
    let format = || {
        let connection = rusqlite::Connection::open(&path).unwrap();
        connection.query_row("PRAGMA user_version", [], |row| row.get::<_, i32>(0)).unwrap()
    };
    let before = (std::fs::read(&path).unwrap(), store::check(&path).unwrap());
    drop(Store::open(&path).unwrap());
    assert_eq!((std::fs::read(&path).unwrap() == before.0, format()), (true, 4));
    let mut store = Store::open(&path).unwrap();
    let mark = Mark { object: "a".into(), kind: MarkKind::Uncertain, class: None, bounds: None };
    let set = Change::SetMark { name: "m".into(), mark };
    // A batch that is given up leaves format 4.
    store.batch().unwrap().apply(set.clone(), &note(1.0)).unwrap();
    assert_eq!(format(), 4);
    let number = store.apply(set, &note(2.0)).unwrap();
    drop(store);
    let after = store::check(&path).unwrap();
    assert_eq!((format(), after.environment.marks().len()), (5, 1));
    let mut store = Store::open(&path).unwrap();
    store.undo(number, false, &note(3.0)).unwrap();
    assert_eq!(store.world().environment().content_hash(), before.1.environment.content_hash());
}

/// A cube of 1 m whose near face is 3 m ahead, before a wall 8 m ahead.
fn marked(mark: Option<(MarkKind, Option<Aabb>)>) -> World {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    let low = |x: f64, y: f64| Pose { translation: glam::DVec3::new(x, y, -0.5), ..at(0.0, 0.0, 0.0) };
    environment.insert(NewObject::new("cube", low(3.0, -0.5), block("cube", 1.0, [0; 6]))).unwrap();
    environment.insert(NewObject::new("wall", low(8.0, -20.0), block("wall", 40.0, [0; 6]))).unwrap();
    if let Some((kind, bounds)) = mark {
        let mark = Mark { object: "cube".into(), kind, class: Some("laser".into()), bounds };
        environment.set_mark("m", mark).unwrap();
    }
    World::new(environment)
}

fn scanner(class: &str) -> presight::Sensor {
    let text = format!(
        "format = 1\nkind = \"scanner\"\nclass = \"{class}\"\nrange_max = 30\n[azimuth]\nstart_deg = -5\nstep_deg = 1\ncount = 11\n[elevation]\nstart_deg = 0\nstep_deg = 1\ncount = 1\n[noise]\nrange_sigma = 0.01\n"
    );
    presight::Sensor::new(presight::files::parse_sensor_toml(&text, "scanner", None).unwrap()).unwrap()
}

#[test]
fn absent_marks_hide_for_their_class_in_images_and_in_batches() {
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let near_face = Aabb { min: glam::DVec3::splat(-0.01), max: glam::DVec3::new(0.01, 1.01, 1.01) };
    let cases = [
        (None, "laser", 3.0),
        (Some((MarkKind::Absent, None)), "laser", 8.0),
        (Some((MarkKind::Absent, None)), "radar", 3.0),
        (Some((MarkKind::Uncertain, None)), "laser", 3.0),
        // Behind the near face, which alone lies in the box, is the far face.
        (Some((MarkKind::Absent, Some(near_face))), "laser", 4.0),
    ];
    for (mark, class, range) in cases {
        let (world, sensor) = (marked(mark), scanner(class));
        let images = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &Request::default()).unwrap().images;
        assert!((f64::from(images.range[5]) - range).abs() < 1e-5, "{mark:?} for {class}: {}", images.range[5]);
        // The likelihood of a batch comes from a cut of the world: it is greatest at the predicted ranges.
        let weigh = |z: f64, predictor: &mut Predictor| {
            let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(vec![z as f32; 11])).unwrap();
            let likelihood = Some(RangeLikelihood::new(&frame, PoseCell::default()).unwrap());
            let request = BatchRequest { likelihood, ..BatchRequest::default() };
            let mut items = predictor.batch(&world, &sensor, vec![SensorPose::IDENTITY], &request).unwrap();
            items.next().unwrap().unwrap().log_likelihood.unwrap()
        };
        let best = [3.0, 4.0, 8.0].map(|z| (weigh(z, &mut predictor), z));
        let best = best.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        assert_eq!(best.1, range, "{mark:?} for {class}");
    }
}

#[test]
fn verdicts_on_uncertain_parts_are_undecidable() {
    let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap();
    let known = PoseEstimate::of_sigmas(RobotPose::IDENTITY, 1e-3, 1e-4);
    let mut judge = |world: &World, z: f32| {
        let frame = Frame::new(0.0, scanner("laser"), Measurement::Range(vec![z; 11])).unwrap();
        of_frame(&mut predictor, world, &frame, &known).unwrap().pixels[5]
    };
    let (plain, uncertain) = (marked(None), marked(Some((MarkKind::Uncertain, None))));
    assert_eq!([3.0, 8.0].map(|z| judge(&plain, z)), [Verdict::Confirmed, Verdict::Farther]);
    assert_eq!([3.0, 8.0, 1.0].map(|z| judge(&uncertain, z)), [Verdict::Undecidable; 3]);
}
