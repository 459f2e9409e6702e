//! Compares the lens models with OpenCV's projectPoints and undistortPoints: at 60 points for each of the cameras in
//! `opencv`, which have thin prism terms and tilted image sensors, and at 400 points for each of six installed cameras.

use presight_testkit as common;

use common::data;
use glam::DVec3;
use presight_model::sensor::{Camera, Distortion, Geometry, Sensor, SensorSpec};
use std::path::Path;

/// Pixels; OpenCV computes in f64 and prints 16 digits, so differences are rounding.
const PIXELS: f64 = 1e-9;
/// Normalized coordinates; OpenCV's undistortion stops at about 1e-14.
const NORMALIZED: f64 = 1e-11;

struct Calibration {
    camera: Camera,
    /// X, Y, Z, u, v, xn, yn.
    points: Vec<[f64; 7]>,
}

/// Those of the repository, and the others where the data are installed.
fn calibrations() -> Vec<Calibration> {
    let own = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/basics/opencv"));
    let mut all = of_folder(own, 3);
    all.extend(data::file("calib").map(|folder| of_folder(&folder, 6)).into_iter().flatten());
    all
}

fn of_folder(folder: &Path, count: usize) -> Vec<Calibration> {
    let json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("calib.json")).unwrap()).unwrap();
    let cameras = json["cameras"].as_array().unwrap();
    assert_eq!(cameras.len(), count);
    cameras.iter().map(|c| read(folder, c)).collect()
}

fn read(folder: &Path, json: &serde_json::Value) -> Calibration {
    let number = |key: &str| json[key].as_f64().unwrap();
    let coefficients: Vec<f64> = json["D"].as_array().unwrap().iter().map(|c| c.as_f64().unwrap()).collect();
    let camera = Camera {
        width: number("width") as u32,
        height: number("height") as u32,
        fx: number("fx"),
        fy: number("fy"),
        cx: number("cx"),
        cy: number("cy"),
        distortion: Distortion::from_model(json["model"].as_str().unwrap(), &coefficients).unwrap(),
    };
    let text = std::fs::read_to_string(folder.join(format!("{}.csv", json["name"].as_str().unwrap()))).unwrap();
    let points: Vec<[f64; 7]> = text
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| {
            let numbers: Vec<f64> = line.split(',').map(|n| n.parse().unwrap()).collect();
            numbers[..7].try_into().unwrap()
        })
        .collect();
    assert_eq!(points.len() as u64, json["points"].as_u64().unwrap());
    Calibration { camera, points }
}

/// The largest difference from projectPoints in pixels; infinite if a point is not imaged.
fn projection_error(c: &Calibration, model: &Distortion) -> f64 {
    let (lens, camera) = (model.lens(), &c.camera);
    let error = |&[x, y, z, u, v, ..]: &[f64; 7]| match lens.distort(DVec3::new(x, y, z)) {
        Some((xd, yd)) => (camera.fx * xd + camera.cx - u).hypot(camera.fy * yd + camera.cy - v),
        None => f64::INFINITY,
    };
    c.points.iter().map(error).fold(0.0, f64::max)
}

/// The largest difference from undistortPoints and from the projected point, in normalized coordinates.
fn inverse_error(c: &Calibration, model: &Distortion) -> f64 {
    let lens = model.lens();
    let error = |&[x, y, z, u, v, xn, yn]: &[f64; 7]| {
        let (xd, yd) = c.camera.normalized(u, v);
        let Some(ray) = lens.undistort(xd, yd) else { return f64::INFINITY };
        let (rx, ry) = (ray.x / ray.z, ray.y / ray.z);
        let to_opencv = (rx - xn).hypot(ry - yn);
        let to_point = (rx - x / z).hypot(ry - y / z);
        to_opencv.max(to_point) / rx.hypot(ry).max(1.0)
    };
    c.points.iter().map(error).fold(0.0, f64::max)
}

#[test]
fn both_ways_as_opencv() {
    for c in calibrations() {
        let (there, back) = (projection_error(&c, &c.camera.distortion), inverse_error(&c, &c.camera.distortion));
        eprintln!("{:<20} projection {there:.1e} px, inverse {back:.1e}", c.camera.distortion.model());
        assert!(there <= PIXELS, "{:?}: {there} px", c.camera);
        assert!(back <= NORMALIZED, "{:?}: {back}", c.camera);
    }
}

/// The planted faults: the comparison must notice a wrong sign of k1, exchanged p1 and p2, and a dropped coefficient.
#[test]
fn a_wrong_coefficient_is_noticed() {
    let (all, mut planted) = (calibrations(), 0);
    for c in all.iter().filter(|c| !c.camera.distortion.is_none()) {
        let good = c.camera.distortion.coefficients().to_vec();
        let with = |change: &dyn Fn(&mut Vec<f64>)| {
            let mut bad = good.clone();
            change(&mut bad);
            (bad != good).then(|| Distortion::from_model(c.camera.distortion.model(), &bad).unwrap())
        };
        let dropped = (0..good.len()).map(|i| with(&|b| b[i] = 0.0));
        for fault in [with(&|b| b[0] = -b[0]), with(&|b| b.swap(2, 3))].into_iter().chain(dropped).flatten() {
            assert!(projection_error(c, &fault) > PIXELS, "{fault:?} passed instead of {good:?}");
            assert!(inverse_error(c, &fault) > NORMALIZED, "{fault:?} passed instead of {good:?}");
            planted += 1;
        }
    }
    assert!(planted >= 40, "{planted} faults planted");
}

/// Every ray of a sensor's table projects to its pixel, and every pixel inside OpenCV's points has a ray.
#[test]
fn tables_hold_the_inverse_over_the_whole_image() {
    for c in calibrations() {
        let camera = c.camera.clone();
        let sensor = Sensor::new(SensorSpec::new("c", "video", Geometry::Camera(camera.clone()))).unwrap();
        let (lens, mut without) = (camera.distortion.lens(), 0);
        for (row, column) in (0..camera.height).flat_map(|r| (0..camera.width).map(move |c| (r, c))) {
            let Some(ray) = sensor.ray(column, row) else {
                without += 1;
                continue;
            };
            assert!((ray.length() - 1.0).abs() < 1e-14);
            let (xd, yd) = lens.distort(ray).unwrap();
            let (u, v) = (camera.fx * xd + camera.cx, camera.fy * yd + camera.cy);
            assert!((u - f64::from(column)).hypot(v - f64::from(row)) < PIXELS, "{camera:?} {column} {row}: {u} {v}");
        }
        eprintln!("{:<20} {without} pixels without a ray", camera.distortion.model());
    }
}
