use super::*;
use presight::files::{ExrAttributes, write_exr};
use presight::{Images, Output, Outputs};

/// An image of ranges has its own sensor, pose and time.
#[test]
fn images_of_ranges_are_frames() {
    let folder = tempfile::tempdir().unwrap();
    let sensor = crate::preset("laser-scanner").unwrap();
    let write = |name: &str, outputs: &[Output], sensor: Option<String>| {
        let mut images = Images::default();
        images.prepare(361, 1, Outputs::of(outputs));
        images.range.fill(2.5);
        let pose = Some(SensorPose::from_xyz_rpy(DVec3::X, 0.0, 0.0, 0.5));
        let attributes = ExrAttributes { sensor, pose, ..Default::default() };
        write_exr(&folder.path().join(name), &images, Outputs::ALL, &attributes).unwrap();
    };
    let text = || Some(sensor_toml::to_string(sensor.spec()));
    write("10.exr", &[Output::Range], text());
    write("9.exr", &[Output::Range, Output::Echo], text());
    let frames: Vec<Observation> = Scans::open(folder.path(), None).unwrap().map(Result::unwrap).collect();
    assert_eq!(frames.iter().map(|o| o.frame.stamp).collect::<Vec<_>>(), [9.0, 10.0]);
    assert_eq!(frames[0].frame.sensor().spec().geometry, sensor.spec().geometry);
    assert_eq!(frames[0].reference.unwrap().world_from_robot().translation, DVec3::X);
    assert_eq!(frames[0].frame.ranges()[7], 2.5);
    write("11.exr", &[Output::Range], None);
    let outcome = |sensor: Option<&Sensor>| {
        let mut scans = Scans::open(&folder.path().join("11.exr"), sensor).unwrap();
        scans.next().unwrap().map(drop).map_err(|e| e.to_string())
    };
    assert!(outcome(None).unwrap_err().contains("sensor that measured"));
    assert!(outcome(Some(&sensor)).is_ok());
    assert!(outcome(Some(&crate::preset("laser-range-camera").unwrap())).unwrap_err().contains("361 x 1"));
    write("12.exr", &[Output::Echo], text());
    let mut scans = Scans::open(folder.path(), None).unwrap();
    assert!(scans.by_ref().nth(2).unwrap().is_err() && scans.next().is_none(), "nothing after an error");
}

#[test]
fn poses_stand_beside_the_scans() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    assert!(Scans::open(folder.path(), None).unwrap_err().to_string().contains("no scan"));
    put("b.csv", "1,2,0\n2,2,0\n");
    put("a.csv", "1,2,0\n2,2,0\n");
    put("poses.json", r#"{"note": "by hand", "b": {"translation": [1, 2, 3], "quaternion_xyzw": [0, 0, 0, 1]}}"#);
    let mut spec = crate::preset("laser-scanner").unwrap().spec().clone();
    (spec.mount, spec.noise.range_sigma) = (Pose::from_xyz_rpy(DVec3::Z, 0.0, 0.0, 0.0), 0.07);
    let sensor = Sensor::new(spec).unwrap();
    let frames: Vec<Observation> = Scans::open(folder.path(), Some(&sensor)).unwrap().map(Result::unwrap).collect();
    assert!(frames[0].reference.is_none() && frames[0].frame.stamp == 0.0);
    assert_eq!(frames[1].reference.unwrap().world_from_robot().translation, DVec3::new(1.0, 2.0, 2.0), "of the robot");
    assert_eq!(frames[1].frame.sensor().spec().noise.range_sigma, 0.07);
    for wrong in [
        "[1]",
        r#"{"b": {"translation": [1, 2]}}"#,
        r#"{"b": {"translation": [1, 2, 3], "quaternion_xyzw": [0, 0, 0, 0]}}"#,
    ] {
        put("poses.json", wrong);
        let e = Scans::open(folder.path(), None).unwrap_err();
        assert!(e.file().is_some_and(|f| f.ends_with("poses.json")), "{e}");
    }
}

/// A cloud of a lidar of 8 rows and 360 columns that turns left in 0.1 s, on a robot that drives past a wall 5 m to its
/// left, in the order of firing, with the times of a driver.
fn moving_cloud(t: impl Fn(f64) -> f64, kind: &str, speed: f64) -> String {
    let pixels = (0..360).flat_map(|c| (0..8).map(move |r| (f64::from(c), f64::from(r))));
    let points: Vec<String> = pixels
        .filter_map(|(c, r)| {
            let (azimuth, elevation) = ((c - 179.5f64).to_radians(), (r - 3.6f64).to_radians());
            let ray = DVec3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
            // The wall is at y = 5; it ends at x = 10 and at x = -10, where the robot was at the stamp.
            let range = 5.0 / ray.y;
            let seconds = 0.1 * c / 360.0;
            let p = range * ray;
            (range > 0.0 && (p.x + speed * seconds).abs() < 10.0)
                .then(|| format!("{} {} {} {}", p.x, p.y, p.z, t(seconds)))
        })
        .collect();
    let count = points.len();
    format!(
        "ply\nformat ascii 1.0\nelement vertex {count}\nproperty double x\nproperty double y\nproperty double z\n\
         property {kind} time\nend_header\n{}\n",
        points.join("\n")
    )
}

fn frames_of(files: &[(&str, String)], sensor: Option<&Sensor>) -> Result<(Vec<Observation>, Vec<String>)> {
    let folder = tempfile::tempdir().unwrap();
    files.iter().for_each(|(name, text)| std::fs::write(folder.path().join(name), text).unwrap());
    let mut log = crate::log::Frames::open(folder.path(), sensor, &Default::default())?.moving_by_reference();
    let frames = log.by_ref().collect::<Result<_>>()?;
    Ok((frames, log.notices()))
}

/// The ends of the wall along x in the points of a frame.
fn wall(frame: &Frame) -> [f64; 2] {
    let sensor = frame.sensor();
    let width = sensor.width();
    let points = (0..).zip(frame.ranges()).filter(|(_, r)| r.is_finite());
    let x = |(i, r): (u32, &f32)| sensor.ray(i % width, i / width).unwrap().x * f64::from(*r);
    points.map(x).fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)])
}

/// Unorganized clouds, whose columns say no time, are moving scans by the times of their points.
#[test]
fn times_of_points_undo_the_motion() {
    let poses = r#"{"10.0": {"translation": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 1]},
        "10.1": {"translation": [2, 0, 0], "quaternion_xyzw": [0, 0, 0, 1]}}"#;
    // 20 m/s: 2 m during the scan.
    let (speed, stamp) = (20.0, 10.0);
    let read = |kind: &str, t: &dyn Fn(f64) -> f64| {
        let cloud = moving_cloud(t, kind, speed);
        let files = [("10.0.ply", cloud.clone()), ("10.1.ply", cloud), ("poses.json", poses.to_owned())];
        let (frames, notices) = frames_of(&files, None).unwrap();
        let frame = frames[0].frame.deskewed(0.0).unwrap();
        (wall(&frames[0].frame), wall(&frame), notices)
    };
    for (kind, t, words) in [
        ("double", &(|t| t) as &dyn Fn(f64) -> f64, "seconds, counted from the stamp"),
        ("uint", &|t: f64| (t * 1e9).round(), "nanoseconds, counted from the stamp"),
        ("double", &|t| stamp + t, "seconds, on the clock of the stamps"),
    ] {
        let (raw, deskewed, notices) = read(kind, t);
        // The ends of the wall are 11 m away, where columns are 0.44 m apart on it. The left side comes in the second
        // half of the scan, 1 to 2 m from where the robot was at the stamp.
        assert!(raw[0] < -11.0 && raw[1] < 9.01, "{raw:?}");
        assert!(
            deskewed[0] > -10.001 && deskewed[0] < -9.5 && deskewed[1] > 9.5 && deskewed[1] < 10.001,
            "{deskewed:?}"
        );
        assert!(notices.iter().any(|n| n.contains(words)), "{notices:?}");
    }
    // Planted: counted from the last ray, the wall is 2 m off.
    let (_, from_last, notices) = read("double", &|t| t - 0.1);
    assert!(from_last[0] < -11.0 && from_last[1] < 8.01, "{from_last:?}");
    assert!(notices.iter().any(|n| n.contains("counted back from the stamp")), "{notices:?}");
}

#[test]
fn stamps_come_from_the_clock_of_the_points_if_names_do_not_tell() {
    let at = |base: f64| moving_cloud(move |t| base + t, "double", 0.0);
    let files = [("first.ply", at(1.7e9)), ("second.ply", at(1.7e9 + 0.1))];
    let (frames, notices) = frames_of(&files, None).unwrap();
    let stamps: Vec<f64> = frames.iter().map(|o| (o.frame.stamp - 1.7e9) * 1e3).map(f64::round).collect();
    // The wall begins at an azimuth of atan(5 / 10), 26.6 degrees: in column 207 of 360, after 57.5 ms.
    assert!(stamps[1] - stamps[0] == 100.0 && (57.0..=58.0).contains(&stamps[0]), "{stamps:?}");
    assert!(
        frames[0].frame.sensor().scan_interval()[0] == 0.0 && notices.iter().any(|n| n.contains("also give the stamp"))
    );
}

#[test]
fn the_sensor_must_not_contradict_the_points() {
    let turning = |turn_s| {
        let spec = crate::preset("laser-scanner").unwrap().spec().clone();
        Sensor::new(spec.with_times(presight_model::sensor::RayTimes::turning(turn_s, Default::default()))).unwrap()
    };
    let files = [("10.0.ply", moving_cloud(|t| t, "double", 0.0))];
    assert!(frames_of(&files, Some(&turning(0.1))).is_ok());
    let e = frames_of(&files, Some(&turning(0.05))).unwrap_err();
    assert!(e.to_string().contains("by the times of the sensor") && e.file().is_some(), "{e}");
    // The columns of an unorganized cloud are no columns of the scanner, and give no times.
    let untimed = [("10.0.ply", files[0].1.replace(" time", " intensity"))];
    let (frames, notices) = frames_of(&untimed, Some(&turning(0.1))).unwrap();
    assert!(frames[0].frame.sensor().spec().times.is_at_once());
    assert!(notices.iter().any(|n| n.contains("are taken as measured at the stamp")), "{notices:?}");
}
