//! Robust fits of planes to the points on them.

use crate::geometry::Flat;
use glam::{DMat3, DVec3};

/// Normal equations of a correction of a plane: its height over the centre and its two slopes.
#[derive(Clone, Copy)]
pub(crate) struct PlaneFit {
    a: DMat3,
    b: DVec3,
    /// Sum of the weights.
    pub weight: f64,
}

impl PlaneFit {
    /// The equations of no points.
    pub const ZERO: Self = Self { a: DMat3::ZERO, b: DVec3::ZERO, weight: 0.0 };

    /// Adds a point relative to the base of the views. Its weight is halved at the distance `tolerance` from the plane,
    /// metres.
    pub fn add(&mut self, plane: &Flat, p: DVec3, weight: f64, tolerance: f64) {
        let (above, q) = (plane.above(p), plane.place(p));
        let weight = weight / (1.0 + (above / tolerance).powi(2));
        let j = DVec3::new(1.0, q.x, q.y);
        self.a += DMat3::from_cols(j * (weight * j.x), j * (weight * j.y), j * (weight * j.z));
        self.b += j * (weight * above);
        self.weight += weight;
    }

    /// The correction: height over the centre, metres, and slopes along the axes. Weak priors hold it where the points
    /// leave it open, as for the slope across a narrow plane.
    pub fn correction(&self) -> DVec3 {
        let slope = 0.02 * (self.a.y_axis.y + self.a.z_axis.z) + 1e-4;
        (self.a + DMat3::from_diagonal(DVec3::new(1e-6, slope, slope))).inverse() * self.b
    }
}
