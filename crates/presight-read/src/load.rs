//! Sensors by name: a preset, or a sensor file in one of the supported formats.

use super::text::{from_settings, read_settings, toml_from_str};
use super::{beams, camera_info, sensor_toml};
use presight_model::error::{Error, Result};
use presight_model::plausible;
use presight_model::printable::did_you_mean;
use presight_model::sensor::{Geometry, PRESETS, RayTable, Sensor, SensorSpec};
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
        let alike = did_you_mean(name, PRESETS.iter().map(|p| p.name));
        let remedy = format!("{alike}choose one of {}", preset_names());
        return Err(Error::usage(format!("unknown preset {name:?}"), remedy));
    };
    Sensor::new(sensor_toml::parse(preset.toml, preset.name, None)?)
}

pub(super) fn preset_names() -> String {
    PRESETS.iter().map(|p| p.name).collect::<Vec<_>>().join(", ")
}

/// What to make of a sensor file that describes more than one image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct SensorOptions {
    /// The rectified camera of a ROS camera_info: P, turned by R.
    pub rectified: bool,
    /// The destaggered image of a lidar: rows moved by the shifts of its beam table, so that a column is a direction.
    pub destagger: bool,
}

impl SensorOptions {
    /// With the rectified image: see [`SensorOptions::rectified`].
    #[must_use]
    pub fn with_rectified(self, rectified: bool) -> Self {
        Self { rectified, ..self }
    }

    /// With the destaggered image: see [`SensorOptions::destagger`].
    #[must_use]
    pub fn with_destagger(self, destagger: bool) -> Self {
        Self { destagger, ..self }
    }
}

/// Makes the sensor that `--sensor PRESET|FILE` names: a preset, a sensor TOML, the YAML of a camera's calibration
/// ([`camera_info`]) or of a Velodyne's ([`beams::velodyne`]), the metadata of an Ouster ([`beams::ouster`]), or a
/// pattern ([`beams::pattern`]). `FILE.yaml:cam1` names a camera of Kalibr's camchain, and `FILE.csv:0.2..0.3` the part
/// of a pattern from 0.2 to 0.3 s. Also returns notices on unused parts of the file.
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] if it is neither a preset nor has the name of a sensor file; errors of the
/// readers.
pub fn load_sensor(arg: &str) -> Result<(Sensor, Vec<String>)> {
    load_sensor_with(arg, SensorOptions::default())
}

/// As [`load_sensor`], with options.
///
/// # Errors
/// As [`load_sensor`], and [`presight_model::ErrorKind::Usage`] for a sensor that has no such image.
pub fn load_sensor_with(arg: &str, options: SensorOptions) -> Result<(Sensor, Vec<String>)> {
    let SensorOptions { rectified, destagger } = options;
    let (path, part) = file_and_part(arg);
    if rectified && !has_extension(path, &["yaml", "yml"]) {
        let what = format!("{arg:?} has no P and R of a rectified image");
        return Err(Error::usage(what, "give a camera_info, or drop `rectified: true`"));
    }
    let is_preset = PRESETS.iter().any(|p| p.name == arg);
    let (spec, mut notices) =
        if is_preset { (preset(arg)?.spec().clone(), Vec::new()) } else { read(path, part, arg, rectified)? };
    let spec = if destagger { destaggered(spec, arg)? } else { spec };
    let sensor = Sensor::new(spec).map_err(|e| if is_preset { e } else { e.in_file(path) })?;
    let in_file = |notice| format!("{}: {notice}", path.display());
    notices.extend(plausible::of_sensor(sensor.spec()).into_iter().map(in_file));
    Ok((sensor, notices))
}

/// Reads a sensor file by the end of its name and by its content.
fn read(path: &Path, part: Option<&str>, arg: &str, rectified: bool) -> Result<(SensorSpec, Vec<String>)> {
    if has_extension(path, &["toml"]) {
        return Ok((sensor_toml::read(path)?, Vec::new()));
    }
    if has_extension(path, &["json"]) {
        return beams::ouster::read(path);
    }
    let name = path.file_stem().map_or_else(|| "sensor".into(), |s| s.to_string_lossy());
    if has_extension(path, &["csv"]) {
        let pattern = beams::pattern::read(path)?;
        let (start, seconds) = part.map_or(Ok((0.0, None)), |part| seconds_of(part).map(|(a, b)| (a, Some(b - a))))?;
        return pattern.sensor(&name, start, seconds).map(|spec| (spec, Vec::new())).map_err(|e| e.in_file(path));
    }
    if has_extension(path, &["yaml", "yml"]) {
        return from_settings(path, |text| match beams::velodyne::is_calibration(text) {
            true if rectified || part.is_some() => {
                let what = "the calibration of a lidar has no cameras";
                Err(Error::usage(what, "give the name of the file alone, without `rectified: true`"))
            }
            true => beams::velodyne::parse(text, &name),
            false => camera_info::parse(text, &name, part, rectified),
        });
    }
    Err(Error::usage(format!("{arg:?} is neither a preset nor a sensor file"), sensor_remedy(arg)))
}

/// How to name a sensor.
pub(super) fn sensor_remedy(name: &str) -> String {
    let alike = did_you_mean(name, PRESETS.iter().map(|p| p.name));
    format!("{alike}choose one of {}, or name a file that ends in .toml, .yaml, .yml, .json or .csv", preset_names())
}

/// The part `FROM..TO` of a pattern, seconds.
fn seconds_of(part: &str) -> Result<(f64, f64)> {
    let ends = part.split_once("..").and_then(|(a, b)| Some((a.parse::<f64>().ok()?, b.parse::<f64>().ok()?)));
    ends.filter(|(from, to)| from.is_finite() && to.is_finite() && from < to).ok_or_else(|| {
        Error::usage(format!("{part:?} is not a part of a pattern"), "give its seconds, such as pattern.csv:0.2..0.3")
    })
}

/// The sensor with the destaggered image.
fn destaggered(spec: SensorSpec, arg: &str) -> Result<SensorSpec> {
    let beams = match &spec.geometry {
        Geometry::Rays(table) => table.beams().filter(|beams| beams.shifts.iter().any(|shift| *shift != 0)),
        _ => None,
    };
    let Some(mut beams) = beams.cloned() else {
        let what = format!("the rows of {arg:?} have no stagger");
        return Err(Error::usage(what, "take the image unchanged, or give Ouster's metadata with pixel_shift_by_row"));
    };
    beams.is_destaggered = true;
    let times = beams.times();
    Ok(spec.with_geometry(Geometry::Rays(RayTable::of_beams(beams)?)).with_times(times))
}

fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|e| extensions.iter().any(|known| e.eq_ignore_ascii_case(known)))
}

/// The file and the part of it that `FILE.yaml:CAMERA` and `FILE.csv:FROM..TO` name.
fn file_and_part(arg: &str) -> (&Path, Option<&str>) {
    match arg.rsplit_once(':') {
        Some((file, part)) if has_extension(Path::new(file), &["yaml", "yml", "csv"]) => (Path::new(file), Some(part)),
        _ => (Path::new(arg), None),
    }
}

/// The files that a sensor file (its ray table) or a robot file (its sensors, and their ray tables) names, and the file
/// in `FILE.yaml:CAMERA` and `FILE.csv:FROM..TO`. A file that cannot be read names none; loading it reports why.
pub fn files_named_by(path: &Path) -> Vec<PathBuf> {
    let of_part = |path: &Path| {
        let (file, part) = file_and_part(path.to_str()?);
        part.map(|_| file.to_owned())
    };
    let (table, sensors) = names_in(path);
    let mut files: Vec<PathBuf> = table.into_iter().chain(of_part(path)).collect();
    for sensor in sensors {
        files.extend(names_in(&sensor).0.into_iter().chain(of_part(&sensor)));
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
            ("vlp-16-real", 1808, 16, "laser", 100.0),
            ("vlp-32c-real", 1808, 32, "laser", 200.0),
            ("os1-128", 1024, 128, "laser", 120.0),
            ("os1-128-real", 1024, 128, "laser", 120.0),
            ("mid-360-like", 20_000, 1, "laser", 40.0),
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
            let rectified = SensorOptions::default().with_rectified(true);
            assert_eq!(load_sensor_with(arg, rectified).unwrap_err().kind(), ErrorKind::Usage, "{arg}");
        }
        // The error of a complete but invalid sensor names the file too.
        std::fs::write(path("eye.YAML"), yaml.replace("4", "0")).unwrap();
        let e = load_sensor(&path("eye.YAML")).unwrap_err();
        assert!(e.kind() == ErrorKind::Invalid && e.file().is_some() && e.to_string().contains("0 x 3"), "{e}");
    }
}
