//! Logs in presight's own format 1: one JSON object per line (JSON Lines), with the header first.
//!
//! ```text
//! {"format": 1, "kind": "range-log", "sensor": "format = 1\nkind = \"scanner\"\n.."}
//! {"t": 12.5, "range": [2.47, null, "inf"], "odometry": [0.2, 0, 0, 0, 0, 8.1], "reference": [3, -1, 0, 0, 0, 1, 0]}
//! ```
//!
//! - `sensor`: the text of a sensor file ([`crate::sensor_toml`]) with its mount and limits.
//! - `t`: seconds, rising.
//! - `range`: metres, one for each ray, row by row; `null` for no reading, `"inf"` for no detection, `"-inf"`
//!   for an object nearer than `range_min`. `NaN`, `Infinity` and the like are read with and without quotes.
//! - `intensities`, optional: strength of each ray's echo, from 0 to 1 (as bright as a retroreflector); `null` for
//!   none.
//! - `times`, optional: seconds after `t` at which each ray was measured, negative before it. Without them they are the
//!   sensor's; if both are there, they must agree.
//! - `twist`, optional: the robot's velocity while the rays were measured, `[vx, vy, vz, wx, wy, wz]` in metres and
//!   radians per second, along and about the robot's own axes.
//! - `odometry`, optional: the robot's motion since the previous frame, previous_robot_from_robot, as
//!   `[x, y, z, roll_deg, pitch_deg, yaw_deg]` or `[x, y, z, qx, qy, qz, qw]`.
//! - `reference`, optional: world_from_robot, in the same form.

use super::readings::{Reading, with_quoted_words};
use super::{Faults, Log, LogFrame, check_time};
use crate::sensor_toml;
use crate::text::{FORMAT, check_version, read_line};
use presight_model::error::{Error, ErrorKind, Result};
use presight_model::geometry::{Pose, RobotPose, Twist};
use presight_model::sensor::{Sensor, SensorSpec};
use serde::de::IgnoredAny;
use std::fs::File;
use std::io::{BufReader, Take};
use std::path::{Path, PathBuf};

const KIND: &str = "range-log";
const REMEDY: &str = "docs/formats.md describes logs";

/// A log of format 1, read line by line.
pub struct Lines {
    path: PathBuf,
    reader: BufReader<Take<File>>,
    sensor: Sensor,
    line: usize,
    time: Option<f64>,
    ended: bool,
    faults: Faults,
}

#[derive(serde::Deserialize)]
struct Header {
    format: Option<i64>,
    kind: Option<String>,
}

/// A header with all keys that this format allows.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct WholeHeader {
    #[serde(rename = "format")]
    _format: IgnoredAny,
    #[serde(rename = "kind")]
    _kind: IgnoredAny,
    sensor: Option<String>,
}

/// Returns true if a line names a format.
pub(super) fn is_header(line: &str) -> bool {
    serde_json::from_str::<Header>(line).is_ok_and(|header| header.format.is_some())
}

/// The header of a log, without the line break.
pub fn header(sensor: &SensorSpec) -> String {
    serde_json::json!({ "format": FORMAT, "kind": KIND, "sensor": sensor_toml::to_string(sensor) }).to_string()
}

/// The line of a frame, without the line break. It reads back bit for bit.
///
/// # Errors
/// [`crate::ErrorKind::Invalid`] if a time is not finite, an intensity is infinite, or a pose or the twist is invalid:
/// the line could not be read back.
pub fn line(frame: &LogFrame) -> Result<String> {
    check_numbers(frame)?;
    let range: Vec<String> = frame.range.iter().map(|r| reading(*r)).collect();
    let mut text = format!("{{\"t\":{:?},\"range\":[{}]", frame.time, range.join(","));
    if let Some(intensities) = &frame.intensities {
        let values: Vec<String> = intensities.iter().map(|v| reading(*v)).collect();
        text += &format!(",\"intensities\":[{}]", values.join(","));
    }
    if let Some(times) = &frame.times {
        text += &format!(",\"times\":{times:?}");
    }
    if let Some(twist) = &frame.twist {
        text += &format!(",\"twist\":{:?}", twist.to_array());
    }
    for (name, p) in [("odometry", frame.odometry), ("reference", frame.reference_pose())] {
        if let Some(p) = p {
            text += &format!(",\"{name}\":{:?}", p.to_array());
        }
    }
    Ok(text + "}")
}

/// Checks that a frame's line can be read back.
fn check_numbers(frame: &LogFrame) -> Result<()> {
    if !frame.time.is_finite() {
        return Err(Error::invalid(format!("the frame's time is {} s", frame.time), "give finite seconds"));
    }
    let place = |e: Error| e.at(format!("the frame at {} s", frame.time));
    if frame.intensities.iter().flatten().any(|v| v.is_infinite()) {
        return Err(place(Error::invalid("an intensity is infinite", "give intensities from 0 to 1")));
    }
    if frame.times.iter().flatten().any(|t| !t.is_finite()) {
        return Err(place(Error::invalid("a time of a ray is not finite", "give seconds after the time of the frame")));
    }
    frame.twist.map_or(Ok(()), |twist| super::check_twist(&twist)).map_err(place)?;
    [frame.odometry, frame.reference_pose()]
        .into_iter()
        .flatten()
        .try_for_each(|p| p.check_as(ErrorKind::Invalid))
        .map_err(place)
}

fn reading(range: f32) -> String {
    match range {
        r if r.is_nan() => "null".into(),
        f32::INFINITY => "\"inf\"".into(),
        f32::NEG_INFINITY => "\"-inf\"".into(),
        r => r.to_string(),
    }
}

impl Lines {
    pub(super) fn new(path: &Path, reader: BufReader<Take<File>>, first: &str, faults: Faults) -> Result<Self> {
        let sensor = read_header(first, path).map_err(|e| e.at("line 1"))?;
        Ok(Self { path: path.to_owned(), reader, sensor, line: 1, time: None, ended: false, faults })
    }

    fn read(&mut self) -> Result<Option<LogFrame>> {
        loop {
            self.line += 1;
            let Some(text) = read_line(&mut self.reader, self.line)? else { return Ok(None) };
            if !text.trim().is_empty() {
                let frame = self.parse(&text).map_err(|e| e.at(format!("line {}", self.line)))?;
                self.time = Some(frame.time);
                return Ok(Some(frame));
            }
        }
    }

    fn parse(&self, text: &str) -> Result<LogFrame> {
        let Entry { t, range, intensities, times, twist, odometry, reference } =
            serde_json::from_str(&with_quoted_words(text)).map_err(|e| match e.is_eof() {
                true => Error::invalid("the line is cut in the middle", "delete it, or record the log again"),
                false => Error::invalid(format!("not a valid frame: {e}"), REMEDY),
            })?;
        let remedy = "give x, y, z, roll_deg, pitch_deg, yaw_deg or x, y, z, qx, qy, qz, qw";
        let wrong = |name| Error::invalid("not a valid pose", remedy).at(name);
        let pose = |numbers: Option<Vec<f64>>, name: &'static str| {
            numbers.map(|n| Pose::of_numbers(&n).map_err(|_| wrong(name))).transpose()
        };
        let frame = LogFrame {
            time: t,
            range: range.into_iter().map(|r| r.0).collect(),
            intensities: intensities.map(|all| all.into_iter().map(|i| i.0).collect()),
            times,
            twist: twist.map(Twist::from_array),
            odometry: pose(odometry, "odometry")?,
            reference: pose(reference, "reference")?.map(RobotPose::new),
        };
        frame.check(self.sensor.spec())?;
        if self.faults == Faults::End {
            check_time(self.time, frame.time)?;
        }
        Ok(frame)
    }
}

impl Iterator for Lines {
    type Item = Result<LogFrame>;

    fn next(&mut self) -> Option<Result<LogFrame>> {
        if self.ended {
            return None;
        }
        let next = self.read().map_err(|e| e.in_file(&self.path)).transpose();
        self.ended = match &next {
            Some(Err(e)) => self.faults == Faults::End || e.kind() != ErrorKind::Invalid,
            next => next.is_none(),
        };
        next
    }
}

impl Log for Lines {
    fn place(&self) -> Option<String> {
        (!self.ended).then(|| format!("line {}", self.line))
    }

    fn sensor(&self) -> &Sensor {
        &self.sensor
    }
}

fn read_header(line: &str, path: &Path) -> Result<Sensor> {
    let header: Header =
        serde_json::from_str(line).map_err(|e| Error::invalid(format!("not a valid header: {e}"), REMEDY))?;
    check_version(header.format, FORMAT, "\"format\": 1")?;
    if header.kind.as_deref() != Some(KIND) {
        return Err(Error::invalid(
            "this is the header of another kind of file",
            format!("write \"kind\": \"{KIND}\""),
        ));
    }
    // Unknown keys are errors only now, because a newer format may have more keys.
    let whole: WholeHeader =
        serde_json::from_str(line).map_err(|e| Error::invalid(format!("not a valid header: {e}"), REMEDY))?;
    let text = whole.sensor.ok_or_else(|| Error::invalid("sensor is missing", "give the text of a sensor file"))?;
    let name = path.file_stem().map_or_else(|| "sensor".into(), |s| s.to_string_lossy());
    sensor_toml::parse(&text, &name, path.parent()).and_then(Sensor::new).map_err(|e| e.at("sensor"))
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    t: f64,
    range: Vec<Reading>,
    intensities: Option<Vec<Reading>>,
    times: Option<Vec<f32>>,
    twist: Option<[f64; 6]>,
    odometry: Option<Vec<f64>>,
    reference: Option<Vec<f64>>,
}
