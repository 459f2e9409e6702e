//! Sensors by name: a preset, or a sensor file in one of the supported formats.

use super::text::{read_settings, toml_from_str};
use super::{camera_info, sensor_toml};
use presight_model::error::{Error, Result};
use presight_model::sensor::{PRESETS, Sensor};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Makes a sensor from a preset ([`PRESETS`]).
///
/// ```
/// let radar = presight::preset("microwave-radar-image")?;
/// assert_eq!((radar.width(), radar.height()), (1280, 200));
/// # Ok::<(), presight::Error>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] if there is no preset of this name; the remedy lists the names.
pub fn preset(name: &str) -> Result<Sensor> {
    let Some(preset) = PRESETS.iter().find(|p| p.name == name) else {
        return Err(Error::usage(format!("unknown preset {name:?}"), format!("choose one of {}", preset_names())));
    };
    Sensor::new(sensor_toml::parse(preset.toml, preset.name, None)?)
}

pub(super) fn preset_names() -> String {
    PRESETS.iter().map(|p| p.name).collect::<Vec<_>>().join(", ")
}

/// Makes the sensor that `--sensor PRESET|FILE` names: a preset, a sensor TOML, or the YAML of a camera's calibration
/// ([`camera_info`]), where `FILE.yaml:cam1` names a camera of Kalibr's camchain. Also returns notices on unused parts
/// of the file.
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] if it is neither a preset nor ends in `.toml`, `.yaml` or `.yml`; errors of
/// [`sensor_toml::read`] and [`camera_info::read`].
pub fn load_sensor(arg: &str) -> Result<(Sensor, Vec<String>)> {
    load(arg, false)
}

/// As [`load_sensor`], but makes the rectified camera of a ROS camera_info: P, turned by R.
///
/// # Errors
/// As [`load_sensor`], and [`presight_model::ErrorKind::Usage`] for a preset or a file that has no rectified camera.
pub fn load_rectified(arg: &str) -> Result<(Sensor, Vec<String>)> {
    load(arg, true)
}

pub(super) fn load(arg: &str, rectified: bool) -> Result<(Sensor, Vec<String>)> {
    let (path, camera) = file_and_camera(arg);
    let is_yaml = is_yaml(path);
    if rectified && !is_yaml {
        let what = format!("{arg:?} has no P and R of a rectified image");
        return Err(Error::usage(what, "give a camera_info, or drop `rectified: true`"));
    }
    if PRESETS.iter().any(|p| p.name == arg) {
        return Ok((preset(arg)?, Vec::new()));
    }
    let (spec, notices) = match path.extension() {
        Some(toml) if toml.eq_ignore_ascii_case("toml") => (sensor_toml::read(path)?, Vec::new()),
        _ if is_yaml => camera_info::read(path, camera, rectified)?,
        _ => {
            return Err(Error::usage(
                format!("{arg:?} is neither a preset nor a sensor file"),
                format!("choose one of {}, or name a file that ends in .toml, .yaml or .yml", preset_names()),
            ));
        }
    };
    Ok((Sensor::new(spec).map_err(|e| e.in_file(path))?, notices))
}

fn is_yaml(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("yaml") || e.eq_ignore_ascii_case("yml"))
}

/// The file and the camera that `FILE.yaml:CAMERA` names.
fn file_and_camera(arg: &str) -> (&Path, Option<&str>) {
    match arg.rsplit_once(':') {
        Some((file, camera)) if is_yaml(Path::new(file)) => (Path::new(file), Some(camera)),
        _ => (Path::new(arg), None),
    }
}

/// The files that a sensor file (its ray table) or a robot file (its sensors, and their ray tables) names, and the file
/// in `FILE.yaml:CAMERA`. A file that cannot be read names none; loading it reports why.
pub fn files_named_by(path: &Path) -> Vec<PathBuf> {
    let of_camera = |path: &Path| {
        let (file, camera) = file_and_camera(path.to_str()?);
        camera.map(|_| file.to_owned())
    };
    let (table, sensors) = names_in(path);
    let mut files: Vec<PathBuf> = table.into_iter().chain(of_camera(path)).collect();
    for sensor in sensors {
        files.extend(names_in(&sensor).0.into_iter().chain(of_camera(&sensor)));
        files.push(sensor);
    }
    files
}

/// The ray table and the sensor files that a file names.
fn names_in(path: &Path) -> (Option<PathBuf>, Vec<PathBuf>) {
    #[derive(Deserialize, Default)]
    #[serde(default)]
    struct Names {
        file: Option<String>,
        sensors: Vec<Entry>,
    }
    #[derive(Deserialize)]
    struct Entry {
        sensor: String,
    }
    let is_toml = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("toml")) && path.is_file();
    let text = is_toml.then(|| read_settings(path).ok()).flatten();
    let names: Names = text.and_then(|text| toml_from_str(&text).ok()).unwrap_or_default();
    let at = |name: String| path.parent().unwrap_or(Path::new("")).join(name);
    (names.file.map(at), names.sensors.into_iter().map(|entry| at(entry.sensor)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::error::ErrorKind;

    #[test]
    fn presets_have_their_size_and_class() {
        let expected = [
            ("video-camera", 512, 512, "video", f64::INFINITY),
            ("microwave-radar-scan", 3600, 1, "radar", 75.0),
            ("microwave-radar-image", 1280, 200, "radar", 75.0),
            ("laser-range-camera", 321, 41, "laser", 10.0),
            ("laser-scanner", 361, 1, "laser", 30.0),
            ("vlp-16", 1800, 16, "laser", 100.0),
            ("os1-128", 1024, 128, "laser", 120.0),
            ("realsense-d435", 1280, 720, "video", 10.0),
        ];
        assert_eq!(expected.map(|e| e.0).as_slice(), PRESETS.iter().map(|p| p.name).collect::<Vec<_>>());
        for (name, width, height, class, range_max) in expected {
            let sensor = preset(name).unwrap();
            let spec = sensor.spec();
            assert_eq!((sensor.width(), sensor.height()), (width, height), "{name}");
            assert_eq!((spec.name.as_str(), spec.class.as_str(), spec.range_max), (name, class, range_max));
        }
    }

    #[test]
    fn presets_end_where_they_should() {
        let corner = |name: &str, column, row| {
            let d = preset(name).unwrap().ray(column, row).unwrap();
            [d.y.atan2(d.x).to_degrees(), d.z.asin().to_degrees()]
        };
        let near = |a: [f64; 2], b: [f64; 2]| assert!((a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-12, "{a:?} {b:?}");
        near(corner("laser-range-camera", 0, 0), [-30.0, 5.0]);
        near(corner("laser-range-camera", 320, 40), [30.0, -55.0]);
        near(corner("laser-scanner", 360, 0), [90.0, 0.0]);
        near(corner("microwave-radar-image", 640, 0), [0.0, 25.0]);
        near(corner("microwave-radar-image", 641, 199), [0.28125, -25.0]);
        near(corner("microwave-radar-scan", 3599, 0), [179.9, 0.0]);
        near(corner("vlp-16", 900, 0), [0.0, 15.0]);
        near(corner("os1-128", 512, 127), [0.0, -22.5]);
    }

    #[test]
    fn an_unknown_preset_is_wrong_usage_and_lists_the_names() {
        for e in [preset("vlp-17").unwrap_err(), load_sensor("vlp-17").unwrap_err()] {
            assert_eq!(e.kind(), ErrorKind::Usage);
            assert!(PRESETS.iter().all(|p| e.remedy().contains(p.name)), "{e}");
        }
        assert_eq!(load_sensor("no/such/sensor.toml").unwrap_err().kind(), ErrorKind::Invalid);
    }

    #[test]
    fn files_are_read_by_their_extension() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        std::fs::write(path("eye.toml"), PRESETS[0].toml).unwrap();
        let yaml = "image_width: 4\nimage_height: 3\ncamera_matrix: {data: [2, 0, 1.5, 0, 2, 1, 0, 0, 1]}\nfoo: 1\n";
        std::fs::write(path("eye.YAML"), yaml).unwrap();
        let (sensor, notices) = load_sensor(&path("eye.toml")).unwrap();
        assert_eq!((sensor.spec().name.as_str(), notices.len()), ("video-camera", 0));
        let (sensor, notices) = load_sensor(&path("eye.YAML")).unwrap();
        assert_eq!((sensor.spec().name.as_str(), sensor.width(), sensor.height()), ("eye", 4, 3));
        assert!(notices.len() == 1 && notices[0].contains("foo"), "{notices:?}");
        std::fs::write(path("chain.yml"), "cam0: {}\ncam1: {resolution: [4, 3], intrinsics: [2, 2, 1.5, 1]}\n")
            .unwrap();
        let chosen = path("chain.yml:cam1");
        assert_eq!(load_sensor(&chosen).unwrap().0.spec().name, "cam1");
        assert_eq!(files_named_by(Path::new(&chosen)), [PathBuf::from(path("chain.yml"))]);
        for arg in ["vlp-16", &path("eye.toml"), &chosen] {
            assert_eq!(load_rectified(arg).unwrap_err().kind(), ErrorKind::Usage, "{arg}");
        }
        // The error of a complete but invalid sensor names the file too.
        std::fs::write(path("eye.YAML"), yaml.replace("4", "0")).unwrap();
        let e = load_sensor(&path("eye.YAML")).unwrap_err();
        assert!(e.kind() == ErrorKind::Invalid && e.file().is_some() && e.to_string().contains("0 x 3"), "{e}");
    }
}
