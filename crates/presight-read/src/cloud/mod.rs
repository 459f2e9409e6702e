//! Point clouds of scans: PLY, PCD and CSV.
//!
//! Coordinates are metres in the body frame of the sensor: x forward, y left, z up. In PLY and PCD a field `t`, `time`,
//! `timestamp` or `offset_time` holds the times of the points ([`PointTimes`]). Other fields are ignored.
//!
//! - **PLY** 1.0: text or binary, with `vertex` as the first element. A file of presight with points in the world also
//!   holds the sensor's pose, and the points are transformed back.
//! - **PCD** up to 0.7: `ascii` or `binary`. `VIEWPOINT` is the sensor's pose in the world. A cloud of several rows is
//!   organized: one point per pixel, NaN for a pixel without a measurement.
//! - **CSV**: one point per line, with `x,y,z` first or columns named by the first line; `#` starts a comment.

mod csv;
mod pcd;
mod ply;
mod records;
#[cfg(test)]
mod tests;
mod times;

pub use times::PointTimes;
#[cfg(feature = "ros")]
pub(crate) use times::field_of as time_field;
pub(crate) use times::{RaySeconds, ScanStamp};

use super::file;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::SensorPose;
use presight_model::limits;
use std::path::Path;

/// The comment in presight's PLY and PCD files whose points are in the world.
pub const POINTS_IN_WORLD: &str = "world: z up; metres";

/// The points of one scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// Metres, sensor's body axes, in the order of the file; NaN where an organized cloud has no measurement.
    pub points: Vec<DVec3>,
    /// Columns and rows of an organized cloud.
    pub size: Option<(u32, u32)>,
    /// The times of the points, if the file has them.
    pub times: Option<PointTimes>,
    /// The sensor's pose, if the file gives it.
    pub pose: Option<SensorPose>,
}

/// Reads a cloud in the format of its file extension.
///
/// # Examples
/// ```
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("corner.csv");
/// std::fs::write(&path, "x,y,z,intensity\n3,0,0.5,12\n0,2,0.5,9\n")?;
/// let cloud = presight::files::read_cloud(&path)?;
/// assert_eq!(cloud.points, [glam::DVec3::new(3.0, 0.0, 0.5), glam::DVec3::new(0.0, 2.0, 0.5)]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] or [`presight_model::ErrorKind::Unsupported`] naming the fault of the file;
/// [`presight_model::ErrorKind::System`] if the system refuses.
pub fn read(path: &Path) -> Result<Cloud> {
    let bytes = file::read(file::open(path)?, path, limits::MAX_FILE_BYTES)?;
    let cloud = match ending(path).as_str() {
        "ply" => ply::parse(&bytes),
        "pcd" => pcd::parse(&bytes),
        "csv" => csv::parse(&bytes),
        _ => Err(Error::invalid("its extension is neither .ply, .pcd nor .csv", "name the file by its format")),
    };
    cloud.and_then(checked).map_err(|e| e.in_file(path))
}

/// The extension of a file name, in lower case.
pub(crate) fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// Makes a point with any NaN coordinate a missing measurement; refuses infinite and huge coordinates.
fn checked(mut cloud: Cloud) -> Result<Cloud> {
    for (i, point) in cloud.points.iter_mut().enumerate() {
        if point.is_nan() {
            *point = DVec3::NAN;
        } else if !(point.abs().max_element() <= limits::MAX_COORDINATE) {
            let remedy = "give metres; nan, nan, nan for no measurement";
            return Err(Error::invalid(format!("point {i} is at {point}"), remedy));
        }
    }
    if !cloud.points.iter().any(|p| !p.is_nan() && *p != DVec3::ZERO) {
        return Err(Error::invalid("it has no point", "give a scan that measured something"));
    }
    Ok(cloud)
}

/// Splits a file into the lines of its header and the data. The last line of the header starts with `end`.
fn header<'a>(bytes: &'a [u8], end: &str) -> Result<(Vec<&'a str>, &'a [u8])> {
    const LONGEST: usize = 1 << 16;
    let mut lines = Vec::new();
    let mut at = 0;
    while at < bytes.len().min(LONGEST) {
        let length = bytes[at..].iter().position(|b| *b == b'\n').map_or(bytes.len() - at, |n| n + 1);
        let line = std::str::from_utf8(&bytes[at..at + length]);
        let wrong =
            |_| Error::invalid("its header is not text", "give a whole file").at(format!("line {}", lines.len() + 1));
        let line = line.map_err(wrong)?.trim();
        at += length;
        lines.push(line);
        if line.split_whitespace().next() == Some(end) {
            return Ok((lines, &bytes[at..]));
        }
    }
    Err(Error::invalid(format!("its header has no {end}"), "give a whole file"))
}

/// Parses a whole number of a header.
fn whole(word: &str, what: &str) -> Result<usize> {
    word.parse().map_err(|_| {
        Error::invalid(format!("{what} is {}", presight_model::printable::quoted(word)), "give a whole number")
    })
}
