//! Converts points to a range image.

use crate::error::Result;
use crate::limits;
use crate::sensor::RayTable;
use crate::statistics::upper_median;
use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Rays and the ranges measured along them, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct RangeGrid {
    /// A ray for each pixel, in the sensor's body axes.
    pub table: RayTable,
    /// Metres; NaN for no reading.
    pub ranges: Vec<f32>,
    /// The point of each pixel, as its index; `None` for a pixel without one.
    pub points: Vec<Option<u32>>,
}

impl RangeGrid {
    /// A number for each pixel: that of its point. A pixel without one has that of the first in its column, or else the
    /// smallest of all; 0 if there is no point.
    pub fn spread(&self, values: &[f32]) -> Vec<f32> {
        let width = self.table.width() as usize;
        let known = |point: &Option<u32>| point.map(|i| values[i as usize]);
        let smallest = self.points.iter().filter_map(known).reduce(f32::min).unwrap_or_default();
        let of_column = |c: usize| self.points[c..].iter().step_by(width).find_map(known).unwrap_or(smallest);
        let columns: Vec<f32> = (0..width).map(of_column).collect();
        self.points.iter().enumerate().map(|(i, point)| known(point).unwrap_or(columns[i % width])).collect()
    }
}

/// Maximum number of comparisons of points to find their spacing.
const COMPARISONS: usize = 20_000_000;
/// Maximum number of pixels per point. If there would be more, the cells are widened.
const MAX_CELLS: f64 = 4.0;

/// Returns the range image of points in the sensor's body axes, metres: an organized cloud's own pixels, row by row, if
/// `size` gives its width and height, otherwise cells of azimuth and elevation.
///
/// # Errors
/// [`crate::ErrorKind::Invalid`] if it has more pixels than the limit of an image.
pub fn range_grid(points: &[DVec3], size: Option<(u32, u32)>) -> Result<RangeGrid> {
    let range = |p: &DVec3| p.length() as f32;
    if let Some((width, height)) = size {
        // A point at the sensor has no direction.
        let ray = |p: &DVec3| if *p == DVec3::ZERO { DVec3::NAN } else { *p };
        let table = RayTable::new(width, height, points.iter().map(ray).collect())?;
        let own = (0..).zip(points).map(|(i, p)| (p.length_squared() > 0.0).then_some(i)).collect();
        return Ok(RangeGrid { table, ranges: points.iter().map(range).collect(), points: own });
    }
    let seen = (0..).zip(points).filter(|(_, p)| p.length_squared() > 0.0);
    let points: Vec<(Direction, DVec3, u32)> = seen.map(|(i, p)| (Direction::of(*p), *p, i)).collect();
    let directions: Vec<Direction> = points.iter().map(|(d, ..)| *d).collect();
    let cells = Cells::of(&directions);
    let centres = (0..cells.rows).flat_map(|r| (0..cells.columns).map(move |c| (c, r)));
    let mut rays: Vec<DVec3> = centres.map(|(c, r)| cells.centre(c, r)).collect();
    let mut nearest = vec![f64::INFINITY; rays.len()];
    let mut ranges = vec![f32::NAN; rays.len()];
    let mut own = vec![None; rays.len()];
    for (direction, point, index) in &points {
        let (at, off) = cells.cell(*direction);
        if off < nearest[at] {
            nearest[at] = off;
            rays[at] = *point;
            ranges[at] = range(point);
            own[at] = Some(*index);
        }
    }
    Ok(RangeGrid { table: RayTable::new(cells.columns as u32, cells.rows as u32, rays)?, ranges, points: own })
}

/// Azimuth, counter-clockwise from x, and elevation, radians.
#[derive(Clone, Copy, Debug)]
struct Direction {
    azimuth: f64,
    elevation: f64,
}

impl Direction {
    fn of(p: DVec3) -> Self {
        Self { azimuth: p.y.atan2(p.x), elevation: p.z.atan2(p.x.hypot(p.y)) }
    }
}

/// Columns by rising azimuth, rows by falling elevation.
#[derive(Debug)]
struct Cells {
    /// Azimuth of the left side, elevation of the upper side.
    first: Direction,
    /// Width and height of a cell.
    pitch: Direction,
    columns: usize,
    rows: usize,
}

impl Cells {
    fn of(directions: &[Direction]) -> Self {
        let (start, width) = opening(directions);
        let elevations = || directions.iter().map(|d| d.elevation);
        let (lowest, highest) = elevations().fold((PI, -PI), |(a, b), e| (a.min(e), b.max(e)));
        let height = highest - lowest;
        let apart = spacing(directions);
        let most = f64::from(limits::MAX_IMAGE_SIDE - 1);
        let pitch = |apart: f64, side: f64| if apart.is_finite() { apart.max(side / most) } else { side + 1e-6 };
        let mut pitch = Direction { azimuth: pitch(apart.azimuth, width), elevation: pitch(apart.elevation, height) };
        let sides = |p: Direction| ((width / p.azimuth).floor() + 1.0, (height / p.elevation).floor() + 1.0);
        // A single row or column needs no widening.
        while sides(pitch).0 * sides(pitch).1 > (MAX_CELLS * directions.len() as f64).max(64.0) {
            let (columns, rows) = sides(pitch);
            pitch.azimuth *= if columns > 1.0 { 1.2 } else { 1.0 };
            pitch.elevation *= if rows > 1.0 { 1.2 } else { 1.0 };
        }
        let (columns, rows) = sides(pitch);
        // Centres the grid on the points.
        let first = Direction {
            azimuth: start - 0.5 * (columns * pitch.azimuth - width),
            elevation: highest + 0.5 * (rows * pitch.elevation - height),
        };
        Self { first, pitch, columns: columns as usize, rows: rows as usize }
    }

    fn centre(&self, column: usize, row: usize) -> DVec3 {
        let azimuth = self.first.azimuth + (column as f64 + 0.5) * self.pitch.azimuth;
        let elevation = self.first.elevation - (row as f64 + 0.5) * self.pitch.elevation;
        // Not exactly at the poles, where all columns would have the same ray.
        let elevation = elevation.clamp(1e-6 - FRAC_PI_2, FRAC_PI_2 - 1e-6);
        let ((sa, ca), (se, ce)) = (azimuth.sin_cos(), elevation.sin_cos());
        DVec3::new(ce * ca, ce * sa, se)
    }

    /// Returns the cell of a direction, and its squared distance from the cell's centre, in cells.
    fn cell(&self, d: Direction) -> (usize, f64) {
        let u = (d.azimuth - self.first.azimuth).rem_euclid(TAU) / self.pitch.azimuth;
        let v = (self.first.elevation - d.elevation) / self.pitch.elevation;
        let (column, row) = ((u as usize).min(self.columns - 1), (v as usize).min(self.rows - 1));
        let (x, y) = (u - column as f64 - 0.5, v - row as f64 - 0.5);
        (row * self.columns + column, x * x + y * y)
    }
}

/// First azimuth, counter-clockwise, and angle covered: the full turn without the widest gap, radians.
fn opening(directions: &[Direction]) -> (f64, f64) {
    let mut azimuths: Vec<f64> = directions.iter().map(|d| d.azimuth).collect();
    azimuths.sort_by(f64::total_cmp);
    let (Some(first), Some(last)) = (azimuths.first(), azimuths.last()) else { return (0.0, 0.0) };
    let across = (first + TAU - last, *first);
    let gaps = azimuths.windows(2).map(|pair| (pair[1] - pair[0], pair[1]));
    let (gap, start) = gaps.chain([across]).fold((0.0, *first), |a, b| if b.0 > a.0 { b } else { a });
    (start, (TAU - gap).max(0.0))
}

/// Angle of a point to its nearest horizontal and vertical neighbours, radians: medians over a sample of points,
/// infinite if there are no neighbours.
fn spacing(directions: &[Direction]) -> Direction {
    // Near the poles, differences of azimuth mean little.
    let level: Vec<&Direction> = directions.iter().filter(|d| d.elevation.abs() < 1.0).collect();
    let some: Vec<&Direction> = if level.len() < 16 { directions.iter().collect() } else { level };
    let count = (COMPARISONS / directions.len().max(1)).clamp(16, 400).min(some.len());
    let (mut beside, mut above) = (Vec::new(), Vec::new());
    for k in 0..count {
        let a = some[k * some.len() / count];
        let flat = a.elevation.cos();
        let (mut b, mut v) = ((f64::INFINITY, 0.0), (f64::INFINITY, 0.0));
        for other in directions {
            let turned = (other.azimuth - a.azimuth + PI).rem_euclid(TAU) - PI;
            let (x, y) = (flat * turned.abs(), (other.elevation - a.elevation).abs());
            let apart = x * x + y * y;
            // Points in the same direction, such as a second echo, are not neighbours.
            if apart < 1e-12 {
                continue;
            }
            if x > y && apart < b.0 {
                b = (apart, turned.abs());
            } else if x <= y && apart < v.0 {
                v = (apart, y);
            }
        }
        beside.extend(b.0.is_finite().then_some(b.1));
        above.extend(v.0.is_finite().then_some(v.1));
    }
    let median = |mut all: Vec<f64>| {
        let known = if 2 * all.len() < count { None } else { upper_median(&mut all, f64::total_cmp) };
        known.unwrap_or(f64::INFINITY)
    };
    Direction { azimuth: median(beside), elevation: median(above) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a rotating scanner, without some of them: columns 2 degrees apart, rows 1 degree.
    fn turning(columns: u32, without: impl Fn(u32, u32) -> bool) -> Vec<DVec3> {
        let all = (0..columns).flat_map(|c| (0..40).map(move |r| (c, r)));
        let point = |(c, r): (u32, u32)| {
            let (azimuth, elevation) =
                (f64::to_radians(2.0 * f64::from(c) + 0.3), f64::to_radians(f64::from(r) - 20.3));
            let ray = DVec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
            (5.0 + 0.01 * f64::from(c) + 0.1 * f64::from(r)) * ray
        };
        all.filter(|(c, r)| !without(*c, *r)).map(point).collect()
    }

    /// Each point gets its own pixel with exactly its ray and range, in any order of the points. Columns run
    /// counter-clockwise, the first row is the highest, and pixels without a point are rays without a reading.
    #[test]
    fn points_of_a_scanner_get_their_pixels_back() {
        for (columns, width) in [(180, 180), (50, 50)] {
            let mut points = turning(columns, |c, r| (c * 7 + r * 3) % 11 == 0);
            // Some other order.
            points.sort_by(|a, b| (a.x * 1e3).fract().total_cmp(&(b.x * 1e3).fract()));
            let grid = range_grid(&points, None).unwrap();
            let numbers: Vec<f32> = (0..points.len()).map(|i| i as f32).collect();
            let spread = grid.spread(&numbers);
            let RangeGrid { table, ranges, points: own } = grid;
            assert!(
                table.width().abs_diff(width) <= 1 && table.height().abs_diff(40) <= 1,
                "{} x {}",
                table.width(),
                table.height()
            );
            let read = ranges.iter().zip(table.directions()).filter(|(r, _)| r.is_finite());
            let seen: Vec<DVec3> = read.map(|(r, d)| f64::from(*r) * *d).collect();
            assert!(seen.len() as f64 > 0.97 * points.len() as f64, "{} of {}", seen.len(), points.len());
            assert!(seen.iter().all(|p| points.iter().any(|q| p.distance(*q) < 1e-6)));
            for (i, point) in own.iter().enumerate() {
                assert_eq!(point.is_some(), ranges[i].is_finite());
                let Some(point) = *point else { continue };
                let seen = f64::from(ranges[i]) * table.directions()[i];
                assert!(seen.distance(points[point as usize]) < 1e-6 && spread[i] == numbers[point as usize]);
            }
            assert!(table.directions().iter().all(|d| !d.is_nan()), "every pixel has a ray");
            let (middle, w) = (table.height() / 2 * table.width(), table.width() as usize);
            let row = &table.directions()[middle as usize..middle as usize + w];
            assert!(row.windows(2).all(|p| p[0].x * p[1].y - p[0].y * p[1].x > 0.0), "counter-clockwise");
            assert!(table.directions()[0].z > table.directions()[w * (table.height() as usize - 1)].z);
        }
    }

    /// A level scan gives one row, a single point one pixel, and scattered points an image of limited size.
    #[test]
    fn odd_clouds_are_images_too() {
        let level: Vec<DVec3> = turning(90, |_, r| r != 0).into_iter().map(|p| DVec3::new(p.x, p.y, 0.0)).collect();
        let grid = range_grid(&level, None).unwrap();
        assert_eq!(grid.table.height(), 1);
        assert!(grid.ranges.iter().filter(|r| r.is_finite()).count() >= 88);
        let one = range_grid(&[DVec3::new(0.0, 3.0, 0.0), DVec3::ZERO], None).unwrap();
        assert_eq!((one.ranges.len(), one.ranges[0]), (1, 3.0));
        let mut random = crate::random::SplitMix64(4);
        let mut any = || DVec3::new(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0));
        // Close pairs, far apart from each other.
        let pairs: Vec<DVec3> = (0..200)
            .flat_map(|_| {
                let p = any();
                [p, p + 1e-5 * any()]
            })
            .collect();
        let grid = range_grid(&pairs, None).unwrap();
        assert!(grid.ranges.len() <= 1700, "{}", grid.ranges.len());
    }

    #[test]
    fn organized_clouds_keep_rows_and_columns() {
        let points = [DVec3::X, DVec3::new(2.0, 1.0, 0.0), DVec3::NAN, DVec3::ZERO];
        let grid = range_grid(&points, Some((2, 2))).unwrap();
        // A pixel without a point has the number of its column, or else the smallest.
        assert_eq!(grid.spread(&[0.3, 0.1, 7.0, 8.0]), [0.3, 0.1, 0.3, 0.1]);
        let RangeGrid { table, ranges, points: own } = grid;
        assert_eq!(own, [Some(0), Some(1), None, None]);
        assert_eq!((table.width(), table.height(), ranges[1]), (2, 2, 5f32.sqrt()));
        assert!(table.directions()[2].is_nan() && table.directions()[3].is_nan() && ranges[2].is_nan());
    }
}
