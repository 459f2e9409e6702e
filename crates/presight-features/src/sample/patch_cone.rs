//! The directions to a convex patch, and the grid over its image.

use glam::{DVec2, DVec3};
use presight_model::geometry::plane_of_polygon;

/// The directions to a patch, and a box around its image, clipped to the sensor's image; `None` if that is empty.
pub(crate) struct PatchOutline {
    pub cone: PatchCone,
    pub(super) bounds: Option<[DVec2; 2]>,
}

/// A grid over the image of a patch.
pub(super) struct Cells {
    /// Centres of the columns and rows, pixels.
    pub columns: Vec<f64>,
    pub rows: Vec<f64>,
    /// The size of a cell, pixels.
    pub cell: DVec2,
    /// The weight of one sample.
    pub weight: f64,
}

/// The directions to a convex patch, and its plane.
pub(crate) struct PatchCone {
    pub edges: Vec<DVec3>,
    normal: DVec3,
    offset: f64,
}

impl PatchCone {
    /// `None` if the sensor is in the patch's plane.
    pub fn new(corners: &[DVec3]) -> Option<Self> {
        let plane = plane_of_polygon(corners)?;
        let reach = corners.iter().map(|p| p.length()).fold(0.0, f64::max);
        if plane.offset.abs() <= 1e-12 * reach {
            return None;
        }
        let sign = plane.offset.signum();
        let edge = |k: usize| sign * corners[k].cross(corners[(k + 1) % corners.len()] - corners[k]);
        Some(Self { edges: (0..corners.len()).map(edge).collect(), normal: plane.normal, offset: plane.offset })
    }

    /// Its product with a vector is the reciprocal of the factor that scales the vector to the plane.
    pub fn inverse(&self) -> DVec3 {
        self.normal / self.offset
    }

    /// Distance of the plane, metres.
    pub fn distance(&self) -> f64 {
        self.offset.abs()
    }

    /// The range of multiples of `axis` that, added to `part`, may meet the patch; slightly wider than exact.
    pub(super) fn between(&self, part: DVec3, axis: DVec3) -> [f64; 2] {
        let (mut from, mut to) = (f64::NEG_INFINITY, f64::INFINITY);
        for e in &self.edges {
            let (at_0, slope) = (e.dot(part), e.dot(axis));
            let at = -at_0 / slope;
            let slack = 1e-9 * (1.0 + at.abs());
            if slope > 0.0 {
                from = from.max(at - slack);
            } else if slope < 0.0 {
                to = to.min(at + slack);
            }
        }
        [from, to]
    }

    /// The intersection of a ray, extended to any length, with the plane.
    pub(super) fn place(&self, ray: DVec3) -> DVec3 {
        ray / (self.normal.dot(ray) / self.offset)
    }

    /// The intersection of a ray, extended to any length, with the patch.
    pub(super) fn meet(&self, ray: DVec3) -> Option<DVec3> {
        let inverse = self.normal.dot(ray) / self.offset;
        (inverse > 0.0 && self.edges.iter().all(|e| e.dot(ray) >= 0.0)).then(|| ray / inverse)
    }
}
