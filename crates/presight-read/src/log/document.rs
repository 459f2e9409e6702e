//! Planar laser scans in the form of public data sets: one JSON object with a list `scans`.
//!
//! Keys of the document: `beams`, `angle_min`, `angle_max` (radians), `counter_clockwise`, `range_min` (default 0),
//! `range_max`, `range_std`, `turn_s` (seconds of a scan, see [`RayTimes::Columns`]; default 0), `stamp` (the ray to
//! which `t` belongs: `first`, `middle` or `last`; default `first`), `sensor_on_robot` {x, y, z, yaw}; or in an object
//! `scan`: `beams`, `angle_min_deg`, `step_deg`, `height_m`, `range_max`. Keys of a scan: `ranges` (metres, and the
//! other readings of [`super::lines`]), and optionally `valid` (a digit for each beam, 1 for a reading), `t` (seconds;
//! default: the index of the scan), `times` and `twist` as in [`super::lines`], `odometry_increment` [x, y, yaw] and
//! the robot's pose {x, y, yaw} under `robot_pose`, `reference_pose` or `pose_in_model`. Other keys are ignored.

use super::readings::{Reading, with_quoted_words};
use super::{Faults, Log, LogFrame, check_time};
use crate::text::check_json_memory;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, RobotPose, Twist};
use presight_model::limits;
use presight_model::sensor::{Angles, Geometry, Noise, RayTimes, SAME_ANGLE, Scanner, Sensor, SensorSpec, StampAt};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A document, read as a whole.
pub struct Document {
    path: PathBuf,
    sensor: Sensor,
    scans: std::iter::Enumerate<std::vec::IntoIter<Result<Scan>>>,
    time: Option<f64>,
    ended: bool,
    faults: Faults,
    /// The last scan read.
    index: usize,
}

#[derive(Deserialize)]
struct File<S> {
    beams: Option<u32>,
    angle_min: Option<f64>,
    angle_max: Option<f64>,
    counter_clockwise: Option<bool>,
    range_min: Option<f64>,
    range_max: Option<f64>,
    range_std: Option<f64>,
    turn_s: Option<f64>,
    stamp: Option<Stamp>,
    sensor_on_robot: Option<Mount>,
    scan: Option<Layout>,
    scans: Vec<S>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Stamp {
    First,
    Middle,
    Last,
}

impl From<Stamp> for StampAt {
    fn from(stamp: Stamp) -> Self {
        match stamp {
            Stamp::First => Self::First,
            Stamp::Middle => Self::Middle,
            Stamp::Last => Self::Last,
        }
    }
}

#[derive(Deserialize)]
struct Layout {
    beams: u32,
    angle_min_deg: f64,
    step_deg: f64,
    height_m: f64,
    range_max: f64,
}

#[derive(Deserialize)]
struct Mount {
    x: f64,
    y: f64,
    z: f64,
    yaw: f64,
}

#[derive(Deserialize)]
struct Planar {
    x: f64,
    y: f64,
    yaw: f64,
}

#[derive(Deserialize)]
struct Scan {
    t: Option<f64>,
    times: Option<Vec<f32>>,
    twist: Option<[f64; 6]>,
    odometry_increment: Option<[f64; 3]>,
    #[serde(alias = "robot_pose", alias = "reference_pose", alias = "pose_in_model")]
    reference: Option<Planar>,
    ranges: Vec<Reading>,
    valid: Option<String>,
}

/// A scan, or the fault that makes it unreadable.
struct MaybeScan(Result<Scan>);

impl<'de> Deserialize<'de> for MaybeScan {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = serde_json::Value::deserialize(deserializer)?;
        let wrong = |e: serde_json::Error| Error::invalid(format!("not a valid scan: {e}"), REMEDY);
        Ok(Self(Scan::deserialize(value).map_err(wrong)))
    }
}

const REMEDY: &str = "give a log: see docs/formats.md";

fn parsed<S: serde::de::DeserializeOwned>(text: &str) -> Result<File<S>> {
    serde_json::from_str(text)
        .map_err(|e| Error::invalid(format!("not a valid log: {e}"), REMEDY).at(format!("line {}", e.line().max(1))))
}

impl Document {
    pub(super) fn parse(path: &Path, text: Vec<u8>, faults: Faults) -> Result<Self> {
        if text.len() as u64 > limits::MAX_LINE_BYTES {
            let what = format!("the document is longer than {} bytes", limits::MAX_LINE_BYTES);
            return Err(Error::invalid(what, "split it, or write it as a log of format 1"));
        }
        let text = String::from_utf8(text).map_err(|_| Error::invalid("it is not UTF-8", "save it as UTF-8 text"))?;
        check_json_memory(&text)?;
        let text = with_quoted_words(&text);
        let name = path.file_stem().map_or_else(|| "scanner".into(), |s| s.to_string_lossy().into_owned());
        // A fault of a scan that ends the log has its line.
        let (sensor, scans): (Sensor, Vec<Result<Scan>>) = match faults {
            Faults::End => {
                let file: File<Scan> = parsed(&text)?;
                (spec(&file, name).and_then(Sensor::new)?, file.scans.into_iter().map(Ok).collect())
            }
            Faults::Pass => {
                let file: File<MaybeScan> = parsed(&text)?;
                (spec(&file, name).and_then(Sensor::new)?, file.scans.into_iter().map(|MaybeScan(scan)| scan).collect())
            }
        };
        let scans = scans.into_iter().enumerate();
        Ok(Self { path: path.to_owned(), sensor, scans, time: None, ended: false, faults, index: 0 })
    }

    fn read(&mut self, index: usize, scan: Result<Scan>) -> Result<LogFrame> {
        let scan = scan?;
        let valid = scan.valid.map_or_else(|| vec![b'1'; scan.ranges.len()], String::into_bytes);
        if valid.len() != scan.ranges.len() || !valid.iter().all(|v| matches!(v, b'0' | b'1')) {
            let remedy = "give a digit 0 or 1 for each beam";
            return Err(Error::invalid(format!("valid does not fit the {} ranges", scan.ranges.len()), remedy));
        }
        let reading = |(range, valid): (&Reading, &u8)| if *valid == b'1' { range.0 } else { f32::NAN };
        let planar = |x, y, yaw| Pose::from_xyz_rpy(DVec3::new(x, y, 0.0), 0.0, 0.0, yaw);
        let frame = LogFrame {
            time: scan.t.unwrap_or(index as f64),
            range: scan.ranges.iter().zip(&valid).map(reading).collect(),
            intensities: None,
            times: scan.times,
            twist: scan.twist.map(Twist::from_array),
            odometry: scan.odometry_increment.map(|[x, y, yaw]| planar(x, y, yaw)),
            reference: scan.reference.map(|p| RobotPose::new(planar(p.x, p.y, p.yaw))),
        };
        frame.check(self.sensor.spec())?;
        if self.faults == Faults::End {
            check_time(self.time, frame.time)?;
        }
        self.time = Some(frame.time);
        Ok(frame)
    }
}

impl Iterator for Document {
    type Item = Result<LogFrame>;

    fn next(&mut self) -> Option<Result<LogFrame>> {
        if self.ended {
            return None;
        }
        let (index, scan) = self.scans.next()?;
        let read = self.read(index, scan).map_err(|e| e.at(format!("scan {index}")).in_file(&self.path));
        self.index = index;
        self.ended = read.is_err() && self.faults == Faults::End;
        Some(read)
    }
}

impl Log for Document {
    fn place(&self) -> Option<String> {
        Some(format!("scan {}", self.index))
    }

    fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    fn has_planar_poses(&self) -> bool {
        true
    }
}

fn spec<S>(file: &File<S>, name: String) -> Result<SensorSpec> {
    let missing = |key: &str| {
        Error::invalid(format!("{key} is missing"), "docs/formats.md lists the keys of a document of scans")
    };
    let (azimuth, range_max, mount) = match &file.scan {
        Some(scan) => {
            let azimuth = Angles::Uniform { start_deg: scan.angle_min_deg, step_deg: scan.step_deg, count: scan.beams };
            let mount = Pose { translation: DVec3::new(0.0, 0.0, scan.height_m), ..Pose::IDENTITY };
            (azimuth, scan.range_max, mount)
        }
        None => {
            let beams = file.beams.ok_or_else(|| missing("beams"))?;
            let min_angle = file.angle_min.ok_or_else(|| missing("angle_min"))?;
            let max_angle = file.angle_max.ok_or_else(|| missing("angle_max"))?;
            // A turn as drivers round it, such as 6.28318977.
            let step = (max_angle - min_angle).abs() / f64::from(beams.saturating_sub(1).max(1));
            if min_angle.abs().max(max_angle.abs()) > std::f64::consts::TAU + SAME_ANGLE * step {
                let what = format!("angle_min {min_angle} and angle_max {max_angle} are more than a turn");
                return Err(Error::invalid(what, "give radians from -6.2831853 to 6.2831853 (90 degrees are 1.5708)"));
            }
            let on_robot = file.sensor_on_robot.as_ref().ok_or_else(|| missing("sensor_on_robot"))?;
            let place = DVec3::new(on_robot.x, on_robot.y, on_robot.z);
            let range_max = file.range_max.ok_or_else(|| missing("range_max"))?;
            let azimuth = azimuths(min_angle, max_angle, beams, file.counter_clockwise.unwrap_or(true));
            (azimuth, range_max, Pose::from_xyz_rpy(place, 0.0, 0.0, on_robot.yaw))
        }
    };
    let elevation = Angles::Uniform { start_deg: 0.0, step_deg: 0.0, count: 1 };
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    let noise = Noise { range_sigma: file.range_std.unwrap_or(0.0), ..Noise::default() };
    let spec = SensorSpec::new(name, "laser", Geometry::Scanner(scanner));
    let stamp = file.stamp.map_or(StampAt::default(), StampAt::from);
    let spec = spec.with_times(RayTimes::turning(file.turn_s.unwrap_or(0.0), stamp));
    Ok(spec.with_limits(file.range_min.unwrap_or(0.0), range_max).with_mount(mount).with_noise(noise))
}

/// Angles of the beams: rising if counter-clockwise, otherwise falling.
pub(super) fn azimuths(min_angle: f64, max_angle: f64, beams: u32, counter_clockwise: bool) -> Angles {
    let (min_angle, max_angle) = (round_degrees(min_angle), round_degrees(max_angle));
    let step = (max_angle - min_angle) / f64::from(beams.saturating_sub(1).max(1));
    let (start_deg, step_deg) = if counter_clockwise { (min_angle, step) } else { (max_angle, -step) };
    Angles::Uniform { start_deg, step_deg, count: beams }
}

/// Converts an angle from radians to degrees. Drivers store angles as f32: the nearest f32 to a round number of degrees
/// becomes that number.
pub(super) fn round_degrees(radians: f64) -> f64 {
    let degrees = radians.to_degrees();
    let round = (degrees * 1e4).round() / 1e4;
    if round.to_radians() as f32 == radians as f32 { round } else { degrees }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(angle_max: &str) -> String {
        format!(
            r#"{{"beams":3,"angle_min":-1.5,"angle_max":{angle_max},"range_max":8,
            "sensor_on_robot":{{"x":0,"y":0,"z":1,"yaw":0}},"scans":[{{"ranges":[2.5,null,3.5],"valid":"110"}}]}}"#
        )
    }

    fn parse(angle_max: &str) -> Result<Document> {
        Document::parse(Path::new("scans.json"), text(angle_max).into_bytes(), Faults::End)
    }

    /// Both null and a range marked as not valid mean no reading.
    #[test]
    fn a_missing_range_is_no_reading() {
        let frame = parse("1.5").unwrap().next().unwrap().unwrap();
        assert!(frame.range[0] == 2.5 && frame.range[1].is_nan() && frame.range[2].is_nan());
    }

    /// ROS's messages have the key `range_min`, and drivers report readings below it.
    #[test]
    fn range_min_is_a_limit() {
        let text = text("1.5").replace("\"range_max\"", "\"range_min\":2.6,\"range_max\"");
        let document = Document::parse(Path::new("scans.json"), text.into_bytes(), Faults::End).unwrap();
        assert_eq!((document.sensor.spec().range_min, document.sensor.spec().range_max), (2.6, 8.0));
    }

    /// Some programs leave out the key `valid`.
    #[test]
    fn without_marks_every_range_is_a_reading() {
        let text = text("1.5").replace(r#","valid":"110""#, "");
        let frame =
            Document::parse(Path::new("scans.json"), text.into_bytes(), Faults::End).unwrap().next().unwrap().unwrap();
        assert!(frame.range[0] == 2.5 && frame.range[1].is_nan() && frame.range[2] == 3.5);
    }

    #[test]
    fn degrees_are_told_from_radians() {
        let wrong = parse("90").err().unwrap().to_string();
        assert!(wrong.contains("angle_max 90") && wrong.contains("give radians"), "{wrong}");
    }
}
