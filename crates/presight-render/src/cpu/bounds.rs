//! Conservative bounds of the images of eight polygons at a time: the lines that each may cover, or that it covers no
//! ray at all. This loop has to be cheap, because it rejects most polygons of a scene.

pub(super) use super::footprint::{Extent, Footprint, LANES, Lanes, LineCover, NOTHING, Reach, SLACK};
use presight_model::sensor::{Geometry, LineAxis, LineGrid, PixelGrid, RayGrid, Sensor};
use pulp::Simd;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::ops::Range;

/// Bounds for one sensor.
pub(super) struct Bounds<'a> {
    kind: Kind<'a>,
    range_max_squared: f64,
}

enum Kind<'a> {
    Camera(&'a LineGrid),
    Scanner(ScannerBounds<'a>),
    Rays(&'a RayGrid),
}

struct ScannerBounds<'a> {
    grid: &'a LineGrid,
    /// Radians of column 0 and from column to column; `None` for listed azimuths.
    uniform: Option<(f64, f64)>,
}

impl<'a> Bounds<'a> {
    pub fn new(sensor: &'a Sensor) -> Self {
        let kind = match (sensor.grid(), &sensor.spec().geometry) {
            (PixelGrid::Rays(grid), _) => Kind::Rays(grid),
            (PixelGrid::Lines(grid), Geometry::Scanner(_)) => Kind::Scanner(ScannerBounds {
                grid,
                uniform: sensor.uniform_columns().map(|[start, step]| (start.to_radians(), step.to_radians())),
            }),
            (PixelGrid::Lines(grid), _) => {
                debug_assert_eq!(grid.axis(), LineAxis::Rows);
                Kind::Camera(grid)
            }
        };
        let range_max = sensor.spec().range_max;
        Self { kind, range_max_squared: range_max * range_max * (1.0 + SLACK) }
    }

    /// The footprints of [`LANES`] polygons, given corner by corner in the frame of the rays. Polygons with fewer
    /// corners repeat one of them.
    #[inline(always)]
    pub fn cover<S: Simd>(&self, simd: S, corners: &[[Lanes; 3]]) -> [Footprint; LANES] {
        match &self.kind {
            Kind::Camera(grid) => camera(grid, self.range_max_squared, corners),
            Kind::Scanner(bounds) => bounds.cover(simd, self.range_max_squared, corners),
            Kind::Rays(grid) => super::ray_bounds::cover(simd, grid, self.range_max_squared, corners),
        }
    }

    /// [`Bounds::cover`] for polygons whose lines and samples are given.
    #[inline(always)]
    pub fn cover_reached(&self, corners: &[[Lanes; 3]], reaches: &[Reach]) -> [Footprint; LANES] {
        let mut e = Extent::new();
        corners.iter().for_each(|corner| e.hold(corner));
        let mut nearest = [0.0; LANES];
        if let Kind::Camera(_) = self.kind {
            nearest = e.least[1];
        } else {
            let (squared, _) = e.box_distances_squared();
            for l in 0..LANES {
                nearest[l] = squared[l].sqrt();
            }
        }
        let mut footprints = [const { NOTHING }; LANES];
        for (l, reach) in reaches.iter().enumerate() {
            if nearest[l] * nearest[l] <= self.range_max_squared {
                let [first_line, first_sample, end_line, end_sample] =
                    [reach[0], reach[1], 1.0 - reach[2], 1.0 - reach[3]].map(|place| place as u32);
                let lines = [first_line..end_line, 0..0];
                footprints[l] = Footprint { lines, samples: first_sample..end_sample, nearest: nearest[l] };
            }
        }
        footprints
    }
}

/// Line frame (fy y, z, fx x): lines and samples are pixels from the principal point.
#[inline(always)]
fn camera(grid: &LineGrid, range_max_squared: f64, corners: &[[Lanes; 3]]) -> [Footprint; LANES] {
    let (lines, samples) = (grid.lines(), grid.positions());
    let (top, bottom) = (lines[0][0] - SLACK, lines[lines.len() - 1][0] + SLACK);
    let (left, right) = (samples[0] - SLACK, samples[samples.len() - 1] + SLACK);
    let per_stride = 1.0 / grid.stride();
    let mut e = Extent::new();
    for [y, z, x] in corners {
        e.hold_ahead([y, z, x], [top, bottom, left, right]);
    }
    let mut footprints = [const { NOTHING }; LANES];
    for l in 0..LANES {
        if e.is_beside(l, range_max_squared) {
            continue;
        }
        if e.least[1][l] <= 0.0 {
            let (lines, samples) = ([0..lines.len() as u32, 0..0], 0..samples.len() as u32);
            footprints[l] = Footprint { lines, samples, nearest: 0.0 };
            continue;
        }
        let rows = pixels_between(e.low[0][l], e.high[0][l], lines[0][0], per_stride, lines.len());
        let columns = pixels_between(e.low[1][l], e.high[1][l], samples[0], per_stride, samples.len());
        if !columns.is_empty() {
            footprints[l] = Footprint { lines: [rows, 0..0], samples: columns, nearest: e.least[1][l] };
        }
    }
    footprints
}

/// The pixels i with `low <= first + i stride <= high`, a little too wide.
#[inline(always)]
fn pixels_between(low: f64, high: f64, first: f64, per_stride: f64, n: usize) -> Range<u32> {
    let slack = SLACK * (1.0 + low.abs().max(high.abs()));
    pieces((low - slack - first) * per_stride, (high + slack - first) * per_stride, n)
}

/// The integers from `low` to `high` in 0..n. Casts saturate; the comparison before them is exact.
#[inline(always)]
fn pieces(low: f64, high: f64, n: usize) -> Range<u32> {
    if !(high >= 0.0 && low <= (n - 1) as f64) {
        return 0..0;
    }
    let start = low.max(0.0);
    let rounded = start as u32;
    let start = rounded + u32::from(f64::from(rounded) < start);
    let end = (high.min((n - 1) as f64) as u32) + 1;
    start..end.max(start)
}

impl ScannerBounds<'_> {
    /// Line frame (x, y, -z).
    #[inline(always)]
    fn cover<S: Simd>(&self, simd: S, range_max_squared: f64, corners: &[[Lanes; 3]]) -> [Footprint; LANES] {
        let mut e = Extent::new();
        for corner in corners {
            e.hold(corner);
            let [x, y, _] = corner;
            for l in 0..LANES {
                e.axis_distance_squared[l] = e.axis_distance_squared[l].max(x[l] * x[l] + y[l] * y[l]);
            }
        }
        let (distance_squared, axis_squared) = e.box_distances_squared();
        let (mut from, mut to) = ([0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            // Positions t = -tan(elevation): z over the distance from the axis. 0/0, on the axis, is NaN and keeps all.
            let (near, far) = (axis_squared[l].sqrt(), e.axis_distance_squared[l].sqrt());
            let (low, high) = (e.least[2][l], e.greatest[2][l]);
            from[l] = low / if low > 0.0 { far } else { near };
            to[l] = high / if high > 0.0 { near } else { far };
            from[l] -= SLACK * (1.0 + from[l].abs());
            to[l] += SLACK * (1.0 + to[l].abs());
            from[l] = if from[l].is_nan() { f64::NEG_INFINITY } else { from[l] };
            to[l] = if to[l].is_nan() { f64::INFINITY } else { to[l] };
        }
        let t = self.grid.positions();
        let samples = self.grid.samples_around(simd, &from, &to);
        let (mut first, mut end) = (samples[0], samples[1]);
        let mut any = false;
        for l in 0..LANES {
            if distance_squared[l] > range_max_squared || first[l] >= end[l] {
                end[l] = first[l];
                continue;
            }
            // One line more at either side is possible. Most polygons that cover no ray end here.
            (first[l], end[l]) = (
                first[l] + u32::from(t[first[l] as usize] < from[l]),
                end[l] - u32::from(t[end[l] as usize - 1] > to[l]),
            );
            any |= first[l] < end[l];
        }
        let mut footprints = [const { NOTHING }; LANES];
        if !any {
            return footprints;
        }
        let mut columns = None;
        if let Some((start, step)) = self.uniform {
            for (i, [x, y, _]) in corners.iter().enumerate() {
                unwrap_azimuth(&mut e, i, x, y);
            }
            unwrap_azimuth(&mut e, corners.len(), &corners[0][0], &corners[0][1]);
            columns = Some(columns_of(&e, start, step));
        }
        for l in 0..LANES {
            if first[l] < end[l] {
                let (lines, nearest) = (self.columns(&e, columns.as_ref(), l), distance_squared[l].sqrt());
                footprints[l] = Footprint { lines, samples: first[l]..end[l], nearest };
            }
        }
        footprints
    }

    #[inline(always)]
    fn columns(&self, e: &Extent, columns: Option<&[Lanes; 2]>, l: usize) -> LineCover {
        let n = self.grid.lines().len();
        let everything = [0..n as u32, 0..0];
        let (Some([low, high]), Some((_, step))) = (columns, self.uniform) else {
            return everything;
        };
        // Around the axis, or too close to it to decide.
        if e.astray[l] > 0.0 || (e.turned[l] - e.first[l]).abs() > 1.0 {
            return everything;
        }
        let (low, high, turn) = (low[l], high[l], TAU / step.abs());
        let one = pieces(low, high, n);
        if high < turn {
            return [one, 0..0];
        }
        let two = pieces(low - turn, high - turn, n);
        if two.is_empty() {
            [one, 0..0]
        } else if one.is_empty() {
            [two, 0..0]
        } else if two.end >= one.start {
            everything
        } else {
            [one, two]
        }
    }
}

/// Azimuth intervals as columns. A full turn has `TAU / step` columns; the intervals begin in the first turn. The step
/// may be negative.
#[inline(always)]
fn columns_of(e: &Extent, start: f64, step: f64) -> [Lanes; 2] {
    let (per_step, turn) = (1.0 / step, TAU / step.abs());
    let per_turn = 1.0 / turn;
    let (mut low, mut high) = ([0.0; LANES], [0.0; LANES]);
    for l in 0..LANES {
        let a = (e.low[0][l] - AZIMUTH_SLACK - start) * per_step;
        let b = (e.high[0][l] + AZIMUTH_SLACK - start) * per_step;
        let (a, b) = if step < 0.0 { (b, a) } else { (a, b) };
        let shift = (a * per_turn).floor() * turn;
        (low[l], high[l]) = (a - shift, b - shift);
    }
    [low, high]
}

/// Widening of approximate azimuths, radians: more than the error of [`atan2_approximately`].
pub(super) const AZIMUTH_SLACK: f64 = 2e-5;

/// Follows the azimuth along the outline from corner to corner, so that it may leave -pi..pi.
#[inline(always)]
fn unwrap_azimuth(e: &mut Extent, i: usize, x: &Lanes, y: &Lanes) {
    for l in 0..LANES {
        let azimuth = atan2_approximately(y[l], x[l]);
        if i == 0 {
            (e.first[l], e.turned[l]) = (azimuth, azimuth);
            (e.low[0][l], e.high[0][l]) = (azimuth, azimuth);
        } else {
            let step = azimuth - e.previous[l];
            let step = if step > PI { step - TAU } else { step };
            let step = if step < -PI { step + TAU } else { step };
            e.astray[l] = e.astray[l].max(step.abs() - (PI - 1e-3));
            e.turned[l] += step;
            e.low[0][l] = e.low[0][l].min(e.turned[l]);
            e.high[0][l] = e.high[0][l].max(e.turned[l]);
        }
        e.previous[l] = azimuth;
    }
}

/// atan2 to 1.2e-5 rad (Abramowitz and Stegun 4.4.49), without a call or a branch.
#[inline(always)]
pub(super) fn atan2_approximately(y: f64, x: f64) -> f64 {
    let (ax, ay) = (x.abs(), y.abs());
    let q = ax.min(ay) / ax.max(ay).max(f64::MIN_POSITIVE);
    let s = q * q;
    let a = q * (0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1))));
    let a = if ay > ax { FRAC_PI_2 - a } else { a };
    let a = if x < 0.0 { PI - a } else { a };
    if y < 0.0 { -a } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn atan2_stays_within_the_slack(y in -1e3..1e3f64, x in -1e3..1e3f64) {
            prop_assert!((atan2_approximately(y, x) - y.atan2(x)).abs() < 0.7 * AZIMUTH_SLACK);
        }

        #[test]
        fn azimuth_intervals_hold_the_polygon(
            points in proptest::array::uniform3((-9.0..9.0f64, -9.0..9.0f64)),
            (u, v) in (0.0..1.0f64, 0.0..1.0f64),
        ) {
            let mut e = Extent::new();
            for i in 0..=3 {
                let (x, y) = points[i % 3];
                unwrap_azimuth(&mut e, i, &[x; LANES], &[y; LANES]);
            }
            if e.astray[0] <= 0.0 && (e.turned[0] - e.first[0]).abs() < 1.0 {
                let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
                let [a, b, c] = points;
                let x = a.0 + (b.0 - a.0) * u + (c.0 - a.0) * v;
                let y = a.1 + (b.1 - a.1) * u + (c.1 - a.1) * v;
                let held = e.low[0][0] - AZIMUTH_SLACK..=e.high[0][0] + AZIMUTH_SLACK;
                let inside = [-TAU, 0.0, TAU].iter().any(|turn| held.contains(&(y.atan2(x) + turn)));
                prop_assert!(inside);
            }
        }

        #[test]
        fn pieces_are_the_integers_between(low in -20.0..20.0f64, length in -1.0..20.0f64, n in 1usize..12) {
            let between = |i: &u32| f64::from(*i) >= low && f64::from(*i) <= low + length;
            let want: Vec<u32> = (0..n as u32).filter(between).collect();
            prop_assert_eq!(pieces(low, low + length, n).collect::<Vec<_>>(), want);
        }
    }
}
