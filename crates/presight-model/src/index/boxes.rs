//! Boxes in f32, rounded outward, tested eight at a time: what indexes are made of.

use super::shapes::Shape;
use crate::geometry::Aabb;
use glam::DVec3;

/// Lanes of a test.
pub const LANES: usize = 8;

/// A box in f32 relative to an origin; contains the box from which it was made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Box32 {
    /// Minimum corner, metres.
    pub min: [f32; 3],
    /// Maximum corner, metres.
    pub max: [f32; 3],
}

impl Box32 {
    /// Holds nothing, and meets nothing.
    pub const EMPTY: Self = Self { min: [f32::INFINITY; 3], max: [f32::NEG_INFINITY; 3] };

    /// The box in the world, relative to an origin. Rounds outward, including the rounding of the subtraction.
    pub fn around(b: &Aabb, origin: DVec3) -> Self {
        let slack = 2.0 * f64::EPSILON * (b.min.abs().max(b.max.abs()) + origin.abs());
        let (min, max) = (b.min - origin - slack, b.max - origin + slack);
        Self { min: min.to_array().map(down), max: max.to_array().map(up) }
    }

    /// The box in the world, rounded outward.
    pub fn in_world(&self, origin: DVec3) -> Aabb {
        let wide = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
        let (min, max) = (wide(self.min) + origin, wide(self.max) + origin);
        let slack = f64::EPSILON * (min.abs().max(max.abs()) + origin.abs());
        Aabb { min: min - slack, max: max + slack }
    }

    /// Twice the centre on one axis; splits compare this.
    #[inline]
    pub fn middle(&self, axis: usize) -> f32 {
        self.min[axis] + self.max[axis]
    }

    /// The smallest box that holds both.
    #[inline]
    pub fn union(&self, other: &Self) -> Self {
        let mut all = *self;
        for k in 0..3 {
            all.min[k] = all.min[k].min(other.min[k]);
            all.max[k] = all.max[k].max(other.max[k]);
        }
        all
    }

    /// True if all of the other box is in this one.
    #[inline]
    pub fn holds(&self, other: &Self) -> bool {
        (0..3).all(|k| self.min[k] <= other.min[k] && self.max[k] >= other.max[k])
    }
}

/// The next f32 at or below a number.
pub(super) fn down(x: f64) -> f32 {
    let near = x as f32;
    if f64::from(near) > x { near.next_down() } else { near }
}

/// The next f32 at or above a number.
pub(super) fn up(x: f64) -> f32 {
    let near = x as f32;
    if f64::from(near) < x { near.next_up() } else { near }
}

/// The offset from the boxes' origin to the region's, which moves boxes into the region's frame.
#[derive(Clone, Copy, Debug)]
pub struct Shift {
    low: DVec3,
    high: DVec3,
    /// For indexes of two axes: the overall heights, used in place of a box's own.
    flat: Option<(f64, f64)>,
}

impl Shift {
    /// The offset between the two origins, with the rounding of the sums below added outward.
    pub fn new(origin: DVec3, region_origin: DVec3, reach: &Box32, axes: usize) -> Self {
        let by = origin - region_origin;
        let far = (0..3).map(|k| reach.min[k].abs().max(reach.max[k].abs())).fold(0.0, f32::max);
        let far = if far.is_finite() { f64::from(far) } else { 0.0 };
        let slack = 2.0 * f64::EPSILON * (origin.abs() + region_origin.abs() + far);
        let (low, high) = (by - slack, by + slack);
        let flat = (axes == 2).then(|| (f64::from(reach.min[2]) + low.z, f64::from(reach.max[2]) + high.z));
        Self { low, high, flat }
    }

    /// This offset for boxes grown by a slack on all sides.
    #[must_use]
    pub(super) fn grown(self, slack: f64) -> Self {
        Self { low: self.low - slack, high: self.high + slack, ..self }
    }

    /// The box relative to the region's origin.
    #[inline(always)]
    pub fn apply(&self, b: &Box32) -> Aabb {
        let wide = |v: [f32; 3]| DVec3::new(f64::from(v[0]), f64::from(v[1]), f64::from(v[2]));
        let mut b = Aabb { min: wide(b.min) + self.low, max: wide(b.max) + self.high };
        if let Some(heights) = self.flat {
            (b.min.z, b.max.z) = heights;
        }
        b
    }
}

/// Eight boxes, as one array per coordinate.
#[derive(Clone, Copy, Debug)]
pub struct Boxes8 {
    min: [[f32; LANES]; 3],
    max: [[f32; LANES]; 3],
}

impl Boxes8 {
    /// Eight empty boxes, which meet nothing.
    pub const EMPTY: Self = Self { min: [[f32::INFINITY; LANES]; 3], max: [[f32::NEG_INFINITY; LANES]; 3] };

    /// Sets the box of a lane.
    #[inline]
    pub fn set(&mut self, lane: usize, b: &Box32) {
        for k in 0..3 {
            self.min[k][lane] = b.min[k];
            self.max[k][lane] = b.max[k];
        }
    }

    #[inline]
    pub(super) fn get(&self, lane: usize) -> Box32 {
        Box32 { min: [0, 1, 2].map(|k| self.min[k][lane]), max: [0, 1, 2].map(|k| self.max[k][lane]) }
    }

    /// The boxes that meet the shape, one bit each.
    #[inline(always)]
    pub fn meet<S: Shape>(&self, shape: &S, shift: &Shift) -> u32 {
        let mut met = [0u32; LANES];
        for (lane, met) in met.iter_mut().enumerate() {
            *met = u32::from(shape.meets(&shift.apply(&self.get(lane)))) << lane;
        }
        met.iter().fold(0, |all, one| all | one)
    }
}
