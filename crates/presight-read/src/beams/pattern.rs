//! Patterns of rays as CSV: a line for each ray with `azimuth_deg`, `elevation_deg` and `time_s`, and optionally its
//! origin `x`, `y`, `z` in metres. The first line names the columns, in any order. Azimuths are counter-clockwise about
//! z from x, all in body axes; a line that starts with `#` is a comment. The pattern repeats itself, and a frame takes
//! the rays of its own time.

use crate::file;
use crate::text::read_line;
use glam::DVec3;
use presight_model::error::{Error, Result};
use presight_model::limits::MAX_LISTED_RAYS;
use presight_model::printable::quoted;
use presight_model::sensor::{Geometry, RayTable, RayTimes, SensorSpec};
use std::f64::consts::{FRAC_PI_2, TAU};
use std::io::{BufRead, BufReader};
use std::path::Path;

/// The rays of a pattern in the order of the file.
#[derive(Clone, Debug, PartialEq)]
pub struct RayPattern {
    rays: Vec<PatternRay>,
    has_origins: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct PatternRay {
    direction: DVec3,
    origin: DVec3,
    seconds: f64,
}

const COLUMNS: [&str; 6] = ["azimuth_deg", "elevation_deg", "time_s", "x", "y", "z"];

/// Reads a pattern line by line.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] with line and column: unknown or missing columns, numbers that are not
/// finite, angles that are not in degrees, over [`MAX_LISTED_RAYS`] rays; [`presight_model::ErrorKind::System`] if the
/// system refuses.
pub fn read(path: &Path) -> Result<RayPattern> {
    let parsed = file::open_or_given(path).and_then(|file| parse(&mut BufReader::new(file)));
    parsed.map_err(|e| e.in_file(path))
}

/// Reads the text of a pattern.
///
/// # Errors
/// As [`read`], without the file.
pub fn parse(reader: &mut impl BufRead) -> Result<RayPattern> {
    let (mut order, mut rays) = (None, Vec::new());
    let mut spans = [Span::EMPTY; 2];
    let mut number = 0;
    loop {
        number += 1;
        let Some(line) = read_line(reader, number)? else { break };
        let line = line.trim();
        if line.is_empty() || line.starts_with('#') {
            continue;
        }
        let Some(order) = &order else {
            order = Some(columns(line).map_err(|e| e.at(format!("line {number}")))?);
            continue;
        };
        let values = values(line, order).map_err(|e| e.at(format!("line {number}")))?;
        rays.push(ray(values));
        spans = [spans[0].with(values[0]), spans[1].with(values[1])];
        if rays.len() > MAX_LISTED_RAYS as usize {
            let remedy = format!("give at most {MAX_LISTED_RAYS} rays, the period of the pattern");
            return Err(Error::invalid("too many rays", remedy).at(format!("line {number}")));
        }
    }
    let Some(order) = order.filter(|_| !rays.is_empty()) else {
        return Err(Error::invalid(
            "the pattern has no rays",
            "give azimuth_deg,elevation_deg,time_s and a line for each ray",
        ));
    };
    check_degrees(spans)?;
    Ok(RayPattern { rays, has_origins: order[3].is_some() })
}

/// Least and greatest of some numbers.
#[derive(Clone, Copy)]
struct Span(f64, f64);

impl Span {
    const EMPTY: Self = Self(f64::INFINITY, f64::NEG_INFINITY);

    fn with(self, x: f64) -> Self {
        Self(self.0.min(x), self.1.max(x))
    }
}

/// Refuses a full turn in radians. A pattern in degrees would be taken for one if its azimuths reached over 6.2 to 6.29
/// degrees and its elevations were within 1.57: no lidar is made so.
fn check_degrees([azimuth, elevation]: [Span; 2]) -> Result<()> {
    let turns = (6.2..TAU + 0.01).contains(&(azimuth.1 - azimuth.0));
    if turns && elevation.0 >= -FRAC_PI_2 && elevation.1 <= FRAC_PI_2 {
        let what = format!("azimuths from {} to {}", azimuth.0, azimuth.1);
        return Err(Error::invalid(what, "give degrees, not radians").at(COLUMNS[0]));
    }
    Ok(())
}

/// Where each of [`COLUMNS`] stands in a line.
type Order = [Option<usize>; 6];

fn columns(line: &str) -> Result<Order> {
    let remedy = "name azimuth_deg,elevation_deg,time_s in the first line, and x,y,z for origins";
    let mut order: Order = [None; 6];
    for (i, word) in line.split(',').map(str::trim).enumerate() {
        let Some(column) = COLUMNS.iter().position(|name| *name == word) else {
            return Err(Error::invalid(format!("{} is not a column of a pattern", quoted(word)), remedy));
        };
        if order[column].replace(i).is_some() {
            return Err(Error::invalid(format!("{word} is named twice"), remedy));
        }
    }
    let origins = order[3..].iter().flatten().count();
    match (0..6).find(|c| order[*c].is_none() && (*c < 3 || origins > 0)) {
        Some(missing) => Err(Error::invalid(format!("{} is missing", COLUMNS[missing]), remedy)),
        None => Ok(order),
    }
}

/// The values of [`COLUMNS`] in a line; 0 for an origin that is not given.
fn values(line: &str, order: &Order) -> Result<[f64; 6]> {
    let count = order.iter().flatten().count();
    let mut words = [""; 6];
    let mut found = 0;
    for word in line.split(',') {
        if found < count {
            words[found] = word.trim();
        }
        found += 1;
    }
    if found != count {
        let what = format!("{found} values for {count} columns");
        return Err(Error::invalid(what, "give one value for each column"));
    }
    let mut values = [0.0; 6];
    for ((value, place), name) in values.iter_mut().zip(order).zip(COLUMNS) {
        let Some(place) = place else { continue };
        let word = words[*place];
        *value = word.parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| {
            Error::invalid(format!("{} is not a finite number", quoted(word)), "give a number").at(name)
        })?;
    }
    for (angle, most, name) in [(values[0], 720.0, COLUMNS[0]), (values[1], 90.0, COLUMNS[1])] {
        if angle.abs() > most {
            let remedy = "give degrees, not thousandths of a degree";
            return Err(Error::invalid(format!("{angle} deg is beyond +-{most}"), remedy).at(name));
        }
    }
    Ok(values)
}

fn ray([azimuth, elevation, seconds, x, y, z]: [f64; 6]) -> PatternRay {
    let ((sin, cos), (sin_up, cos_up)) = (azimuth.to_radians().sin_cos(), elevation.to_radians().sin_cos());
    let direction = DVec3::new(cos_up * cos, cos_up * sin, sin_up);
    PatternRay { direction, origin: DVec3::new(x, y, z), seconds }
}

impl RayPattern {
    /// Seconds from the first ray to its next repetition: one mean step more than to the last ray.
    pub fn period(&self) -> f64 {
        let Span(first, last) = self.span();
        let count = self.rays.len() as f64;
        (last - first) * count / (count - 1.0).max(1.0)
    }

    fn span(&self) -> Span {
        self.rays.iter().fold(Span::EMPTY, |span, ray| span.with(ray.seconds))
    }

    /// The sensor of a frame: the rays from `stamp` on, which may be any time, for `seconds`, or all rays. They are a
    /// list in the order of the file, and their times count from the stamp.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for a duration of 0 or over the pattern's own, and if no ray is in it;
    /// [`presight_model::ErrorKind::Invalid`] for origins that are not in metres.
    pub fn sensor(&self, name: &str, stamp: f64, seconds: Option<f64>) -> Result<SensorSpec> {
        let (first, period) = (self.span().0, self.period());
        let duration = seconds.unwrap_or(period);
        if !stamp.is_finite() || !(duration <= period) || duration < 0.0 {
            let remedy = format!("give a finite start and at most the {period} s of the pattern");
            return Err(Error::usage(format!("{duration} s from {stamp} s of a pattern"), remedy));
        }
        let phase = if period > 0.0 { stamp.rem_euclid(period) } else { 0.0 };
        let late = |ray: &PatternRay| {
            let late = ray.seconds - first - phase;
            if late < 0.0 { late + period } else { late }
        };
        let is_in = |ray: &PatternRay| seconds.is_none() || late(ray) < duration;
        let has_begun = |ray: &PatternRay| ray.seconds - first >= phase;
        let now = self.rays.iter().filter(|ray| has_begun(ray) && is_in(ray));
        let next = self.rays.iter().filter(|ray| !has_begun(ray) && is_in(ray));
        let rays: Vec<&PatternRay> = now.chain(next).collect();
        if rays.is_empty() {
            let remedy = "give a longer part of the pattern";
            return Err(Error::usage(format!("no ray within {duration} s from {stamp} s of a pattern"), remedy));
        }
        let times: Vec<f32> = rays.iter().map(|ray| late(ray) as f32).collect();
        let mut table = RayTable::new(rays.len() as u32, 1, rays.iter().map(|ray| ray.direction).collect())?;
        if self.has_origins {
            table = table.with_origins(rays.iter().map(|ray| ray.origin).collect())?;
        }
        let times = if period > 0.0 { RayTimes::Listed(times.into()) } else { RayTimes::AtOnce };
        Ok(SensorSpec::new(name, "laser", Geometry::Rays(table)).with_times(times))
    }
}
