//! One reading of marks: no command sees a wall that is marked as absent for all sensors.

use super::command::run;
use std::path::Path;

const HALL: &str = r#"
place("floor", box(8.0, 6.0, 0.2), pose(0, 0, -0.2));
place("north", box(8.0, 0.2, 2.0), pose(0, 3.0, 0));
place("south", box(8.0, 0.2, 2.0), pose(0, -3.0, 0));
place("east", box(0.2, 6.0, 2.0), pose(4.0, 0, 0));
place("west", box(0.2, 6.0, 2.0), pose(-4.0, 0, 0));
place("crate", box(0.6, 0.4, 1.0), pose(2.5, 1.2, 0));
"#;
/// It divides the hall.
const WALL: &str = r#"place("wall", box(0.2, 6.0, 2.0), pose(0.5, 0, 0));"#;
const MARK: &str = r#"{"op":"set_mark","mark":"gone","object":"wall","kind":"absent"}"#;
const WAY: &str = r#"{"polyline_in_robot": [[0.3, 0], [5.5, 0]], "half_width": 0.3, "z_min": -0.05, "z_max": 0.05}"#;
const LOG: &str = "../log/scans.jsonl --sensor ../log/sensor.toml --map hall.presight";
const START: &str = "--init=-2.85,-0.5,0,0,0,0";

/// The commands that read a model, each with the file that it writes; an empty name compares the printed text.
fn commands() -> Vec<(String, &'static str)> {
    let predict = "predict hall.presight --pose=-3,-0.5,0.5,0,0,0 --sensor";
    vec![
        (format!("{predict} laser-scanner --outputs range --npy range.npy"), "range.npy"),
        (format!("{predict} video-camera --virtual free-floor"), ""),
        ("occupancy hall.presight --out grid.yaml".into(), "grid.pgm"),
        ("query hall.presight --box 0,-1,0,1,1,1".into(), ""),
        ("query hall.presight --sphere 0.5,0,1,0.3".into(), ""),
        ("query hall.presight --along ../way.json --pose=-2,0,0,0,0,0".into(), ""),
        ("query hall.presight --free 0.8,0,0.6".into(), ""),
        ("query hall.presight --path -2,0,0 2,0,0".into(), ""),
        ("simulate hall.presight --sensor laser-scanner --poses ../drive.tum --out own".into(), "own/scans.jsonl"),
        (format!("localize {LOG} {START} --out pose.tum"), "pose.tum"),
        (format!("localize {LOG} --init unknown --out found.tum"), "found.tum"),
        (format!("supervise {LOG} {START} --corridor ../way.json --out way.jsonl"), "way.jsonl"),
        (format!("update {LOG} {START} --out changes"), "changes/doubts.jsonl"),
    ]
}

/// What a command says and writes in a folder.
fn answer(folder: &Path, (command, file): &(String, &str)) -> Vec<u8> {
    let args: Vec<&str> = command.split(' ').collect();
    let output = super::presight().args(args).current_dir(folder).output().unwrap();
    // A way that is blocked and a robot that is not found are answers too.
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(matches!(output.status.code(), Some(0 | 1)), "{command}: {said}");
    if file.is_empty() { output.stdout } else { std::fs::read(folder.join(file)).unwrap_or_default() }
}

/// Each command answers for a hall with the marked wall as for a hall without it. A command that ignored the mark would
/// answer as for the wall, and that answer differs.
#[test]
fn no_command_sees_what_is_marked_as_absent() {
    let folder = tempfile::tempdir().unwrap();
    let top = folder.path();
    let drive = |k: u32| format!("{} {} -0.5 0 0 0 0 1\n", 0.5 * f64::from(k), -3.0 + 0.15 * f64::from(k));
    std::fs::write(top.join("drive.tum"), (1..9).map(drive).collect::<String>()).unwrap();
    std::fs::write(top.join("way.json"), WAY).unwrap();
    std::fs::write(top.join("mark.jsonl"), format!("{MARK}\n")).unwrap();
    let of = ["bare", "walled", "marked"].map(|name| {
        let own = top.join(name);
        std::fs::create_dir(&own).unwrap();
        let wall = if name == "bare" { "" } else { WALL };
        std::fs::write(own.join("hall.rhai"), format!("{HALL}{wall}")).unwrap();
        run(&own, &["env", "create", "hall.presight", "hall.rhai"]);
        if name == "marked" {
            run(&own, &["env", "apply", "hall.presight", "../mark.jsonl"]);
        }
        own
    });
    let simulate = "simulate bare/hall.presight --sensor laser-scanner --poses drive.tum --out log";
    run(top, &simulate.split(' ').collect::<Vec<_>>());
    for command in &commands() {
        let [bare, walled, marked] = of.each_ref().map(|own| answer(own, command));
        assert!(bare != walled, "{}: the wall makes no difference", command.0);
        assert!(bare == marked, "{}: {}", command.0, String::from_utf8_lossy(&marked[..marked.len().min(500)]));
    }
}
