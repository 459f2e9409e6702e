//! Query regions: geometry in the world, derived from a sensor and its pose (paper section 2.2).

use super::sector::Sector;
use super::shapes::{
    self, Axes, AxisPermuted, Cuboid, Frustum, Outside, Ray, RotatedShape, SLACK, Segment, Shape, UprightSector, Zone,
};
use crate::error::Result;
use crate::geometry::{Aabb, Pose};
use glam::{DMat3, DVec2, DVec3};
use std::f64::consts::{FRAC_PI_2, TAU};

/// A region of space to query. All regions are closed, and answers are conservative: every box with a point in the
/// region is found, with few others.
#[derive(Clone, Copy, Debug)]
pub struct Region {
    /// Apex or centre, in the world.
    pub(super) origin: DVec3,
    /// Rotates the world's axes into the region's; identity except for sensors that lean.
    pub(super) region_from_world: DMat3,
    pub(super) form: Form,
}

/// Radians. A segment with a larger opening is tested as a full turn, ignoring the gap between the last and the first
/// column of a 360 degree scanner. This saves half of the tests and adds about a hundredth of the polygons.
const NEARLY_ROUND: f64 = 0.99 * TAU;

#[derive(Clone, Copy, Debug)]
pub(super) enum Form {
    Sector(UprightSector),
    Segment(Segment),
    Zone(Zone),
    Frustum(Frustum),
    Outside(Outside),
    Cuboid(Cuboid),
    Ray(Ray),
}

impl Region {
    /// Maximum number of planes of a frustum.
    pub const MAX_PLANES: usize = shapes::MAX_PLANES;

    /// A circular sector of any height: apex in the world's horizontal plane, heading and opening in radians
    /// (counter-clockwise from +x), radius in metres. An opening of a full turn is the whole circle.
    pub fn sector(apex: DVec2, heading: f64, opening: f64, radius: f64) -> Self {
        let form = Form::Sector(UprightSector(Sector::new(heading, opening, radius)));
        Self { origin: apex.extend(0.0), region_from_world: DMat3::IDENTITY, form }
    }

    /// A spherical segment: the directions with azimuth within `opening / 2` of `heading` and elevation (positive up)
    /// in `elevations`, all in the frame of the pose, radians, up to a radius in metres.
    ///
    /// For a level pose, boxes are tested in the world's axes by two sector-rectangle tests in perpendicular planes, as
    /// in the paper. For a leaning pose, boxes are first rotated into its frame.
    ///
    /// # Errors
    /// Those of [`Pose::check`].
    pub fn segment(
        world_from_body: &Pose,
        heading: f64,
        opening: f64,
        elevations: (f64, f64),
        radius: f64,
    ) -> Result<Self> {
        world_from_body.check()?;
        Ok(Self::around(world_from_body, heading, opening, elevations, radius))
    }

    /// [`Region::segment`] for a pose that is already checked.
    fn around(world_from_body: &Pose, heading: f64, opening: f64, elevations: (f64, f64), radius: f64) -> Self {
        let rotation = world_from_body.rotation_matrix();
        // An exact comparison: near the poles the slightest lean turns azimuths by any angle.
        let level = rotation.z_axis == DVec3::Z;
        let (turn, region_from_world) = if level {
            (rotation.x_axis.y.atan2(rotation.x_axis.x), DMat3::IDENTITY)
        } else {
            (0.0, rotation.transpose())
        };
        let (low, high) = elevations;
        let elevation = Sector::new(0.5 * (low + high), high - low + 2.0 * SLACK, radius);
        let form = if opening >= NEARLY_ROUND {
            Form::Zone(Zone(elevation))
        } else {
            Form::Segment(Segment { azimuth: Sector::new(heading + turn, opening + 2.0 * SLACK, radius), elevation })
        };
        Self { origin: world_from_body.translation, region_from_world, form }
    }

    /// A ball around a point: a segment of all directions.
    pub fn ball(center: DVec3, radius: f64) -> Self {
        let pose = Pose { translation: center, ..Pose::IDENTITY };
        Self::around(&pose, 0.0, TAU, (-FRAC_PI_2, FRAC_PI_2), radius)
    }

    /// A pyramid with its apex at `apex`, given by inward unit normals (world axes) of planes through the apex, and a
    /// radius in metres. Planes beyond [`Region::MAX_PLANES`] are ignored, which keeps too much. Without planes: a
    /// ball.
    pub fn frustum(apex: DVec3, normals: &[DVec3], radius: f64) -> Self {
        let form = Form::Frustum(pyramid(normals, radius));
        Self { origin: apex, region_from_world: DMat3::IDENTITY, form }
    }

    /// A ball minus a pyramid: the region of rays that look everywhere except in some directions. Takes the apex,
    /// inward unit normals of the pyramid's planes (world axes, 1 to [`Region::MAX_PLANES`]; with any other number it
    /// is the whole ball) and the ball's radius in metres.
    pub fn outside(apex: DVec3, normals: &[DVec3], radius: f64) -> Self {
        if normals.is_empty() || normals.len() > Self::MAX_PLANES {
            return Self::frustum(apex, &[], radius);
        }
        let form = Form::Outside(Outside { hole: pyramid(normals, f64::INFINITY), radius });
        Self { origin: apex, region_from_world: DMat3::IDENTITY, form }
    }

    /// An axis-aligned box in the world.
    pub fn cuboid(bounds: &Aabb) -> Self {
        let form = Form::Cuboid(Cuboid(bounds.half_extent()));
        Self { origin: bounds.center(), region_from_world: DMat3::IDENTITY, form }
    }

    /// A line segment from `from` along a unit `direction` (world axes) with a length in metres: the boxes that a ray
    /// meets.
    pub fn ray(from: DVec3, direction: DVec3, length: f64) -> Self {
        Self { origin: from, region_from_world: DMat3::IDENTITY, form: Form::Ray(Ray { direction, length }) }
    }

    /// All of space.
    pub fn everything() -> Self {
        Self::frustum(DVec3::ZERO, &[], f64::INFINITY)
    }

    /// Apex or centre in the world, metres (z is 0 for a sector).
    pub fn origin(&self) -> DVec3 {
        self.origin
    }

    /// True if the box (world, metres) has a point in the region; may keep too much, never too little.
    pub fn meets(&self, bounds: &Aabb) -> bool {
        let slack = 4.0 * f64::EPSILON * (bounds.min.abs().max(bounds.max.abs()) + self.origin.abs());
        let b = Aabb { min: bounds.min - self.origin - slack, max: bounds.max - self.origin + slack };
        self.with(BoxTest(b))
    }

    /// True if the point (world, metres) is in the region.
    pub fn contains(&self, p_in_world: DVec3) -> bool {
        self.with(PointTest(p_in_world - self.origin))
    }

    /// Calls a visitor with the shape, compiled for the shape's type.
    #[inline(always)]
    pub(super) fn with<V: ShapeVisitor>(&self, visitor: V) -> V::Out {
        let shape_from_box = self.region_from_world;
        match self.form {
            Form::Sector(shape) => visitor.visit(&shape),
            Form::Segment(shape) if shape_from_box == DMat3::IDENTITY => visitor.visit(&shape),
            Form::Segment(shape) => visitor.visit(&RotatedShape { shape, shape_from_box }),
            Form::Zone(shape) if shape_from_box == DMat3::IDENTITY => visitor.visit(&shape),
            Form::Zone(shape) => visitor.visit(&RotatedShape { shape, shape_from_box }),
            Form::Frustum(shape) => visitor.visit(&shape),
            Form::Outside(shape) => visitor.visit(&shape),
            Form::Cuboid(shape) => visitor.visit(&shape),
            Form::Ray(shape) => visitor.visit(&shape),
        }
    }

    /// [`Region::with`] for boxes of another frame, where `region_from_box` is the linear part of the transform.
    #[inline(always)]
    pub(super) fn with_turned<V: ShapeVisitor>(&self, region_from_box: DMat3, visitor: V) -> V::Out {
        let axes = Axes::of(region_from_box);
        match (self.form, axes) {
            (Form::Sector(shape), Some(axes)) => visit_lying(shape.in_axes(&axes), axes, visitor),
            (Form::Segment(shape), Some(axes)) => visit_lying(shape.in_axes(&axes), axes, visitor),
            (Form::Zone(shape), Some(axes)) => visit_lying(shape.in_axes(&axes), axes, visitor),
            (form, _) => visit_turned(form, region_from_box, visitor),
        }
    }
}

/// Uses at most `MAX_PLANES` planes and ignores the rest.
fn pyramid(normals: &[DVec3], radius: f64) -> Frustum {
    let count = normals.len().min(Region::MAX_PLANES);
    let mut planes = [DVec3::ZERO; Region::MAX_PLANES];
    planes[..count].copy_from_slice(&normals[..count]);
    Frustum { planes, count, radius }
}

#[inline(always)]
fn visit_lying<S: Shape, V: ShapeVisitor>(shape: S, axes: Axes, visitor: V) -> V::Out {
    match axes.up {
        0 => visitor.visit(&AxisPermuted::<S, 0> { shape, axes }),
        1 => visitor.visit(&AxisPermuted::<S, 1> { shape, axes }),
        _ => visitor.visit(&AxisPermuted::<S, 2> { shape, axes }),
    }
}

fn visit_turned<V: ShapeVisitor>(form: Form, region_from_box: DMat3, visitor: V) -> V::Out {
    match form {
        Form::Sector(shape) => visitor.visit(&RotatedShape { shape, shape_from_box: region_from_box }),
        Form::Segment(shape) => visitor.visit(&RotatedShape { shape, shape_from_box: region_from_box }),
        Form::Zone(shape) => visitor.visit(&RotatedShape { shape, shape_from_box: region_from_box }),
        Form::Frustum(shape) => visitor.visit(&shape.turned(region_from_box)),
        Form::Outside(shape) => visitor.visit(&RotatedShape { shape, shape_from_box: region_from_box }),
        Form::Cuboid(shape) => visitor.visit(&RotatedShape { shape, shape_from_box: region_from_box }),
        Form::Ray(shape) => visitor.visit(&shape.turned(region_from_box)),
    }
}

impl Region {
    /// A box in the world that contains the region; infinite where the region is unbounded.
    pub fn bounds(&self) -> Aabb {
        let around = |half: DVec3| Aabb { min: self.origin - half, max: self.origin + half };
        match self.form {
            Form::Sector(UprightSector(s)) => around(DVec3::new(s.radius(), s.radius(), f64::INFINITY)),
            Form::Segment(s) => around(DVec3::splat(s.azimuth.radius())),
            Form::Zone(Zone(s)) => around(DVec3::splat(s.radius())),
            Form::Frustum(f) => around(DVec3::splat(f.radius)),
            Form::Outside(o) => around(DVec3::splat(o.radius)),
            Form::Cuboid(c) => around(c.0),
            Form::Ray(r) => Aabb::of([self.origin, self.origin + r.length * r.direction]),
        }
    }
}

/// An operation on any shape.
pub(super) trait ShapeVisitor {
    /// The result.
    type Out;
    fn visit<S: Shape>(self, shape: &S) -> Self::Out;
}

struct BoxTest(Aabb);

impl ShapeVisitor for BoxTest {
    type Out = bool;

    fn visit<S: Shape>(self, shape: &S) -> bool {
        shape.meets(&self.0)
    }
}

struct PointTest(DVec3);

impl ShapeVisitor for PointTest {
    type Out = bool;

    fn visit<S: Shape>(self, shape: &S) -> bool {
        shape.contains(self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn around(p: DVec3) -> Aabb {
        Aabb::of([p - 0.1, p + 0.1])
    }

    #[test]
    fn a_ball_without_a_pyramid_leaves_out_what_is_behind() {
        let all_but_behind = Region::outside(DVec3::ZERO, &[DVec3::NEG_X], 10.0);
        assert!(all_but_behind.meets(&around(DVec3::X)) && all_but_behind.meets(&around(DVec3::Y)));
        assert!(!all_but_behind.meets(&around(DVec3::NEG_X)) && !all_but_behind.meets(&around(DVec3::X * 11.0)));
    }

    #[test]
    fn a_ray_meets_the_boxes_on_its_way() {
        let ray = Region::ray(DVec3::ZERO, DVec3::X, 10.0);
        assert!(ray.meets(&around(DVec3::X * 10.05)));
        assert!(!ray.meets(&around(DVec3::X * 10.2)) && !ray.meets(&around(DVec3::new(5.0, 0.2, 0.0))));
        assert!(!ray.meets(&around(DVec3::X * -0.2)));
    }
}
