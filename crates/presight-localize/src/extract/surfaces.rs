//! Flat surfaces in ranges: line segments in scans of one row, planes in range images.
//!
//! A surface is returned as points on it with independent errors. With weights w = 1 / s^2 of the measured points and
//! their spreads a, b along the surface, the variance of a line at distance t from its middle is 1 / sum w + t^2 / (a^2
//! sum w). The points at t = +-a thus have independent errors of variance 2 / sum w each. Three points of a plane on
//! the ellipse sqrt(2) (a, b) have variance 3 / sum w each.

use super::PixelBox;
use glam::{DMat3, DVec3};
use presight_model::geometry::Plane;
use presight_model::matrix::eigen;
use presight_model::measured::{Frame, RangeNoise};

/// Thresholds of the surface detector.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SurfaceOptions {
    /// Fewest measured points.
    pub least_points: usize,
    /// Shortest extent along the surface, metres.
    pub least_extent: f64,
    /// Allowed unevenness of a surface in addition to the sensor's noise, one standard deviation, metres.
    pub flatness: f64,
}

impl Default for SurfaceOptions {
    fn default() -> Self {
        Self { least_points: 8, least_extent: 0.1, flatness: 0.001 }
    }
}

presight_model::with_options!(
    SurfaceOptions:
    with_least_points least_points: usize,
    with_least_extent least_extent: f64,
    with_flatness flatness: f64,
);

/// A detected flat surface, in the image frame of the sensor, metres.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundSurface {
    /// Normal, towards the sensor, and offset. For a line in a scan, the plane perpendicular to the scan.
    pub plane: Plane,
    /// Points on it with independent errors: two for a line, three for a plane.
    pub points: Vec<DVec3>,
    /// Standard deviation of each of these points along the normal, metres.
    pub sigma: f64,
    /// Number of measured points on it.
    pub count: usize,
    /// The pixels of the measured points.
    pub pixels: PixelBox,
    /// Root mean square distance of the measured points, in standard deviations.
    pub scatter: f64,
}

impl FoundSurface {
    /// Squared distance from a plane (image frame): the sum over its points of the squared distance in standard
    /// deviations. `more` is the error of the plane itself at the points, metres. Has one degree of freedom per point.
    pub fn squared_distance(&self, plane: &Plane, more: f64) -> f64 {
        let variance = self.sigma * self.sigma + more * more;
        self.points.iter().map(|p| (plane.normal.dot(*p) - plane.offset).powi(2) / variance).sum()
    }
}

/// Points farther away than this, in standard deviations, belong to another surface.
const FAR: f64 = 4.0;
/// Two neighbours this far away on the same side, in standard deviations, show that a line bends.
const BEND: f64 = 3.0;
/// Readings that may be missing inside one surface of a scan.
const MISSING: i64 = 3;
/// Flattest incidence at which neighbours may belong to one surface, as a tangent.
const STEEPEST: f64 = 12.0;
/// In a region of at most this many blocks, a single block may form a plane.
const FEW: usize = 4;
/// Side of the blocks from which planes are grown, pixels.
const BLOCK: i64 = 6;
/// Largest root mean square distance of a flat block's points from its plane, in standard deviations.
const FLAT: f64 = 1.25;

/// The flat surfaces in a box of a range frame, the largest first. On a full turn, the box may extend over the seam.
///
/// # Examples
/// A wall 2 m ahead of a scanner fills the beams from -60 to 60 degrees.
pub fn surfaces_in(frame: &Frame, region: PixelBox, options: &SurfaceOptions) -> Vec<FoundSurface> {
    let Some(patch) = Patch::of(frame, region, options) else { return Vec::new() };
    let mut found = if frame.sensor().height() == 1 { patch.lines() } else { patch.planes() };
    found.sort_by_key(|s| std::cmp::Reverse(s.count));
    found
}

/// A measured point and its pixel.
#[derive(Clone, Copy)]
struct Reading {
    column: i64,
    row: i64,
    point: DVec3,
}

/// Weighted sums over points, to fit a line or a plane.
#[derive(Clone, Copy, Default)]
struct Moments {
    weight: f64,
    first: DVec3,
    second: DMat3,
    count: usize,
}

impl Moments {
    fn add(&mut self, p: DVec3, w: f64) {
        self.weight += w;
        self.first += w * p;
        self.second += DMat3::from_cols(w * p.x * p, w * p.y * p, w * p.z * p);
        self.count += 1;
    }

    fn merged(mut self, other: &Self) -> Self {
        self.weight += other.weight;
        self.first += other.first;
        self.second += other.second;
        self.count += other.count;
        self
    }

    /// Mean, unit axes and variances along them, the largest first.
    fn axes(&self) -> (DVec3, [DVec3; 3], [f64; 3]) {
        let middle = self.first / self.weight;
        let spread = self.second * (1.0 / self.weight)
            - DMat3::from_cols(middle.x * middle, middle.y * middle, middle.z * middle);
        let mut m = [[0.0; 6]; 6];
        for i in 0..3 {
            for j in 0..3 {
                m[i][j] = spread.col(j)[i];
            }
        }
        let (values, vectors) = eigen(m, 3);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| values[*b].total_cmp(&values[*a]));
        let axis = |k: usize| DVec3::new(vectors[0][k], vectors[1][k], vectors[2][k]).normalize_or_zero();
        (middle, order.map(axis), order.map(|k| values[k].max(0.0)))
    }
}

/// The readings in a box.
struct Patch<'a> {
    readings: Vec<Reading>,
    noise: RangeNoise,
    options: &'a SurfaceOptions,
    is_row: bool,
    /// Angle between neighbouring columns, radians.
    pitch: f64,
}

impl<'a> Patch<'a> {
    fn of(frame: &Frame, region: PixelBox, options: &'a SurfaceOptions) -> Option<Self> {
        let sensor = frame.sensor();
        let (width, height) = (sensor.width(), sensor.height());
        let [x0, y0, x1, y1] = region.0;
        if !region.0.iter().all(|x| x.is_finite() && x.abs() < 1e9) {
            return None;
        }
        // Over the seam of a full turn, column numbers continue beyond the width.
        let (least, most) = (x0.ceil() as i64, x1.floor() as i64);
        let whole = i64::from(width);
        let turns = presight_features::turn(sensor).is_some_and(|turn| (turn - f64::from(width)).abs() < 0.01);
        let (first, last) =
            if turns { (least, most.min(least + whole - 1)) } else { (least.max(0), most.min(whole - 1)) };
        let (top, bottom) = ((y0.ceil() as i64).max(0), (y1.floor() as i64).min(i64::from(height) - 1));
        let (near, far) = (sensor.spec().range_min, sensor.spec().range_max);
        let mut readings = Vec::new();
        for row in top..=bottom {
            for column in first..=last {
                let at = column.rem_euclid(whole);
                let range = f64::from(frame.ranges()[(row * whole + at) as usize]);
                if !(range.is_finite() && range >= near && range <= far) {
                    continue;
                }
                if let Some(ray) = sensor.ray(at as u32, row as u32) {
                    readings.push(Reading { column, row, point: range * ray });
                }
            }
        }
        let middle = (width / 2).min(width.saturating_sub(2));
        let pitch = match (sensor.ray(middle, height / 2), sensor.ray(middle + 1, height / 2)) {
            (Some(a), Some(b)) if width > 1 => a.angle_between(b),
            _ => 0.0,
        };
        Some(Self { readings, noise: RangeNoise::of(sensor), options, is_row: height == 1, pitch })
    }

    /// Variance of a point's distance from a surface with this normal.
    fn variance(&self, p: DVec3, normal: DVec3) -> f64 {
        let range = p.length();
        let cos = (normal.dot(p) / range).abs().max(0.1);
        self.noise.variance_along_normal(range, cos) + self.options.flatness.powi(2) + 1e-12
    }

    /// Moments for perpendicular incidence, before the normal is known.
    fn rough(&self, readings: &[Reading]) -> Moments {
        let mut m = Moments::default();
        readings.iter().for_each(|r| m.add(r.point, self.noise.range_sigma(r.point.length()).powi(-2)));
        m
    }

    /// Mean and normal (towards the sensor) of the surface through points.
    fn normal(&self, m: &Moments) -> (DVec3, DVec3) {
        let (middle, axes, _) = m.axes();
        let normal = if self.is_row { axes[0].cross(DVec3::Z).normalize_or_zero() } else { axes[2] };
        (middle, if normal.dot(middle) > 0.0 { -normal } else { normal })
    }

    /// Largest deviation of readings from their line, in standard deviations. Takes the smaller of two neighbours on
    /// the same side, because a single one may be an outlier.
    fn worst(&self, readings: &[Reading]) -> f64 {
        let (middle, normal) = self.normal(&self.rough(readings));
        let off = |r: &Reading| normal.dot(r.point - middle) / self.variance(r.point, normal).sqrt();
        let both = |pair: &[Reading]| {
            let [a, b] = [off(&pair[0]), off(&pair[1])];
            if a * b > 0.0 { a.abs().min(b.abs()) } else { 0.0 }
        };
        readings.windows(2).map(both).fold(0.0, f64::max)
    }

    /// The surface through readings, weighted by noise and without outliers; `None` if they are too few or too close.
    fn fitted(&self, readings: &[Reading]) -> Option<FoundSurface> {
        if readings.len() < self.options.least_points.max(3) {
            return None;
        }
        let (middle, mut normal) = self.normal(&self.rough(readings));
        let near = |r: &&Reading| normal.dot(r.point - middle).abs() <= FAR * self.variance(r.point, normal).sqrt();
        let kept: Vec<Reading> = readings.iter().filter(near).copied().collect();
        if kept.len() < self.options.least_points.max(3) || 4 * kept.len() < 3 * readings.len() {
            return None;
        }
        let readings = &kept[..];
        let mut weighed = Moments::default();
        for _ in 0..2 {
            weighed = Moments::default();
            readings.iter().for_each(|r| weighed.add(r.point, 1.0 / self.variance(r.point, normal)));
            normal = self.normal(&weighed).1;
        }
        let (middle, axes, spread) = weighed.axes();
        let squares: f64 =
            readings.iter().map(|r| normal.dot(r.point - middle).powi(2) / self.variance(r.point, normal)).sum();
        let dimensions = if self.is_row { 2 } else { 3 };
        let scatter = (squares / (readings.len() - dimensions).max(1) as f64).sqrt();
        let own = scatter.max(1.0) / weighed.weight.sqrt();
        let [a, b] = [spread[0].sqrt(), spread[1].sqrt()];
        // Evenly spread points lie within sqrt(3) standard deviations.
        let narrowest = if self.is_row { a } else { b };
        if !(narrowest * 12f64.sqrt() >= self.options.least_extent) {
            return None;
        }
        let points: Vec<DVec3> = if self.is_row {
            [a, -a].map(|t| middle + t * axes[0]).into()
        } else {
            let on = |k: u32| (f64::from(k) * std::f64::consts::TAU / 3.0).sin_cos();
            let at = |(sin, cos): (f64, f64)| middle + 2f64.sqrt() * (a * cos * axes[0] + b * sin * axes[1]);
            (0..3).map(|k| at(on(k))).collect()
        };
        let (columns, rows) = (readings.iter().map(|r| r.column as f64), readings.iter().map(|r| r.row as f64));
        let ends = |all: &mut dyn Iterator<Item = f64>| {
            all.fold((f64::MAX, f64::MIN), |(least, most), x| (least.min(x), most.max(x)))
        };
        let ((x0, x1), (y0, y1)) = (ends(&mut columns.into_iter()), ends(&mut rows.into_iter()));
        Some(FoundSurface {
            plane: Plane { normal, offset: normal.dot(middle) },
            sigma: own * (points.len() as f64).sqrt(),
            points,
            count: readings.len(),
            pixels: PixelBox([x0 - 0.5, y0 - 0.5, x1 + 0.5, y1 + 0.5]),
            scatter,
        })
    }

    /// Splits runs of readings where they deviate from a line, and merges others (T. Pavlidis and S. Horowitz 1974).
    fn lines(&self) -> Vec<FoundSurface> {
        let mut pieces: Vec<(usize, usize)> = Vec::new();
        let mut first = 0;
        for i in 1..=self.readings.len() {
            if i == self.readings.len() || self.is_apart(&self.readings[i - 1], &self.readings[i]) {
                let begun = pieces.len();
                self.split(first, i, &mut pieces);
                self.merge(begun, &mut pieces);
                first = i;
            }
        }
        pieces.iter().filter_map(|(a, b)| self.fitted(&self.readings[*a..*b])).collect()
    }

    /// True if two consecutive readings cannot belong to one surface.
    fn is_apart(&self, a: &Reading, b: &Reading) -> bool {
        let (ra, rb) = (a.point.length(), b.point.length());
        let columns = (b.column - a.column) as f64;
        let slope = STEEPEST * self.pitch * columns * ra.min(rb);
        b.column - a.column > MISSING + 1 || (ra - rb).abs() > slope + FAR * self.noise.range_sigma(ra.max(rb))
    }

    fn split(&self, first: usize, end: usize, pieces: &mut Vec<(usize, usize)>) {
        // Iterative, because a scan may have many thousand readings.
        let mut open = vec![(first, end)];
        while let Some((a, b)) = open.pop() {
            let readings = &self.readings[a..b];
            if readings.len() < 3 {
                continue;
            }
            if self.worst(readings) <= BEND {
                pieces.push((a, b));
                continue;
            }
            let (start, way) = (readings[0].point, readings[readings.len() - 1].point - readings[0].point);
            let along = way.normalize_or_zero();
            let off = |r: &Reading| (r.point - start).reject_from(along).length_squared();
            let off = |r: &Reading| if along == DVec3::ZERO { (r.point - start).length_squared() } else { off(r) };
            let far = (1..readings.len() - 1).max_by(|i, j| off(&readings[*i]).total_cmp(&off(&readings[*j])));
            let at = a + far.unwrap_or(readings.len() / 2);
            // The left part is processed first, so that pieces stay in order.
            open.push((at, b));
            open.push((a, at));
        }
    }

    /// Merges neighbouring pieces on one line.
    fn merge(&self, begun: usize, pieces: &mut Vec<(usize, usize)>) {
        let mut i = begun;
        while i + 1 < pieces.len() {
            let ((a, b), (c, d)) = (pieces[i], pieces[i + 1]);
            let joint = &self.readings[a..d];
            if c <= b + 2 && self.worst(joint) <= BEND {
                pieces[i] = (a, d);
                pieces.remove(i + 1);
                i = i.saturating_sub(1).max(begun);
            } else {
                i += 1;
            }
        }
    }

    /// Grows planes from flat blocks over neighbouring flat blocks, starting with the flattest.
    fn planes(&self) -> Vec<FoundSurface> {
        let Some(mut blocks) = Blocks::of(self) else { return Vec::new() };
        let mut found = Vec::new();
        for start in blocks.flattest() {
            let Some(mut grown) = blocks.grow(self, start) else { continue };
            grown.sort_unstable();
            // A single flat block among many is usually a crease that happens to look flat.
            if grown.len() == 1 && blocks.scatter.len() > FEW {
                continue;
            }
            // Blocks at a crease hold points of both planes. Omitting them makes the plane smaller but keeps it flat.
            let own: Vec<Reading> = grown.iter().flat_map(|b| &blocks.readings[*b]).copied().collect();
            grown.iter().for_each(|b| blocks.scatter[*b] = f64::INFINITY);
            found.extend(self.fitted(&own));
        }
        found
    }
}

/// A box's readings in square blocks.
struct Blocks {
    across: i64,
    down: i64,
    readings: Vec<Vec<Reading>>,
    moments: Vec<Moments>,
    /// Root mean square distance in standard deviations; infinite if a block is not flat, or already part of a plane.
    scatter: Vec<f64>,
}

impl Blocks {
    fn of(patch: &Patch<'_>) -> Option<Self> {
        let columns = || patch.readings.iter().map(|r| r.column);
        let rows = || patch.readings.iter().map(|r| r.row);
        let (left, right, top, bottom) = (columns().min()?, columns().max()?, rows().min()?, rows().max()?);
        // Thin images get thin blocks.
        let side = |length: i64| BLOCK.min((length / 2).max(2));
        let (wide, high) = (side(right - left + 1), side(bottom - top + 1));
        let (across, down) = ((right - left) / wide + 1, (bottom - top) / high + 1);
        let mut readings = vec![Vec::new(); (across * down) as usize];
        for r in &patch.readings {
            readings[((r.row - top) / high * across + (r.column - left) / wide) as usize].push(*r);
        }
        let moments: Vec<Moments> = readings.iter().map(|r| patch.rough(r)).collect();
        let full = (wide * high) as usize;
        let flat = |r: &Vec<Reading>| {
            // At least half of a block, and more than three points, which always lie in a plane.
            let scatter = if 2 * r.len() >= full && r.len() >= 4 { scatter_of(patch, r) } else { f64::INFINITY };
            if scatter <= FLAT { scatter } else { f64::INFINITY }
        };
        let scatter = readings.iter().map(flat).collect();
        Some(Self { across, down, readings, moments, scatter })
    }

    fn flattest(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.scatter.len()).filter(|b| self.scatter[*b].is_finite()).collect();
        order.sort_by(|a, b| self.scatter[*a].total_cmp(&self.scatter[*b]));
        order
    }

    /// The flat blocks in one plane with a start block; `None` if the start block is already used.
    fn grow(&self, patch: &Patch<'_>, start: usize) -> Option<Vec<usize>> {
        if !self.scatter[start].is_finite() {
            return None;
        }
        let mut grown = vec![start];
        let mut seen = vec![false; self.scatter.len()];
        seen[start] = true;
        let mut sum = self.moments[start];
        let mut next = 0;
        while next < grown.len() {
            for b in self.around(grown[next]) {
                if seen[b] || !self.scatter[b].is_finite() {
                    continue;
                }
                let (middle, normal) = patch.normal(&sum);
                // The whole block must lie in the plane, up to noise and the plane's current uncertainty.
                let readings = &self.readings[b];
                let squares =
                    readings.iter().map(|r| normal.dot(r.point - middle).powi(2) / patch.variance(r.point, normal));
                let scatter = (squares.sum::<f64>() / readings.len() as f64).sqrt();
                let slack = if grown.len() < 4 { 3.0 } else { 1.8 };
                if scatter <= slack {
                    seen[b] = true;
                    sum = sum.merged(&self.moments[b]);
                    grown.push(b);
                }
            }
            next += 1;
        }
        Some(grown)
    }

    fn around(&self, block: usize) -> impl Iterator<Item = usize> + use<> {
        let (x, y) = (block as i64 % self.across, block as i64 / self.across);
        let (across, down) = (self.across, self.down);
        let inside = move |(x, y): &(i64, i64)| (0..across).contains(x) && (0..down).contains(y);
        [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)]
            .into_iter()
            .filter(inside)
            .map(move |(x, y)| (y * across + x) as usize)
    }
}

fn scatter_of(patch: &Patch<'_>, readings: &[Reading]) -> f64 {
    let (middle, normal) = patch.normal(&patch.rough(readings));
    let squares = readings.iter().map(|r| normal.dot(r.point - middle).powi(2) / patch.variance(r.point, normal));
    (squares.sum::<f64>() / (readings.len() - 3).max(1) as f64).sqrt()
}
