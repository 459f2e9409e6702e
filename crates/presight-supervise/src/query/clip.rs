//! Convex polygons cut by axis-aligned planes.

use glam::DVec3;
use presight_model::floor::half;
use presight_model::geometry::Aabb;

/// The part of a convex polygon inside of a box; empty if they have no point in common.
pub fn clipped(mut corners: Vec<DVec3>, bounds: &Aabb) -> Vec<DVec3> {
    for axis in 0..3 {
        for (limit, sign) in [(bounds.min[axis], 1.0), (bounds.max[axis], -1.0)] {
            if limit.is_finite() {
                corners = half(&corners, |p: DVec3| sign * (p[axis] - limit));
            }
        }
    }
    corners
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_is_cut() {
        let square = [[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 2.0, 1.0], [0.0, 2.0, 1.0]].map(DVec3::from);
        let part = |min: [f64; 3], max: [f64; 3]| clipped(square.to_vec(), &Aabb { min: min.into(), max: max.into() });
        let bounds = Aabb::of(part([1.0, -1.0, 0.0], [3.0, 1.5, 2.0]));
        assert_eq!((bounds.min, bounds.max), (DVec3::new(1.0, 0.0, 1.0), DVec3::new(2.0, 1.5, 1.0)));
        assert!(part([0.0, 0.0, 1.1], [2.0, 2.0, 2.0]).is_empty());
    }
}
