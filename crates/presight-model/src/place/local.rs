//! A polygon in the frame of a feature, and what is near it.

use super::plane::cut;
use crate::geometry::plane_of_polygon;
use glam::DVec3;

/// A convex polygon, coordinates about the feature's first point.
pub(super) struct Local {
    pub slot: u32,
    pub corners: Vec<DVec3>,
    /// `None` where roundings swallow the area: what counts then are its sides.
    pub normal: Option<DVec3>,
    offset: f64,
    /// How far its corners are off its plane, metres.
    pub warp: f64,
    /// How near counts as on it, metres: the tolerance and the roundings.
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

    /// Height of a point over the plane.
    fn height(&self, normal: DVec3, p: DVec3) -> f64 {
        normal.dot(p) - self.offset
    }

    /// From a point to the polygon's nearest point.
    pub fn distance(&self, p: DVec3) -> f64 {
        if let Some(normal) = self.normal
            && self.sides().all(|(u, v)| normal.cross(v - u).dot(p - u) >= 0.0)
        {
            return self.height(normal, p).abs();
        }
        self.sides().map(|(u, v)| to_side(p, u, v)).fold(f64::INFINITY, f64::min)
    }

    /// True if a point is on it, within the tolerance.
    pub fn holds(&self, p: DVec3) -> bool {
        self.distance(p) <= self.reach
    }

    /// Where the segment from `a` along `d` (t in 0..=1) is straight over or under it, within the tolerance.
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

    /// True if the segment from `a` along `d` goes on over or under it where it is no more on it: it leans through the polygon.
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

    /// True only if two points are on one side of its plane, or beyond one side of it, by far more than the tolerance and roundings:
    /// so then is all between them.
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

    /// Where the segment from `a` along `d` (t in 0..=1) is on it, within the tolerance.
    ///
    /// All points within a distance of a convex polygon are a convex body, made of the polygon's prism, a cylinder
    /// around each side and a ball around each corner; the interval is the hull of those inside each part.
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

/// t in 0..=1 with |w + t d| <= r.
fn in_ball(w: DVec3, d: DVec3, r: f64) -> Option<(f64, f64)> {
    let speed = d.length_squared();
    let nearest = if speed > 0.0 { -w.dot(d) / speed } else { 0.0 };
    // Parallel within roundings: the nearest may be anywhere, and it makes no difference where.
    let nearest = if nearest.is_finite() { nearest } else { 0.0 };
    let rest = r * r - (w + d * nearest).length_squared();
    if rest < 0.0 {
        return None;
    }
    let half = (rest / speed).sqrt();
    let t = if half.is_nan() { (0.0, 1.0) } else { ((nearest - half).max(0.0), (nearest + half).min(1.0)) };
    (t.0 <= t.1).then_some(t)
}

/// t in 0..=1 where `w + t d` is within r of the axis from the origin along `side`, between its ends.
fn in_cylinder(w: DVec3, d: DVec3, side: DVec3, r: f64) -> Option<(f64, f64)> {
    let length = side.length();
    if !(length > 0.0) {
        return None;
    }
    let axis = side / length;
    let across = |v: DVec3| v - axis * axis.dot(v);
    let (w_across, d_across) = (across(w), across(d));
    // In line with the axis up to roundings.
    let turned = d_across.length() > 8.0 * f64::EPSILON * d.length();
    let mut t = in_ball(w_across, if turned { d_across } else { DVec3::ZERO }, r)?;
    cut(&mut t, axis.dot(w), axis.dot(d));
    cut(&mut t, length - axis.dot(w), -axis.dot(d));
    (t.0 <= t.1).then_some(t)
}
