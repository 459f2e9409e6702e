//! Distance between a detection and an expected feature.

use super::detection::{Detection, ExpectedFeature, Shape};
use glam::{DMat2, DVec2};
use presight_model::statistics::chi_squared_quantile;
use std::f64::consts::PI;

/// Minimum variance of a measured coordinate, pixels squared. With a smaller one, a track would reject its detections.
const FLOOR: f64 = 1e-4;

/// Minimum overlap of two segments as a share of their union, measured along them.
const OVERLAP: f64 = 1.0 / 3.0;

/// Relative bound on rounding when the same test is computed in a different order.
const ROUNDING: f64 = 1e-9;

/// Distance between a detection and an expected feature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Distance {
    /// Squared Mahalanobis distance in the image.
    pub squared: f64,
    /// Number of dimensions.
    pub dimensions: u32,
    /// 1/2 ln det(2 pi S).
    pub log_volume: f64,
    /// Logarithm of the clutter density over these dimensions, minus the logarithm of its density in the image.
    pub log_clutter: f64,
}

/// Adds one coordinate of an innovation with its variance.
fn scalar(squared: f64, variance: f64, into: &mut Distance) {
    into.squared += squared / variance;
    into.dimensions += 1;
    into.log_volume += 0.5 * (2.0 * PI * variance).ln();
}

/// Maximum squared distances that pass the gate, by number of dimensions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Gate {
    deviate: f64,
    /// The first entry is for 0 dimensions.
    limits: [f64; GATES],
}

/// Number of limits computed in advance. They suffice for positions, and for segments with all properties.
const GATES: usize = 8;

impl Gate {
    pub fn new(deviate: f64) -> Self {
        Self { deviate, limits: std::array::from_fn(|n| chi_squared_quantile(n as u32, deviate)) }
    }

    pub fn limit(&self, dimensions: u32) -> f64 {
        let known = self.limits.get(dimensions as usize);
        known.copied().unwrap_or_else(|| chi_squared_quantile(dimensions, self.deviate))
    }

    pub fn passes(&self, distance: &Distance) -> bool {
        distance.squared <= self.limit(distance.dimensions)
    }
}

/// A detection's covariance, limited from below.
pub(crate) fn floored(covariance: DMat2) -> DMat2 {
    covariance + DMat2::from_diagonal(DVec2::splat(FLOOR))
}

fn variance_along(direction: DVec2, covariance: DMat2) -> f64 {
    direction.dot(covariance * direction)
}

/// Multiple of `turn` that brings a detection's column `x` nearest to `near`.
pub(crate) fn unwrap(turn: Option<f64>, near: f64, x: f64) -> f64 {
    turn.map_or(0.0, |turn| turn * ((near - x) / turn).round())
}

/// Difference of two directions modulo pi, in -pi/2..pi/2.
pub(super) fn turn_apart(a: f64, b: f64) -> f64 {
    let apart = (a - b) / PI;
    PI * (apart - apart.round())
}

/// Returns the distance in the image. Returns `None` if the kinds differ, if segments do not overlap enough, or if the
/// distance is beyond the gate. `noise` multiplies the detection's covariance.
pub(super) fn compare(
    expected: &ExpectedFeature,
    found: &Detection,
    noise: f64,
    turn: Option<f64>,
    gate: &Gate,
) -> Option<Distance> {
    let mut distance = Distance { squared: 0.0, dimensions: 0, log_volume: 0.0, log_clutter: 0.0 };
    let covariance = floored(found.covariance * noise);
    let near = expected.shape.points().first()?.x;
    let shift = DVec2::new(unwrap(turn, near, found.shape.points().first()?.x), 0.0);
    match (&expected.shape, &found.shape) {
        (Shape::Point(p), Shape::Point(q)) | (Shape::Reflector(p), Shape::Reflector(q)) => {
            let (innovation, s) = (*q + shift - *p, expected.covariances[0] + covariance);
            let (squared, determinant) = squared_of(innovation, s);
            // The majority of pairs fails here, before any logarithm is computed.
            if squared > gate.limit(2) {
                return None;
            }
            add_squared(squared, determinant, &mut distance);
        }
        (Shape::Segment { ends, corners }, Shape::Segment { ends: found_ends, corners: found_corners }) => {
            let seen = SegmentPair::new(ends, found_ends.map(|q| q + shift), found_corners)?;
            for (i, p) in ends.iter().enumerate() {
                let c = expected.covariances[i];
                let noise = variance_along(seen.normal, covariance) * seen.spread(i);
                let across = seen.normal.dot(seen.ends[i] - *p);
                scalar(across * across, variance_along(seen.normal, c) + noise, &mut distance);
                if corners[i] && seen.corners[i] {
                    let along = seen.along.dot(seen.ends[i] - *p);
                    scalar(along * along, variance_along(seen.along, c + covariance), &mut distance);
                    distance.log_clutter -= seen.length.max(1.0).ln();
                }
            }
            // A line is given by its distances d0 and d1 from both ends. Clutter directions are uniform over pi.
            distance.log_clutter -= PI.ln() + seen.overlap.ln();
        }
        (Shape::Fiducial(p), Shape::Fiducial(q)) => add_outline(expected, p, q, 0, shift, covariance, &mut distance),
        (Shape::Patch(p), Shape::Patch(q)) if p.len() == q.len() => {
            distance = (0..p.len())
                .map(|first| {
                    let mut begun = distance;
                    add_outline(expected, p, q, first, shift, covariance, &mut begun);
                    begun
                })
                .min_by(|a, b| a.squared.total_cmp(&b.squared))?;
        }
        _ => return None,
    }
    gate.passes(&distance).then_some(distance)
}

/// A detected segment, prepared to reject most expected segments quickly.
#[derive(Clone, Copy, Debug)]
pub(super) struct FoundLine {
    from: DVec2,
    whole: DVec2,
    normal: DVec2,
    /// Inverse of the squared length.
    rate: f64,
    /// Variance along `normal`, which has the length of the segment.
    noise: f64,
}

impl FoundLine {
    /// Returns `None` if the detection is not a segment.
    pub fn of(found: &Detection, noise: f64) -> Option<Self> {
        let Shape::Segment { ends, .. } = &found.shape else { return None };
        let whole = ends[1] - ends[0];
        let normal = whole.perp();
        let noise = variance_along(normal, floored(found.covariance * noise));
        Some(Self { from: ends[0], whole, normal, rate: 1.0 / whole.length_squared(), noise })
    }

    /// Returns false only if [`compare`] returns `None`. Needs neither a root nor a logarithm.
    #[inline]
    pub fn may_be(&self, ends: &[DVec2; 2], covariances: &[DMat2], turn: Option<f64>, gate: &Gate) -> bool {
        let from = self.from + DVec2::new(unwrap(turn, ends[0].x, self.from.x), 0.0);
        // For end i: its squared distance across the line, the variance, and its position along the detected segment.
        let across = |i: usize| {
            let off = ends[i] - from;
            let (across, at) = (self.normal.dot(off), self.whole.dot(off) * self.rate);
            let spread = (1.0 - at) * (1.0 - at) + at * at;
            (across * across, variance_along(self.normal, covariances[i]) + self.noise * spread, at)
        };
        // Corners may add two squares along the segment. NaN passes, and the full test decides.
        let limit = gate.limit(4) * (1.0 + ROUNDING);
        let (first, variance, begin) = across(0);
        let (second, other, end) = across(1);
        if first * other + second * variance > limit * (variance * other) {
            return false;
        }
        let (low, high) = (begin.min(end), begin.max(end));
        let is_apart = high.min(1.0) - low.max(0.0) < (OVERLAP - ROUNDING) * (high.max(1.0) - low.min(0.0));
        !is_apart
    }
}

/// Squared Mahalanobis distance, and the determinant of the covariance.
fn squared_of(innovation: DVec2, s: DMat2) -> (f64, f64) {
    let determinant = s.determinant().max(f64::MIN_POSITIVE);
    let adjugate = DMat2::from_cols_array(&[s.y_axis.y, -s.x_axis.y, -s.y_axis.x, s.x_axis.x]);
    (innovation.dot(adjugate * innovation) / determinant, determinant)
}

fn add_point(innovation: DVec2, s: DMat2, into: &mut Distance) {
    let (squared, determinant) = squared_of(innovation, s);
    add_squared(squared, determinant, into);
}

fn add_squared(squared: f64, determinant: f64, into: &mut Distance) {
    into.squared += squared;
    into.dimensions += 2;
    into.log_volume += (2.0 * PI).ln() + 0.5 * determinant.ln();
}

/// Adds the distance corner by corner, with the detected outline starting at corner `first`.
fn add_outline(
    expected: &ExpectedFeature,
    p: &[DVec2],
    q: &[DVec2],
    first: usize,
    shift: DVec2,
    covariance: DMat2,
    into: &mut Distance,
) {
    let [x0, y0, x1, y1] = expected.window;
    for (i, p) in p.iter().enumerate() {
        add_point(q[(i + first) % q.len()] + shift - *p, expected.covariances[i] + covariance, into);
        if i > 0 {
            into.log_clutter -= ((x1 - x0) * (y1 - y0)).max(1.0).ln();
        }
    }
}

/// A detected segment with its ends in the order of the expected segment.
struct SegmentPair {
    ends: [DVec2; 2],
    corners: [bool; 2],
    normal: DVec2,
    along: DVec2,
    length: f64,
    /// Overlap as a share of the union, along the detected segment.
    overlap: f64,
    /// Positions of the expected ends along the detected segment, which runs from 0 to 1.
    at: [f64; 2],
}

impl SegmentPair {
    fn new(expected: &[DVec2; 2], found: [DVec2; 2], corners: &[bool; 2]) -> Option<Self> {
        let (mut ends, mut corners) = (found, *corners);
        if (ends[1] - ends[0]).dot(expected[1] - expected[0]) < 0.0 {
            ends.swap(0, 1);
            corners.swap(0, 1);
        }
        let whole = ends[1] - ends[0];
        let length = whole.length();
        let along = whole / length;
        let at = [0, 1].map(|i| along.dot(expected[i] - ends[0]) / length);
        let both = at[1].min(1.0) - at[0].max(0.0);
        let overlap = both / (at[1].max(1.0) - at[0].min(0.0));
        (overlap >= OVERLAP).then(|| Self { ends, corners, normal: along.perp(), along, length, overlap, at })
    }

    /// Factor from the variance of a detected end to that of the detected line at expected end `i`.
    fn spread(&self, i: usize) -> f64 {
        let t = self.at[i];
        (1.0 - t) * (1.0 - t) + t * t
    }
}

/// Returns the measured position of each defining point of the expected shape, in order, with its covariance. An
/// extractor breaks a segment anywhere, so an end without a corner is uniformly distributed along the expected segment,
/// with a variance of its squared length / 12.
pub(crate) fn aligned(expected: &ExpectedFeature, found: &Detection, turn: Option<f64>) -> Vec<(DVec2, DMat2)> {
    let covariance = floored(found.covariance);
    let points = found.shape.points();
    let wanted = expected.shape.points();
    let shift = DVec2::new(unwrap(turn, wanted[0].x, points[0].x), 0.0);
    match (&expected.shape, &found.shape) {
        (Shape::Segment { ends, corners }, Shape::Segment { ends: found_ends, corners: found_corners }) => {
            let seen = SegmentPair::new(ends, found_ends.map(|q| q + shift), found_corners);
            let measured = |seen: &SegmentPair, i: usize| {
                let is_fixed = corners[i] && seen.corners[i];
                let across = variance_along(seen.normal, covariance) * seen.spread(i);
                let along = match is_fixed {
                    true => variance_along(seen.along, covariance),
                    false => ends[0].distance_squared(ends[1]) / 12.0,
                };
                (seen.ends[i], outer(seen.normal) * across + outer(seen.along) * along)
            };
            seen.iter().flat_map(|seen| [0, 1].map(|i| measured(seen, i))).collect()
        }
        (Shape::Patch(p), Shape::Patch(q)) => {
            let apart = |first: usize| -> f64 {
                let mut begun = Distance { squared: 0.0, dimensions: 0, log_volume: 0.0, log_clutter: 0.0 };
                add_outline(expected, p, q, first, shift, covariance, &mut begun);
                begun.squared
            };
            let best = (0..q.len()).min_by(|a, b| apart(*a).total_cmp(&apart(*b))).unwrap_or(0);
            (0..p.len()).map(|i| (q[(i + best) % q.len()] + shift, covariance)).collect()
        }
        _ => points.iter().map(|q| (*q + shift, covariance)).collect(),
    }
}

fn outer(v: DVec2) -> DMat2 {
    DMat2::from_cols(v * v.x, v * v.y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::ExpectedProperties;
    use presight_model::random::SplitMix64;

    fn expected(shape: Shape, sigma: f64) -> ExpectedFeature {
        let covariances = vec![DMat2::from_diagonal(DVec2::splat(sigma * sigma)); shape.points().len()];
        ExpectedFeature {
            shape,
            covariances,
            window: [0.0, 0.0, 10.0, 10.0],
            properties: ExpectedProperties::default(),
        }
    }

    fn compare(a: &ExpectedFeature, b: &Detection, noise: f64, turn: Option<f64>) -> Option<Distance> {
        super::compare(a, b, noise, turn, &Gate::new(1e3))
    }

    #[test]
    fn points_are_apart_by_mahalanobis() {
        // The variance is 9 + 16 = 25 in both axes. 10 pixels in x give 100 / 25 = 4, apart from the floor of 1e-4.
        let p = expected(Shape::Point(DVec2::ZERO), 3.0);
        let d = compare(&p, &Detection::point(DVec2::new(10.0, 0.0), 4.0), 1.0, None).unwrap();
        assert!((d.squared - 4.0).abs() < 1e-4 && d.dimensions == 2);
        assert!((d.log_volume - (2.0 * PI * 25.0).ln()).abs() < 1e-5);
        assert!(compare(&p, &Detection::new(Shape::Reflector(DVec2::ZERO), 4.0), 1.0, None).is_none());
        // Across the seam of a 720-column image.
        let over = compare(&p, &Detection::point(DVec2::new(730.0, 0.0), 4.0), 1.0, Some(720.0)).unwrap();
        assert!((over.squared - 4.0).abs() < 1e-4);
    }

    /// A part of a segment, or one with swapped ends, is as near as the whole. Only the offset across it counts.
    #[test]
    fn segments_count_across_themselves() {
        let line =
            |y0: f64, y1: f64, x0: f64, x1: f64| Detection::segment([DVec2::new(x0, y0), DVec2::new(x1, y1)], 1.0);
        let whole = Shape::Segment { ends: [DVec2::ZERO, DVec2::new(100.0, 0.0)], corners: [true, true] };
        let p = expected(whole, 1.0);
        for (x0, x1) in [(0.0, 100.0), (0.0, 50.0), (100.0, 0.0), (120.0, 10.0)] {
            let d = compare(&p, &line(0.0, 0.0, x0, x1), 1.0, None).unwrap();
            assert!(d.squared < 1e-12 && d.dimensions == 2, "{x0}..{x1}: {d:?}");
        }
        // 2 pixels across at both ends with variance 1 + 1 give 4 / 2 twice.
        let d = compare(&p, &line(2.0, 2.0, 0.0, 100.0), 1.0, None).unwrap();
        assert!((d.squared - 4.0).abs() < 1e-3);
        // A continuation beyond the end is a different segment.
        assert!(compare(&p, &line(0.0, 0.0, 101.0, 200.0), 1.0, None).is_none());
        // With corners, an offset of 2 pixels along the segment adds to the distance.
        let ends = [DVec2::new(2.0, 0.0), DVec2::new(102.0, 0.0)];
        let fixed = Detection::new(Shape::Segment { ends, corners: [true, false] }, 1.0);
        let d = compare(&p, &fixed, 1.0, None).unwrap();
        assert!((d.squared - 2.0).abs() < 1e-3 && d.dimensions == 3, "{d:?}");
    }

    /// Counts, in 20,000 pairs, those rejected by `may_be` that pass the gate, and all those rejected by `may_be`.
    fn told_at_once(first: &Gate, gate: &Gate) -> (usize, usize) {
        let mut random = SplitMix64(17);
        let (mut lost, mut told) = (0, 0);
        for i in 0..20_000 {
            let mut at = |side: f64| side * DVec2::new(random.unit() - 0.5, random.unit() - 0.5);
            let ends = [at(60.0), at(60.0)];
            let off = [at(12.0), at(12.0)];
            let turn = (i % 3 == 0).then_some(720.0);
            let over = DVec2::new(turn.unwrap_or(0.0), 0.0);
            let found_ends = [0, 1].map(|k| ends[(k + i) % 2].lerp(ends[(k + i + 1) % 2], at(1.0).x) + off[k] + over);
            let mut p = expected(Shape::Segment { ends, corners: [i % 5 == 0; 2] }, 1.0 + at(1.0).x);
            p.covariances[1] = p.covariances[1] * 3.0 + DMat2::from_cols_array(&[0.5, 0.4, 0.4, 0.5]);
            let found = Detection::new(Shape::Segment { ends: found_ends, corners: [i % 2 == 0; 2] }, 0.5);
            let may_be = FoundLine::of(&found, 1.3).is_some_and(|line| line.may_be(&ends, &p.covariances, turn, first));
            let is = super::compare(&p, &found, 1.3, turn, gate).is_some();
            lost += usize::from(is && !may_be);
            told += usize::from(!may_be);
        }
        (lost, told)
    }

    #[test]
    fn segments_told_apart_at_once_have_no_distance() {
        let gate = Gate::new(3.09);
        let (lost, told) = told_at_once(&gate, &gate);
        assert!(lost == 0 && told > 5_000, "{lost} {told}");
        // Planted fault: a first gate that is narrower than the second.
        assert!(told_at_once(&Gate::new(1.0), &gate).0 > 50);
    }

    #[test]
    fn patches_begin_at_any_corner_fiducials_at_theirs() {
        let square = [DVec2::ZERO, DVec2::new(9.0, 0.0), DVec2::new(9.0, 9.0), DVec2::new(0.0, 9.0)];
        let turned = [square[2], square[3], square[0], square[1]];
        let p = expected(Shape::Patch(square.to_vec()), 1.0);
        assert_eq!(compare(&p, &Detection::new(Shape::Patch(turned.to_vec()), 1.0), 1.0, None).unwrap().squared, 0.0);
        assert!(compare(&p, &Detection::new(Shape::Patch(turned[..3].to_vec()), 1.0), 1.0, None).is_none());
        let f = expected(Shape::Fiducial(square), 1.0);
        assert!(compare(&f, &Detection::new(Shape::Fiducial(turned), 1.0), 1.0, None).unwrap().squared > 100.0);
        let found = aligned(&p, &Detection::new(Shape::Patch(turned.to_vec()), 1.0), None);
        assert_eq!(found.iter().map(|(at, _)| *at).collect::<Vec<_>>(), square);
    }

    #[test]
    fn directions_are_modulo_pi() {
        assert!((turn_apart(0.1, 0.1 + PI)).abs() < 1e-12);
        assert!((turn_apart(0.1, PI - 0.1) - 0.2).abs() < 1e-12);
    }
}
