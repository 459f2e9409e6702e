//! Logs of measured frames: measurements of a sensor with their times, and the robot's odometry.
//!
//! [`open`] opens a log of ranges and returns its frames one at a time:
//!
//! - **Format 1**, our own ([`lines`]): a header and then one JSON object per line. It is read line by line, so a log
//!   can be larger than memory.
//! - **Documents** ([`document`]): one JSON object whose `scans` list planar laser scans, as in public data sets. It is
//!   held in memory.
//!
//! [`Frames`] also opens ROS 2 bags (`bag`), folders of depth images, and scans as points or images of ranges
//! ([`scans`]).

#[cfg(feature = "ros")]
pub mod bag;
mod bag_options;
pub mod document;
mod frames;
pub mod lines;
mod notices;
mod ray_times;
mod readings;
mod scan_motions;
pub mod scans;
mod skip_bad;
#[cfg(test)]
mod tests;

pub use bag_options::BagOptions;
pub use frames::{Frames, Observation, Recorded};
pub use readings::notice_of_readings;

use super::file;
use super::text::read_line;
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::{Pose, RobotPose, Twist};
use presight_model::limits;
use presight_model::measured::{Frame, GreyImage, Measurement, Motion, OdometryNoise, ScanMotion, check_intensities};
use presight_model::sensor::{RayTimes, Sensor, SensorSpec};
use std::io::{BufReader, Read};
use std::path::Path;

/// A measurement of a sensor at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct LogFrame {
    /// Seconds, rising within a log.
    pub time: f64,
    /// Metres along each ray, row-major, after REP-117: `+inf` for no detection, `-inf` for an object nearer
    /// than `range_min`, NaN for no reading. As in the log: 0, or a finite value outside of the sensor's limits, is no
    /// measurement either.
    pub range: Vec<f32>,
    /// Strength of the echo along each ray, from 0 to 1 (as bright as a retroreflector); NaN for no echo.
    pub intensities: Option<Vec<f32>>,
    /// Seconds after `time` at which each ray was measured, row-major; negative before it. `None` for the
    /// times that the sensor states.
    pub times: Option<Vec<f32>>,
    /// The robot's velocity while the rays were measured, along and about its own axes.
    pub twist: Option<Twist>,
    /// The robot's motion since the previous frame, by its odometry: previous_robot_from_robot.
    pub odometry: Option<Pose>,
    /// A reference for the robot's pose. Estimates must not use it.
    pub reference: Option<RobotPose>,
}

impl LogFrame {
    /// Ranges at a time, without anything else.
    pub fn new(time: f64, range: Vec<f32>) -> Self {
        Self { time, range, intensities: None, times: None, twist: None, odometry: None, reference: None }
    }

    /// A frame as a line of a log, which can hold a constant twist but no other motion during the scan.
    pub fn of(frame: &Frame, reference: Option<RobotPose>) -> Self {
        let times = match &frame.sensor().spec().times {
            RayTimes::Listed(times) => Some(times.to_vec()),
            _ => None,
        };
        let twist = match frame.scan_motion() {
            Some(ScanMotion::Twist(twist)) => Some(*twist),
            _ => None,
        };
        Self {
            time: frame.stamp,
            range: frame.ranges().to_vec(),
            intensities: frame.intensities().map(|i| i.values().to_vec()),
            times,
            twist,
            odometry: frame.motion.map(|m| m.previous_from_current),
            reference,
        }
    }

    /// Converts to a frame for the estimator. `noise` is the odometry's, which logs do not contain.
    ///
    /// # Errors
    /// As [`Frame::new`]; [`presight_model::ErrorKind::Invalid`] if the times of the rays contradict the sensor.
    pub fn into_frame(self, sensor: &Sensor, noise: &OdometryNoise) -> Result<Frame> {
        let sensor =
            self.times.as_ref().map_or_else(|| Ok(sensor.clone()), |times| ray_times::listed(sensor, times))?;
        self.into_frame_of(sensor, noise)
    }

    /// As [`Self::into_frame`], of the sensor with the frame's own times.
    fn into_frame_of(self, sensor: Sensor, noise: &OdometryNoise) -> Result<Frame> {
        let size = (sensor.width(), sensor.height());
        let mut frame = Frame::new(self.time, sensor, Measurement::Range(self.range))?;
        if let Some(values) = self.intensities {
            frame = frame.with_intensities(GreyImage::new(size.0, size.1, values)?)?;
        }
        if let Some(twist) = self.twist {
            check_twist(&twist)?;
            frame = frame.with_scan_motion(ScanMotion::Twist(twist));
        }
        frame.motion = self.odometry.map(|motion| Motion::of_odometry(motion, noise));
        Ok(frame)
    }

    /// The transform of the reference.
    fn reference_pose(&self) -> Option<Pose> {
        self.reference.map(|robot| robot.world_from_robot())
    }

    /// Checks the size of the frame, that time, twist and poses are finite, that intensities are from 0 to 1, and that
    /// the times of the rays do not contradict the sensor.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] naming the wrong value.
    pub fn check(&self, sensor: &SensorSpec) -> Result<()> {
        let (width, height) = sensor.geometry.size();
        let pixels = width as usize * height as usize;
        if self.range.len() != pixels {
            let remedy = "give one for each ray, row by row; null for none";
            return Err(Error::invalid(format!("{} ranges for {pixels} rays", self.range.len()), remedy));
        }
        if !self.time.is_finite() {
            return Err(Error::invalid("the time is not finite", "give seconds"));
        }
        if let Some(intensities) = &self.intensities {
            if intensities.len() != pixels {
                let remedy = "give one for each ray, row by row; null for none";
                return Err(Error::invalid(format!("{} intensities for {pixels} rays", intensities.len()), remedy));
            }
            check_intensities(intensities)?;
        }
        if let Some(times) = &self.times {
            ray_times::check(times, sensor)?;
        }
        if let Some(twist) = &self.twist {
            check_twist(twist)?;
        }
        let poses = [("odometry", self.odometry), ("reference", self.reference_pose())];
        for (name, pose) in poses {
            pose.map_or(Ok(()), |p| p.check_as(ErrorKind::Invalid)).map_err(|e| e.at(name))?;
        }
        Ok(())
    }
}

/// Checks that a twist leads to a pose that is near enough.
fn check_twist(twist: &Twist) -> Result<()> {
    twist.check().map_err(|e| e.at("twist"))
}

/// The frames of one sensor, in the order of time. The first error ends them, unless bad frames are skipped.
pub trait Log: Iterator<Item = Result<LogFrame>> {
    /// The place of the last frame read, good or bad; `None` if the fault is not that of a single frame.
    fn place(&self) -> Option<String>;

    /// The sensor. Its mount is its pose on the robot.
    fn sensor(&self) -> &Sensor;

    /// True if its poses are x, y and yaw only.
    fn has_planar_poses(&self) -> bool {
        false
    }
}

/// Opens a log of format 1 or a document.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming file and line if it is not a valid log;
/// [`presight_model::ErrorKind::Unsupported`] for a newer format; [`presight_model::ErrorKind::System`] if the file
/// cannot be read. A bad frame is reported when it is read.
pub fn open(path: &Path) -> Result<Box<dyn Log + Send>> {
    open_with(path, Faults::End)
}

/// What the faults of single frames do to a log.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Faults {
    /// The first one ends it.
    End,
    /// The log continues, and leaves the order of the times to its reader.
    Pass,
}

fn open_with(path: &Path, faults: Faults) -> Result<Box<dyn Log + Send>> {
    open_unnamed(path, faults).map_err(|e| e.in_file(path))
}

fn open_unnamed(path: &Path, faults: Faults) -> Result<Box<dyn Log + Send>> {
    let mut reader = BufReader::new(file::open_or_given(path)?);
    let first = read_line(&mut reader, 1)?;
    let first = first.ok_or_else(|| Error::invalid("the log is empty", "give a header, then frames"))?;
    if lines::is_header(&first) {
        return Ok(Box::new(lines::Lines::new(path, reader, &first, faults)?));
    }
    let mut text = first.into_bytes();
    let rest = limits::MAX_LINE_BYTES + 1 - text.len() as u64;
    reader.take(rest).read_to_end(&mut text).map_err(|e| Error::io(path, "read it", e))?;
    Ok(Box::new(document::Document::parse(path, text, faults)?))
}

/// Reads frame `index` of a log, from 0, and its sensor.
///
/// # Errors
/// As [`open`], and the errors of all frames up to this one; [`presight_model::ErrorKind::Usage`] if the log has fewer.
pub fn read_frame(path: &Path, index: usize) -> Result<(Sensor, LogFrame)> {
    let mut log = open(path)?;
    for i in 0..=index {
        match log.next().transpose()? {
            Some(frame) if i == index => return Ok((log.sensor().clone(), frame)),
            Some(_) => {}
            None => {
                let what = format!("there is no frame {index}: the log has {i}");
                return Err(Error::usage(what, "frames count from 0").in_file(path));
            }
        }
    }
    unreachable!("the loop ends with a frame or without one")
}

/// Checks that times rise.
fn check_time(before: Option<f64>, time: f64) -> Result<()> {
    match before {
        Some(before) if !(time > before) => {
            let what = format!("its time {time} s is not after the {before} s of the previous frame");
            Err(Error::invalid(what, "sort the frames by time, each once"))
        }
        _ => Ok(()),
    }
}
