//! What polygons leave of an outline that they cover.

use super::cut::{area, half};
use glam::DVec2;

/// Maximum width of a gap between polygons that counts as covered, metres. The corners of models are stored in f32,
/// 0.01 mm at 100 m, and drawn to a millimetre; no wheel notices such a gap.
pub const SEAM: f64 = 1e-3;

/// Maximum area of a remainder that counts as nothing, square metres: a square of one micrometre, which is rounding.
const NOTHING: f64 = 1e-12;

/// The parts of a convex outline that convex polygons do not cover, as convex polygons. All are counter-clockwise, in
/// metres.
pub(super) fn uncovered<'a>(outline: &[DVec2], polygons: impl IntoIterator<Item = &'a [DVec2]>) -> Vec<Vec<DVec2>> {
    let mut rest = vec![outline.to_vec()];
    // A polygon that is cut down to a point or a line covers nothing.
    for polygon in polygons.into_iter().filter(|polygon| area(polygon) > NOTHING) {
        let mut next = Vec::with_capacity(rest.len());
        for piece in rest {
            subtract(piece, polygon, &mut next);
        }
        rest = next;
        if rest.is_empty() {
            break;
        }
    }
    rest
}

/// Adds the parts of a convex piece outside of a convex polygon, which half a seam widens.
fn subtract(piece: Vec<DVec2>, polygon: &[DVec2], rest: &mut Vec<Vec<DVec2>>) {
    let (first, mut inside) = (rest.len(), piece.clone());
    for (outward, offset) in sides(polygon) {
        let outside = half(&inside, |p| outward.dot(p) - offset);
        inside = half(&inside, |p| offset - outward.dot(p));
        if area(&inside) <= NOTHING {
            rest.truncate(first);
            rest.push(piece);
            return;
        }
        if area(&outside) > NOTHING {
            rest.push(outside);
        }
    }
}

/// Outward unit normals of the sides of a counter-clockwise polygon, and the offsets of its sides, which half a seam
/// widens, metres.
pub(super) fn sides(polygon: &[DVec2]) -> impl Iterator<Item = (DVec2, f64)> + '_ {
    (0..polygon.len()).filter_map(|k| {
        let (a, b) = (polygon[k], polygon[(k + 1) % polygon.len()]);
        let outward = -(b - a).perp().try_normalize()?;
        Some((outward, outward.dot(a) + 0.5 * SEAM))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::SplitMix64;

    fn rectangle(min: [f64; 2], max: [f64; 2]) -> Vec<DVec2> {
        vec![min.into(), DVec2::new(max[0], min[1]), max.into(), DVec2::new(min[0], max[1])]
    }

    fn left(outline: &[DVec2], polygons: &[Vec<DVec2>]) -> f64 {
        uncovered(outline, polygons.iter().map(Vec::as_slice)).iter().map(|p| area(p)).sum()
    }

    /// By hand: a square of 1 m, with rectangles that leave a strip, a hole, a seam and nothing.
    #[test]
    fn strips_and_holes_remain_and_seams_do_not() {
        let square = rectangle([0.0, 0.0], [1.0, 1.0]);
        let halves = |gap: f64| [rectangle([-1.0, -1.0], [0.5, 2.0]), rectangle([0.5 + gap, -1.0], [2.0, 2.0])];
        assert_eq!(left(&square, &halves(0.0)), 0.0);
        assert_eq!(left(&square, &halves(0.9 * SEAM)), 0.0);
        assert!((left(&square, &halves(0.035)) - (0.035 - SEAM)).abs() < 1e-9);
        let frame = [
            rectangle([-1.0, -1.0], [0.4, 2.0]),
            rectangle([0.6, -1.0], [2.0, 2.0]),
            rectangle([0.4, -1.0], [0.6, 0.3]),
            rectangle([0.4, 0.5], [0.6, 2.0]),
        ];
        // The hole of 0.2 x 0.2 m touches no corner of the square.
        assert!((left(&square, &frame) - (0.2 - SEAM) * (0.2 - SEAM)).abs() < 1e-9);
        assert_eq!(left(&square, &[rectangle([2.0, 0.0], [3.0, 1.0])]), 1.0);
        assert_eq!(left(&square, &[]), 1.0);
        assert_eq!(left(&square, &[vec![DVec2::splat(0.5); 3]]), 1.0);
    }

    /// Random triangles against points: a point is in a remainder exactly if it is in no triangle.
    #[test]
    fn remainders_agree_with_points() {
        let mut random = SplitMix64(11);
        let square = rectangle([0.0, 0.0], [1.0, 1.0]);
        let mut counts = [0, 0];
        for _ in 0..300 {
            let mut draw = || DVec2::new(random.uniform(-0.5, 1.5), random.uniform(-0.5, 1.5));
            let triangles: Vec<Vec<DVec2>> = (0..5)
                .map(|_| vec![draw(), draw(), draw()])
                .map(|mut t| {
                    if area(&t) < 0.0 {
                        t.reverse();
                    }
                    t
                })
                .collect();
            let rest = uncovered(&square, triangles.iter().map(Vec::as_slice));
            for k in 0..100 {
                let p = DVec2::new(0.05 + 0.1 * f64::from(k % 10), 0.05 + 0.1 * f64::from(k / 10));
                let depth = |t: &Vec<DVec2>| sides(t).map(|(n, d)| d - n.dot(p)).fold(f64::INFINITY, f64::min);
                let inside = triangles.iter().map(depth).fold(f64::NEG_INFINITY, f64::max);
                if inside.abs() < 1e-6 {
                    continue;
                }
                let remains = rest.iter().any(|piece| super::super::cut::distance_from_above(piece, p) < 1e-9);
                assert_eq!(remains, inside < 0.0, "{p} in {triangles:?}");
                counts[usize::from(remains)] += 1;
            }
        }
        assert!(counts.iter().all(|n| *n > 1000), "{counts:?}");
    }
}
