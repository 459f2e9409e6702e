//! Axis-aligned boxes.

use glam::{DAffine3, DVec3};

/// An axis-aligned box; empty when `min > max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Minimum corner, metres.
    pub min: DVec3,
    /// Maximum corner, metres.
    pub max: DVec3,
}

impl Aabb {
    /// The box without points.
    pub const EMPTY: Self = Self { min: DVec3::INFINITY, max: DVec3::NEG_INFINITY };

    /// The smallest box around points.
    pub fn of(points: impl IntoIterator<Item = DVec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, Self::with)
    }

    /// The smallest box around this one and a point.
    #[must_use]
    #[inline]
    pub fn with(self, p: DVec3) -> Self {
        Self { min: self.min.min(p), max: self.max.max(p) }
    }

    /// The smallest box around this one and another.
    #[must_use]
    #[inline]
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// True if the box contains no point.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.min.cmpgt(self.max).any()
    }

    /// The middle.
    #[inline]
    pub fn center(&self) -> DVec3 {
        0.5 * (self.min + self.max)
    }

    /// Half the extent along each axis.
    #[inline]
    pub fn half_extent(&self) -> DVec3 {
        0.5 * (self.max - self.min)
    }

    /// Length of the diagonal. Tolerances use it as the size of an object.
    pub fn size(&self) -> f64 {
        if self.is_empty() { 0.0 } else { (self.max - self.min).length() }
    }

    /// Squared distance from a point to the box; 0 inside.
    pub fn distance_squared(&self, p: DVec3) -> f64 {
        (self.min - p).max(p - self.max).max(DVec3::ZERO).length_squared()
    }

    /// The box around this box after a transform.
    #[must_use]
    pub fn transformed(&self, a_from_b: &DAffine3) -> Self {
        if self.is_empty() {
            return Self::EMPTY;
        }
        let center = a_from_b.transform_point3(self.center());
        let m = a_from_b.matrix3;
        let h = self.half_extent();
        let half = m.x_axis.abs() * h.x + m.y_axis.abs() * h.y + m.z_axis.abs() * h.z;
        Self { min: center - half, max: center + half }
    }
}
