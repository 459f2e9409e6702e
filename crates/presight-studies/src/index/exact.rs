//! Decides whether a polygon itself, not only its box, has a point in a region. Selectivity is measured against this.

use glam::DVec3;
use presight_model::geometry::Aabb;
use presight_model::index::Region;

/// True if a convex polygon (corners in the world, metres) has a point in the region, or comes within a millimetre.
///
/// Halves triangles along their longest side until a corner lies in the region, the box does not meet it, or the side
/// is shorter than a millimetre.
pub fn polygon_meets(region: &Region, corners: &[DVec3]) -> bool {
    /// Metres.
    const FINEST: f64 = 1e-3;
    let Some((first, rest)) = corners.split_first() else { return false };
    if corners.iter().any(|p| region.contains(*p)) {
        return true;
    }
    let mut stack: Vec<[DVec3; 3]> = rest.windows(2).map(|pair| [*first, pair[0], pair[1]]).collect();
    while let Some(triangle) = stack.pop() {
        if !region.meets(&Aabb::of(triangle)) {
            continue;
        }
        let side = |k: usize| triangle[k].distance_squared(triangle[(k + 1) % 3]);
        let longest = (1..3).fold(0, |best, k| if side(k) > side(best) { k } else { best });
        let [a, b, c] = [0, 1, 2].map(|k| triangle[(longest + k) % 3]);
        let middle = 0.5 * (a + b);
        if side(longest) <= FINEST * FINEST || region.contains(middle) {
            return true;
        }
        stack.push([a, middle, c]);
        stack.push([middle, b, c]);
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;
    use presight_model::geometry::Pose;

    #[test]
    fn a_polygon_across_counts_and_one_beside_does_not() {
        let region = Region::sector(DVec2::ZERO, 0.0, 1.0, 10.0);
        let wall = |x: f64| [[x, -50.0, 0.0], [x, 50.0, 0.0], [x, 50.0, 3.0], [x, -50.0, 3.0]].map(DVec3::from);
        assert!(polygon_meets(&region, &wall(5.0)));
        assert!(!polygon_meets(&region, &wall(-0.01)) && !polygon_meets(&region, &wall(10.01)));
        // Its box meets the region, but the polygon does not.
        let slanted = [[-4.0, 0.0, 0.0], [4.0, 8.0, 0.0], [4.0, 8.0, 1.0], [-4.0, 0.0, 1.0]].map(DVec3::from);
        assert!(region.meets(&Aabb::of(slanted)) && !polygon_meets(&region, &slanted));
    }

    #[test]
    fn a_floor_below_the_beams_does_not() {
        let region = Region::segment(&Pose::IDENTITY, 0.0, 6.0, (-0.1, 0.1), 10.0).unwrap();
        let floor = |z: f64| [[-20.0, -20.0, z], [20.0, -20.0, z], [20.0, 20.0, z], [-20.0, 20.0, z]].map(DVec3::from);
        assert!(polygon_meets(&region, &floor(-0.5)));
        assert!(!polygon_meets(&region, &floor(-1.1)));
    }
}
