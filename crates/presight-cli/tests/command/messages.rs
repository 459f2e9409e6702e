//! Messages are one printable line of bounded length and do not mislead, whatever names and files contain.

use super::{Outcome, Place, VIEW, WALL, WALL_INDICES, camera, wall};
use presight::files;
use serde_json::json;

/// A name that breaks lines, colours a terminal, reverses the text direction and hides characters.
const NASTY: &str = "wall\n\u{1b}[31mred\r\u{202e}\u{200b}\u{9b}";
/// [`NASTY`] as messages must show it.
#[cfg(feature = "store")]
const SHOWN: &str = "wall\\n\\u{1b}[31mred\\r\\u{202e}\\u{200b}\\u{9b}";

fn assert_printable(text: &str) {
    let odd = text.chars().find(|c| *c != '\n' && (c.is_control() || "\u{202e}\u{200b}".contains(*c)));
    assert_eq!(odd, None, "{text:?}");
}

/// Checks that stderr is one line of bounded length, and returns the exit status.
fn refused(outcome: &Outcome) -> Option<i32> {
    let said = &outcome.stderr;
    assert_eq!((said.lines().count(), outcome.stdout.as_str()), (1, ""), "{said:?}");
    assert!(said.starts_with("error: ") && said.len() < 6000, "{} bytes", said.len());
    assert_printable(said);
    outcome.status
}

fn nasty_scene(place: &Place) {
    let rename = |root: &mut serde_json::Value| {
        root["nodes"][0]["name"] = json!(NASTY);
        root["materials"] = json!([{ "name": NASTY }]);
        root["meshes"][0]["primitives"][0]["material"] = json!(0);
    };
    place.write("nasty.glb", &wall(rename, WALL, WALL_INDICES));
}

#[test]
fn names_are_shown_escaped_and_kept_unchanged() {
    let place = Place::new();
    nasty_scene(&place);
    let sensor = camera(16, 16).replace("format = 1", "format = 1\nname = \"wall\\n\\u001b[31mred\"");
    place.write("s.toml", sensor.as_bytes());
    let view = "--sensor s.toml --pose 0,0,1,0,0,0 --backend cpu";
    for line in [
        "inspect nasty.glb".to_owned(),
        format!("predict nasty.glb {view}"),
        format!("predict nasty.glb {view} --explain"),
        "features pick nasty.glb --sensor s.toml --pose 0,0,1,0,0,0 --pixel 8,8".to_owned(),
    ] {
        let outcome = place.run(&line);
        assert_printable(&outcome.stdout);
        assert!(outcome.stdout.contains("wall\\n\\u{1b}[31mred"), "{line}: {}{}", outcome.stdout, outcome.stderr);
    }
    // Output for programs keeps the names unchanged.
    assert_eq!(place.done("inspect nasty.glb --json").matches("wall\\n\\u001b[31mred").count(), 2);
    place.done(&format!("predict nasty.glb {view} --out a.exr"));
    let attributes = place.images("a.exr").attributes;
    assert_eq!(attributes.objects[&1], NASTY);
    let sensor = files::parse_sensor_toml(&attributes.sensor.unwrap(), "", None).unwrap();
    assert_eq!(sensor.name, "wall\n\u{1b}[31mred");
}

#[test]
fn faults_of_odd_and_long_names_are_one_line() {
    let place = Place::new();
    nasty_scene(&place);
    let uri = "x".repeat(100_000);
    let with_uri = |uri: &str| {
        wall(
            |root| root["buffers"].as_array_mut().unwrap().push(json!({ "byteLength": 8, "uri": uri })),
            WALL,
            WALL_INDICES,
        )
    };
    place.write("long.glb", &with_uri(&uri));
    place.write("odd.glb", &with_uri(NASTY));
    place.write("zero.glb", &with_uri("a%00b"));
    let flat = |root: &mut serde_json::Value| {
        root["nodes"][0]["name"] = json!(format!("{NASTY}{uri}"));
        root["nodes"][0]["scale"] = json!([1, 0, 1]);
    };
    place.write("flat.glb", &wall(flat, WALL, WALL_INDICES));
    for scene in ["long.glb", "odd.glb", "zero.glb", "flat.glb"] {
        assert_eq!(refused(&place.run(&format!("inspect {scene}"))), Some(1), "{scene}");
    }
    assert!(place.run("inspect odd.glb").stderr.contains("\\u{1b}[31mred"));
    for name in [&format!("{NASTY}.glb"), NASTY, &uri] {
        assert_eq!(refused(&place.run_args(&["inspect", name])), Some(1));
        let pose = ["--sensor", name, "--pose", "0,0,1,0,0,0"];
        assert_eq!(refused(&place.run_args(&[&["predict", "wall.glb"][..], &pose].concat())), Some(2));
        assert_eq!(refused(&place.run_args(&["sensors", name])), Some(2));
        assert_eq!(refused(&place.run_args(&[name])), Some(2));
    }
}

/// A file with 50 MB of text instead of a line of three numbers.
#[test]
fn a_long_line_is_quoted_by_its_start() {
    let place = Place::new();
    let table = "format = 1\nkind = \"rays\"\nwidth = 1\nheight = 1\nfile = \"r.csv\"\n";
    place.write("r.toml", table.as_bytes());
    place.write("r.csv", "1,0,é\u{1b}".repeat(6_250_000).as_bytes());
    let outcome = place.run("predict wall.glb --sensor r.toml --pose 0,0,1,0,0,0 --backend cpu");
    assert_eq!(refused(&outcome), Some(1));
    assert!(
        outcome.stderr.contains("r.csv: line 1: \"1,0,é\\u{1b}1,0") && outcome.stderr.len() < 400,
        "{}",
        outcome.stderr
    );
}

#[cfg(feature = "script")]
#[test]
fn scripts_print_and_throw_one_line() {
    let place = Place::new();
    let long = "y".repeat(4_000);
    let names = |text: &str| format!("print(\"{text}\"); let y = \"{long}\"; print(y + y + y + y); throw \"{text}\";");
    place.write("s.rhai", names("a\\nb\\x1b[2J").as_bytes());
    let outcome = place.run("inspect s.rhai");
    let said: Vec<&str> = outcome.stderr.lines().collect();
    assert!(said.len() == 3 && said[0] == "a\\nb\\u{1b}[2J", "{said:?}");
    assert!(said[1].len() < 6000 && said[2].starts_with("error: ") && said[2].contains("\\u{1b}[2J"), "{said:?}");
    assert_printable(&outcome.stderr);
}

#[cfg(feature = "store")]
#[test]
fn the_log_has_one_line_for_each_entry() {
    let place = Place::new();
    place.done("env create s.presight wall.glb");
    let long = "z".repeat(1 << 20);
    let entry =
        |id: &str, more: &str| json!({ "op": "group", "changes": [], "id": id, "cause": format!("{NASTY}{more}") });
    let other = json!({ "op": "delete_object", "object": "wall", "id": long });
    place.write("c.jsonl", format!("{}\n{}\n{other}\n", entry(NASTY, ""), entry(&long, &long)).as_bytes());
    let outcome = place.run("env apply s.presight c.jsonl");
    assert_eq!((outcome.status, outcome.stdout.as_str()), (Some(1), "ack 1\nack 2\n"));
    assert!(outcome.stderr.contains("c.jsonl: line 3: id \"zzz") && outcome.stderr.len() < 400, "{}", outcome.stderr);
    let log = place.done("env log s.presight");
    assert_printable(&log);
    assert!(log.lines().count() == 2 && log.len() < 2000 && log.contains(SHOWN), "{log}");
    let json = place.done("env log s.presight --json");
    let first: serde_json::Value = serde_json::from_str(json.lines().next().unwrap()).unwrap();
    assert_eq!((first["cause"].as_str(), first["id"].as_str()), (Some(NASTY), Some(NASTY)));
}

/// A message about a negative number is about the number; it gives no useless tip about flags.
#[test]
fn negative_numbers_are_numbers() {
    let place = Place::new();
    let predict = format!("predict wall.glb {VIEW}");
    for (line, named) in [
        ("features wall.glb --class video --sigma -1".to_owned(), "deviation of -1"),
        ("features wall.glb --class video --crease-deg -1e3".to_owned(), "crease"),
        (format!("{predict} --threads -1"), "--threads"),
        (format!("{predict} --repeat -2"), "--repeat"),
        (format!("{predict} --merge-tolerance -1e-9"), "merge tolerance"),
        ("index wall.glb --count -5".to_owned(), "--count"),
        ("features wall.glb --class video --sigma -inf".to_owned(), "deviation of -inf"),
    ] {
        let outcome = place.run(&line);
        assert_eq!(refused(&outcome), Some(2), "{line}");
        assert!(outcome.stderr.contains(named) && !outcome.stderr.contains("'-- "), "{line}: {}", outcome.stderr);
    }
}

#[test]
fn no_bound_is_minus_zero() {
    let place = Place::new();
    let mut corners = WALL;
    corners.iter_mut().for_each(|c| c[2] = if c[2] > 0.0 { 1e-5 } else { -2.0 });
    place.write("w.glb", &wall(|_| (), corners, WALL_INDICES));
    let words = place.done("inspect w.glb");
    // y is -z of glTF and ranges from -1e-5 to 2.
    assert!(words.contains("y 0.000..2.000") && !words.contains("-0.000"), "{words}");
}
