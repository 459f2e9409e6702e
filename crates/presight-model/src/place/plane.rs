//! Geometry in the plane of a patch.

use crate::geometry::Plane;
use glam::{DVec2, DVec3};

/// A plane with axes. Heights are relative to the mean of the patch's corners.
pub(super) struct PatchPlane {
    pub x: DVec3,
    pub y: DVec3,
    pub normal: DVec3,
    pub offset: f64,
}

impl PatchPlane {
    /// x, y and the normal are right-handed: a winding about the normal is counter-clockwise in x and y.
    pub fn of(plane: &Plane) -> Self {
        let x = plane.normal.any_orthonormal_vector();
        Self { x, y: plane.normal.cross(x), normal: plane.normal, offset: plane.offset }
    }

    pub fn project(&self, p: DVec3) -> DVec2 {
        DVec2::new(self.x.dot(p), self.y.dot(p))
    }

    pub fn height(&self, p: DVec3) -> f64 {
        self.normal.dot(p) - self.offset
    }

    pub fn lift(&self, p: DVec2) -> DVec3 {
        self.x * p.x + self.y * p.y + self.normal * self.offset
    }
}

/// A point in the plane or in space.
pub trait Point: Copy {
    /// The point at share `t` of the way to another.
    fn between(self, other: Self, t: f64) -> Self;
}

impl Point for DVec2 {
    fn between(self, other: Self, t: f64) -> Self {
        self.lerp(other, t)
    }
}

impl Point for DVec3 {
    fn between(self, other: Self, t: f64) -> Self {
        self.lerp(other, t)
    }
}

/// The part of a side, as shares of it, inside a convex counter-clockwise outline; `None` if it is empty.
pub(super) fn within((u, v): (DVec2, DVec2), outline: &[DVec2]) -> Option<(f64, f64)> {
    let mut t = (0.0, 1.0);
    for side in sides(outline) {
        let at_u = inside(side, u);
        cut(&mut t, at_u, inside(side, v) - at_u);
    }
    (t.0 < t.1).then_some(t)
}

/// Keeps the part of an interval where `at_0 + t slope >= 0`.
pub(super) fn cut(t: &mut (f64, f64), at_0: f64, slope: f64) {
    if slope > 0.0 {
        t.0 = t.0.max(-at_0 / slope);
    } else if slope < 0.0 {
        t.1 = t.1.min(at_0 / -slope);
    } else if at_0 < 0.0 {
        t.1 = f64::NEG_INFINITY;
    }
}

/// Keeps the part of a convex polygon where a linear function is not negative.
pub fn clip<P: Point>(polygon: &[P], value: impl Fn(&P) -> f64) -> Vec<P> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (k, p) in polygon.iter().enumerate() {
        let q = &polygon[(k + 1) % polygon.len()];
        let (at_p, at_q) = (value(p), value(q));
        if at_p >= 0.0 {
            kept.push(*p);
        }
        if (at_p > 0.0 && at_q < 0.0) || (at_p < 0.0 && at_q > 0.0) {
            kept.push(p.between(*q, at_p / (at_p - at_q)));
        }
    }
    kept
}

pub(super) fn sides(polygon: &[DVec2]) -> impl Iterator<Item = (DVec2, DVec2)> + '_ {
    (0..polygon.len()).map(|k| (polygon[k], polygon[(k + 1) % polygon.len()]))
}

/// Positive to the left of a side.
pub(super) fn inside((u, v): (DVec2, DVec2), p: DVec2) -> f64 {
    (v - u).perp_dot(p - u)
}

pub(super) fn doubled_area(polygon: &[DVec2]) -> f64 {
    sides(polygon).map(|(u, v)| (u - polygon[0]).perp_dot(v - polygon[0])).sum()
}

/// Approximate width of a narrow polygon: twice its area over its circumference; 0 without area.
pub(super) fn width(polygon: &[DVec2]) -> f64 {
    let around: f64 = sides(polygon).map(|(u, v)| u.distance(v)).sum();
    if around > 0.0 { doubled_area(polygon).abs() / around } else { 0.0 }
}

pub(super) fn bounds_of(piece: &[DVec2]) -> (DVec2, DVec2) {
    let start = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    piece.iter().fold(start, |(min, max), p| (min.min(*p), max.max(*p)))
}
