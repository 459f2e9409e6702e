//! Point clouds of scans: PLY, PCD and CSV.
//!
//! Coordinates are metres in the axes of the sensor: x forward, y left, z up, the sensor at the origin. Other fields are not read.
//!
//! - **PLY** of format 1.0: text or binary, the element `vertex` first. A file of ours in the world says where the sensor was, and its
//!   points are moved back.
//! - **PCD** 0.7 and before: `ascii` or `binary`. `VIEWPOINT` is the sensor's pose in the world. A cloud of several rows is organized:
//!   a point for each pixel, NaN where nothing was measured.
//! - **CSV**: a point a line, `x,y,z` first, or columns named by the first line; `#` begins a comment.

mod csv;
mod pcd;
mod ply;
mod records;
#[cfg(test)]
mod tests;

use super::file;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::limits;
use std::path::Path;

/// The points of one scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Cloud {
    /// Metres, sensor's body axes, in the order of the file; NaN where an organized cloud has no measurement.
    pub points: Vec<DVec3>,
    /// Columns and rows of an organized cloud.
    pub size: Option<(u32, u32)>,
    /// Where the sensor was, if the file says so.
    pub world_from_sensor: Option<Pose>,
}

/// Reads a cloud; its name's ending says which format it has.
///
/// # Examples
/// ```
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("corner.csv");
/// std::fs::write(&path, "x,y,z,intensity\n3,0,0.5,12\n0,2,0.5,9\n")?;
/// let cloud = presight::io::cloud::read(&path)?;
/// assert_eq!(cloud.points, [glam::DVec3::new(3.0, 0.0, 0.5), glam::DVec3::new(0.0, 2.0, 0.5)]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`crate::ErrorKind::Invalid`] or [`crate::ErrorKind::Unsupported`] naming what is wrong with the file;
/// [`crate::ErrorKind::System`] if the system refuses.
pub fn read(path: &Path) -> Result<Cloud> {
    let bytes = file::read(file::open(path)?, path, limits::MAX_FILE_BYTES)?;
    let cloud = match ending(path).as_str() {
        "ply" => ply::parse(&bytes),
        "pcd" => pcd::parse(&bytes),
        "csv" => csv::parse(&bytes),
        _ => Err(Error::invalid("its name ends in none of .ply, .pcd and .csv", "name the file by its format")),
    };
    cloud.and_then(checked).map_err(|e| e.in_file(path))
}

/// What follows the last dot of a name, in small letters.
pub(crate) fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// A number that is none is no measurement, in each of a point's coordinates; infinite ones and huge ones are refused.
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

/// The lines of a header, and what follows it. The last line of a header starts with `end`.
fn header<'a>(bytes: &'a [u8], end: &str) -> Result<(Vec<&'a str>, &'a [u8])> {
    const LONGEST: usize = 1 << 16;
    let mut lines = Vec::new();
    let mut at = 0;
    while at < bytes.len().min(LONGEST) {
        let length = bytes[at..].iter().position(|b| *b == b'\n').map_or(bytes.len() - at, |n| n + 1);
        let line = std::str::from_utf8(&bytes[at..at + length]);
        let wrong =
            |_| Error::invalid("its header is no text", "give a whole file").at(format!("line {}", lines.len() + 1));
        let line = line.map_err(wrong)?.trim();
        at += length;
        lines.push(line);
        if line.split_whitespace().next() == Some(end) {
            return Ok((lines, &bytes[at..]));
        }
    }
    Err(Error::invalid(format!("its header has no {end}"), "give a whole file"))
}

/// A whole number of a header.
fn whole(word: &str, what: &str) -> Result<usize> {
    word.parse().map_err(|_| {
        Error::invalid(format!("{what} is {}", presight_model::printable::quoted(word)), "give a whole number")
    })
}
