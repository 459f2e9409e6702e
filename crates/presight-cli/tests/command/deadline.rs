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

#[test]
fn invalid_deadlines_are_wrong_usage_and_too_short_ones_exit_with_4() {
    let place = Place::new();
    for wrong in ["0", "-3", "NaN", "inf", "1e300"] {
        let outcome = place.run(&format!("{PREDICT} --deadline-ms {wrong} --out a.exr"));
        assert_eq!(outcome.status, Some(2), "{wrong}: {}", outcome.stderr);
        assert!(outcome.stderr.contains("--deadline-ms"), "{}", outcome.stderr);
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

#[test]
fn priorities_are_checked() {
    let place = Place::new();
    for (flag, value) in [("--deadline-radius", "0"), ("--deadline-radius", "-1"), ("--deadline-heading", "NaN")] {
        let outcome = place.run(&format!("{PREDICT} --deadline-ms 60000 {flag} {value}"));
        assert_eq!(outcome.status, Some(2), "{flag} {value}: {}", outcome.stderr);
        assert!(outcome.stderr.contains(flag), "{}", outcome.stderr);
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
    for (text, said) in
        [("{}", "has no format"), ("{\"format\": 9, \"models\": []}", "newer"), ("no", "not a valid file of costs")]
    {
        place.write("costs.json", text.as_bytes());
        let outcome = place.run(&format!("{PREDICT} --deadline-ms 60000 --costs costs.json"));
        assert_eq!(outcome.status, Some(1), "{text}: {}", outcome.stderr);
        assert!(outcome.stderr.contains("costs.json") && outcome.stderr.contains(said), "{}", outcome.stderr);
        assert_eq!(fs::read_to_string(place.path("costs.json")).unwrap(), text);
    }
}
