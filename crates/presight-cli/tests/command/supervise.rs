//! `presight supervise` and `presight query`: the commands of docs/supervise.md, and bad input.

use super::{Place, bad, check};
use presight_testkit::data;
use serde_json::Value;

const WAY: &str = r#"{"polyline_in_robot": [[0.4, 0], [4, 0]], "half_width": 0.4, "z_min": -1.14, "z_max": 0.6}"#;

/// A place with the charging bay, and a log of a robot that stands in it.
fn bay() -> Place {
    let place = Place::new();
    let scenes = data::root().join("scenes");
    std::fs::create_dir(place.path("parts")).unwrap();
    for name in ["docking.rhai", "parts/dock.rhai", "parts/profiles.rhai"] {
        std::fs::copy(scenes.join(name), place.path(name)).unwrap();
    }
    place.write("way.json", WAY.as_bytes());
    let poses: String = (0..5).map(|k| format!("{k} 0 -0.5 1.2 0 0 0 1\n")).collect();
    place.write("stand.tum", poses.as_bytes());
    place.done("simulate docking.rhai --sensor laser-range-camera --poses stand.tum --out bay");
    place
}

const RUN: &str = "supervise bay/scans.jsonl --map docking.rhai --init reference --corridor way.json --out run.jsonl";

fn lines(place: &Place) -> Vec<Value> {
    let text = std::fs::read_to_string(place.path("run.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The map lacks the trolley, which stands 2.8 m ahead: it intrudes. A way leads around it.
#[test]
fn a_trolley_that_the_map_lacks_intrudes() {
    let place = bay();
    let said = place.run(&format!("{RUN} --exclude trolley --speed 0.5 --png way.png"));
    assert_eq!(said.status, Some(0), "{}", said.stderr);
    assert!(said.stdout.contains("frames show something in the corridor"), "{}", said.stdout);
    let lines = lines(&place);
    assert_eq!(lines.len(), 6, "a header and five frames");
    let (header, last) = (&lines[0], &lines[5]);
    let columns = header["grid"]["columns"].as_array().unwrap().len();
    let layers = header["grid"]["layers"].as_u64().unwrap() as usize;
    assert_eq!(last["cells"].as_str().unwrap().len(), columns * layers);
    assert_eq!((&last["state"], &last["against"]), (&"tracking".into(), &"model".into()));
    let first = &last["intrusions"][0];
    let x = first["nearest_world"][0].as_f64().unwrap();
    assert!((2.6..3.2).contains(&x), "{first}");
    let (along, time) = (first["along"].as_f64().unwrap(), last["time_to_reach"].as_f64().unwrap());
    assert!((time - along / 0.5).abs() < 1e-9 && along > 1.5);
    let free = last["counts"]["free"].as_u64().unwrap();
    assert!(free > 300 && last["counts"]["intruded"].as_u64().unwrap() > 10, "{}", last["counts"]);
    assert_eq!(&std::fs::read(place.path("way.png")).unwrap()[1..4], b"PNG");
    let way = "query docking.rhai --path 1,1.0,0 2.4,-1,0 --radius 0.3 --json";
    let length = |line: &str| serde_json::from_str::<Value>(&place.done(line)).unwrap()["length"].as_f64().unwrap();
    assert!(length(&format!("{way} --blocked run.jsonl")) >= length(way));
}

/// With the whole map nothing intrudes, and the trolley is known.
#[test]
fn what_the_map_has_is_known() {
    let place = bay();
    let said = place.run(RUN);
    assert!(said.status == Some(0), "{}", said.stderr);
    for line in lines(&place).iter().skip(1).filter(|line| line["against"] == "model") {
        assert_eq!(line["intrusions"].as_array().unwrap().len(), 0, "{line}");
        assert!(line["known"].as_object().unwrap().keys().any(|name| name.starts_with("trolley")), "{line}");
    }
}

/// Two sensors of one robot, each with its own log, leave less unseen than one.
#[test]
fn the_sensors_of_a_robot_work_together() {
    let place = bay();
    place.write(
        "kurt.toml",
        b"format = 1\n[[sensors]]\nname = \"front\"\nsensor = \"laser-range-camera\"\n\
          [[sensors]]\nname = \"plane\"\nsensor = \"laser-scanner\"\n",
    );
    place.done("simulate docking.rhai --sensor laser-scanner --poses stand.tum --out plane");
    let free = |line: &str| {
        let said = place.run(line);
        assert_eq!(said.status, Some(0), "{}", said.stderr);
        lines(&place)[5]["counts"]["free"].as_u64().unwrap()
    };
    let alone = free(RUN);
    let flags = "--map docking.rhai --init reference --corridor way.json --out run.jsonl";
    let logs = "front=bay/scans.jsonl plane=plane/scans.jsonl";
    let together = free(&format!("supervise {logs} --robot kurt.toml {flags}"));
    assert!(together >= alone && alone > 0, "{together} and {alone}");
    check(
        &place,
        vec![
            bad(
                format!("supervise bay/scans.jsonl --robot kurt.toml {flags}"),
                2,
                &["bay/scans.jsonl", "; give NAME=LOG"],
            ),
            bad(
                format!("supervise rear=bay/scans.jsonl --robot kurt.toml {flags}"),
                2,
                &["rear", "; name one of front, plane"],
            ),
        ],
    );
}

#[test]
fn questions_are_answered_as_text_and_as_json() {
    let place = bay();
    let json = |line: &str| serde_json::from_str::<Value>(&place.done(&format!("{line} --json"))).unwrap();
    let docks = json("query docking.rhai --docks");
    assert!(docks["docks"].as_array().unwrap().iter().any(|d| d["name"] == "dock2" && d["class"] == "laser"));
    assert!(place.done("query docking.rhai --docks").contains("dock1: 3 reflectors for laser"));
    let near = json("query docking.rhai --sphere 3.0,0.05,1,0.3");
    assert_eq!(near["objects"][0]["name"], "pillar");
    assert!(place.done("query docking.rhai --box -5,-5,5,5,5,6").contains("no object"));
    let along = place.done("query docking.rhai --along way.json --pose 0,-0.5,1.2,0,0,0");
    assert!(along.contains("trolley/frame"), "{along}");
    // The pillar is 0.3 m wide about (3, 0.05): its corner is 0.85 m ahead and 0.4 m aside.
    let free = json("query docking.rhai --free 2.0,0.6,1.0")["distance"].as_f64().unwrap();
    assert!((free - 0.85f64.hypot(0.4)).abs() < 1e-6, "{free}");
    assert!(place.done("query docking.rhai --uncertain --below 0.95").contains("chipped edge"));
    assert!(place.done("query docking.rhai --path 0,0,0 3.6,1.2,0 --radius 0.3").starts_with("a path of"));
}

#[test]
fn bad_input_is_refused_in_one_line() {
    let place = bay();
    place.write(
        "bow.json",
        br#"{"format": 2, "footprint": [[0,0],[1,1],[1,0],[0,1]], "poses": [[0,0,0]], "z_min": 0, "z_max": 1}"#,
    );
    place.write("broken.jsonl", b"{\n");
    let run = |flags: &str| format!("{RUN} {flags}");
    check(
        &place,
        vec![
            bad(run("").replace("way.json", "none.json"), 1, &["none.json", "; "]),
            bad(run("").replace("way.json", "bow.json"), 1, &["bow.json", "footprint", "cross", "; "]),
            bad(run("--speed nan"), 2, &["speed", "; give metres per second"]),
            bad(run("--cell 0"), 2, &["cell", "; "]),
            bad(run("--smallest -1"), 2, &["smallest", "; "]),
            bad(run("--deadline-ms 0"), 2, &["--deadline-ms 0", "; "]),
            bad(run("").replace("run.jsonl", "run.txt"), 2, &["--out", ".jsonl"]),
            bad(run("").replace("run.jsonl", "way.json"), 2, &["--out", ".jsonl"]),
            bad("query docking.rhai --box 1,1,1,0,0,0".to_owned(), 2, &["box", "; give the least corner first"]),
            bad("query docking.rhai --sphere 1,1,1".to_owned(), 2, &["--sphere", "4 finite numbers"]),
            bad("query docking.rhai --free nan,0,0".to_owned(), 2, &["--free", "3 finite numbers"]),
            bad("query docking.rhai --along way.json".to_owned(), 2, &["--along", "; give the robot's --pose"]),
            bad("query docking.rhai --path 3,0.05,0 0,0,0".to_owned(), 2, &["--path", "the start", "pillar", "; "]),
            bad("query docking.rhai --path 0,0,0 90,0,0".to_owned(), 2, &["the end", "no floor", "; "])
                .after_a_notice(),
            bad("query docking.rhai --path 0,0,0 1,0,0 --radius nan".to_owned(), 2, &["radius", "; "]),
            bad(
                "query docking.rhai --path 0,0,0 1,0,0 --blocked broken.jsonl".to_owned(),
                1,
                &["broken.jsonl", "line 1"],
            ),
            bad("query docking.rhai".to_owned(), 2, &["--docks"]),
        ],
    );
}
