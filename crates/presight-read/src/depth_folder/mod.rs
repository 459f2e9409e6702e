//! Folders of images: `camera.json`, 16-bit `depth/*.png`, `grey/*.png` or both, and optionally `poses.txt` and
//! `odometry.txt`.
//!
//! `camera.json` has `width`, `height`, `fx`, `fy`, `cx`, `cy`, and optionally `distortion` (five numbers, plumb bob)
//! and `depth_unit_m` (default 0.001). A depth of 0 or of 65535 units, the largest, means no measurement. Images are
//! read in the order of their names. A name that is a number is the time in seconds; otherwise the time is the index of
//! the frame from 0.
//!
//! Grey images have 8 or 16 bits; colour images are converted to luminance. A grey image belongs to the depth image of
//! the same time. If another camera took the grey images, `grey.toml` is its sensor file.
//!
//! A line of `poses.txt` is `time tx ty tz qx qy qz qw`; further words are ignored. These poses are world_from_camera
//! with optical axes, in the frame of the scene's file (y up).
//!
//! A line of `odometry.txt` has the same form: the robot's pose in body axes (x ahead, z up) by its odometry, in any
//! frame that stays. The motion between two images comes from the poses at their times, on a straight line between two
//! entries.

use super::file;
use super::text::from_text;
use crate::file::file_name;
use crate::picture::Picture;
use crate::tum::StampedPose;
use glam::{DQuat, DVec3};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::measured::{Frame, GreyImage, Measurement};
use presight_model::sensor::{Camera, Distortion, Geometry, Sensor, SensorSpec, body_from_optical_rotation};
use serde::Deserialize;
use std::io::BufReader;
use std::path::{Path, PathBuf};

/// Times that differ by less are equal, seconds.
const SAME_TIME: f64 = 1e-6;

/// The frames of a folder, one at a time.
#[derive(Debug)]
pub struct DepthFolder {
    sensor: Sensor,
    is_grey: bool,
    unit: f64,
    images: std::vec::IntoIter<PathBuf>,
    count: usize,
    reference: Vec<StampedPose>,
    odometry: Vec<StampedPose>,
}

#[derive(Deserialize)]
struct File {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    #[serde(default)]
    distortion: Option<[f64; 5]>,
    #[serde(default)]
    depth_unit_m: Option<f64>,
}

impl DepthFolder {
    /// Opens the depth images of a folder, or its grey images if it has no depth images. `sensor` replaces the camera
    /// of `camera.json`, which has no noise, limits or mount; its image must have the same size.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] naming the file at fault; [`presight_model::ErrorKind::System`] if the
    /// system refuses.
    pub fn open(folder: &Path, sensor: Option<&Sensor>) -> Result<Self> {
        let is_grey = !folder.join("depth").exists() && folder.join("grey").exists();
        Self::of_images(folder, sensor, is_grey, &mut None)
    }

    /// As [`DepthFolder::open`], without the lines of `poses.txt` and `odometry.txt` that are not valid: notices count
    /// them.
    ///
    /// # Errors
    /// As [`DepthFolder::open`].
    pub(crate) fn open_skipping_bad(folder: &Path, sensor: Option<&Sensor>) -> Result<(Self, Vec<String>)> {
        let is_grey = !folder.join("depth").exists() && folder.join("grey").exists();
        let mut notices = Some(Vec::new());
        let log = Self::of_images(folder, sensor, is_grey, &mut notices)?;
        Ok((log, notices.unwrap_or_default()))
    }

    /// Opens the grey images of a folder with depth images; `None` if there are none. `sensor` is the camera that took
    /// them. It defaults to the camera of `grey.toml`, or else to `depth`, which measured the depths.
    ///
    /// # Errors
    /// As [`DepthFolder::open`], and errors of the sensor file.
    pub fn grey_beside(folder: &Path, sensor: Option<&Sensor>, depth: &Sensor) -> Result<Option<Self>> {
        if !folder.join("grey").is_dir() || !folder.join("depth").exists() {
            return Ok(None);
        }
        let own = folder.join("grey.toml");
        let sensor = match sensor {
            None if own.exists() => super::load_sensor(&own.to_string_lossy())?.0,
            given => given.unwrap_or(depth).clone(),
        };
        let images = pngs(&folder.join("grey"))?.into_iter();
        Ok(Some(Self {
            sensor,
            is_grey: true,
            unit: 1.0,
            images,
            count: 0,
            reference: Vec::new(),
            odometry: Vec::new(),
        }))
    }

    /// With `left_out`, lines that are not valid become notices there.
    fn of_images(
        folder: &Path,
        sensor: Option<&Sensor>,
        is_grey: bool,
        left_out: &mut Option<Vec<String>>,
    ) -> Result<Self> {
        let (sensor, unit) = from_text(&folder.join("camera.json"), |text| {
            let (own, unit) = camera(text)?;
            let sensor = sensor.unwrap_or(&own);
            if (sensor.width(), sensor.height()) != (own.width(), own.height()) {
                let what = format!(
                    "{} x {} pixels, the sensor has {} x {}",
                    own.width(),
                    own.height(),
                    sensor.width(),
                    sensor.height()
                );
                return Err(Error::invalid(what, "give the sensor that took the images"));
            }
            Ok((sensor.clone(), unit))
        })?;
        let images = pngs(&folder.join(if is_grey { "grey" } else { "depth" }))?.into_iter();
        let poses = folder.join("poses.txt");
        let reference = if poses.exists() { reference(&poses, left_out)? } else { Vec::new() };
        let odometry = folder.join("odometry.txt");
        let odometry = if odometry.exists() { rising(&odometry, left_out)? } else { Vec::new() };
        Ok(Self { sensor, is_grey, unit, images, count: 0, reference, odometry })
    }

    /// Returns the frame of this time, if there is one, and skips earlier frames.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] for an image that cannot be read.
    pub fn next_at(&mut self, time: f64) -> Result<Option<Frame>> {
        while let Some(path) = self.images.as_slice().first() {
            let stamp = self.stamp(path);
            if stamp > time + SAME_TIME {
                return Ok(None);
            }
            match self.next() {
                Some(frame) if stamp >= time - SAME_TIME => return frame.map(Some),
                _ => {}
            }
        }
        Ok(None)
    }

    /// The file of the next image.
    pub(crate) fn next_image(&self) -> Option<&Path> {
        self.images.as_slice().first().map(PathBuf::as_path)
    }

    /// The sensor that measured.
    pub fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    /// Reference poses of `poses.txt`: world_from_sensor, body axes, z up. Estimates must not use them.
    pub fn reference(&self) -> &[StampedPose] {
        &self.reference
    }

    /// The robot's poses of `odometry.txt`, by rising time.
    pub fn odometry(&self) -> &[StampedPose] {
        &self.odometry
    }

    fn stamp(&self, path: &Path) -> f64 {
        let stamp = path.file_stem().and_then(|s| s.to_str()).and_then(|s| s.parse::<f64>().ok());
        stamp.filter(|s| s.is_finite()).unwrap_or(self.count as f64)
    }

    fn frame(&self, path: &Path) -> Result<Frame> {
        let file = BufReader::new(file::open(path)?);
        let size = (self.sensor.width(), self.sensor.height());
        let picture = Picture::read(file, |(w, h)| {
            let what = || format!("{w} x {h} pixels; the camera has {} x {}", size.0, size.1);
            if (w, h) == size { Ok(()) } else { Err(Error::invalid(what(), "give images of this camera")) }
        })?;
        let sensed = if self.is_grey {
            Measurement::Grey(GreyImage::new(size.0, size.1, picture.into_luminances()?)?)
        } else {
            // Cameras and exporters write the largest number where they have no depth, or one that does not fit.
            let metres = |v: u16| if v == u16::MAX { f32::NAN } else { (f64::from(v) * self.unit) as f32 };
            Measurement::DepthZ(picture.into_grey16()?.into_iter().map(metres).collect())
        };
        Frame::new(self.stamp(path), self.sensor.clone(), sensed)
    }
}

/// The poses of a file whose text is `prepared` first. With `left_out`, lines that are not valid become a notice there.
fn trajectory(
    path: &Path,
    left_out: &mut Option<Vec<String>>,
    prepared: impl Fn(&str) -> String,
) -> Result<Vec<StampedPose>> {
    let Some(notices) = left_out else { return from_text(path, |text| super::tum::parse(&prepared(text))) };
    let (poses, faults) = from_text(path, |text| Ok(super::tum::parse_valid(&prepared(text))))?;
    if let Some(first) = faults.first() {
        let (line, what) = (first.place().unwrap_or_default(), first.what());
        let name = file_name(path);
        notices.push(format!("{name}: {} lines are left out, the first is {line} ({what})", faults.len()));
    }
    Ok(poses)
}

/// The poses of `odometry.txt`.
fn rising(path: &Path, left_out: &mut Option<Vec<String>>) -> Result<Vec<StampedPose>> {
    let mut poses = trajectory(path, left_out, str::to_owned)?;
    if let Some(notices) = left_out {
        let (count, mut last) = (poses.len(), f64::NEG_INFINITY);
        poses.retain(|pose| {
            let rises = pose.time > last;
            last = last.max(pose.time);
            rises
        });
        let falling = count - poses.len();
        if falling > 0 {
            notices.push(format!("{}: {falling} of {count} times fall and are left out", file_name(path)));
        }
    }
    match poses.windows(2).find(|pair| !(pair[1].time > pair[0].time)) {
        Some([a, b]) => {
            let what = format!("a time of {} s after one of {} s", b.time, a.time);
            Err(Error::invalid(what, "sort the poses by time, each once").in_file(path))
        }
        _ => Ok(poses),
    }
}

/// The pose at a time, between the two entries around it; `None` before the first entry and after the last.
pub fn pose_at(poses: &[StampedPose], time: f64) -> Option<Pose> {
    let after = poses.partition_point(|p| p.time < time - SAME_TIME);
    let b = poses.get(after)?;
    if (b.time - time).abs() <= SAME_TIME {
        return Some(b.pose);
    }
    let a = poses.get(after.checked_sub(1)?)?;
    let part = (time - a.time) / (b.time - a.time);
    let translation = a.pose.translation.lerp(b.pose.translation, part);
    Some(Pose { translation, rotation: a.pose.rotation.slerp(b.pose.rotation, part).normalize() })
}

/// The images of a folder, by name.
fn pngs(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|e| Error::io(folder, "list it", e))?;
    let mut images = Vec::new();
    for entry in entries {
        let path = entry.map_err(|e| Error::io(folder, "list it", e))?.path();
        if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
            images.push(path);
        }
    }
    images.sort();
    if images.is_empty() {
        return Err(Error::invalid("there is no .png file", "give images").in_file(folder));
    }
    Ok(images)
}

impl Iterator for DepthFolder {
    type Item = Result<Frame>;

    fn next(&mut self) -> Option<Self::Item> {
        let path = self.images.next()?;
        let frame = self.frame(&path).map_err(|e| e.in_file(&path));
        self.count += 1;
        Some(frame)
    }
}

/// The text of `camera.json` for a camera whose depths are written in millimetres.
///
/// # Errors
/// [`presight_model::ErrorKind::Usage`] for a sensor that is not a camera, a rectified camera that R turns, or a lens
/// with another distortion than plumb bob.
pub fn camera_json(sensor: &Sensor) -> Result<String> {
    let name = &sensor.spec().name;
    let Geometry::Camera(c) = &sensor.spec().geometry else {
        return Err(Error::usage(format!("sensor {name:?} is not a camera and has no depth images"), "give a camera"));
    };
    if sensor.spec().optical_from_image != DQuat::IDENTITY {
        let what = format!("camera.json cannot describe the rectified image of sensor {name:?}");
        return Err(Error::usage(what, "give the raw camera"));
    }
    let lens = match &c.distortion {
        Distortion::None => [0.0; 5],
        Distortion::PlumbBob(k) => *k,
        _ => {
            let remedy = "give a camera without distortion, or with a plumb-bob lens";
            return Err(Error::usage(format!("camera.json cannot describe the lens of sensor {name:?}"), remedy));
        }
    };
    let json = serde_json::json!({
        "width": c.width, "height": c.height, "fx": c.fx, "fy": c.fy, "cx": c.cx, "cy": c.cy,
        "distortion": lens, "depth_unit_m": 1e-3,
    });
    Ok(format!("{json}\n"))
}

/// The name of the image at a time in seconds, 0 or more. Names sort in the order of times.
pub fn image_name(time: f64) -> String {
    format!("{time:018.6}.png")
}

/// The text of `poses.txt` for poses of the robot on which a sensor is mounted.
pub fn poses_txt(sensor: &Sensor, world_from_robot: &[StampedPose]) -> String {
    let (y_up, body_from_optical) = (z_up_from_y_up().inverse(), optical_from_body().inverse());
    let mut text = String::from("# time tx ty tz qx qy qz qw: world_from_camera, optical axes, y up, metres\n");
    for s in world_from_robot {
        let pose = y_up * s.pose * sensor.spec().mount * body_from_optical;
        let (t, q) = (pose.translation, pose.rotation);
        // With the digits of the image's name.
        text += &format!("{:.6} {} {} {} {} {} {} {}\n", s.time, t.x, t.y, t.z, q.x, q.y, q.z, q.w);
    }
    text
}

fn z_up_from_y_up() -> Pose {
    Pose::from_xyz_rpy(DVec3::ZERO, std::f64::consts::FRAC_PI_2, 0.0, 0.0)
}

fn optical_from_body() -> Pose {
    Pose { rotation: body_from_optical_rotation().conjugate(), translation: DVec3::ZERO }
}

fn camera(text: &str) -> Result<(Sensor, f64)> {
    let file: File = serde_json::from_str(text).map_err(|e| {
        let remedy = "give width, height, fx, fy, cx, cy, and optionally distortion and depth_unit_m";
        Error::invalid(e.to_string(), remedy).at(format!("line {}", e.line()))
    })?;
    let unit = file.depth_unit_m.unwrap_or(1e-3);
    if !(unit > 0.0 && unit.is_finite()) {
        return Err(Error::invalid(format!("a depth unit of {unit} m"), "give metres above 0"));
    }
    let distortion = file.distortion.map_or(Distortion::None, Distortion::PlumbBob);
    let camera = Camera { distortion, ..Camera::pinhole(file.width, file.height, file.fx, file.fy, file.cx, file.cy) };
    let mut spec = SensorSpec::new("depth camera", "laser", Geometry::Camera(camera));
    // Typical of triangulating cameras at one metre.
    spec.noise.range_sigma = 0.005;
    Ok((Sensor::new(spec)?, unit))
}

/// Reads poses with optical axes in a y-up world, and converts them to body axes in a z-up world.
fn reference(path: &Path, left_out: &mut Option<Vec<String>>) -> Result<Vec<StampedPose>> {
    let first_eight = |line: &str| line.split_whitespace().take(8).collect::<Vec<_>>().join(" ");
    let kept = |line: &str| if line.trim_start().starts_with('#') { String::new() } else { first_eight(line) };
    let prepared = |text: &str| text.lines().map(kept).collect::<Vec<_>>().join("\n");
    let mut poses = trajectory(path, left_out, prepared)?;
    poses.iter_mut().for_each(|s| s.pose = z_up_from_y_up() * s.pose * optical_from_body());
    Ok(poses)
}

#[cfg(test)]
mod tests;
