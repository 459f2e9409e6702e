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
