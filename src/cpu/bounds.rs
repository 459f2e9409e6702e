//! Conservative bounds of a polygon's image: which lines it may cover, or that it covers no ray at all.

use crate::geometry::Aabb;
use crate::sensor::{Angles, Geometry, LineAxis, LineGrid, PixelGrid, RayGrid, Sensor};
use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, PI};
use std::ops::Range;

/// The lines that a polygon may cover.
#[derive(Debug, PartialEq)]
pub(super) enum Cover {
    Nothing,
    Lines(Range<usize>),
    /// A polygon over the azimuth seam: two ranges that do not overlap.
    OverSeam(Range<usize>, Range<usize>),
}

/// Bounds for one sensor.
pub(super) struct Bounds<'a> {
    kind: Kind<'a>,
    range_max: f64,
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

/// Relative widening of every bound: far above f64 rounding, far below a pixel.
const SLACK: f64 = 1e-9;

impl<'a> Bounds<'a> {
    pub fn new(sensor: &'a Sensor) -> Self {
        let kind = match (sensor.grid(), &sensor.spec().geometry) {
            (PixelGrid::Rays(grid), _) => Kind::Rays(grid),
            (PixelGrid::Lines(grid), Geometry::Scanner(scanner)) => Kind::Scanner(ScannerBounds {
                grid,
                uniform: match scanner.azimuth {
                    Angles::Uniform { start_deg, step_deg, count } if count > 1 => {
                        Some((start_deg.to_radians(), step_deg.to_radians()))
                    }
                    _ => None,
                },
            }),
            (PixelGrid::Lines(grid), _) => {
                debug_assert_eq!(grid.axis(), LineAxis::Rows);
                Kind::Camera(grid)
            }
        };
        Self { kind, range_max: sensor.spec().range_max }
    }

    /// `corners` in the frame of the rays.
    #[inline(always)]
    pub fn cover(&self, corners: &[DVec3]) -> Cover {
        match &self.kind {
            Kind::Camera(grid) => camera(grid, corners),
            Kind::Scanner(bounds) => bounds.cover(corners, self.range_max),
            Kind::Rays(grid) => {
                let b = Aabb::of(corners.iter().copied());
                if b.distance_squared(DVec3::ZERO).sqrt() * (1.0 - SLACK) > self.range_max {
                    return Cover::Nothing;
                }
                Cover::Lines(0..grid.height() as usize)
            }
        }
    }
}

/// Line frame (fy y, z, fx x): lines and samples are pixels from the principal point.
#[inline(always)]
fn camera(grid: &LineGrid, corners: &[DVec3]) -> Cover {
    let (lines, samples) = (grid.lines(), grid.positions());
    let (top, bottom) = (lines[0][0] - SLACK, lines[lines.len() - 1][0] + SLACK);
    let (left, right) = (samples[0] - SLACK, samples[samples.len() - 1] + SLACK);
    let mut outside = 0b1_1111u32;
    let mut nearest = f64::INFINITY;
    for w in corners {
        let z = w.y;
        let code = u32::from(w.x < top * z)
            | u32::from(w.x > bottom * z) << 1
            | u32::from(w.z < left * z) << 2
            | u32::from(w.z > right * z) << 3
            | u32::from(z <= 0.0) << 4;
        outside &= code;
        nearest = nearest.min(z);
    }
    if outside != 0 {
        return Cover::Nothing;
    }
    if nearest <= 0.0 {
        return Cover::Lines(0..lines.len());
    }
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for w in corners {
        let p = *w * (1.0 / w.y);
        low = low.min(p);
        high = high.max(p);
    }
    // Pixel i is at i - principal point.
    let range = |low: f64, high: f64, first: f64, n: usize| {
        let slack = SLACK * (1.0 + low.abs().max(high.abs()));
        let start = (low - slack - first).ceil().max(0.0);
        let end = (high + slack - first).floor().min(n as f64 - 1.0);
        (start <= end).then_some((start, end))
    };
    let Some((start, end)) = range(low.x, high.x, lines[0][0], lines.len()) else {
        return Cover::Nothing;
    };
    if range(low.z, high.z, samples[0], samples.len()).is_none() {
        return Cover::Nothing;
    }
    Cover::Lines(start as usize..end as usize + 1)
}

impl ScannerBounds<'_> {
    /// Line frame (x, y, -z).
    #[inline(always)]
    fn cover(&self, corners: &[DVec3], range_max: f64) -> Cover {
        let b = Aabb::of(corners.iter().copied());
        let gap = b.min.max(-b.max).max(DVec3::ZERO);
        let near_squared = gap.x * gap.x + gap.y * gap.y;
        if (near_squared + gap.z * gap.z) * (1.0 - SLACK) > range_max * range_max {
            return Cover::Nothing;
        }
        let near = near_squared.sqrt();
        let far = corners.iter().map(|w| w.x * w.x + w.y * w.y).fold(0.0, f64::max).sqrt();
        let t = self.grid.positions();
        let least = if b.min.z > 0.0 { b.min.z / far } else { b.min.z / near };
        let greatest = if b.max.z > 0.0 { b.max.z / near } else { b.max.z / far };
        // NaN (0 / 0, on the axis) keeps everything.
        let widen = |x: f64| SLACK * (1.0 + x.abs());
        let (least, greatest) = (least - widen(least), greatest + widen(greatest));
        let first = if least > t[0] { t.partition_point(|&s| s < least) } else { 0 };
        if first == t.len() || t[first] > greatest {
            return Cover::Nothing;
        }
        self.columns(corners)
    }

    #[inline(always)]
    fn columns(&self, corners: &[DVec3]) -> Cover {
        let n = self.grid.lines().len();
        let everything = Cover::Lines(0..n);
        let Some((start, step)) = self.uniform else {
            return everything;
        };
        let Some((low, high)) = azimuth_interval(corners) else {
            return everything;
        };
        // In columns, of which a whole turn has `turn`; either sign of the step.
        let (a, b) = ((low - start) / step, (high - start) / step);
        let (a, b) = (a.min(b), a.max(b));
        let turn = std::f64::consts::TAU / step.abs();
        let shift = (a / turn).floor() * turn;
        let piece = |offset: f64| {
            let first = (a - shift - offset).ceil().max(0.0);
            let last = (b - shift - offset).floor().min(n as f64 - 1.0);
            if first <= last { first as usize..last as usize + 1 } else { 0..0 }
        };
        let (one, two) = (piece(0.0), piece(turn));
        match (one.is_empty(), two.is_empty()) {
            (true, true) => Cover::Nothing,
            (false, true) => Cover::Lines(one),
            (true, false) => Cover::Lines(two),
            _ if two.end >= one.start => everything,
            _ => Cover::OverSeam(one, two),
        }
    }
}

/// Widening of approximate azimuths, radians: above the error of [`atan2_approximately`].
const AZIMUTH_SLACK: f64 = 2e-5;

/// Least and greatest azimuth of a convex polygon, unwrapped along its outline (so either may leave -pi..pi), a
/// little too wide; `None` if the outline goes round the axis or too close by it to tell.
#[inline(always)]
fn azimuth_interval(corners: &[DVec3]) -> Option<(f64, f64)> {
    let first = atan2_approximately(corners[0].y, corners[0].x);
    let (mut at, mut low, mut high) = (first, first, first);
    let mut previous = first;
    for w in corners.iter().skip(1).chain(std::iter::once(&corners[0])) {
        let azimuth = atan2_approximately(w.y, w.x);
        let mut turned = azimuth - previous;
        if turned > PI {
            turned -= 2.0 * PI;
        } else if turned < -PI {
            turned += 2.0 * PI;
        }
        if turned.abs() > PI - 1e-3 {
            return None;
        }
        previous = azimuth;
        at += turned;
        low = low.min(at);
        high = high.max(at);
    }
    ((at - first).abs() < 1.0).then_some((low - AZIMUTH_SLACK, high + AZIMUTH_SLACK))
}

/// atan2 to 1.2e-5 rad (Abramowitz and Stegun 4.4.49), without a call or a branch.
#[inline(always)]
fn atan2_approximately(y: f64, x: f64) -> f64 {
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
            weights in (0.0..1.0f64, 0.0..1.0f64),
        ) {
            let c = points.map(|(x, y)| DVec3::new(x, y, 0.0));
            if let Some((low, high)) = azimuth_interval(&c) {
                let (u, v) = if weights.0 + weights.1 > 1.0 { (1.0 - weights.0, 1.0 - weights.1) } else { weights };
                let p = c[0] + (c[1] - c[0]) * u + (c[2] - c[0]) * v;
                let a = p.y.atan2(p.x);
                let held = [-2.0 * PI, 0.0, 2.0 * PI].iter().any(|turn| (low..=high).contains(&(a + turn)));
                prop_assert!(held, "{a} not in {low}..{high}");
            }
        }
    }
}
