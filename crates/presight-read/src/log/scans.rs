//! Scans of points (PLY, PCD, CSV: [`crate::cloud`]) and images of ranges (EXR) as frames: one file, or all files
//! of a folder in the order of their names.
//!
//! If all names are numbers, they are the times in seconds; otherwise the times count up from 0, unless the points have
//! times of a clock: then the first of these is the stamp.
//!
//! **Points become a range image** with one ray per point, so that neither ranges nor directions are rounded. An
//! organized cloud keeps its rows and columns. For other clouds, pixels are cells of azimuth and elevation, as wide as
//! the spacing of neighbouring points. If a cell has several points, the one nearest to its centre is used. A cell
//! without a point is a ray without a reading.
//!
//! **The sensor's pose** comes from the file itself or from `poses.json` in its folder: an object with an entry for
//! each file name, each with `translation` and `quaternion_xyzw`, world_from_sensor in body axes. Estimates must not
//! use it.

#[cfg(test)]
mod tests;

use super::notices::Notices;
use super::skip_bad::Placed;
use super::{Faults, Observation, check_time, ray_times};
use crate::cloud::{RaySeconds, ScanStamp};
use crate::exr::KnownChannel;
use crate::file::file_name;
use crate::text::{check_json_memory, from_text};
use crate::{cloud, exr, sensor_toml};
use glam::{DQuat, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::measured::{Frame, Measurement, range_grid};
use presight_model::sensor::{Geometry, Sensor, SensorSpec};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Frames of scans, one at a time.
#[derive(Debug)]
pub struct Scans {
    files: std::vec::IntoIter<(f64, PathBuf)>,
    sensor: Option<Sensor>,
    poses: HashMap<String, SensorPose>,
    time: Option<f64>,
    /// True if the names of the files are their times.
    is_timed: bool,
    faults: Faults,
    notices: Notices,
}

/// Returns true if a file has the ending of a scan.
pub(super) fn is_scan(path: &Path) -> bool {
    matches!(cloud::ending(path).as_str(), "ply" | "pcd" | "csv" | "exr")
}

impl Scans {
    /// Opens a scan or a folder of scans. `sensor` supplies noise, limits, class and mount. Points have their own rays;
    /// images use the rays of `sensor`, or those of the sensor that the file names if `sensor` is `None`.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for a folder without a scan and for invalid poses;
    /// [`presight_model::ErrorKind::System`] if a file cannot be read. Errors in a scan are reported when it is read.
    pub fn open(path: &Path, sensor: Option<&Sensor>) -> Result<Self> {
        let (folder, files) = if path.is_dir() { (path, listed(path)?) } else { (parent(path), vec![path.to_owned()]) };
        if files.is_empty() {
            let remedy = "give .ply, .pcd, .csv or .exr files, or camera.json and depth images";
            return Err(Error::invalid("there is no scan in this folder", remedy).in_file(path));
        }
        let poses = folder.join("poses.json");
        let poses = if poses.exists() { read_poses(&poses)? } else { HashMap::new() };
        let (is_timed, files) = timed(files);
        let (sensor, notices) = (sensor.cloned(), Notices::default());
        let faults = Faults::End;
        Ok(Self { files: files.into_iter(), sensor, poses, time: None, is_timed, faults, notices })
    }

    /// The scans with the names of their files, also after a bad one.
    pub(super) fn placed(mut self) -> impl Iterator<Item = Placed> + Send {
        self.faults = Faults::Pass;
        std::iter::from_fn(move || {
            let place = self.files.as_slice().first().map(|(_, path)| file_name(path))?;
            self.next().map(|item| (Some(place), item))
        })
    }

    /// The notices on the times of points, which grow as frames are read.
    pub(super) fn notices(&self) -> Notices {
        self.notices.clone()
    }

    fn read(&mut self, time: f64, path: &Path) -> Result<Observation> {
        let (frame, in_file) = match cloud::ending(path).as_str() {
            "exr" => self.of_image(time, path)?,
            _ => self.of_points(time, path)?,
        };
        if self.faults == Faults::End {
            check_time(self.time, frame.stamp)?;
        }
        self.time = Some(frame.stamp);
        let known = self.poses.get(&stem(path)).copied().or(in_file);
        Ok(Observation { reference: known.map(|pose| pose.robot(frame.sensor())), frame, recorded: None })
    }

    fn of_points(&self, time: f64, path: &Path) -> Result<(Frame, Option<SensorPose>)> {
        let cloud = cloud::read(path)?;
        let grid = range_grid(&cloud.points, cloud.size)?;
        let stamp = if self.is_timed { ScanStamp::Known(time) } else { ScanStamp::Counted(time) };
        let is_measured = |i: usize| cloud.points[i].length_squared() > 0.0;
        let taken = cloud.times.map(|times| times.after(stamp, None, is_measured)).transpose()?;
        let RaySeconds { stamp, seconds, notices } = taken.unwrap_or(RaySeconds::none(time));
        notices.into_iter().for_each(|notice| self.notices.add(notice));
        let own = seconds.map(|seconds| grid.spread(&seconds));
        let given = self.sensor.as_ref().map(Sensor::spec);
        let size = (grid.table.width(), grid.table.height());
        let (times, notice) = ray_times::of_cloud(own, given, size, cloud.size.is_some())?;
        notice.into_iter().for_each(|notice| self.notices.add(notice));
        let geometry = Geometry::Rays(grid.table);
        let spec = match given {
            Some(spec) => spec.clone().with_geometry(geometry),
            None => SensorSpec::new(stem(path), "laser", geometry),
        };
        let frame = Frame::new(stamp, Sensor::new(spec.with_times(times))?, Measurement::Range(grid.ranges))?;
        Ok((frame, cloud.pose))
    }

    fn of_image(&self, time: f64, path: &Path) -> Result<(Frame, Option<SensorPose>)> {
        let channel = |name: &str| KnownChannel { name: name.to_owned(), is_id: false };
        let mut file = exr::read(path, &[channel("range"), channel("depth_z")])?;
        let text_of = |name: &str| file.texts.iter().find(|(of, _)| of == name).map(|(_, text)| text);
        let own = text_of("sensor")
            .map(|text| sensor_toml::parse(text, &stem(path), path.parent()).and_then(Sensor::new))
            .transpose()?;
        let world_from_sensor = text_of("world_from_sensor").map(|text| exr::pose_from_text(text)).transpose();
        let world_from_sensor = world_from_sensor.map_err(|e| e.at(exr::attribute("world_from_sensor")))?;
        let Some(sensor) = self.sensor.clone().or(own) else {
            return Err(Error::invalid("the file does not name the sensor that measured it", "give the sensor"));
        };
        let (width, height) = (sensor.width(), sensor.height());
        if (file.width, file.height) != (width, height) {
            let what = format!("{} x {} pixels, but the sensor has {width} x {height}", file.width, file.height);
            return Err(Error::invalid(what, "give the sensor that measured"));
        }
        let measurement = match (file.take_floats("range"), file.take_floats("depth_z")) {
            (Some(range), _) => Measurement::Range(range),
            (None, Some(depth_z)) => Measurement::DepthZ(depth_z),
            _ => return Err(Error::invalid("it has no range image", "give one with the channel range or depth_z")),
        };
        Ok((Frame::new(time, sensor, measurement)?, world_from_sensor.map(SensorPose::new)))
    }
}

impl Iterator for Scans {
    type Item = Result<Observation>;

    fn next(&mut self) -> Option<Self::Item> {
        let (time, path) = self.files.next()?;
        let read = self.read(time, &path);
        if read.is_err() && self.faults == Faults::End {
            self.files = Vec::new().into_iter();
        }
        Some(read.map_err(|e| e.in_file(&path)))
    }
}

fn parent(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn stem(path: &Path) -> String {
    path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}

fn listed(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list it", e))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::io(folder, "list it", e))?.path();
        if is_scan(&path) && path.is_file() {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// Pairs each file with its time, in the order of time; true if the names are the times.
fn timed(files: Vec<PathBuf>) -> (bool, Vec<(f64, PathBuf)>) {
    let named = |path: &PathBuf| stem(path).parse::<f64>().ok().filter(|t| t.is_finite());
    let Some(times) = files.iter().map(named).collect::<Option<Vec<f64>>>() else {
        return (false, files.into_iter().enumerate().map(|(i, path)| (i as f64, path)).collect());
    };
    let mut timed: Vec<(f64, PathBuf)> = times.into_iter().zip(files).collect();
    timed.sort_by(|a, b| a.0.total_cmp(&b.0));
    (true, timed)
}

#[derive(serde::Deserialize)]
struct NamedPose {
    translation: [f64; 3],
    quaternion_xyzw: [f64; 4],
}

fn read_poses(path: &Path) -> Result<HashMap<String, SensorPose>> {
    from_text(path, parse_poses)
}

fn parse_poses(text: &str) -> Result<HashMap<String, SensorPose>> {
    let wrong = |what: String| Error::invalid(what, "give {\"name\": {\"translation\": .., \"quaternion_xyzw\": ..}}");
    check_json_memory(text)?;
    let all: HashMap<String, serde_json::Value> = serde_json::from_str(text).map_err(|e| wrong(e.to_string()))?;
    let mut poses = HashMap::new();
    // Values that are not objects are notes, such as the source of the poses.
    for (name, value) in all.into_iter().filter(|(_, value)| value.is_object()) {
        let NamedPose { translation, quaternion_xyzw } = serde_json::from_value(value)
            .map_err(|e| wrong(format!("{}: {e}", presight_model::printable::quoted(&name))))?;
        let pose = Pose::new(DVec3::from(translation), DQuat::from_array(quaternion_xyzw));
        poses.insert(name, SensorPose::new(pose?));
    }
    Ok(poses)
}
