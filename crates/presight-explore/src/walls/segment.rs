//! Segments of scans, split at bends and merged over all scans.

use super::scan::{NEAR, Scan, Wall};
use glam::{DMat2, DVec2};

/// Minimum length of a segment, metres.
const SHORT: f64 = 0.25;
/// Minimum number of steps between the points of a segment.
const POINTS: usize = 4;
/// Range beyond which points are too far apart, metres.
const FAR: f64 = 25.0;
/// Maximum gap between segments of one wall, metres.
const GAP: f64 = 0.2;
/// Minimum cosine between the normals of segments of one wall: 4 degrees.
const PARALLEL: f64 = 0.9976;

struct Segment {
    line: Line,
    points: Vec<DVec2>,
}

/// A stretch of a line.
#[derive(Clone, Copy)]
struct Line {
    middle: DVec2,
    direction: DVec2,
    /// Towards the sensor.
    normal: DVec2,
    from: f64,
    to: f64,
}

impl Line {
    /// The least-squares line through points, with its normal towards a side.
    fn of(points: &[DVec2], towards: DVec2) -> Self {
        let middle = points.iter().sum::<DVec2>() / points.len() as f64;
        let outer = |p: &DVec2| {
            let q = *p - middle;
            DMat2::from_cols(q * q.x, q * q.y)
        };
        let m = points.iter().map(outer).fold(DMat2::ZERO, |a, b| a + b);
        let angle = 0.5 * (2.0 * m.x_axis.y).atan2(m.x_axis.x - m.y_axis.y);
        let direction = DVec2::from_angle(angle);
        let perpendicular = direction.perp();
        let normal = if perpendicular.dot(towards) > 0.0 { perpendicular } else { -perpendicular };
        let mut along: Vec<f64> = points.iter().map(|p| (*p - middle).dot(direction)).collect();
        along.sort_by(f64::total_cmp);
        // Two in a thousand points may lie beyond each end.
        let at = |share: f64| along[(share * (along.len() - 1) as f64).round() as usize];
        Self { middle, direction, normal, from: at(0.002), to: at(0.998) }
    }

    fn length(&self) -> f64 {
        self.to - self.from
    }

    fn ends(&self) -> [DVec2; 2] {
        [self.middle + self.direction * self.from, self.middle + self.direction * self.to]
    }
}

/// The walls of all scans: their segments, merged.
pub(crate) fn walls(scans: &[Scan]) -> Vec<Wall> {
    let mut segments: Vec<Segment> = scans.iter().flat_map(segments).collect();
    segments.sort_by(|a, b| b.line.length().total_cmp(&a.line.length()));
    let mut merged: Vec<Segment> = Vec::new();
    for segment in segments {
        match merged.iter_mut().find(|m| belongs(&m.line, &segment.line)) {
            Some(wall) => {
                wall.points.extend(segment.points);
                wall.line = Line::of(&wall.points, wall.line.normal);
            }
            None => merged.push(segment),
        }
    }
    merged.iter().filter(|m| m.line.length() > SHORT).map(|m| Wall { ends: m.line.ends() }).collect()
}

fn belongs(wall: &Line, other: &Line) -> bool {
    let off = other.ends().map(|p| p - wall.middle);
    let along = off.map(|p| p.dot(wall.direction));
    wall.normal.dot(other.normal) > PARALLEL
        && off.iter().all(|p| p.dot(wall.normal).abs() < NEAR)
        && along[0].max(along[1]) > wall.from - GAP
        && along[0].min(along[1]) < wall.to + GAP
}

fn segments(scan: &Scan) -> Vec<Segment> {
    let mut found = Vec::new();
    let mut start = 0;
    while start < scan.ranges.len() {
        let mut end = start;
        while is_joined(scan, end) {
            end += 1;
        }
        if scan.ranges[start].is_finite() {
            split(scan, start, end, &mut found);
        }
        start = end + 1;
    }
    found
}

/// True if the ends of a beam and the next one are close enough to lie on one surface.
fn is_joined(scan: &Scan, beam: usize) -> bool {
    let Some(next) = scan.ranges.get(beam + 1) else { return false };
    let range = scan.ranges[beam];
    range.is_finite() && next.is_finite() && scan.point(beam + 1).distance(scan.point(beam)) < (0.035 * range).max(0.15)
}

/// Splits a run of beams at the point farthest from its chord, until all points are near (Ramer, Douglas and Peucker).
fn split(scan: &Scan, start: usize, end: usize, found: &mut Vec<Segment>) {
    let mut parts = vec![(start, end)];
    while let Some((a, b)) = parts.pop() {
        if b - a < POINTS {
            continue;
        }
        let chord = scan.point(b) - scan.point(a);
        if chord.length() < 1e-6 {
            continue;
        }
        let normal = chord.perp().normalize();
        let off = |k: usize| (scan.point(k) - scan.point(a)).dot(normal).abs();
        let worst = (a..=b).max_by(|i, j| off(*i).total_cmp(&off(*j))).unwrap_or(a);
        if off(worst) > NEAR {
            parts.extend([(worst, b), (a, worst)]);
            continue;
        }
        let points: Vec<DVec2> = (a..=b).map(|k| scan.point(k)).collect();
        let line = Line::of(&points, scan.origin - points[0]);
        if line.length() >= SHORT && (a..=b).all(|k| scan.ranges[k] < FAR) {
            found.push(Segment { line, points });
        }
    }
}
