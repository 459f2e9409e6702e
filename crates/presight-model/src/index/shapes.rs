//! The forms of regions, relative to their origin.

use super::sector::{Rect, Sector, greater, lesser};
use crate::geometry::Aabb;
use glam::{DMat2, DMat3, DVec2, DVec3};

/// Maximum number of planes of a frustum.
pub(super) const MAX_PLANES: usize = 6;

/// Margin of angles, radians: a region may hold too much, never too little.
pub(super) const SLACK: f64 = 1e-9;

/// Tests of a region against boxes relative to its origin.
pub trait Shape: Copy + Sync {
    /// True if the box has a point in it; may keep too much.
    fn meets(&self, b: &Aabb) -> bool;
    /// True only if all of the box is in it, up to rounding.
    fn covers(&self, b: &Aabb) -> bool;
    /// True if the point is in it.
    fn contains(&self, p: DVec3) -> bool;
    /// Lower bound of the distance of the box from the origin, metres.
    #[inline(always)]
    fn distance(&self, b: &Aabb) -> f64 {
        nearest_squared(b).sqrt() * (1.0 - 8.0 * f64::EPSILON)
    }
}

/// A circular sector of any height.
#[derive(Clone, Copy, Debug)]
pub(super) struct UprightSector(pub Sector);

/// Directions between two azimuths and two elevations, up to a radius: two sectors in perpendicular planes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Segment {
    pub azimuth: Sector,
    /// In the half plane of horizontal distance and height.
    pub elevation: Sector,
}

/// A segment with all azimuths. It needs half of the tests, and scanners with a full turn are common.
#[derive(Clone, Copy, Debug)]
pub(super) struct Zone(
    /// In the half plane of horizontal distance and height.
    pub Sector,
);

/// A pyramid of rays: inward normals of planes through the apex, and a radius.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frustum {
    pub planes: [DVec3; MAX_PLANES],
    pub count: usize,
    pub radius: f64,
}

/// A ball minus a pyramid of directions.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outside {
    /// Its radius is ignored.
    pub hole: Frustum,
    pub radius: f64,
}

/// A box around the origin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cuboid(pub DVec3);

/// A line segment from the origin: parameters 0 to `length` along `direction`, which need not be a unit vector.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    pub direction: DVec3,
    pub length: f64,
}

impl Ray {
    /// The parameter is the same in any linear frame.
    pub fn turned(&self, shape_from_box: DMat3) -> Self {
        Self { direction: shape_from_box.inverse() * self.direction, length: self.length }
    }
}

/// A shape whose axes are rotated (or scaled) relative to the axes of the boxes.
#[derive(Clone, Copy, Debug)]
pub(super) struct RotatedShape<S> {
    pub shape: S,
    pub shape_from_box: DMat3,
}

/// A frustum whose axes are rotated relative to the axes of the boxes.
#[derive(Clone, Copy, Debug)]
pub(super) struct RotatedFrustum {
    planes: Frustum,
    ball: RotatedShape<Frustum>,
}

/// A shape for boxes with one vertical axis. Axis `UP` of a box is the shape's vertical, so the rotation is exact.
#[derive(Clone, Copy, Debug)]
pub(super) struct AxisPermuted<S, const UP: usize> {
    pub shape: S,
    pub axes: Axes,
}

/// The orientation of a box's axes in a region, if one of them is vertical and the scale is uniform.
#[derive(Clone, Copy, Debug)]
pub(super) struct Axes {
    /// The axis of the box that is the region's z, up or down.
    pub up: usize,
    down: bool,
    /// Maps the region's horizontal directions to the box's other two axes, in cyclic order.
    box_from_region: DMat2,
    /// Metres per unit of the box.
    scale: f64,
}

impl Axes {
    /// `None` for any other matrix.
    pub fn of(region_from_box: DMat3) -> Option<Self> {
        /// A few rounding errors of a rotation's elements.
        const NOTHING: f64 = 8.0 * f64::EPSILON;
        let m = region_from_box.to_cols_array_2d();
        let scale = region_from_box.x_axis.length();
        let is = |value: f64, wanted: f64| (value - wanted).abs() <= NOTHING * scale;
        let up = (0..3).find(|k| is(m[*k][2].abs(), scale))?;
        let (i, j) = ((up + 1) % 3, (up + 2) % 3);
        let flat = is(m[up][0], 0.0) && is(m[up][1], 0.0) && is(m[i][2], 0.0) && is(m[j][2], 0.0);
        let (a, b) = (DVec2::new(m[i][0], m[i][1]), DVec2::new(m[j][0], m[j][1]));
        let even = is(a.length(), scale) && is(b.length(), scale) && (a.dot(b) / scale).abs() <= NOTHING * scale;
        let box_from_region = DMat2::from_cols(a, b).transpose() * (1.0 / scale);
        (flat && even).then_some(Self { up, down: m[up][2] < 0.0, box_from_region, scale })
    }
}

impl<S: Shape, const UP: usize> AxisPermuted<S, UP> {
    /// The box with its vertical axis last.
    #[inline(always)]
    fn stand(&self, b: &Aabb) -> Aabb {
        let (min, max) = (b.min.to_array(), b.max.to_array());
        let (i, j) = ((UP + 1) % 3, (UP + 2) % 3);
        let (low, high) = if self.axes.down { (-max[UP], -min[UP]) } else { (min[UP], max[UP]) };
        Aabb { min: DVec3::new(min[i], min[j], low), max: DVec3::new(max[i], max[j], high) }
    }
}

impl<S: Shape, const UP: usize> Shape for AxisPermuted<S, UP> {
    #[inline(always)]
    fn meets(&self, b: &Aabb) -> bool {
        self.shape.meets(&self.stand(b))
    }

    #[inline(always)]
    fn covers(&self, b: &Aabb) -> bool {
        self.shape.covers(&self.stand(b))
    }

    fn contains(&self, p: DVec3) -> bool {
        self.shape.contains(self.stand(&Aabb { min: p, max: p }).min)
    }

    #[inline(always)]
    fn distance(&self, b: &Aabb) -> f64 {
        self.shape.distance(&self.stand(b)) * self.axes.scale * (1.0 - 64.0 * f64::EPSILON)
    }
}

#[inline(always)]
fn horizontal(b: &Aabb) -> Rect {
    Rect { min: b.min.truncate(), max: b.max.truncate() }
}

impl UprightSector {
    pub fn in_axes(&self, axes: &Axes) -> Self {
        Self(self.0.in_axes(axes.box_from_region, 1.0 / axes.scale))
    }
}

impl Shape for UprightSector {
    #[inline(always)]
    fn meets(&self, b: &Aabb) -> bool {
        self.0.meets(&horizontal(b))
    }

    #[inline(always)]
    fn covers(&self, b: &Aabb) -> bool {
        self.0.covers(&horizontal(b))
    }

    fn contains(&self, p: DVec3) -> bool {
        self.0.contains(p.truncate())
    }

    /// Ignores heights: the origin of a sector has none.
    #[inline(always)]
    fn distance(&self, b: &Aabb) -> f64 {
        let flat = |p: DVec3| p.truncate().extend(0.0);
        nearest_squared(&Aabb { min: flat(b.min), max: flat(b.max) }).sqrt() * (1.0 - 8.0 * f64::EPSILON)
    }
}

impl Segment {
    pub fn in_axes(&self, axes: &Axes) -> Self {
        let scale = 1.0 / axes.scale;
        Self {
            azimuth: self.azimuth.in_axes(axes.box_from_region, scale),
            elevation: self.elevation.in_axes(DMat2::IDENTITY, scale),
        }
    }

    /// The horizontal distances and the heights of a box, for its elevation test.
    #[inline(always)]
    fn upright(b: &Aabb) -> Rect {
        let gap = |min: f64, max: f64| greater(greater(min, -max), 0.0);
        let far = |min: f64, max: f64| greater(-min, max);
        let (gx, gy) = (gap(b.min.x, b.max.x), gap(b.min.y, b.max.y));
        let (fx, fy) = (far(b.min.x, b.max.x), far(b.min.y, b.max.y));
        let (near, far) = ((gx * gx + gy * gy).sqrt(), (fx * fx + fy * fy).sqrt());
        let slack = 4.0 * f64::EPSILON;
        Rect { min: DVec2::new(near * (1.0 - slack), b.min.z), max: DVec2::new(far * (1.0 + slack), b.max.z) }
    }
}

impl Zone {
    pub fn in_axes(&self, axes: &Axes) -> Self {
        Self(self.0.in_axes(DMat2::IDENTITY, 1.0 / axes.scale))
    }
}

impl Shape for Zone {
    #[inline(always)]
    fn meets(&self, b: &Aabb) -> bool {
        self.0.meets(&Segment::upright(b))
    }

    #[inline(always)]
    fn covers(&self, b: &Aabb) -> bool {
        self.0.covers(&Segment::upright(b))
    }

    fn contains(&self, p: DVec3) -> bool {
        self.0.contains(DVec2::new(p.truncate().length(), p.z))
    }
}

impl Shape for Segment {
    #[inline(always)]
    fn meets(&self, b: &Aabb) -> bool {
        self.azimuth.meets(&horizontal(b)) & self.elevation.meets(&Self::upright(b))
    }

    #[inline(always)]
    fn covers(&self, b: &Aabb) -> bool {
        self.azimuth.covers(&horizontal(b)) && self.elevation.covers(&Self::upright(b))
    }

    fn contains(&self, p: DVec3) -> bool {
        let flat = p.truncate();
        self.azimuth.contains(flat) && self.elevation.contains(DVec2::new(flat.length(), p.z))
    }
}

/// Maximum squared distance from the origin to a point of the box.
#[inline(always)]
fn farthest_squared(b: &Aabb) -> f64 {
    b.min.abs().max(b.max.abs()).length_squared()
}

#[inline(always)]
fn nearest_squared(b: &Aabb) -> f64 {
    let gap = |min: f64, max: f64| greater(greater(min, -max), 0.0);
    let g = DVec3::new(gap(b.min.x, b.max.x), gap(b.min.y, b.max.y), gap(b.min.z, b.max.z));
    g.length_squared()
}

impl Shape for Frustum {
    #[inline(always)]
    fn meets(&self, b: &Aabb) -> bool {
        let mut met = nearest_squared(b) <= self.radius * self.radius * (1.0 + 8.0 * f64::EPSILON);
        for n in &self.planes[..self.count] {
            // The corner farthest along the normal.
            let reach = greater(n.x * b.min.x, n.x * b.max.x)
                + greater(n.y * b.min.y, n.y * b.max.y)
                + greater(n.z * b.min.z, n.z * b.max.z);
            let size = greater(-b.min.x, b.max.x) + greater(-b.min.y, b.max.y) + greater(-b.min.z, b.max.z);
            met &= reach >= -SLACK * size.abs();
        }
        met
    }

    #[inline(always)]
    fn covers(&self, b: &Aabb) -> bool {
        farthest_squared(b) <= self.radius * self.radius
            && self.planes[..self.count].iter().all(|n| {
                let least = lesser(n.x * b.min.x, n.x * b.max.x)
                    + lesser(n.y * b.min.y, n.y * b.max.y)
                    + lesser(n.z * b.min.z, n.z * b.max.z);
                least >= 0.0
            })
    }

    fn contains(&self, p: DVec3) -> bool {
        p.length_squared() <= self.radius * self.radius && self.planes[..self.count].iter().all(|n| n.dot(p) >= 0.0)
    }
}

impl Frustum {
    /// Rotates the planes exactly, whereas rotated boxes grow.
    pub fn turned(&self, shape_from_box: DMat3) -> RotatedFrustum {
        let box_from_normal = shape_from_box.transpose();
        let planes = self.planes.map(|n| (box_from_normal * n).normalize_or_zero());
        let ball = Self { count: 0, ..*self };
        RotatedFrustum {
            planes: Self { planes, radius: f64::INFINITY, ..*self },
            ball: RotatedShape { shape: ball, shape_from_box },
        }
    }
}

impl Shape for RotatedFrustum {
    #[inline(always)]
    fn meets(&self, b: &Aabb) -> bool {
        self.planes.meets(b) & self.ball.meets(b)
    }

    #[inline(always)]
    fn covers(&self, b: &Aabb) -> bool {
        self.planes.covers(b) && self.ball.covers(b)
    }

    fn contains(&self, p: DVec3) -> bool {
        self.planes.contains(p) && self.ball.contains(p)
    }

    #[inline(always)]
    fn distance(&self, b: &Aabb) -> f64 {
        self.ball.distance(b)
    }
}

impl Shape for Outside {
    #[inline(always)]
    fn meets(&self, b: &Aabb) -> bool {
        nearest_squared(b) <= self.radius * self.radius * (1.0 + 8.0 * f64::EPSILON) && !self.hole.covers(b)
    }

    #[inline(always)]
    fn covers(&self, b: &Aabb) -> bool {
        farthest_squared(b) <= self.radius * self.radius && !self.hole.meets(b)
    }

    fn contains(&self, p: DVec3) -> bool {
        p.length_squared() <= self.radius * self.radius && !self.hole.contains(p)
    }
}

impl Shape for Cuboid {
    #[inline(always)]
    fn meets(&self, b: &Aabb) -> bool {
        let h = self.0;
        (b.min.x <= h.x)
            & (b.max.x >= -h.x)
            & (b.min.y <= h.y)
            & (b.max.y >= -h.y)
            & (b.min.z <= h.z)
            & (b.max.z >= -h.z)
    }

    #[inline(always)]
    fn covers(&self, b: &Aabb) -> bool {
        b.min.cmpge(-self.0).all() && b.max.cmple(self.0).all()
    }

    fn contains(&self, p: DVec3) -> bool {
        p.abs().cmple(self.0).all()
    }
}

impl Shape for Ray {
    /// Slab test, with the box grown by the rounding of the rotated direction at the box's far corner.
    #[inline(always)]
    fn meets(&self, b: &Aabb) -> bool {
        let far = greater(greater(-b.min.x, b.max.x), greater(greater(-b.min.y, b.max.y), greater(-b.min.z, b.max.z)));
        let slack = 64.0 * f64::EPSILON * far.abs();
        let (mut from, mut to) = (0.0f64, self.length * (1.0 + 64.0 * f64::EPSILON));
        for k in 0..3 {
            let (low, high, d) = (b.min[k] - slack, b.max[k] + slack, self.direction[k]);
            if d == 0.0 {
                if low > 0.0 || high < 0.0 {
                    return false;
                }
                continue;
            }
            let (s, t) = (low / d, high / d);
            (from, to) = (from.max(s.min(t)), to.min(s.max(t)));
        }
        // Written so that NaN (an infinite box, an overflow) keeps the box.
        !(from * (1.0 - 64.0 * f64::EPSILON) > to * (1.0 + 64.0 * f64::EPSILON))
    }

    #[inline(always)]
    fn covers(&self, _: &Aabb) -> bool {
        false
    }

    fn contains(&self, p: DVec3) -> bool {
        let t = p.dot(self.direction) / self.direction.length_squared();
        (0.0..=self.length).contains(&t) && p.distance(t * self.direction) <= SLACK * p.length()
    }

    /// 0 is always a lower bound. Boxes of other frames have other units.
    #[inline(always)]
    fn distance(&self, _: &Aabb) -> f64 {
        0.0
    }
}

impl<S: Shape> RotatedShape<S> {
    /// The box around the rotated box.
    #[inline(always)]
    pub fn turn(&self, b: &Aabb) -> Aabb {
        let m = &self.shape_from_box;
        let (center, half) = (0.5 * (b.min + b.max), 0.5 * (b.max - b.min));
        let c = m.x_axis * center.x + m.y_axis * center.y + m.z_axis * center.z;
        let h = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
        // Covers the rounding of the sums and of the matrix elements (a unit quaternion is off by one to a few eps).
        let slack = 64.0 * f64::EPSILON * (c.abs() + h + (c.x.abs() + c.y.abs() + c.z.abs()));
        Aabb { min: c - h - slack, max: c + h + slack }
    }
}

impl<S: Shape> Shape for RotatedShape<S> {
    #[inline(always)]
    fn meets(&self, b: &Aabb) -> bool {
        self.shape.meets(&self.turn(b))
    }

    #[inline(always)]
    fn covers(&self, b: &Aabb) -> bool {
        self.shape.covers(&self.turn(b))
    }

    fn contains(&self, p: DVec3) -> bool {
        self.shape.contains(self.shape_from_box * p)
    }

    #[inline(always)]
    fn distance(&self, b: &Aabb) -> f64 {
        self.shape.distance(&self.turn(b))
    }
}
