//! Circular sector against rectangle: the basic test of every query (paper section 2.2).

use glam::{DMat2, DVec2};
use std::f64::consts::{PI, TAU};

/// A rectangle relative to the sector's apex.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rect {
    /// Minimum corner, metres.
    pub min: DVec2,
    /// Maximum corner, metres.
    pub max: DVec2,
}

/// All points within `radius` of the apex (the origin) whose direction is within half the opening of the heading.
/// Closed: rectangles that touch it meet it.
#[derive(Clone, Copy, Debug)]
pub struct Sector {
    wedge: Wedge,
    complement: Wedge,
    radius: f64,
}

/// The directions of a sector.
#[derive(Clone, Copy, Debug)]
struct Wedge {
    heading: DVec2,
    /// The clockwise and the counter-clockwise side, unit vectors.
    from: Side,
    to: Side,
    whole: bool,
    /// Wider than half a turn, so that its complement is the convex one.
    reflex: bool,
}

#[derive(Clone, Copy, Debug)]
struct Side {
    direction: DVec2,
    inverse: DVec2,
}

/// Relative rounding errors of the products below. Rectangles that miss by less are kept.
const SLACK: f64 = 8.0 * f64::EPSILON;

impl Sector {
    /// Heading and opening in radians, radius in metres; an opening of a full turn or more is the whole circle. The
    /// radius may be infinite.
    pub fn new(heading: f64, opening: f64, radius: f64) -> Self {
        let whole = opening >= TAU;
        let wedge = Wedge::new(heading, opening.clamp(0.0, TAU), whole);
        Self { wedge, complement: Wedge::new(heading + PI, TAU - opening.clamp(0.0, TAU), false), radius }
    }

    /// This sector in a plane with other axes: `turn` is a rotation or reflection that maps directions to it, and
    /// `scale` is the length there of a metre here.
    pub(super) fn in_axes(&self, turn: DMat2, scale: f64) -> Self {
        let mirrored = turn.determinant() < 0.0;
        let wedge = self.wedge.in_axes(turn, mirrored);
        Self { wedge, complement: self.complement.in_axes(turn, mirrored), radius: self.radius * scale }
    }

    /// Metres.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// True if the point is in the sector.
    pub fn contains(&self, p: DVec2) -> bool {
        p.length_squared() <= self.radius * self.radius && self.wedge.contains(p)
    }

    /// True if the rectangle has a point in the sector; rounding may also keep a rectangle that just misses.
    ///
    /// If the rectangle's point nearest to the apex is in the sector, it is a witness. If that point is too far, so are
    /// all others. Otherwise, moving any witness towards that nearest point only brings it closer to the apex, until it
    /// crosses a side of the sector: then a side meets the rectangle within the radius. This holds for every opening.
    #[inline(always)]
    pub fn meets(&self, r: &Rect) -> bool {
        let q = DVec2::new(nearest(r.min.x, r.max.x), nearest(r.min.y, r.max.y));
        let near = q.length_squared() <= self.radius * self.radius * (1.0 + SLACK);
        let w = &self.wedge;
        near & (w.contains(q) | w.from.hits(r, self.radius) | w.to.hits(r, self.radius))
    }

    /// True if all of the rectangle is in the sector. Rounding may turn true into false.
    #[inline(always)]
    pub fn covers(&self, r: &Rect) -> bool {
        let far = r.min.abs().max(r.max.abs());
        if far.length_squared() > self.radius * self.radius {
            return false;
        }
        let c = &self.complement;
        let q = DVec2::new(nearest(r.min.x, r.max.x), nearest(r.min.y, r.max.y));
        self.wedge.whole | !(c.contains(q) | c.from.hits(r, f64::INFINITY) | c.to.hits(r, f64::INFINITY))
    }
}

impl Wedge {
    fn new(heading: f64, opening: f64, whole: bool) -> Self {
        let side = |angle: f64| Side::new(DVec2::from_angle(angle));
        Self {
            heading: DVec2::from_angle(heading),
            from: side(heading - 0.5 * opening),
            to: side(heading + 0.5 * opening),
            whole,
            reflex: opening > PI,
        }
    }

    fn in_axes(&self, turn: DMat2, mirrored: bool) -> Self {
        let side = |s: Side| Side::new(turn * s.direction);
        let (from, to) = if mirrored { (self.to, self.from) } else { (self.from, self.to) };
        Self { heading: turn * self.heading, from: side(from), to: side(to), ..*self }
    }

    #[inline(always)]
    fn contains(&self, q: DVec2) -> bool {
        let slack = -SLACK * (q.x.abs() + q.y.abs());
        let left = self.from.direction.perp_dot(q) >= slack;
        let right = q.perp_dot(self.to.direction) >= slack;
        let ahead = self.heading.dot(q) >= slack;
        self.whole | (self.reflex & (left | right)) | (left & right & ahead)
    }
}

impl Side {
    fn new(direction: DVec2) -> Self {
        // A component of 0 would give 0 * infinity in the slab test; this value leads to the same decision.
        let inverse = |d: f64| if d.abs() < 1e-300 { 1e300f64.copysign(d) } else { 1.0 / d };
        Self { direction, inverse: DVec2::new(inverse(direction.x), inverse(direction.y)) }
    }

    /// True if the ray from the apex along this side meets the rectangle within the radius (slab test).
    #[inline(always)]
    fn hits(&self, r: &Rect, radius: f64) -> bool {
        let (a, b) = (r.min * self.inverse, r.max * self.inverse);
        let enter = greater(greater(lesser(a.x, b.x), lesser(a.y, b.y)), 0.0);
        let exit = lesser(lesser(greater(a.x, b.x), greater(a.y, b.y)), radius);
        enter <= exit * (1.0 + SLACK)
    }
}

/// The coordinate nearest to 0 in an interval.
#[inline(always)]
fn nearest(min: f64, max: f64) -> f64 {
    lesser(greater(0.0, min), max)
}

// Unlike f64::min and max, these are one instruction each. No operand here is NaN.
#[inline(always)]
pub(super) fn lesser(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

#[inline(always)]
pub(super) fn greater(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Two closed sets with piecewise smooth borders meet if and only if one of these points is in both: a corner of
    /// the rectangle, the apex, an end of the arc, or a crossing of their borders.
    fn oracle(heading: f64, opening: f64, radius: f64, r: &Rect, slack: f64) -> bool {
        let in_rect = |p: DVec2| p.cmpge(r.min - slack).all() && p.cmple(r.max + slack).all();
        let in_sector = |p: DVec2| {
            let off = (p.to_angle() - heading + PI).rem_euclid(TAU) - PI;
            // An angle of slack / |p| is a distance of slack.
            p.length() <= radius + slack && (off.abs() * p.length() <= 0.5 * opening * p.length() + slack)
        };
        let (a, b) = (r.min, r.max);
        let corners = [a, DVec2::new(b.x, a.y), b, DVec2::new(a.x, b.y)];
        let ends = [-0.5, 0.5].map(|s| DVec2::from_angle(heading + s * opening));
        let mut points = corners.to_vec();
        points.push(DVec2::ZERO);
        points.extend(ends.map(|e| e * radius));
        for (axis, other) in [(0, 1), (1, 0)] {
            for bound in [a[axis], b[axis]] {
                for end in ends {
                    points.push(end * (bound / end[axis]));
                }
                let root = (radius * radius - bound * bound).sqrt();
                for root in [root, -root] {
                    let mut p = DVec2::ZERO;
                    (p[axis], p[other]) = (bound, root);
                    points.push(p);
                }
            }
        }
        points.into_iter().any(|p| p.is_finite() && in_rect(p) && in_sector(p))
    }

    fn coordinate() -> impl Strategy<Value = f64> {
        prop_oneof![(-8..8i32).prop_map(f64::from), -8.0..8.0f64, -0.01..0.01f64]
    }

    fn angle() -> impl Strategy<Value = f64> {
        prop_oneof![(-8..8i32).prop_map(|i| f64::from(i) * PI / 4.0), -4.0..4.0f64]
    }

    fn rect() -> impl Strategy<Value = Rect> {
        let size = prop_oneof![Just(0.0), 0.0..6.0f64, (0..4u32).prop_map(f64::from), Just(100.0)];
        (coordinate(), coordinate(), size.clone(), size)
            .prop_map(|(x, y, w, h)| Rect { min: DVec2::new(x, y), max: DVec2::new(x + w, y + h) })
    }

    fn opening() -> impl Strategy<Value = f64> {
        prop_oneof![Just(0.0), 0.0..TAU, (0..9u32).prop_map(|i| f64::from(i) * PI / 4.0), Just(1e-7)]
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(20_000))]

        /// Exact to 1e-9 m in both directions.
        #[test]
        fn meets_agrees_with_witness_points(
            r in rect(),
            heading in angle(),
            opening in opening(),
            radius in 0.01..9.0f64,
        ) {
            let met = Sector::new(heading, opening, radius).meets(&r);
            if oracle(heading, opening, radius, &r, -1e-9) {
                prop_assert!(met);
            }
            if met {
                prop_assert!(oracle(heading, opening, radius, &r, 1e-9));
            }
        }

        /// A covered rectangle has all its points inside, and one with all points well inside is covered.
        #[test]
        fn covers_as_points_say(r in rect(), heading in angle(), opening in opening(), radius in 0.01..9.0f64) {
            let sector = Sector::new(heading, opening, radius);
            let points = || (0..=8).flat_map(|i| (0..=8).map(move |j| (i, j))).map(|(i, j)| {
                r.min + (r.max - r.min) * DVec2::new(f64::from(i), f64::from(j)) / 8.0
            });
            if sector.covers(&r) {
                prop_assert!(points().all(|p| sector.contains(p)));
                prop_assert!(sector.meets(&r));
            } else if opening >= TAU {
                prop_assert!(points().any(|p| p.length() >= radius));
            }
        }

        #[test]
        fn every_point_inside_is_met(p in (coordinate(), coordinate()), heading in angle(), opening in opening()) {
            let (p, sector) = (DVec2::new(p.0, p.1), Sector::new(heading, opening, 20.0));
            prop_assert_eq!(sector.contains(p), sector.meets(&Rect { min: p, max: p }));
        }
    }

    fn at(x: f64, y: f64, half: f64) -> Rect {
        Rect { min: DVec2::new(x - half, y - half), max: DVec2::new(x + half, y + half) }
    }

    #[test]
    fn cases_by_hand() {
        let quarter = Sector::new(0.0, PI / 2.0, 10.0);
        assert!(quarter.meets(&at(0.0, 0.0, 1.0)), "apex inside");
        assert!(quarter.meets(&at(-1.0, 0.0, 1.0)), "apex on an edge");
        assert!(quarter.meets(&at(-1.0, -1.0, 1.0)), "apex on a corner");
        assert!(!quarter.meets(&at(-2.0, 0.0, 1.0)), "behind");
        assert!(quarter.meets(&at(11.0, 0.0, 1.0)), "touching the arc");
        assert!(!quarter.meets(&at(11.000_001, 0.0, 1.0)));
        assert!(quarter.meets(&at(1.0, 3.0, 1.0)), "touching a side with a corner");
        assert!(!quarter.meets(&at(1.0, 3.000_001, 1.0)));
        assert!(quarter.covers(&at(5.0, 0.0, 1.0)) && !quarter.covers(&at(5.0, 4.5, 1.0)));
        let wide = Sector::new(0.0, 1.5 * PI, 10.0);
        assert!(wide.meets(&at(-2.0, 2.5, 1.0)) && !wide.meets(&at(-4.0, 0.0, 1.0)), "over 180 degrees");
        assert!(!wide.covers(&at(-2.0, 2.5, 1.0)) && wide.covers(&at(-2.0, 4.5, 1.0)));
        let ring = Rect { min: DVec2::new(-1.0, -20.0), max: DVec2::new(1.0, 20.0) };
        assert!(!wide.covers(&ring) && Sector::new(0.0, TAU, 30.0).covers(&ring));
        assert!(Sector::new(1.0, 0.0, f64::INFINITY).meets(&at(1e6, 1e6 * 1f64.tan(), 1.0)), "no reach, no opening");
    }
}
