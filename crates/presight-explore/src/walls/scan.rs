//! Scans and walls in two dimensions.

use crate::observe::View;
use glam::DVec2;

/// Maximum distance of a wall's points from its line, metres. A point twice as far behind the wall is a pass.
pub(super) const NEAR: f64 = 0.06;

/// A planar scan at a known pose, seen from above.
#[derive(Clone, Debug)]
pub(crate) struct Scan {
    pub origin: DVec2,
    /// Unit directions of the beams.
    pub directions: Vec<DVec2>,
    /// Ranges, metres; not finite without a return.
    pub ranges: Vec<f64>,
}

impl Scan {
    pub fn of(view: &View, base: DVec2, is_used: impl Fn(usize) -> bool) -> Self {
        let ray = |pixel: usize| view.ray(pixel).truncate();
        let pixels = 0..view.ranges.len();
        let range = |pixel: usize| {
            let range = f64::from(view.ranges[pixel]) * ray(pixel).length();
            if is_used(pixel) { range } else { f64::NAN }
        };
        Self {
            origin: view.origin().truncate() + base,
            directions: pixels.clone().map(|p| ray(p).normalize_or(DVec2::X)).collect(),
            ranges: pixels.map(range).collect(),
        }
    }

    /// The end of a beam.
    pub fn point(&self, beam: usize) -> DVec2 {
        self.origin + self.directions[beam] * self.ranges[beam]
    }
}

/// A wall seen from above, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Wall {
    /// Both ends.
    pub ends: [DVec2; 2],
}

impl Wall {
    /// The vector from the first end to the second.
    pub fn along(&self) -> DVec2 {
        self.ends[1] - self.ends[0]
    }

    /// The distance along a ray to the wall, metres, and the share of the wall's length up to the intersection.
    #[inline]
    pub fn intersection(&self, ray: &Ray) -> Option<(f64, f64)> {
        let (along, to) = (self.along(), self.ends[0] - ray.origin);
        let across = ray.direction.perp_dot(along);
        let distance = to.perp_dot(along) / across;
        let share = to.perp_dot(ray.direction) / across;
        (distance > 0.02 && (0.0..=1.0).contains(&share)).then_some((distance, share))
    }
}

/// A beam of a scan, seen from above.
#[derive(Clone, Copy)]
pub(crate) struct Ray {
    pub origin: DVec2,
    pub direction: DVec2,
    pub range: f64,
}
