use super::*;
use crate::cloud::Cloud;
use presight_render::plan::{Images, Output, Outputs};

fn cloud(points: Vec<DVec3>) -> Cloud {
    Cloud { points, size: None, world_from_sensor: None }
}

/// Points of a rotating scanner, without some of them: columns 2 degrees apart, rows 1 degree.
fn turning(columns: u32, without: impl Fn(u32, u32) -> bool) -> Vec<DVec3> {
    let all = (0..columns).flat_map(|c| (0..40).map(move |r| (c, r)));
    let point = |(c, r): (u32, u32)| {
        let (azimuth, elevation) = (f64::to_radians(2.0 * f64::from(c) + 0.3), f64::to_radians(f64::from(r) - 20.3));
        let ray = DVec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
        (5.0 + 0.01 * f64::from(c) + 0.1 * f64::from(r)) * ray
    };
    all.filter(|(c, r)| !without(*c, *r)).map(point).collect()
}

/// Each point gets its own pixel with exactly its ray and range, in any order of the points. Columns run
/// counter-clockwise, the first row is the highest, and pixels without a point are rays without a reading.
#[test]
fn points_of_a_scanner_get_their_pixels_back() {
    for (columns, width) in [(180, 180), (50, 50)] {
        let mut points = turning(columns, |c, r| (c * 7 + r * 3) % 11 == 0);
        // Some other order.
        points.sort_by(|a, b| (a.x * 1e3).fract().total_cmp(&(b.x * 1e3).fract()));
        let RangeGrid { table, ranges } = range_grid(&cloud(points.clone())).unwrap();
        assert!(
            table.width().abs_diff(width) <= 1 && table.height().abs_diff(40) <= 1,
            "{} x {}",
            table.width(),
            table.height()
        );
        let read = ranges.iter().zip(table.directions()).filter(|(r, _)| r.is_finite());
        let seen: Vec<DVec3> = read.map(|(r, d)| f64::from(*r) * *d).collect();
        assert!(seen.len() as f64 > 0.97 * points.len() as f64, "{} of {}", seen.len(), points.len());
        assert!(seen.iter().all(|p| points.iter().any(|q| p.distance(*q) < 1e-6)));
        assert!(table.directions().iter().all(|d| !d.is_nan()), "every pixel has a ray");
        let (middle, w) = (table.height() / 2 * table.width(), table.width() as usize);
        let row = &table.directions()[middle as usize..middle as usize + w];
        assert!(row.windows(2).all(|p| p[0].x * p[1].y - p[0].y * p[1].x > 0.0), "counter-clockwise");
        assert!(table.directions()[0].z > table.directions()[w * (table.height() as usize - 1)].z);
    }
}

/// A level scan gives one row, a single point one pixel, and scattered points an image of limited size.
#[test]
fn odd_clouds_are_images_too() {
    let level: Vec<DVec3> = turning(90, |_, r| r != 0).into_iter().map(|p| DVec3::new(p.x, p.y, 0.0)).collect();
    let grid = range_grid(&cloud(level)).unwrap();
    assert_eq!(grid.table.height(), 1);
    assert!(grid.ranges.iter().filter(|r| r.is_finite()).count() >= 88);
    let one = range_grid(&cloud(vec![DVec3::new(0.0, 3.0, 0.0), DVec3::ZERO])).unwrap();
    assert_eq!((one.ranges.len(), one.ranges[0]), (1, 3.0));
    let mut random = presight_model::random::SplitMix64(4);
    let mut any = || DVec3::new(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0));
    // Close pairs, far apart from each other.
    let pairs: Vec<DVec3> = (0..200)
        .flat_map(|_| {
            let p = any();
            [p, p + 1e-5 * any()]
        })
        .collect();
    let grid = range_grid(&cloud(pairs)).unwrap();
    assert!(grid.ranges.len() <= 1700, "{}", grid.ranges.len());
}

#[test]
fn organized_clouds_keep_rows_and_columns() {
    let points = vec![DVec3::X, DVec3::new(2.0, 1.0, 0.0), DVec3::NAN, DVec3::ZERO];
    let RangeGrid { table, ranges } = range_grid(&Cloud { size: Some((2, 2)), ..cloud(points) }).unwrap();
    assert_eq!((table.width(), table.height(), ranges[1]), (2, 2, 5f32.sqrt()));
    assert!(table.directions()[2].is_nan() && table.directions()[3].is_nan() && ranges[2].is_nan());
}

/// An image of ranges has its own sensor, pose and time.
#[test]
fn images_of_ranges_are_frames() {
    let folder = tempfile::tempdir().unwrap();
    let sensor = crate::preset("laser-scanner").unwrap();
    let write = |name: &str, outputs: &[Output], sensor: Option<String>| {
        let mut images = Images::default();
        images.prepare(361, 1, Outputs::of(outputs));
        images.range.fill(2.5);
        let world_from_sensor = Some(Pose::from_xyz_rpy(DVec3::X, 0.0, 0.0, 0.5));
        let attributes = exr::Attributes { sensor, world_from_sensor, ..Default::default() };
        exr::write(&folder.path().join(name), &images, Outputs::ALL, &attributes).unwrap();
    };
    let text = || Some(sensor_toml::to_string(sensor.spec()));
    write("10.exr", &[Output::Range], text());
    write("9.exr", &[Output::Range, Output::Echo], text());
    let frames: Vec<Observation> = Scans::open(folder.path(), None).unwrap().map(Result::unwrap).collect();
    assert_eq!(frames.iter().map(|o| o.frame.stamp).collect::<Vec<_>>(), [9.0, 10.0]);
    assert_eq!(frames[0].frame.sensor().spec().geometry, sensor.spec().geometry);
    assert_eq!(frames[0].reference.unwrap().translation, DVec3::X);
    assert_eq!(frames[0].frame.ranges()[7], 2.5);
    write("11.exr", &[Output::Range], None);
    let told = |sensor: Option<&Sensor>| {
        let mut scans = Scans::open(&folder.path().join("11.exr"), sensor).unwrap();
        scans.next().unwrap().map(drop).map_err(|e| e.to_string())
    };
    assert!(told(None).unwrap_err().contains("which sensor"));
    assert!(told(Some(&sensor)).is_ok());
    assert!(told(Some(&crate::preset("laser-range-camera").unwrap())).unwrap_err().contains("361 x 1"));
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
    put("poses.json", r#"{"note": "by hand", "b": {"translation": [1, 2, 3], "quaternion_xyzw": [0, 0, 0, 2]}}"#);
    let mut spec = crate::preset("laser-scanner").unwrap().spec().clone();
    (spec.mount, spec.noise.range_sigma) = (Pose::from_xyz_rpy(DVec3::Z, 0.0, 0.0, 0.0), 0.07);
    let sensor = Sensor::new(spec).unwrap();
    let frames: Vec<Observation> = Scans::open(folder.path(), Some(&sensor)).unwrap().map(Result::unwrap).collect();
    assert!(frames[0].reference.is_none() && frames[0].frame.stamp == 0.0);
    assert_eq!(frames[1].reference.unwrap().translation, DVec3::new(1.0, 2.0, 2.0), "of the robot");
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
