//! Deadlines on the command line: `--deadline-ms` and the cost file.

use super::*;

const PREDICT: &str = "predict wall.glb --sensor laser-scanner --pose 0,0,1,0,0,0 --backend cpu --threads 1";

#[test]
fn the_deadline_is_reported_and_costs_are_stored() {
    let place = Place::new();
    let line = format!("{PREDICT} --deadline-ms 60000 --costs costs.json --explain --stats stats.json --out a.exr");
    let said = place.done(&line);
    assert!(said.contains("deadline  ") && said.contains(" of 60000 ms"), "{said}");
    let costs = fs::read_to_string(place.path("costs.json")).unwrap();
    let stats: Value = serde_json::from_str(&fs::read_to_string(place.path("stats.json")).unwrap()).unwrap();
    assert_eq!((&stats["deadline"]["deadline_ms"], &stats["deadline"]["given_up"]), (&json!(60000.0), &Value::Null));
    assert!(stats["counts"]["samples tested"].as_u64() > Some(0) && stats["counts"]["waves"] == 1);
    assert_eq!(place.images("a.exr").attributes.given_up, None);
    // A second run starts from the stored costs.
    place.done(&line);
    let frames = |text: &str| serde_json::from_str::<Value>(text).unwrap()["models"][0]["frames"].as_u64().unwrap();
    assert!(frames(&fs::read_to_string(place.path("costs.json")).unwrap()) > frames(&costs));
}

/// A flag whose value is refused until it is the one that the remedy names.
fn check_value(place: &Place, flag: &'static str, wrong: &'static str, (remedy, right): (&'static str, &'static str)) {
    let line = format!("{PREDICT} --out a.exr {flag} {wrong}");
    let name = flag.rsplit(' ').next().unwrap();
    check(place, vec![bad(line, 2, &[name]).until(wrong, right, remedy)]);
}

#[test]
fn invalid_deadlines_are_wrong_usage_and_too_short_ones_exit_with_4() {
    let place = Place::new();
    for wrong in ["0", "-3", "NaN", "inf", "1e300"] {
        let change = ("; give milliseconds above 0 and up to 1e9", "1e9");
        check_value(&place, "--deadline-ms", wrong, change);
    }
    let outcome = place.run(&format!("{PREDICT} --deadline-ms 0.000001 --out a.exr"));
    assert_eq!(outcome.status, Some(4), "{}", outcome.stderr);
    assert!(outcome.stderr.contains("no prediction is possible within"), "{}", outcome.stderr);
    assert_eq!(place.run(&format!("{PREDICT} --costs costs.json")).status, Some(2), "costs without a deadline");
    assert_eq!(place.names(), ["wall.glb"]);
}

#[test]
fn costs_are_learnt_over_a_series() {
    let place = Place::new();
    place.write("drive.tum", b"0 0 0 1 0 0 0 1\n1 0 0 1 0 0 0 1\n2 0 0 1 0 0 0 1\n");
    let series =
        "predict wall.glb --sensor laser-scanner --poses drive.tum --backend cpu --threads 1 --deadline-ms 60000";
    place.done(&format!("{series} --costs costs.json --out {{i}}.exr"));
    let costs: Value = serde_json::from_str(&fs::read_to_string(place.path("costs.json")).unwrap()).unwrap();
    let finished = costs["models"].as_array().unwrap().iter().find(|model| model["forecast"] == "finished").unwrap();
    assert_eq!(finished["frames"], 3);
    assert!(place.path("2.exr").exists());
}

/// Runs a command line that learns costs, and then sets the seconds of one forecast for every frame.
fn learn_slow(place: &Place, line: &str, forecast: &str, seconds: f64) {
    place.done(line);
    let mut costs = place.json("costs.json");
    for model in costs["models"].as_array_mut().unwrap().iter_mut().filter(|model| model["forecast"] == forecast) {
        model["seconds"].as_object_mut().unwrap().values_mut().for_each(|cost| *cost = json!(0.0));
        model["seconds"]["frame"] = json!(seconds);
    }
    place.write("costs.json", costs.to_string().as_bytes());
}

/// By costs that are far too high, only 8 of 361 columns can be drawn. The clock decides nothing.
#[test]
fn what_was_given_up_is_said_with_every_output() {
    let place = Place::new();
    let line = format!("{PREDICT} --deadline-ms 60000 --costs costs.json");
    let whole: Value = serde_json::from_str(&place.done(&format!("{line} --json"))).unwrap();
    assert_eq!((&whole["given_up"], whole["pixels_hit"].as_u64() > Some(8)), (&Value::Null, true));
    learn_slow(&place, &line, "selection", 1e6);
    let json: Value = serde_json::from_str(&place.done(&format!("{line} --json --out a.exr"))).unwrap();
    assert!(json["given_up"]["samples"].as_u64() > Some(300), "{json}");
    let in_file = place.images("a.exr").attributes.given_up;
    assert_eq!(json["given_up"], serde_json::to_value(in_file).unwrap());
    for output in ["--out a.exr", "--png a.png", "--depth-png a.png", "--npy {output}.npy"] {
        let outcome = place.run(&format!("{line} {output}"));
        let said = &outcome.stderr;
        assert_eq!((outcome.status, outcome.stdout.as_str(), said.lines().count()), (Some(0), "", 1), "{said}");
        assert!(said.starts_with("note: ") && said.contains(" samples given up"), "{said}");
        assert!(said.ends_with("; a longer --deadline-ms gives up less\n"), "{said}");
    }
}

/// By the learnt costs, selection takes 1.25 x 48.48 s = 60.6 s, which refuses the first frame of a series. After the
/// refusal, 2 % less are below 60 s, and the second frame corrects the costs.
#[test]
fn a_series_goes_on_after_a_frame_without_time() {
    let place = Place::new();
    place.write("drive.tum", b"0 0 0 1 0 0 0 1\n1 0 0 1 0 0 0 1\n2 0 0 1 0 0 0 1\n");
    let layer = r#"{"format": 1, "class": "laser", "features": [{"id": 7, "kind": "point", "points": [[2, 0, 1]]}]}"#;
    place.write("l.json", layer.as_bytes());
    let series = "predict wall.glb --sensor laser-scanner --poses drive.tum --backend cpu --threads 1 --layer l.json \
                  --outputs range,object_id,feature_id --deadline-ms 60000 --costs costs.json";
    learn_slow(&place, series, "access", 48.48);
    let outcome = place
        .run(&format!("{series} --json --out {{i}}.exr --png {{i}}.png --features {{i}}.json --npy {{output}}.npy"));
    assert_eq!(outcome.status, Some(0), "{}", outcome.stderr);
    let said = "note: 1 of 3 predictions are incomplete, 1 of them empty: a longer --deadline-ms gives up less\n";
    assert_eq!(outcome.stderr, said);
    let lines: Vec<Value> = outcome.stdout.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    let given_up = &lines[0]["given_up"];
    assert_eq!(
        (lines.len(), &given_up["samples"], &given_up["complete_to"]),
        (3, &json!(361), &json!(0.0)),
        "{given_up}"
    );
    assert_eq!((&given_up["features"], &lines[0]["pixels_hit"]), (&json!([7]), &json!(0)));
    for line in &lines[1..] {
        assert_eq!((&line["given_up"], line["pixels_hit"].as_u64() > Some(0)), (&Value::Null, true), "{line}");
    }
    let empty = place.images("0.exr");
    assert!(empty.images.range.len() == 361 && empty.images.range.iter().all(|range| range.is_nan()));
    assert!(empty.images.object_id.iter().chain(&empty.images.feature_id).all(|id| *id == 0));
    assert_eq!(serde_json::to_value(empty.attributes.given_up).unwrap(), *given_up);
    assert_eq!(place.json("0.json")["given_up"], *given_up);
    assert_eq!(place.images("2.exr").images.object_id[180], 1);
    assert!(place.path("0.png").exists());
}

#[test]
fn priorities_are_checked() {
    let place = Place::new();
    let metres = ("; give metres above 0, such as 2", "2");
    for (flag, value, change) in [
        ("--deadline-ms 60000 --deadline-radius", "0", metres),
        ("--deadline-ms 60000 --deadline-radius", "-1", metres),
        ("--deadline-ms 60000 --deadline-heading", "NaN", ("; give degrees, such as 30", "30")),
    ] {
        check_value(&place, flag, value, change);
    }
    let line = format!(
        "{PREDICT} --deadline-ms 60000 --deadline-radius 3 --deadline-heading -30 --deadline-features 7,3 --explain"
    );
    assert!(place.done(&line).contains("given up  nothing"));
    assert_eq!(place.run(&format!("{PREDICT} --deadline-heading 3")).status, Some(2), "a heading without a deadline");
}

#[test]
fn broken_cost_files_are_named_and_left_unchanged() {
    let place = Place::new();
    for (text, said) in [
        ("{}", "does not name its format"),
        ("{\"format\": 9, \"models\": []}", "newer"),
        ("no", "not a valid file of costs"),
    ] {
        place.write("costs.json", text.as_bytes());
        let outcome = place.run(&format!("{PREDICT} --deadline-ms 60000 --costs costs.json"));
        assert_eq!(outcome.status, Some(1), "{text}: {}", outcome.stderr);
        assert!(outcome.stderr.contains("costs.json") && outcome.stderr.contains(said), "{}", outcome.stderr);
        assert_eq!(fs::read_to_string(place.path("costs.json")).unwrap(), text);
    }
}
