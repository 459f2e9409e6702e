//! A polygon in the frame of a feature, and distances from it.

use super::plane::cut;
use crate::geometry::plane_of_polygon;
use glam::DVec3;

/// A convex polygon; coordinates are relative to the feature's first point.
pub(super) struct Local {
    pub slot: u32,
    pub corners: Vec<DVec3>,
    /// `None` if the area is within rounding; then only its sides count.
    pub normal: Option<DVec3>,
    offset: f64,
    /// Maximum distance of its corners from its plane, metres.
    pub warp: f64,
    /// Maximum distance of a point on it, metres: the tolerance plus rounding.
    pub reach: f64,
}

impl Local {
    pub fn new(slot: u32, corners: Vec<DVec3>, reach: f64) -> Self {
        let plane = plane_of_polygon(&corners);
        let (normal, offset) = (plane.map(|p| p.normal), plane.map_or(0.0, |p| p.offset));
        let off = |n: DVec3| corners.iter().map(|c| (n.dot(*c) - offset).abs()).fold(0.0, f64::max);
        Self { slot, normal, offset, warp: normal.map_or(0.0, off), corners, reach }
    }

    fn sides(&self) -> impl Iterator<Item = (DVec3, DVec3)> + '_ {
        let n = self.corners.len();
        (0..n).map(move |k| (self.corners[k], self.corners[(k + 1) % n]))
    }

    /// Height of a point above the plane.
    fn height(&self, normal: DVec3, p: DVec3) -> f64 {
        normal.dot(p) - self.offset
    }

    /// Distance from a point to the polygon.
    pub fn distance(&self, p: DVec3) -> f64 {
        if let Some(normal) = self.normal
            && self.sides().all(|(u, v)| normal.cross(v - u).dot(p - u) >= 0.0)
        {
            return self.height(normal, p).abs();
        }
        self.sides().map(|(u, v)| to_side(p, u, v)).fold(f64::INFINITY, f64::min)
    }

    /// Returns true if a point is on it, within the tolerance.
    pub fn holds(&self, p: DVec3) -> bool {
        self.distance(p) <= self.reach
    }

    /// The interval of t in 0..=1 in which a + t d is directly above or below it, within the tolerance.
    pub fn over(&self, a: DVec3, d: DVec3) -> Option<(f64, f64)> {
        let normal = self.normal?;
        let mut t = (0.0, 1.0);
        let (height, rise) = (self.height(normal, a), normal.dot(d));
        cut(&mut t, self.reach - height, -rise);
        cut(&mut t, self.reach + height, rise);
        for (u, v) in self.sides() {
            let inward = normal.cross(v - u);
            cut(&mut t, inward.dot(a - u), inward.dot(d));
        }
        (t.0 <= t.1).then_some(t)
    }

    /// Returns true if the segment from `a` along `d` crosses it: it leaves the tolerance while above or below it.
    pub fn is_left_within(&self, a: DVec3, d: DVec3, (from, to): (f64, f64)) -> bool {
        let Some(normal) = self.normal else { return false };
        let mut t = (0.0, 1.0);
        for (u, v) in self.sides() {
            let inward = normal.cross(v - u);
            cut(&mut t, inward.dot(a - u), inward.dot(d));
        }
        let more = 4.0 * self.reach / d.length().max(f64::MIN_POSITIVE);
        t.0 <= t.1 && (t.0 < from - more || t.1 > to + more)
    }

    /// Returns true if two points are outside one side of it, or on one side of its plane, by far more than tolerance
    /// and rounding. Then everything between them is, too.
    fn is_beside(&self, p: DVec3, q: DVec3) -> bool {
        let Some(normal) = self.normal else { return false };
        let far = 2.0 * (self.reach + self.warp);
        let are_off = |p: f64, q: f64, far: f64| (p > far && q > far) || (p < -far && q < -far);
        are_off(self.height(normal, p), self.height(normal, q), far)
            || self.sides().any(|(u, v)| {
                let inward = normal.cross(v - u);
                let outside = (inward.dot(p - u)).max(inward.dot(q - u));
                outside < 0.0 && outside * outside > far * far * inward.length_squared()
            })
    }

    /// The interval of t in 0..=1 in which a + t d is on it, within the tolerance.
    ///
    /// The points within a distance of a convex polygon form a convex body: the polygon's prism, a cylinder around each
    /// side and a ball around each corner. The interval is the hull of the intervals of these parts.
    pub fn stretch(&self, a: DVec3, d: DVec3) -> Option<(f64, f64)> {
        if self.is_beside(a, a + d) {
            return None;
        }
        let r = self.reach;
        let prism = self.over(a, d);
        if prism == Some((0.0, 1.0)) {
            return prism;
        }
        let rounds = self.sides().flat_map(|(u, v)| [in_ball(a - u, d, r), in_cylinder(a - u, d, v - u, r)]);
        let parts = prism.into_iter().chain(rounds.flatten());
        parts.reduce(|x, y| (x.0.min(y.0), x.1.max(y.1)))
    }
}

fn to_side(p: DVec3, u: DVec3, v: DVec3) -> f64 {
    let along = v - u;
    let length = along.length_squared();
    let t = if length > 0.0 { ((p - u).dot(along) / length).clamp(0.0, 1.0) } else { 0.0 };
    (p - u - along * t).length()
}

/// The interval of t in 0..=1 with |w + t d| <= r.
fn in_ball(w: DVec3, d: DVec3, r: f64) -> Option<(f64, f64)> {
    let speed = d.length_squared();
    let nearest = if speed > 0.0 { -w.dot(d) / speed } else { 0.0 };
    // Parallel within rounding: any point may be the nearest, and all are equally near.
    let nearest = if nearest.is_finite() { nearest } else { 0.0 };
    let rest = r * r - (w + d * nearest).length_squared();
    if rest < 0.0 {
        return None;
    }
    let half = (rest / speed).sqrt();
    let t = if half.is_nan() { (0.0, 1.0) } else { ((nearest - half).max(0.0), (nearest + half).min(1.0)) };
    (t.0 <= t.1).then_some(t)
}

/// The interval of t in 0..=1 in which `w + t d` is within r of the axis `side` from the origin, between its ends.
fn in_cylinder(w: DVec3, d: DVec3, side: DVec3, r: f64) -> Option<(f64, f64)> {
    let length = side.length();
    if !(length > 0.0) {
        return None;
    }
    let axis = side / length;
    let across = |v: DVec3| v - axis * axis.dot(v);
    let (w_across, d_across) = (across(w), across(d));
    let turned = d_across.length() > 8.0 * f64::EPSILON * d.length();
    let mut t = in_ball(w_across, if turned { d_across } else { DVec3::ZERO }, r)?;
    cut(&mut t, axis.dot(w), axis.dot(d));
    cut(&mut t, length - axis.dot(w), -axis.dot(d));
    (t.0 <= t.1).then_some(t)
}
