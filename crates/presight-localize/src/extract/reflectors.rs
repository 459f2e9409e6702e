//! Retro-reflectors in scans: echoes far brighter than from any wall.

use super::region::PixelBox;
use crate::matching::{Detection, Shape, UncertainValue};
use glam::{DMat2, DVec2};
use presight_model::error::{Error, Result};
use presight_model::measured::{Frame, GreyImage, RangeNoise};
use presight_model::sensor::Sensor;
use presight_model::statistics::median;
use std::collections::BTreeMap;

presight_model::options! {
    /// Thresholds of the reflector detector.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct ReflectorOptions {
        /// Minimum intensity; diffuse surfaces stay far below it.
        least: f64 = 0.8, with_least;
        /// Maximum extent, metres: wider spots are walls or a blinded receiver.
        widest: f64 = 0.4, with_widest;
    }
}

/// A detected reflector.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundReflector {
    /// Position in the image, with covariance. In a scan of one row, the row is unknown.
    pub detection: Detection,
    /// Metres along the ray.
    pub range: UncertainValue,
}

/// Variance of an unknown position, pixels squared: a standard deviation of 1,000 pixels excludes no row.
const UNKNOWN: f64 = 1e6;
/// Maximum range difference within one reflector, metres.
const DEPTH: f64 = 0.2;

/// The reflectors in a box of a scan, in pixel order. `intensity` has the pixels of the scan, 1 for the brightest. A
/// reflector partly inside the box is found as a whole, also over the seam of a full turn, and its whole width counts.
/// A pixel without a reading does not divide it.
///
/// # Examples
/// Two beams of a scanner meet a reflector 3 m away.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if the intensities have another size than the scan.
pub fn reflectors_in(
    frame: &Frame,
    intensity: &GreyImage,
    region: PixelBox,
    options: &ReflectorOptions,
) -> Result<Vec<FoundReflector>> {
    let sensor = frame.sensor();
    let (width, height) = (sensor.width(), sensor.height());
    if (intensity.width(), intensity.height()) != (width, height) {
        let what = format!(
            "intensities of {} x {} pixels for a scan of {width} x {height}",
            intensity.width(),
            intensity.height()
        );
        return Err(Error::invalid(what, "give one intensity per pixel of the scan"));
    }
    let scan = BrightScan::new(frame, intensity, options);
    let Some([x0, y0, x1, y1]) = scan.pixels(&region) else { return Ok(Vec::new()) };
    let mut seen = BTreeMap::new();
    let mut found = Vec::new();
    for at in (y0..=y1).flat_map(|r| (x0..=x1).map(move |c| (c, r))) {
        let at = scan.wrapped(at);
        if scan.range(at).is_some() && !seen.contains_key(&at) {
            found.extend(scan.spot(at, &mut seen).and_then(|spot| scan.reflector(&spot)));
        }
    }
    Ok(found)
}

/// Column and row. Over the seam, columns continue beyond the width.
type Pixel = (i64, i64);

struct BrightScan<'a> {
    frame: &'a Frame,
    intensity: &'a GreyImage,
    options: &'a ReflectorOptions,
    /// Columns and rows, without a column that repeats the first at the seam.
    size: Pixel,
    /// Columns of the image.
    width: i64,
    /// True if the last column is next to the first.
    is_round: bool,
}

/// Connected bright pixels with their columns and ranges, and the first and last column and row.
struct BrightSpot {
    ranges: Vec<(i64, f64)>,
    columns: (i64, i64),
    rows: (i64, i64),
}

impl<'a> BrightScan<'a> {
    fn new(frame: &'a Frame, intensity: &'a GreyImage, options: &'a ReflectorOptions) -> Self {
        let sensor = frame.sensor();
        let (size, width) =
            ((i64::from(sensor.distinct_columns()), i64::from(sensor.height())), i64::from(sensor.width()));
        let is_round = sensor.columns_of_a_turn().is_some_and(|turn| (turn - size.0 as f64).abs() < 1e-6);
        Self { frame, intensity, options, size, width, is_round }
    }

    /// First and last column and row of a region. A full turn may exceed the width; a single row is always included.
    fn pixels(&self, region: &PixelBox) -> Option<[i64; 4]> {
        let [x0, y0, x1, y1] = region.0;
        let of_row = if self.size.1 == 1 { [-0.5, 0.5] } else { [y0, y1] };
        let (width, height) = (self.size.0 as u32, self.size.1 as u32);
        let rows = PixelBox([0.0, of_row[0], 0.0, of_row[1]]).pixels(width, height)?;
        let [first, last] = match self.is_round && x0.is_finite() && x1.is_finite() {
            // At most one turn, so that no column occurs twice.
            true => [x0.ceil() as i64, x1.floor().min(x0.ceil() + self.size.0 as f64 - 1.0) as i64],
            false => PixelBox([x0, 0.0, x1, 0.0]).pixels(width, 1).map(|p| [p[0], p[2]])?,
        };
        (first <= last).then_some([first, rows[1], last, rows[3]])
    }

    fn wrapped(&self, (c, r): Pixel) -> Pixel {
        (if self.is_round { c.rem_euclid(self.size.0) } else { c }, r)
    }

    /// The range measured at a pixel; `None` outside of the scan.
    fn reading(&self, at: Pixel) -> Option<f64> {
        let (c, r) = self.wrapped(at);
        let inside = (0..self.size.0).contains(&c) && (0..self.size.1).contains(&r);
        inside.then(|| f64::from(self.frame.ranges()[(r * self.width + c) as usize]))
    }

    /// The range of a bright pixel.
    fn range(&self, at: Pixel) -> Option<f64> {
        let range = self.reading(at)?;
        let (c, r) = self.wrapped(at);
        let bright = f64::from(self.intensity.pixel(c as u32, r as u32)) >= self.options.least;
        (bright && range.is_finite() && range > 0.0).then_some(range)
    }

    /// The next pixel in a direction, skipping one without a reading.
    fn next(&self, (c, r): Pixel, (dc, dr): Pixel) -> Pixel {
        let next = (c + dc, r + dr);
        if self.reading(next).is_some_and(f64::is_nan) { (c + 2 * dc, r + 2 * dr) } else { next }
    }

    /// The bright pixels connected to a first one at similar ranges; `None` if they are too wide. `seen` maps visited
    /// pixels to true if they belong to a spot that is too wide; such a spot contains no reflector.
    fn spot(&self, first: Pixel, seen: &mut BTreeMap<Pixel, bool>) -> Option<BrightSpot> {
        let mut spot = BrightSpot { ranges: Vec::new(), columns: (first.0, first.0), rows: (first.1, first.1) };
        let (mut open, mut own, mut wide) = (vec![first], vec![first], false);
        seen.insert(first, false);
        while let Some(at) = open.pop() {
            let Some(range) = self.range(at) else { continue };
            spot.take(at, range);
            wide |= self.extent(&spot).is_none_or(|metres| metres > self.options.widest);
            if wide {
                break;
            }
            for direction in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                let near = self.next(at, direction);
                if !self.range(near).is_some_and(|other| (other - range).abs() <= DEPTH) {
                    continue;
                }
                let known = self.wrapped(near);
                match seen.get(&known) {
                    Some(is_wide) => wide |= *is_wide,
                    None => {
                        seen.insert(known, false);
                        own.push(known);
                        open.push(near);
                    }
                }
            }
        }
        if wide {
            seen.extend(own.into_iter().map(|at| (at, true)));
        }
        (!wide).then_some(spot)
    }

    /// Angle between columns, and angle over all rows, radians.
    fn angles(&self, spot: &BrightSpot) -> Option<(f64, f64)> {
        let sensor = self.frame.sensor();
        let (x, _) = self.wrapped((spot.columns.0, 0));
        let (x, y) = (x as f64, spot.rows.0 as f64);
        // Uses the pitch, because the ends of a full turn coincide.
        let pitch = sensor.ray_at(x - 0.5, y)?.angle_between(sensor.ray_at(x + 0.5, y)?);
        let rows = || Some(sensor.ray_at(x, y)?.angle_between(sensor.ray_at(x, spot.rows.1 as f64)?));
        let down = if spot.rows.1 > spot.rows.0 { rows()? } else { 0.0 };
        Some((pitch, down))
    }

    /// The larger of width and height, metres.
    fn extent(&self, spot: &BrightSpot) -> Option<f64> {
        let (pitch, down) = self.angles(spot)?;
        let across = pitch * (spot.columns.1 - spot.columns.0 + 1) as f64;
        Some(across.max(down) * spot.ranges.first()?.1)
    }

    /// True if the reflector may continue beyond its end: there is no reading, or a mixed one of two surfaces.
    fn is_open(&self, end: Pixel, direction: Pixel, range: f64) -> bool {
        let at = |k: i64| self.reading((end.0 + k * direction.0, end.1 + k * direction.1));
        let Some(next) = at(1) else { return false };
        let beyond = at(2).unwrap_or(f64::NAN);
        let between = (next - range).abs() > DEPTH && (beyond - next).abs() > DEPTH;
        next.is_nan() || (between && (beyond - next).signum() == (next - range).signum())
    }

    /// True if bright pixels continue on both sides for more than a reflector's width, at any range. On a wall that
    /// blinds the receiver at a flat angle, ranges of neighbouring beams differ a lot.
    fn is_part_of_a_wall(&self, spot: &BrightSpot, pitch: f64, range: f64) -> bool {
        let most = (self.options.widest / (pitch * range)).ceil().min(1e6) as i64;
        let beside = |from: i64, by: i64| {
            (1..=most).take_while(|k| self.range((from + by * k, spot.rows.0)).is_some()).count() as i64
        };
        beside(spot.columns.0, -1) + beside(spot.columns.1, 1) + spot.columns.1 - spot.columns.0 + 1 > most
    }

    fn reflector(&self, spot: &BrightSpot) -> Option<FoundReflector> {
        let sensor = self.frame.sensor();
        let (range, count) = (spot.median()?, spot.ranges.len() as f64);
        let noise = RangeNoise::of(sensor);
        let (pitch, _) = self.angles(spot)?;
        if self.is_part_of_a_wall(spot, pitch, range) {
            return None;
        }
        let jitter = 0.5 * (noise.angle / pitch).powi(2);
        let (x, of_column) = middle(spot.columns, |c, by| self.is_open((c, spot.rows.0), (by, 0), range));
        let (y, of_row) = middle(spot.rows, |r, by| self.is_open((spot.columns.0, r), (0, by), range));
        let of_row = if sensor.height() == 1 { UNKNOWN } else { of_row + jitter };
        // On a flat reflector seen obliquely, the nearer half covers more columns, which shifts the middle.
        let (slope, of_slope) = spot.slope();
        let (sigma, half) = (noise.range_sigma(range), 0.5 * (spot.columns.1 - spot.columns.0 + 1) as f64);
        let lever = half * half / range;
        let aside = lever * slope;
        let of_column = of_column + jitter + (lever * sigma).powi(2) * of_slope;
        let mut detection = Detection::new(Shape::Reflector(DVec2::new(x + aside, y)), 1.0);
        detection.covariance = DMat2::from_diagonal(DVec2::new(of_column, of_row));
        detection.properties.strength = Some(1.0);
        // A median has a larger variance than a mean: pi / 2 times for many values.
        let of_median = if count > 2.0 { std::f64::consts::FRAC_PI_2 } else { 1.0 };
        // A shift of the middle also changes its range.
        let variance = of_median * sigma * sigma / count + slope * slope * of_column;
        let range = UncertainValue { mean: range + slope * aside, variance };
        detection.properties.range = Some(range);
        Some(FoundReflector { detection, range })
    }
}

impl BrightSpot {
    fn take(&mut self, (c, r): Pixel, range: f64) {
        self.ranges.push((c, range));
        self.columns = (self.columns.0.min(c), self.columns.1.max(c));
        self.rows = (self.rows.0.min(r), self.rows.1.max(r));
    }

    /// Change of range per column, metres, and its variance in units of a range's variance.
    fn slope(&self) -> (f64, f64) {
        let count = self.ranges.len() as f64;
        let (c, r) = self.ranges.iter().fold((0.0, 0.0), |(c, r), of| (c + of.0 as f64, r + of.1));
        let (c, r) = (c / count, r / count);
        let (cc, cr) = self.ranges.iter().fold((0.0, 0.0), |(cc, cr), of| {
            let off = of.0 as f64 - c;
            (cc + off * off, cr + off * (of.1 - r))
        });
        if cc > 0.0 { (cr / cc, 1.0 / cc) } else { (0.0, 0.0) }
    }

    fn median(&self) -> Option<f64> {
        median(&mut self.ranges.iter().map(|(_, range)| *range).collect::<Vec<f64>>())
    }
}

/// Middle of the pixels from first to last, and its variance. Each end is uniform within its pixel (variance 1/12), or
/// within two pixels if the next one is open.
fn middle((first, last): (i64, i64), is_open: impl Fn(i64, i64) -> bool) -> (f64, f64) {
    let end = |at: i64, by: i64| {
        if is_open(at, by) { (at as f64 + 0.5 * by as f64, 4.0 / 12.0) } else { (at as f64, 1.0 / 12.0) }
    };
    let (a, b) = (end(first, -1), end(last, 1));
    (0.5 * (a.0 + b.0), 0.25 * (a.1 + b.1))
}

/// The predicted range of a reflector at `p` (image frame). A reflector extends upright from its point to the row of a
/// single-row scan, so there it is the range where the row meets the vertical through `p`.
pub fn range_to(sensor: &Sensor, p: glam::DVec3) -> f64 {
    match &sensor.spec().geometry {
        presight_model::Geometry::Scanner(scanner) if sensor.height() == 1 => {
            p.truncate().length() / scanner.rows_deg()[0].to_radians().cos().max(1e-6)
        }
        _ => p.length(),
    }
}
