//! Straight pieces of possible edges.

use super::FeatureKind;
use super::soup::grown;
use glam::DVec3;
use presight_model::geometry::Aabb;

/// A straight piece of a possible edge, in the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    pub start: DVec3,
    pub end: DVec3,
    /// The object to which the line belongs.
    pub object: u32,
    pub kind: FeatureKind,
}

impl Line {
    pub fn length(&self) -> f64 {
        self.start.distance(self.end)
    }

    pub fn direction(&self) -> DVec3 {
        (self.end - self.start).normalize_or_zero()
    }

    /// The part from `t0` to `t1`, metres from the start.
    pub fn part(&self, t0: f64, t1: f64) -> Self {
        let d = self.direction();
        Self { start: self.start + d * t0, end: self.start + d * t1, ..*self }
    }

    pub fn bounds(&self) -> Aabb {
        Aabb::of([self.start, self.end])
    }
}

/// Boxes that together hold a line with a margin. A slanting line gets several, since one box would be wide.
pub(super) fn boxes_along(line: &Line, margin: f64) -> impl Iterator<Item = Aabb> + '_ {
    let mut extents = (line.end - line.start).abs().to_array();
    extents.sort_by(f64::total_cmp);
    // Maximum width of a box across its longest side, metres.
    const WIDE: f64 = 1.0;
    let count = (extents[1] / WIDE).ceil().clamp(1.0, 256.0);
    (0..count as u32).map(move |k| {
        let at = |k: f64| line.start.lerp(line.end, k / count);
        grown(&Aabb::of([at(f64::from(k)), at(f64::from(k + 1))]), margin)
    })
}
