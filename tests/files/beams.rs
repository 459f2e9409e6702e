//! Beam tables as the makers of lidars write them, against the arithmetic that the makers publish, written out here by
//! itself.

use glam::{DMat4, DVec3, DVec4};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::{Geometry, RayTable, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::{Backend, Options, Predictor, Request};
use presight_read::{SensorOptions, beams, load_sensor, load_sensor_with};
use presight_testkit::{data, scenes};
use serde_json::Value;
use std::path::PathBuf;

const RANGES: [f64; 3] = [0.5, 10.0, 120.0];

/// Metres: a hundredth of the tenth of a millimetre that predicted points may be off.
const EXACT: f64 = 1e-6;

fn files(folder: &str, ending: &str) -> Vec<PathBuf> {
    let Some(folder) = data::file(&format!("lidar_calib/{folder}")) else { return Vec::new() };
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut files: Vec<PathBuf> = entries.filter(|path| path.extension().is_some_and(|e| e == ending)).collect();
    files.sort();
    files
}

fn table(spec: &SensorSpec) -> &RayTable {
    let Geometry::Rays(table) = &spec.geometry else { panic!("no rays") };
    table
}

/// The measured point of a pixel, `None` without a ray.
fn point(sensor: &Sensor, column: u32, row: u32, range: f64) -> Option<DVec3> {
    sensor.ray(column, row).map(|ray| sensor.origin(column, row) + range * ray)
}

/// What a file says, with the values that ouster-sdk 1.0.1 takes where it says nothing.
struct Ouster {
    columns: u32,
    altitudes: Vec<f64>,
    azimuths: Vec<f64>,
    beam_mm: f64,
    sensor_from_lidar: DMat4,
    shifts: Vec<i64>,
    window: [u32; 2],
}

/// What one does wrong with a table.
#[derive(Clone, Copy, PartialEq)]
enum Planted {
    Nothing,
    OffsetsTurnedBack,
    AzimuthSign,
    RangeFromBeam,
}

impl Ouster {
    fn of(text: &str) -> Self {
        let root: Value = serde_json::from_str(text).unwrap();
        let find = |name: &str| {
            let sections = root.as_object().unwrap().values().chain([&root]);
            sections.filter_map(|section| section.get(name)).next().cloned()
        };
        let numbers = |name: &str| -> Option<Vec<f64>> {
            find(name).map(|list| list.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect())
        };
        let mode = find("lidar_mode").unwrap();
        let columns: u32 = mode.as_str().unwrap().split('x').next().unwrap().parse().unwrap();
        let product = find("prod_line").map_or(String::new(), |p| p.as_str().unwrap().to_owned());
        let usual_mm = match product.split('-').nth(1) {
            Some("0") => 27.67,
            Some("1") => 15.806,
            _ => 12.163,
        };
        let altitudes = numbers("beam_altitude_angles").unwrap();
        let usual: [f64; 16] = [-1., 0., 0., 0., 0., -1., 0., 0., 0., 0., 1., 36.18, 0., 0., 0., 1.];
        let matrix = numbers("lidar_to_sensor_transform").unwrap_or(usual.to_vec());
        let first = [18, 12, 6, 0].map(|shift| shift * i64::from(columns) / 1024);
        let usual_shifts = altitudes.iter().enumerate().map(|(row, _)| first[row % 4]).collect();
        let window = numbers("column_window").map_or([0, columns - 1], |w| [w[0] as u32, w[1] as u32]);
        Self {
            columns,
            azimuths: numbers("beam_azimuth_angles").unwrap(),
            beam_mm: find("lidar_origin_to_beam_origin_mm").map_or(usual_mm, |n| n.as_f64().unwrap()),
            sensor_from_lidar: DMat4::from_cols_slice(&matrix).transpose(),
            shifts: numbers("pixel_shift_by_row").map_or(usual_shifts, |s| s.iter().map(|x| *x as i64).collect()),
            altitudes,
            window,
        }
    }

    /// The point of a range in millimetres, as `XYZLut` has it; in metres.
    fn point(&self, column: u32, row: usize, range_m: f64, planted: Planted) -> DVec3 {
        let range = 1000.0 * range_m;
        let encoder = 2.0 * std::f64::consts::PI * (1.0 - f64::from(column) / f64::from(self.columns));
        let sign = if planted == Planted::AzimuthSign { 1.0 } else { -1.0 };
        let azimuth = sign * self.azimuths[row].to_radians();
        let altitude = self.altitudes[row].to_radians();
        let turned = if planted == Planted::OffsetsTurnedBack { -encoder } else { encoder };
        let along = if planted == Planted::RangeFromBeam { range } else { range - self.beam_mm };
        let x = along * (encoder + azimuth).cos() * altitude.cos() + self.beam_mm * turned.cos();
        let y = along * (encoder + azimuth).sin() * altitude.cos() + self.beam_mm * turned.sin();
        let z = along * altitude.sin();
        (self.sensor_from_lidar * DVec4::new(x, y, z, 1.0)).truncate() / 1000.0
    }

    fn is_in_window(&self, column: u32) -> bool {
        let [first, last] = self.window;
        if first <= last { (first..=last).contains(&column) } else { column >= first || column <= last }
    }
}

#[test]
fn points_of_an_ouster_are_those_of_its_published_formula() {
    let files = files("ouster", "json");
    assert!(files.is_empty() || files.len() == 11, "{files:?}");
    for path in files {
        let ouster = Ouster::of(&std::fs::read_to_string(&path).unwrap());
        let (sensor, _) = load_sensor(path.to_str().unwrap()).unwrap();
        assert_eq!((sensor.width(), sensor.height()), (ouster.columns, ouster.altitudes.len() as u32));
        let faults = [Planted::OffsetsTurnedBack, Planted::AzimuthSign, Planted::RangeFromBeam];
        let (mut worst, mut planted, mut rays) = (0.0f64, [0; 3], 0);
        for (column, row) in (0..sensor.height()).flat_map(|row| (0..sensor.width()).map(move |c| (c, row))) {
            if !ouster.is_in_window(column) {
                assert_eq!(sensor.ray(column, row), None, "{}: column {column}", path.display());
                continue;
            }
            rays += 1;
            for range in RANGES {
                let found = point(&sensor, column, row, range).expect("a ray");
                let off = |fault| found.distance(ouster.point(column, row as usize, range, fault));
                worst = worst.max(off(Planted::Nothing));
                for (count, fault) in planted.iter_mut().zip(faults) {
                    *count += usize::from(range == 10.0 && off(fault) > 1e-4);
                }
            }
        }
        assert!(worst < EXACT, "{}: {worst} m", path.display());
        // Near the seam a turn back equals a turn forth, so the fault does not show there.
        assert!(planted.iter().all(|count| 10 * count > 9 * rays), "{}: {planted:?} of {rays}", path.display());
    }
}

/// Points at 10 m that ouster-sdk 1.0.1 gives for some pixels (`XYZLut` of an image of ranges of 10,000).
#[test]
fn points_are_those_of_ouster_sdk() {
    let known = [
        ("2_5_0_os-992146000760-128.json", 0, 950, [-8.652072926750426, -3.4523283228964186, 3.6694440223397975]),
        ("2_5_0_os-992146000760-128.json", 127, 1000, [-9.068999608102136, -2.0488103365777026, -3.6424871284905116]),
        ("1_12_os1-991913000010-64.json", 1, 300, [2.7079835875411904, 9.218005982625035, 2.807956766817278]),
        (
            "1_14_6cccd_os-882002000138-128_legacy.json",
            3,
            1023,
            [-7.077329540695184, -1.391125952383817, 6.951011854169738],
        ),
        ("ouster-studio-reduced-config-v1.json", 63, 1, [-9.317324566005986, -0.6725510776877734, -3.5301177942236004]),
        ("3_0_1_os-122246000293-128.json", 64, 512, [9.9718211058734, -0.7310568538103868, -0.12732644990100878]),
    ];
    for (file, row, column, expected) in known {
        let Some(path) = data::file(&format!("lidar_calib/ouster/{file}")) else { return };
        let (sensor, _) = load_sensor(path.to_str().unwrap()).unwrap();
        let found = point(&sensor, column, row, 10.0).unwrap();
        assert!(found.distance(DVec3::from_array(expected)) < 1e-9, "{file}: {found}");
    }
}

/// `destagger` of ouster-sdk puts what row r has at column c to column c + shift, round the image.
#[test]
fn destaggered_rows_have_moved_to_the_right() {
    for path in files("ouster", "json") {
        let ouster = Ouster::of(&std::fs::read_to_string(&path).unwrap());
        let name = path.to_str().unwrap();
        let destagger = SensorOptions::default().with_destagger(true);
        let (staggered, _) = load_sensor(name).unwrap();
        if ouster.shifts.iter().all(|shift| *shift == 0) {
            let e = load_sensor_with(name, destagger).unwrap_err();
            assert!(e.to_string().contains("no stagger"), "{e}");
            continue;
        }
        let (moved, _) = load_sensor_with(name, destagger).unwrap();
        let columns = i64::from(moved.width());
        let mut wrong_way = 0;
        for (column, row) in (0..moved.height()).flat_map(|row| (0..moved.width()).map(move |c| (c, row))) {
            let to = |sign: i64| (i64::from(column) + sign * ouster.shifts[row as usize]).rem_euclid(columns) as u32;
            let seen =
                |sensor: &Sensor, c: u32| (point(sensor, c, row, 7.0), sensor.seconds_after_stamp(c, row) as f32);
            assert_eq!(seen(&moved, to(1)), seen(&staggered, column), "{name} {column} {row}");
            wrong_way += usize::from(seen(&moved, to(-1)) != seen(&staggered, column));
        }
        assert!(wrong_way > moved.width() as usize, "{name}: rows moved the wrong way go unseen");
    }
}

/// By hand: column 256 of 1024 in 0.1 s is measured 25 ms after column 0.
#[test]
fn columns_are_measured_in_turn() {
    let Some(path) = data::file("lidar_calib/ouster/3_0_1_os-122246000293-128.json") else { return };
    let (sensor, notices) = load_sensor(path.to_str().unwrap()).unwrap();
    assert_eq!(notices, [""; 0]);
    assert!((sensor.seconds_after_stamp(256, 3) - 0.025).abs() < 1e-12);
}

#[test]
fn metadata_at_fault_is_refused_with_the_field() {
    let expected = [
        ("complete_but_all_zeros_legacy", Err("beam_altitude_angles: all angles are 0")),
        ("garbled_legacy_and_nonlegacy", Err("config_params: the section is missing")),
        ("incomplete_data_format_legacy", Ok("data_format.columns_per_frame is missing: 1024 is taken")),
        ("incomplete_no_calref_nonlegacy", Err("calibration_status: the section is missing")),
        ("incomplete_no_sensor_info_nonlegacy", Err("sensor_info: the section is missing")),
        ("incorrect_nbeam_angles_legacy_113", Err("beam_altitude_angles: 63 values for 16 beams")),
        ("legacy_with_calibration_status", Err("beam_intrinsics: the section is missing")),
    ];
    let files = files("ouster/malformed", "json");
    for (path, (name, expected)) in files.iter().zip(expected) {
        assert_eq!(path.file_stem().unwrap(), name);
        match (load_sensor(path.to_str().unwrap()), expected) {
            (Ok((_, notices)), Ok(says)) => assert!(notices.iter().any(|n| n.contains(says)), "{notices:?}"),
            (Err(e), Err(says)) => {
                let text = e.to_string();
                assert!(text.contains(says) && text.contains(name) && !text.contains('\n'), "{text}");
                assert!(!e.remedy().is_empty() && e.kind().exit_status() == 1, "{text}");
            }
            (found, _) => panic!("{name}: {:?}", found.map(|(_, notices)| notices)),
        }
    }
}

/// One fault in each copy of a valid file: the replaced text, its replacement, and the field that the error names.
#[test]
fn faults_in_metadata_are_named() {
    let Some(path) = data::file("lidar_calib/ouster/2_5_0_os-992146000760-128_legacy.json") else { return };
    let sound = std::fs::read_to_string(path).unwrap();
    let angles = |change: &dyn Fn(f64) -> f64| {
        let mut root: Value = serde_json::from_str(&sound).unwrap();
        for name in ["beam_altitude_angles", "beam_azimuth_angles"] {
            for x in root[name].as_array_mut().unwrap() {
                *x = change(x.as_f64().unwrap()).into();
            }
        }
        root.to_string()
    };
    let replaced = |name: &str, value: Value| {
        let mut root: Value = serde_json::from_str(&sound).unwrap();
        match root["data_format"].get(name) {
            Some(_) => root["data_format"][name] = value,
            None => root[name] = value,
        }
        root.to_string()
    };
    let cases = [
        (angles(&f64::to_radians), "beam_altitude_angles: 128 beams within 0.7"),
        (angles(&|a| 1000.0 * a), "beam_altitude_angles: 21340 deg"),
        (replaced("json_calibration_version", 9.into()), "json_calibration_version: version 9 is newer"),
        (replaced("json_calibration_version", "x".into()), "json_calibration_version"),
        (replaced("lidar_mode", "1024".into()), "lidar_mode: mode \"1024\" is unknown"),
        (replaced("lidar_mode", "2048x10".into()), "data_format.columns_per_frame: 1024 columns"),
        (replaced("lidar_mode", Value::Null), "lidar_mode: it is missing"),
        (replaced("beam_azimuth_angles", vec![1.0; 64].into()), "beam_azimuth_angles: 64 values for 128"),
        (replaced("beam_azimuth_angles", vec!["x"; 128].into()), "beam_azimuth_angles: it is not a list of numbers"),
        (replaced("pixel_shift_by_row", vec![1; 64].into()), "data_format.pixel_shift_by_row: 64 values"),
        (replaced("pixel_shift_by_row", vec![4096; 128].into()), "pixel_shift_by_row: 4096 is not a number"),
        (replaced("column_window", vec![0, 1024].into()), "data_format.column_window: columns 0 to 1024"),
        (replaced("lidar_origin_to_beam_origin_mm", 27.67.into()), "lidar_origin_to_beam_origin_mm: 27.67 mm where"),
        (replaced("beam_to_lidar_transform", vec![5000.0; 16].into()), "lidar_origin_to_beam_origin_mm"),
        (
            replaced("lidar_to_sensor_transform", vec![0.0; 16].into()),
            "lidar_to_sensor_transform: it is not a rotation",
        ),
        (replaced("lidar_to_sensor_transform", vec![1.0; 15].into()), "lidar_to_sensor_transform: 15 values"),
        (replaced("pixels_per_column", 64.into()), "beam_altitude_angles: 128 values for 64"),
        (sound.replace("21.34", "1e400"), "line"),
        (sound[..sound.len() / 2].to_owned(), "line"),
    ];
    for (text, says) in cases {
        let e = beams::ouster::parse(&text, "s").expect_err(says);
        assert!(e.to_string().contains(says) && !e.remedy().is_empty(), "{says}: {e}");
    }
    let mut root: Value = serde_json::from_str(&sound).unwrap();
    root.as_object_mut().unwrap().remove("beam_to_lidar_transform");
    root["lidar_origin_to_beam_origin_mm"] = 2500.0.into();
    let e = beams::ouster::parse(&root.to_string(), "s").unwrap_err();
    assert!(e.to_string().contains("lidar_origin_to_beam_origin_mm: a beam leaves the sensor 2500 mm"), "{e}");
}

/// The driver's arithmetic for a range without distance correction, as `velodyne_pointcloud` has it: rotation in
/// radians clockwise, x to the right and y ahead, turned to ROS's axes.
fn driven(laser: &Value, rotation: f64, range: f64) -> DVec3 {
    let value = |name: &str| laser[name].as_f64().unwrap_or(0.0);
    let (vertical, turned) = (value("vert_correction"), rotation - value("rot_correction"));
    let (up, left) = (value("vert_offset_correction"), value("horiz_offset_correction"));
    let xy = range * vertical.cos() - up * vertical.sin();
    let x = xy * turned.sin() - left * turned.cos();
    let y = xy * turned.cos() + left * turned.sin();
    let z = range * vertical.sin() + up * vertical.cos();
    DVec3::new(y, -x, z)
}

#[test]
fn points_of_a_velodyne_are_those_of_its_driver() {
    let files = files("velodyne", "yaml");
    assert!(files.is_empty() || files.len() == 5, "{files:?}");
    for path in files {
        let text = std::fs::read_to_string(&path).unwrap();
        let root: Value = serde_saphyr::from_str(&text).unwrap();
        let mut lasers = root["lasers"].as_array().unwrap().clone();
        let (sensor, notices) = load_sensor(path.to_str().unwrap()).unwrap();
        let (columns, count) = match lasers.len() {
            16 => (1808, 16),
            32 => (2170, 32),
            _ => (2083, 64),
        };
        assert_eq!((sensor.width(), sensor.height()), (columns, count), "{}", path.display());
        lasers.sort_by(|a, b| {
            let up = |laser: &Value| laser["vert_correction"].as_f64().unwrap();
            up(b).total_cmp(&up(a)).then(a["laser_id"].as_u64().cmp(&b["laser_id"].as_u64()))
        });
        let mut wrong = [0; 2];
        for (column, row) in (0..count).flat_map(|row| (0..columns).map(move |c| (c, row))) {
            let laser = &lasers[row as usize];
            // 16 lasers fire one by one while the head turns on.
            let later = if count == 16 { laser["laser_id"].as_f64().unwrap() * 2.304 / 55.296 } else { 0.0 };
            let step = std::f64::consts::TAU / f64::from(columns);
            let rotation = (f64::from(column) + later) * step;
            for range in RANGES {
                let found = point(&sensor, column, row, range).unwrap();
                let off = found.distance(driven(laser, rotation, range));
                assert!(off < EXACT, "{}: {column} {row}: {off} m", path.display());
            }
            let found = point(&sensor, column, row, 10.0).unwrap();
            let mut other = laser.clone();
            other["rot_correction"] = (-laser["rot_correction"].as_f64().unwrap()).into();
            wrong[0] += usize::from(found.distance(driven(&other, rotation, 10.0)) > 1e-4);
            wrong[1] += usize::from(found.distance(driven(laser, -rotation, 10.0)) > 1e-4);
        }
        let has_azimuths = lasers.iter().any(|laser| laser["rot_correction"].as_f64() != Some(0.0));
        assert!(!has_azimuths || wrong[0] > columns as usize, "{}: a wrong sign goes unseen", path.display());
        assert!(wrong[1] > 3 * columns as usize, "{}: turning back goes unseen", path.display());
        let says = |part: &str| notices.iter().any(|notice| notice.contains(part));
        match path.file_stem().unwrap().to_str().unwrap() {
            "VLP16db" => assert!(says("vlp-16-real"), "{notices:?}"),
            "64e_s2.1-sztaki" => assert!(says("dist_correction") && !says("axis"), "{notices:?}"),
            "64e_utexas" => assert!(says("dist_correction") && says("axis"), "{notices:?}"),
            _ => assert!(says("axis"), "{notices:?}"),
        }
    }
}

/// By hand: the manual's laser 0 looks 15 degrees down from 11.2 mm above the origin, as the first of its firing.
#[test]
fn the_real_vlp_16_has_the_manuals_offsets() {
    let real = presight_read::preset("vlp-16-real").unwrap();
    let row = real.height() - 1;
    assert_eq!(real.origin(0, row), DVec3::new(0.0, 0.0, 0.0112));
    let down = 15f64.to_radians();
    assert!(real.ray(0, row).unwrap().distance(DVec3::new(down.cos(), 0.0, -down.sin())) < 1e-12);
    assert_eq!(real.seconds_after_stamp(0, row), 0.0);
    // Laser 1 fires 2.304 us later, when the head has turned on by 1/24 of a column's step.
    let row = (0..16).find(|row| real.origin(0, *row).z == -0.0007).unwrap();
    let d = real.ray(0, row).unwrap();
    assert!((-d.y.atan2(d.x) * 24.0 - std::f64::consts::TAU / 1808.0).abs() < 1e-10);
    assert!((real.seconds_after_stamp(0, row) - 2.304e-6).abs() < 1e-12);
}

#[test]
fn faults_in_calibrations_are_named() {
    let lasers = |id: &str, up: &str, more: &str| {
        let laser = |i: usize, id: &str, up: &str, more: &str| {
            format!("- {{laser_id: {id}, rot_correction: 0.0, vert_correction: {up}{more}}} # {i}\n")
        };
        let rest: String = (1..16).map(|i| laser(i, &i.to_string(), &(0.03 * i as f64).to_string(), "")).collect();
        format!("num_lasers: 16\nlasers:\n{}{rest}", laser(0, id, up, more))
    };
    assert!(beams::velodyne::parse(&lasers("0", "0.0", ""), "s").is_ok());
    for (text, says) in [
        (lasers("0", "-15.0", ""), "laser_id 0: vert_correction: an angle of -15"),
        (lasers("0", ".nan", ""), "vert_correction"),
        (lasers("3", "0.0", ""), "lasers: laser_id"),
        (lasers("0", "0.0", ", vert_offset_correction: 11.2"), "vert_offset_correction: an offset of 11.2 m"),
        (lasers("0", "0.0", ", horiz_offset_correction: .inf"), "horiz_offset_correction"),
        (lasers("0", "0.0", "").replace("num_lasers: 16", "num_lasers: 32"), "num_lasers: 32 where 16"),
        (lasers("0", "0.0", "").replace("num_lasers: 16", "num_lasers: x"), "line 1"),
        ("lasers:\n- {laser_id: 0, rot_correction: 0, vert_correction: 0}\n".to_owned(), "a sensor of 1 lasers"),
    ] {
        let e = beams::velodyne::parse(&text, "s").expect_err(says);
        assert!(e.to_string().contains(says) && !e.remedy().is_empty(), "{says}: {e}");
    }
}

/// By hand: four rays 10 ms apart repeat themselves after 40 ms. A frame of 20 ms from 1.03 s on begins with the ray
/// at 30 ms, and then comes the first one.
#[test]
fn a_frame_takes_its_part_of_a_pattern() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("p.csv");
    let text = "# a cross\nazimuth_deg,elevation_deg,time_s,x,y,z\n0,0,5,0,0,0\n90,0,5.01,0,0,0\n\n\
        180,0,5.02,0,0,0\n0,-90,5.03,0,0,0.1\n";
    std::fs::write(&path, text).unwrap();
    let name = path.to_str().unwrap();
    let whole = load_sensor(name).unwrap().0;
    assert_eq!((whole.width(), whole.height()), (4, 1));
    assert!(whole.ray(1, 0).unwrap().distance(DVec3::Y) < 1e-15);
    assert_eq!(whole.origin(3, 0), DVec3::new(0.0, 0.0, 0.1));
    assert!((whole.seconds_after_stamp(3, 0) - 0.03).abs() < 1e-7);
    let part = load_sensor(&format!("{name}:1.03..1.05")).unwrap().0;
    assert_eq!(part.width(), 2);
    assert!(part.ray(0, 0).unwrap().distance(DVec3::NEG_Z) < 1e-15 && part.ray(1, 0).unwrap() == DVec3::X);
    assert!((part.seconds_after_stamp(1, 0) - 0.01).abs() < 1e-7);
    let back = presight_read::sensor_toml::to_string(part.spec());
    assert_eq!(presight_read::sensor_toml::parse(&back, "", None).unwrap(), *part.spec());
    for (part, says) in [("1..2", "pattern"), ("2..1", "not a part"), ("x", "not a part"), ("0.031..0.032", "no ray")] {
        let e = load_sensor(&format!("{name}:{part}")).unwrap_err();
        assert!(e.kind().exit_status() == 2 && e.to_string().contains(says), "{part}: {e}");
    }
}

#[test]
fn faults_in_patterns_are_named() {
    let parse = |text: String| beams::pattern::parse(&mut text.as_bytes());
    let head = "azimuth_deg,elevation_deg,time_s\n";
    let turn =
        |unit: f64| (0..360).map(|i| format!("{},{},{i}\n", unit * f64::from(i), unit * 3.0)).collect::<String>();
    assert!(parse(format!("{head}{}", turn(1.0))).is_ok());
    let far = "azimuth_deg,elevation_deg,time_s,x,y,z\n0,0,0,0,0,3\n".to_owned();
    for (text, says) in [
        (format!("{head}{}", turn(1f64.to_radians())), "azimuth_deg: azimuths from 0 to 6.26"),
        (format!("{head}{}", turn(1000.0)), "line 2: elevation_deg: 3000 deg"),
        (head.to_owned(), "no rays"),
        (String::new(), "no rays"),
        (format!("{head}0,0\n"), "line 2: 2 values for 3"),
        (format!("{head}0,0,0,0\n"), "line 2: 4 values for 3"),
        (format!("{head}0,nan,0\n"), "line 2: elevation_deg"),
        (format!("{head}0,x,0\n"), "elevation_deg: \"x\""),
        ("azimuth_deg,elevation_deg\n0,0\n".to_owned(), "line 1: time_s is missing"),
        ("azimuth_deg,elevation_deg,time_s,x\n0,0,0,0\n".to_owned(), "line 1: y is missing"),
        ("azimuth_deg,azimuth_deg,time_s\n".to_owned(), "named twice"),
        ("azimuth,elevation_deg,time_s\n".to_owned(), "\"azimuth\" is not a column"),
        ("0,0,0\n".to_owned(), "line 1: \"0\" is not a column"),
        (format!("{head}{}", "0,0,0\n".repeat(1_000_001)), "line 1000002: too many rays"),
    ] {
        let e = parse(text).expect_err(says);
        assert!(e.to_string().contains(says) && !e.remedy().is_empty(), "{says}: {e}");
    }
    let e = parse(far).unwrap().sensor("p", 0.0, None).unwrap_err();
    assert!(e.to_string().contains("3"), "{e}");
}

/// Every sensor file writes as sensor TOML that reads back equal, short for spinning sensors.
#[test]
fn beam_tables_are_written_as_they_are_read() {
    for path in files("ouster", "json").into_iter().chain(files("velodyne", "yaml")) {
        for destagger in [false, true] {
            let options = SensorOptions::default().with_destagger(destagger);
            let Ok((sensor, _)) = load_sensor_with(path.to_str().unwrap(), options) else { continue };
            let text = presight_read::sensor_toml::to_string(sensor.spec());
            assert!(text.len() < 30_000, "{}: {} bytes", path.display(), text.len());
            assert_eq!(presight_read::sensor_toml::parse(&text, "", None).unwrap(), *sensor.spec(), "{text}");
            assert_eq!(table(sensor.spec()).beams().unwrap().is_destaggered, destagger);
        }
    }
}

/// In a closed room the points that the makers' formulas give for the predicted ranges lie on its walls, in every
/// pixel, and so do the points of the sensor. With offsets turned back many are off the walls.
#[test]
fn predicted_ranges_are_those_that_the_makers_measure() {
    let (least, most) = (DVec3::new(-5.0, -4.0, 0.0), DVec3::new(5.0, 4.0, 3.0));
    let world = World::new(scenes::room(1, 0));
    let world_from_sensor = Pose::from_xyz_rpy(DVec3::new(0.7, -0.4, 1.2), 0.03, -0.05, 0.6);
    let mut predictor = Predictor::new(Options::new(Backend::Cpu)).unwrap();
    let off_walls = |p_in_sensor: DVec3| {
        let p = world_from_sensor.transform_point(p_in_sensor);
        (p - least).abs().min((most - p).abs()).min_element()
    };
    for path in files("ouster", "json") {
        let ouster = Ouster::of(&std::fs::read_to_string(&path).unwrap());
        let (sensor, _) = load_sensor(path.to_str().unwrap()).unwrap();
        let pose = SensorPose::new(world_from_sensor);
        let seen = predictor.predict(&world, &sensor, &pose, &Request::default()).unwrap().images;
        let (mut worst, mut turned_back, mut rays) = ([0.0f64; 2], 0, 0);
        for (i, range) in seen.range.iter().enumerate() {
            let (column, row) = (i as u32 % sensor.width(), i as u32 / sensor.width());
            if !ouster.is_in_window(column) {
                assert!(range.is_nan(), "{}: {column} {row}: {range}", path.display());
                continue;
            }
            rays += 1;
            let range = f64::from(*range);
            let at = |planted| off_walls(ouster.point(column, row as usize, range, planted));
            let own = off_walls(point(&sensor, column, row, range).unwrap());
            worst = [worst[0].max(at(Planted::Nothing)), worst[1].max(own)];
            turned_back += usize::from(at(Planted::OffsetsTurnedBack) > 1e-4);
        }
        assert!(rays > 0 && worst.iter().all(|off| *off < 1e-4), "{}: {worst:?} m", path.display());
        assert!(2 * turned_back > rays, "{}: {turned_back} of {rays}", path.display());
    }
}
