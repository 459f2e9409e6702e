use super::*;
use glam::DVec3;
use presight_model::error::ErrorKind;
use presight_model::sensor::{Angles, Geometry, Scanner};
use proptest::prelude::*;

fn scanner(beams: u32) -> SensorSpec {
    let uniform = |count| Angles::Uniform { start_deg: 0.0, step_deg: 1.0, count };
    let geometry = Scanner { azimuth: uniform(beams), elevation: uniform(1), beam_height_deg: None };
    SensorSpec::new("s", "laser", Geometry::Scanner(geometry)).with_limits(0.5, 30.0)
}

fn write(text: &str) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.jsonl");
    std::fs::write(&path, text).unwrap();
    (folder, path)
}

/// All frames of a log, or the first error.
fn frames(text: &str) -> Result<Vec<LogFrame>> {
    let (_folder, path) = write(text);
    open(&path)?.collect()
}

fn log(lines: &[&str]) -> String {
    let mut text = lines::header(&scanner(3));
    lines.iter().for_each(|line| text += &format!("\n{line}"));
    text
}

proptest! {
    #[test]
    fn frames_read_back_bit_for_bit(
        time in -1e10..1e10f64,
        range in prop::array::uniform3(prop_oneof![
            0.5..30f32, Just(f32::INFINITY), Just(f32::NEG_INFINITY), Just(f32::NAN)
        ]),
        moved in prop::option::of(prop::array::uniform3(-3.0..3.0f64)),
        bright in prop::option::of(
            prop::array::uniform3(prop_oneof![0.0..=1f32, Just(0.0), Just(1.0), Just(f32::NAN)])
        ),
        late in prop::option::of(prop::array::uniform3(-60.0..=60f32)),
    ) {
        let odometry = moved.map(|[x, y, yaw]| Pose::from_xyz_rpy(DVec3::new(x, y, 0.1), 0.2, 0.3, yaw));
        let intensities = bright.map(|all| all.to_vec());
        let reference = odometry.map(RobotPose::new);
        let twist = moved.map(|[x, y, yaw]| Twist::from_array([x, y, 0.1, 0.2, -0.3, yaw]));
        let times = late.map(|all| all.to_vec());
        let frame = LogFrame { time, range: range.to_vec(), intensities, times, twist, odometry, reference };
        let read = frames(&log(&[&lines::line(&frame).unwrap(), ""])).unwrap();
        prop_assert_eq!(read.len(), 1);
        let bits = |all: &[f32]| all.iter().map(|r| if r.is_nan() { 0 } else { r.to_bits() }).collect::<Vec<_>>();
        let kept = |f: &LogFrame| (bits(&f.range), f.intensities.as_deref().map(bits));
        prop_assert_eq!(kept(&read[0]), kept(&frame));
        prop_assert_eq!((read[0].time, read[0].odometry, read[0].reference), (time, odometry, reference));
        prop_assert_eq!((&read[0].times, read[0].twist), (&frame.times, twist));
    }
}

#[test]
fn what_a_line_cannot_hold_is_refused() {
    let sound = LogFrame { intensities: Some(vec![0.5]), ..LogFrame::new(1.0, vec![2.0]) };
    let far = Pose { translation: DVec3::new(f64::NAN, 0.0, 0.0), ..Pose::IDENTITY };
    for (frame, words) in [
        (LogFrame { time: f64::NAN, ..sound.clone() }, "time is NaN s"),
        (LogFrame { time: f64::INFINITY, ..sound.clone() }, "time is inf s"),
        (LogFrame { intensities: Some(vec![f32::INFINITY]), ..sound.clone() }, "an intensity is infinite"),
        (LogFrame { odometry: Some(far), ..sound.clone() }, "is not finite"),
        (LogFrame { times: Some(vec![f32::NAN]), ..sound.clone() }, "a time of a ray is not finite"),
        (LogFrame { twist: Some(Twist::new(DVec3::X * f64::INFINITY, DVec3::ZERO)), ..sound.clone() }, "a twist of"),
    ] {
        let e = lines::line(&frame).unwrap_err();
        assert!(e.kind() == ErrorKind::Invalid && e.to_string().contains(words), "{e}");
    }
    assert!(lines::line(&sound).is_ok());
}

#[test]
fn readings_and_poses_are_what_the_line_says() {
    let text = log(&[
        r#"{"t": 1, "range": [2, null, "inf"]}"#,
        "",
        r#"{"t": 2.5, "range": ["-inf", 0.5, 30], "odometry": [1,0,0,0,0,90], "reference": [1, 2, 3, 0, 0, 0, 1]}"#,
    ]);
    let read = frames(&text).unwrap();
    assert_eq!(read.len(), 2);
    assert!(read[0].range[0] == 2.0 && read[0].range[1].is_nan() && read[0].range[2] == f32::INFINITY);
    assert_eq!(read[1].range, [f32::NEG_INFINITY, 0.5, 30.0]);
    let ahead = read[1].odometry.unwrap().transform_point(DVec3::X);
    assert!((ahead - DVec3::new(1.0, 1.0, 0.0)).length() < 1e-12);
    let reference = RobotPose::from_xyz_rpy(DVec3::new(1.0, 2.0, 3.0), 0.0, 0.0, 0.0);
    assert_eq!(read[1].reference, Some(reference));
    assert_eq!((read[0].odometry, read[0].reference), (None, None));
}

/// Intensities are optional, and the estimator's frame keeps them.
#[test]
fn intensities_are_read_beside_ranges() {
    let text = log(&[
        r#"{"t": 1, "range": [2, null, "inf"], "intensities": [0.25, 1, null]}"#,
        r#"{"t": 2, "range": [2, 2, 2]}"#,
    ]);
    let read = frames(&text).unwrap();
    let kept = read[0].intensities.as_ref().unwrap();
    assert!(kept[..2] == [0.25, 1.0] && kept[2].is_nan() && read[1].intensities.is_none());
    let sensor = Sensor::new(scanner(3)).unwrap();
    let sensed: Vec<_> = read.into_iter().map(|f| f.into_frame(&sensor, &OdometryNoise::default()).unwrap()).collect();
    let image = sensed[0].intensities().unwrap();
    assert_eq!((image.width(), image.height(), image.values()[1]), (3, 1, 1.0));
    assert!(sensed[1].intensities().is_none());
    // The middle beam keeps its intensity.
    assert_eq!(sensed[0].thinned(3).unwrap().intensities().unwrap().values(), [1.0]);
}

#[test]
fn what_is_wrong_is_kept_with_file_and_line() {
    let good = r#"{"t": 1, "range": [2, 2, 2]}"#;
    let cases = [
        (r#"{"t": 2, "range": [2, 2]}"#, "2 ranges for 3 rays"),
        (r#"{"t": 1, "range": [2, 2, 2]}"#, "is not after"),
        (r#"{"t": 0, "range": [2, 2, 2]}"#, "is not after"),
        (r#"{"t": 2, "range": [2, 2, "near"]}"#, "not a valid frame"),
        (r#"{"t": 2, "range": [2, 2, "2.5"]}"#, "not a valid frame"),
        (r#"{"t": NaN, "range": [2, 2, 2]}"#, "not a valid frame"),
        (r#"{"t": 2, "range": [2, 2, true]}"#, "not a valid frame"),
        (r#"{"t": 2, "range": [2, 2, 2], "more": 1}"#, "not a valid frame"),
        (r#"{"t": 2, "range": [2, 2, 2], "odometry": [1, 2]}"#, "odometry: not a valid pose"),
        (r#"{"t": 2, "range": [2, 2, 2], "reference": [0, 0, 0, 0, 0, 0, 0]}"#, "reference: not a valid pose"),
        (r#"{"t": 2, "range": [2, 2"#, "cut in the middle"),
        (r#"{"t": 2, "range": [2, 2, 2], "intensities": [0.5, 1"#, "cut in the middle"),
        (r#"{"t": 2, "range": [2, 2, 2], "intensities": [0.5, 1]}"#, "2 intensities for 3 rays"),
        (r#"{"t": 2, "range": [2, 2, 2], "intensities": []}"#, "0 intensities for 3 rays"),
        (r#"{"t": 2, "range": [2, 2, 2], "intensities": [0, 1, -0.1]}"#, "intensity 2: an intensity of -0.1"),
        (r#"{"t": 2, "range": [2, 2, 2], "intensities": [0, 255, 1]}"#, "intensity 1: an intensity of 255"),
        (r#"{"t": 2, "range": [2, 2, 2], "intensities": [0, 1, 1e300]}"#, "intensity 2"),
        (r#"{"t": 2, "range": [2, 2, 2], "intensities": [0, 1, "inf"]}"#, "intensity 2: an intensity of inf"),
        (r#"{"t": 2, "range": [2, 2, 2], "intensity": [0, 1, 1]}"#, "not a valid frame"),
        (r#"{"t": 2, "range": [2, 2, 2], "times": [0, 0.1]}"#, "times: 2 times for 3 x 1 rays"),
        (r#"{"t": 2, "range": [2, 2, 2], "times": [0, 0.1, 1e8]}"#, "ray 2: a time of 100000000 s"),
        (r#"{"t": 2, "range": [2, 2, 2], "times": [0, 0.1, null]}"#, "not a valid frame"),
        (r#"{"t": 2, "range": [2, 2, 2], "twist": [1, 0, 0]}"#, "not a valid frame"),
        (r#"{"t": 2, "range": [2, 2, 2], "twist": [1e300, 0, 0, 0, 0, 1]}"#, "a twist of"),
        ("nonsense", "not a valid frame"),
    ];
    for (line, what) in cases {
        let (_folder, path) = write(&log(&[good, line, good]));
        let mut log = open(&path).unwrap();
        assert!(log.next().unwrap().is_ok());
        let e = log.next().unwrap().unwrap_err();
        assert_eq!((e.kind(), e.file()), (ErrorKind::Invalid, Some(path.as_path())), "{e}");
        assert!(e.to_string().contains("line 3") && e.to_string().contains(what), "{line}: {e}");
        assert!(!e.remedy().is_empty() && log.next().is_none(), "the log ends there");
    }
}

#[test]
fn headers_are_checked() {
    let newer = lines::header(&scanner(3)).replace("\"format\":1", "\"format\":2");
    assert_eq!(frames(&newer).unwrap_err().kind(), ErrorKind::Unsupported);
    let cases = ["", "{}", "[1]", "{\"format\": 1}", "{\"format\": 0}", "{\"scans\": []}", "{\"scans\": [", "\u{0}"];
    for text in cases {
        let e = frames(text).unwrap_err();
        assert!(e.kind() == ErrorKind::Invalid && e.file().is_some() && !e.remedy().is_empty(), "{text:?}: {e}");
    }
    let (_folder, path) = write(&log(&[]));
    assert_eq!(open(&path).unwrap().count(), 0, "a log without frames is one");
    let e = read_frame(&path, 0).unwrap_err();
    assert_eq!(e.kind(), ErrorKind::Usage, "{e}");
}

#[test]
fn endless_lines_end() {
    let header = format!("{}\n{{\"t\": 1, \"range\": [", lines::header(&scanner(3)));
    let (_folder, path) = write(&header);
    let file = std::fs::File::options().write(true).open(&path).unwrap();
    // A sparse file takes no space on disk.
    file.set_len(limits::MAX_LINE_BYTES + (1 << 20)).unwrap();
    let e = open(&path).unwrap().next().unwrap().unwrap_err();
    assert!(e.to_string().contains("longer than") && e.to_string().contains("line 2"), "{e}");
}

/// A document of a data set is read; variants with one fault each are refused.
#[test]
fn documents_are_read_and_their_faults_named() {
    let good = r#"{"beams": 3, "angle_min": -1.5707963705062866, "angle_max": 1.5707963705062866, "range_max": 80,
        "range_std": 0.01, "sensor_on_robot": {"x": 0.5, "y": 0, "z": 0.25, "yaw": 0}, "note": 1,
        "scans": [{"t": 1, "odometry_increment": [1, 2, 0], "robot_pose": {"x": 3, "y": 4, "yaw": 0},
            "ranges": [1.5, 81.9, 2], "valid": "101"}]}"#;
    let (_folder, path) = write(good);
    let log = open(&path).unwrap();
    let spec = log.sensor().spec().clone();
    let Geometry::Scanner(scanner) = &spec.geometry else { panic!("a scanner") };
    // The nearest f32 to pi / 2 means 90 degrees.
    assert_eq!(scanner.azimuth, Angles::Uniform { start_deg: -90.0, step_deg: 90.0, count: 3 });
    assert_eq!((spec.noise.range_sigma, spec.range_max, spec.mount.translation.z), (0.01, 80.0, 0.25));
    let frame = log.map(Result::unwrap).next().unwrap();
    assert!(frame.range[1].is_nan() && frame.range[0] == 1.5 && frame.range[2] == 2.0);
    assert_eq!(frame.odometry.unwrap().translation, DVec3::new(1.0, 2.0, 0.0));
    assert_eq!(frame.reference.unwrap().world_from_robot().translation, DVec3::new(3.0, 4.0, 0.0));
    let faults = [
        ("\"valid\": \"101\"", "\"valid\": \"10\"", "valid does not fit"),
        ("\"valid\": \"101\"", "\"valid\": \"1x1\"", "valid does not fit"),
        ("1.5, 81.9, 2", "1.5, 81.9", "valid does not fit"),
        ("1.5, 81.9, 2], \"valid\": \"101\"", "1.5, 2], \"valid\": \"11\"", "2 ranges for 3 rays"),
        ("\"x\": 3", "\"x\": 1e200", "reference"),
        ("\"beams\": 3", "\"beams\": 0", "image"),
        ("\"beams\": 3, ", "", "beams is missing"),
        ("\"scans\"", "\"scam\"", "not a valid log"),
    ];
    for (part, fault, what) in faults {
        assert!(good.contains(part));
        let e = frames(&good.replace(part, fault)).unwrap_err();
        assert!(e.kind() == ErrorKind::Invalid && e.file().is_some() && e.to_string().contains(what), "{fault}: {e}");
    }
    let mirrored = good.replace("\"beams\": 3", "\"beams\": 3, \"counter_clockwise\": false");
    let (_folder, path) = write(&mirrored);
    let spec = open(&path).unwrap().sensor().spec().clone();
    let Geometry::Scanner(scanner) = &spec.geometry else { panic!("a scanner") };
    assert_eq!(scanner.azimuth, Angles::Uniform { start_deg: 90.0, step_deg: -90.0, count: 3 });
}
