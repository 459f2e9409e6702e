//! Convex polygons, cut by lines and planes.

use glam::{DVec2, DVec3, Vec3Swizzles};
use std::ops::{Add, Mul, Sub};

/// The part of a convex polygon where a linear function is not negative.
pub fn half<P>(corners: &[P], side: impl Fn(P) -> f64) -> Vec<P>
where
    P: Copy + Add<Output = P> + Sub<Output = P> + Mul<f64, Output = P>,
{
    let mut kept = Vec::with_capacity(corners.len() + 1);
    half_into(corners, side, &mut kept);
    kept
}

/// As [`half`], into memory that cuts share.
pub(super) fn half_into<P>(corners: &[P], side: impl Fn(P) -> f64, kept: &mut Vec<P>)
where
    P: Copy + Add<Output = P> + Sub<Output = P> + Mul<f64, Output = P>,
{
    kept.clear();
    for (i, &p) in corners.iter().enumerate() {
        let q = corners[(i + 1) % corners.len()];
        let (a, b) = (side(p), side(q));
        if a >= 0.0 {
            kept.push(p);
        }
        if a * b < 0.0 {
            kept.push(p + (q - p) * (a / (a - b)));
        }
    }
}

/// The part of a convex polygon between two heights.
pub(super) fn between_heights(corners: &[DVec3], low: f64, high: f64) -> Vec<DVec3> {
    half(&half(corners, |p| p.z - low), |p| high - p.z)
}

/// The part of a convex polygon in an upright box on a rectangle.
pub(super) fn above_rectangle(corners: &[DVec3], min: DVec2, max: DVec2) -> Vec<DVec3> {
    let part = half(&half(corners, |p| p.x - min.x), |p| max.x - p.x);
    half(&half(&part, |p| p.y - min.y), |p| max.y - p.y)
}

/// Lowest and highest corner, metres.
pub(super) fn heights(corners: &[DVec3]) -> (f64, f64) {
    corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p.z), b.max(p.z)))
}

/// Signed area, positive if counter-clockwise.
pub(super) fn area(outline: &[DVec2]) -> f64 {
    0.5 * (2..outline.len()).map(|k| (outline[k - 1] - outline[0]).perp_dot(outline[k] - outline[0])).sum::<f64>()
}

/// The outline of a polygon from above, counter-clockwise.
pub(super) fn from_above(corners: &[DVec3]) -> Vec<DVec2> {
    let mut outline: Vec<DVec2> = corners.iter().map(|p| p.xy()).collect();
    if area(&outline) < 0.0 {
        outline.reverse();
    }
    outline
}

/// Height of the plane of a polygon at a point, metres; the polygon must not be upright.
pub(super) fn height_at(corners: &[DVec3], p: DVec2) -> f64 {
    let normal: DVec3 = (2..corners.len()).map(|k| (corners[k - 1] - corners[0]).cross(corners[k] - corners[0])).sum();
    corners[0].z - normal.xy().dot(p - corners[0].xy()) / normal.z
}

/// Distance of a point from a convex polygon seen from above, metres; 0 inside.
pub fn distance_from_above(corners: &[DVec2], p: DVec2) -> f64 {
    let n = corners.len();
    let at = |i: usize| corners[i % n];
    let (mut left, mut right, mut nearest) = (true, true, f64::INFINITY);
    for i in 0..n {
        let along = at(i + 1) - at(i);
        let t = (p - at(i)).dot(along) / along.length_squared();
        nearest = nearest.min(p.distance(at(i) + along * if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) }));
        let turn = along.perp_dot(p - at(i));
        (left, right) = (left && turn >= 0.0, right && turn <= 0.0);
    }
    if (left || right) && area(corners) != 0.0 { 0.0 } else { nearest }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: a square of 2 m seen from its inside, its side, and its corner; and an upright wall.
    #[test]
    fn distances_are_from_above() {
        let square = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]].map(DVec2::from);
        for (p, far) in [([1.0, 1.0], 0.0), ([3.0, 1.0], 1.0), ([3.0, 3.0], 2f64.sqrt()), ([-0.5, 1.0], 0.5)] {
            assert!((distance_from_above(&square, p.into()) - far).abs() < 1e-12, "{p:?}");
        }
        let wall = [[0.0, 0.0], [2.0, 0.0], [2.0, 0.0], [0.0, 0.0]].map(DVec2::from);
        assert_eq!(distance_from_above(&wall, DVec2::new(3.0, 0.0)), 1.0, "a wall has no area from above");
    }

    #[test]
    fn a_ramp_is_cut_and_measured() {
        let ramp = [[0.0, 0.0, 0.0], [2.0, 0.0, 1.0], [2.0, 2.0, 1.0], [0.0, 2.0, 0.0]].map(DVec3::from);
        assert_eq!(heights(&between_heights(&ramp, 0.25, 0.5)), (0.25, 0.5));
        assert_eq!(heights(&above_rectangle(&ramp, DVec2::new(1.0, -1.0), DVec2::new(3.0, 1.0))), (0.5, 1.0));
        assert!(between_heights(&ramp, 1.1, 2.0).is_empty());
        assert_eq!(height_at(&ramp, DVec2::new(0.5, 1.0)), 0.25);
        assert_eq!(area(&from_above(&ramp)), 4.0);
    }
}
