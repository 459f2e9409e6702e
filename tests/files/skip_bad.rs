//! Logs with single bad frames.

use presight::files::{BagOptions, LogFrames, range_log_header};
use presight::measured::{Frame, OdometryNoise};
use presight::sensor::{Angles, Geometry, Scanner, SensorSpec};
use std::path::PathBuf;

fn write(text: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jsonl");
    std::fs::write(&path, text).unwrap();
    (folder, path)
}

/// A log of three rays.
fn log(lines: &[&str]) -> String {
    let uniform = |count| Angles::Uniform { start_deg: 0.0, step_deg: 1.0, count };
    let geometry = Scanner { azimuth: uniform(3), elevation: uniform(1), beam_height_deg: None };
    let spec = SensorSpec::new("s", "laser", Geometry::Scanner(geometry)).with_limits(0.5, 30.0);
    let mut text = range_log_header(&spec);
    lines.iter().for_each(|line| text += &format!("\n{line}"));
    text
}

/// The number of frames until the log ends, or its first error.
fn frames(text: &str) -> presight::Result<usize> {
    let (_folder, path) = write(text);
    LogFrames::open(&path, None, &OdometryNoise::default())?.try_fold(0, |count, frame| frame.map(|_| count + 1))
}

/// The times and odometry of the frames that are left when bad ones are skipped, and the notice on the others.
fn skipped(text: &str) -> (Vec<(f64, Option<f64>)>, Vec<String>) {
    let (_folder, path) = write(text);
    let noise = OdometryNoise::default();
    let mut log = LogFrames::open_skipping_bad(&path, None, &noise, &BagOptions::default()).unwrap();
    let frames: Vec<Frame> = log.by_ref().map(|o| o.unwrap().frame).collect();
    let left = |f: &Frame| (f.stamp, f.motion.map(|m| m.previous_from_current.translation.x));
    (frames.iter().map(left).collect(), log.notices().into_iter().filter(|n| n.contains("left out")).collect())
}

fn driven(time: f64) -> String {
    format!("{{\"t\": {time}, \"range\": [1, 2, 3], \"odometry\": [1, 0, 0, 0, 0, 0]}}")
}

/// One planted fault of each kind. The motion over a line that cannot be read is unknown.
#[test]
fn single_bad_lines_are_left_out_and_named() {
    let sound: Vec<String> = (0..6).map(|k| driven(f64::from(k))).collect();
    for (bad, why) in [
        ("{\"t\": 3, \"range\": [1, 2", "cut in the middle"),
        ("{\"t\": 3}", "missing field `range`"),
        ("{\"t\": 3, \"range\": [1, 2]}", "2 ranges for 3 rays"),
        ("{\"t\": 3, \"range\": [1, 2, 3], \"odometry\": [1]}", "not a valid pose"),
        ("{\"t\": 3, \"range\": [1, 2, \"three\"]}", "not a valid frame"),
        ("\u{0}\u{0}\u{0}", "not a valid frame"),
    ] {
        let mut lines = sound.clone();
        lines[3] = bad.into();
        let text = log(&lines.iter().map(String::as_str).collect::<Vec<_>>());
        assert!(frames(&text).is_err(), "without skipping, {bad} ends the log");
        let (left, notices) = skipped(&text);
        let one = Some(1.0);
        assert_eq!(left, [(0.0, one), (1.0, one), (2.0, one), (4.0, None), (5.0, one)], "{bad}");
        assert!(
            matches!(&notices[..], [n] if n.starts_with("1 of 6 frames are left out: line 5 (") && n.contains(why)),
            "{notices:?}"
        );
    }
    assert_eq!(skipped(&log(&sound.iter().map(String::as_str).collect::<Vec<_>>())).1, Vec::<String>::new());
}

/// By hand: which of the stamps is bad, and how far the robot drove over it.
#[test]
fn a_stamp_out_of_order_leaves_the_others() {
    for (times, bad, left) in [
        (vec![0.0, 1.0, 0.5, 2.0, 3.0], 3, vec![(0.0, 1.0), (1.0, 1.0), (2.0, 2.0), (3.0, 1.0)]),
        (vec![0.0, 1.0, 1e9, 2.0, 3.0], 3, vec![(0.0, 1.0), (1.0, 1.0), (2.0, 2.0), (3.0, 1.0)]),
        (vec![0.0, 1.0, -7.0, 2.0, 3.0], 3, vec![(0.0, 1.0), (1.0, 1.0), (2.0, 2.0), (3.0, 1.0)]),
        (vec![0.0, 1.0, 1.0, 2.0, 3.0], 3, vec![(0.0, 1.0), (1.0, 1.0), (2.0, 2.0), (3.0, 1.0)]),
        (vec![9e9, 1.0, 2.0], 1, vec![(1.0, 2.0), (2.0, 1.0)]),
        (vec![0.0, 1.0, 2.0, 1.5], 4, vec![(0.0, 1.0), (1.0, 1.0), (2.0, 1.0)]),
    ] {
        let lines: Vec<String> = times.iter().copied().map(driven).collect();
        let (kept, notices) = skipped(&log(&lines.iter().map(String::as_str).collect::<Vec<_>>()));
        let expected: Vec<_> = left.into_iter().map(|(t, x)| (t, Some(x))).collect();
        assert_eq!(kept, expected, "{times:?}: {notices:?}");
        assert!(notices[0].contains(&format!("line {} (", bad + 1)), "{times:?}: {notices:?}");
    }
}

/// A log of bad lines only is an error, not an empty log, and the notice on a long list of faults is short.
#[test]
fn many_bad_lines_are_counted() {
    let (_folder, path) = write(&log(&["{", "{"]));
    let noise = OdometryNoise::default();
    let all: Vec<_> = LogFrames::open_skipping_bad(&path, None, &noise, &BagOptions::default()).unwrap().collect();
    assert!(matches!(&all[..], [Err(e)] if e.place() == Some("line 2")), "{all:?}");
    let mut lines = vec!["{"; 500];
    let sound = driven(1.0);
    lines.push(&sound);
    let (kept, notices) = skipped(&log(&lines));
    assert!(kept.len() == 1 && notices[0].ends_with("and 490 more") && notices[0].len() < 1000, "{notices:?}");
    let (_folder, path) = write("{\"forma");
    assert!(LogFrames::open_skipping_bad(&path, None, &noise, &BagOptions::default()).is_err(), "no header, no sensor");
}

/// A scan of a document without its ranges, and a scan whose time falls.
#[test]
fn bad_scans_of_a_document_are_left_out() {
    let (_folder, path) = write(
        r#"{"beams":2,"angle_min":-1.5,"angle_max":1.5,"range_max":8,"sensor_on_robot":{"x":0,"y":0,"z":1,"yaw":0},
        "scans":[{"t":1,"ranges":[1,2]},{"t":2},{"t":3,"ranges":[1,2]},{"t":0,"ranges":[1,2]},{"t":4,"ranges":[1,2]}]}"#,
    );
    let mut log = LogFrames::open_skipping_bad(&path, None, &OdometryNoise::default(), &BagOptions::default()).unwrap();
    assert_eq!(log.by_ref().map(|o| o.unwrap().frame.stamp).collect::<Vec<_>>(), [1.0, 3.0, 4.0]);
    let notice = log.notices().join("\n");
    assert!(notice.contains("2 of 5 frames are left out: scan 1 (") && notice.contains("scan 3 ("), "{notice}");
}
