//! `robot.toml`: the sensors of a robot and where they are mounted.
//!
//! ```toml
//! format = 1
//! name = "kurt"                # optional, default: the file's stem
//!
//! [[sensors]]
//! name = "front"               # optional, default: the sensor's own name; names must differ
//! sensor = "laser-scanner"     # a preset, or a sensor file relative to this file
//! rectified = true             # optional: the rectified camera of a ROS camera_info (P, R), default false
//! destagger = true             # optional: the destaggered image of a lidar's beam table, default false
//! mount = { xyz = [0.2, 0.0, 0.3], rpy_deg = [0.0, 0.0, 0.0] }  # optional, default: the sensor's own [mount]
//! ```

use super::load::{SensorOptions, load_sensor_with, sensor_remedy};
use super::sensor_toml::MountTable;
use super::text::{check_format, from_settings, toml_from_str};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::limits;
use presight_model::sensor::{PRESETS, Sensor};
use serde::Deserialize;
use std::path::Path;

/// A robot's sensors, in the order of the file.
#[derive(Clone, Debug)]
pub struct Robot {
    /// The name of the robot.
    pub name: String,
    /// The sensors with their mounts: at least one, with different names.
    pub sensors: Vec<Sensor>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(rename = "format")]
    _format: i64,
    name: Option<String>,
    #[serde(default)]
    sensors: Vec<Entry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: Option<String>,
    sensor: String,
    mount: Option<MountTable>,
    #[serde(default)]
    rectified: bool,
    #[serde(default)]
    destagger: bool,
}

/// Reads a robot file with all its sensors. Also returns notices on unused parts of the sensor files.
///
/// # Errors
/// [`ErrorKind::Invalid`] with file and place, and errors of sensor files.
pub fn load_robot(path: &Path) -> Result<(Robot, Vec<String>)> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut notices = Vec::new();
    let robot = from_settings(path, |text| {
        check_format(text)?;
        let file: File = toml_from_str(text)?;
        if file.sensors.len() > limits::MAX_ROBOT_SENSORS {
            let what = format!("{} sensors", file.sensors.len());
            return Err(Error::invalid(what, format!("give at most {}", limits::MAX_ROBOT_SENSORS)));
        }
        let mut sensors: Vec<Sensor> = Vec::new();
        for (i, entry) in file.sensors.into_iter().enumerate() {
            let sensor = entry.load(folder, &mut notices).map_err(|e| e.named_in(path, format!("sensor {i}")))?;
            let name = &sensor.spec().name;
            if sensors.iter().any(|other| other.spec().name == *name) {
                return Err(Error::invalid(format!("two sensors are named {name:?}"), "give each a different name")
                    .at(format!("sensor {i}")));
            }
            sensors.push(sensor);
        }
        if sensors.is_empty() {
            return Err(Error::invalid("the robot has no sensors", "add a [[sensors]] table"));
        }
        let stem = || path.file_stem().map_or_else(|| "robot".into(), |s| s.to_string_lossy().into_owned());
        Ok(Robot { name: file.name.unwrap_or_else(stem), sensors })
    })?;
    Ok((robot, notices))
}

impl Entry {
    fn load(self, folder: &Path, notices: &mut Vec<String>) -> Result<Sensor> {
        let is_preset = PRESETS.iter().any(|p| p.name == self.sensor);
        let arg =
            if is_preset { self.sensor.clone() } else { folder.join(&self.sensor).to_string_lossy().into_owned() };
        let options = SensorOptions::default().with_rectified(self.rectified).with_destagger(self.destagger);
        let (sensor, more) = load_sensor_with(&arg, options).map_err(|e| match e.kind() {
            // The name comes from a file, not from the command line, so the file is at fault.
            ErrorKind::Usage if e.what().contains("neither a preset") => Error::invalid(
                format!("{:?} is neither a preset nor a sensor file", self.sensor),
                sensor_remedy(&self.sensor),
            ),
            ErrorKind::Usage => Error::invalid(e.what(), e.remedy().replace("`rectified: true`", "rectified = true")),
            _ => e,
        })?;
        notices.extend(more.into_iter().map(|n| format!("{}: {n}", self.sensor)));
        if self.name.is_none() && self.mount.is_none() {
            return Ok(sensor);
        }
        let mut spec = sensor.spec().clone();
        spec.name = self.name.unwrap_or(spec.name);
        if let Some(mount) = &self.mount {
            spec.mount = mount.pose().map_err(|e| e.at("mount"))?;
        }
        Sensor::new(spec)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn presets_and_files_beside_it_are_loaded() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("kurt.toml");
        std::fs::write(folder.path().join("eye.toml"), PRESETS[0].toml).unwrap();
        let text = "format = 1\n[[sensors]]\nsensor = \"laser-scanner\"\nname = \"front\"\n\
            mount = { xyz = [1, 2, 3], rpy_deg = [0, 0, 180] }\n[[sensors]]\nsensor = \"eye.toml\"\n";
        std::fs::write(&path, text).unwrap();
        let (robot, notices) = load_robot(&path).unwrap();
        assert_eq!((robot.name.as_str(), notices.len()), ("kurt", 0));
        let names: Vec<&str> = robot.sensors.iter().map(|s| s.spec().name.as_str()).collect();
        assert_eq!(names, ["front", "video-camera"]);
        let p_in_robot = robot.sensors[0].spec().mount.transform_point(DVec3::X);
        assert!((p_in_robot - DVec3::new(0.0, 2.0, 3.0)).length() < 1e-15);

        for (bad, says) in [
            (text.replace("format = 1", "format = 2"), "newer"),
            (text.replace("name =", "nome ="), "line 4"),
            (text.replace("eye.toml", "ear.toml"), "kurt.toml: sensor 1: "),
            (text.replace("eye.toml", "ear.toml"), "ear.toml: cannot open it"),
            (text.replace("laser-scanner", "laser-scaner"), "choose one of"),
            (text.replace("\"front\"", "\"video-camera\""), "two sensors"),
            ("format = 1".to_owned(), "no sensors"),
            (format!("format = 1\n{}", "[[sensors]]\nsensor = \"eye.toml\"\n".repeat(300)), "at most"),
        ] {
            std::fs::write(&path, &bad).unwrap();
            let e = load_robot(&path).unwrap_err();
            assert_eq!(e.kind().exit_status(), 1, "{e}");
            assert!(e.to_string().contains(says), "{e}");
        }
    }
}
