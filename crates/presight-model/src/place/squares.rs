//! Decides whether polygons that are small compared with the tolerance together cover a patch.
//!
//! The distance from the nearest polygon changes by at most a metre per metre. So a piece of the patch is covered if it
//! reaches no farther from its middle than the middle is inside the tolerance. Other pieces are divided, until one
//! has a middle off all polygons or is so small that it exceeds the tolerance by at most [`SLACK`] of it.

use super::coplanar::CoplanarPart;
use super::cover::SLACK;
use super::plane::{PatchPlane, bounds_of, clip, doubled_area, inside, sides};
use crate::error::Result;
use crate::geometry::Aabb;
use crate::index::{Params, QueryResult, Region, Skd, SpatialIndex};
use glam::{DVec2, DVec3};

/// Returns true if pieces as wide as the tolerance are fewer than the polygons.
pub(super) fn are_fewer(outline: &[DVec2], under: &[CoplanarPart<'_>]) -> bool {
    let reach = under.iter().map(|u| u.local.reach).fold(f64::INFINITY, f64::min);
    0.5 * doubled_area(outline).abs() < reach * reach * under.len() as f64
}

/// A point of a convex outline that is off all polygons by more than the tolerance; `None` if there is none. `compare`
/// is called with the number of polygons before distances from them are computed.
pub(super) fn uncovered(
    outline: &[DVec2],
    under: &[CoplanarPart<'_>],
    flat: &PatchPlane,
    compare: &dyn Fn(usize) -> Result<()>,
) -> Result<Option<DVec3>> {
    let boxes: Vec<(u32, Aabb)> = (0..).zip(under.iter().map(|u| Aabb::of(u.local.corners.iter().copied()))).collect();
    let index: Skd<3> = Skd::build(Params::default(), &boxes);
    let most = under.iter().map(|u| u.local.reach).fold(0.0, f64::max);
    let mut found = QueryResult::default();
    let (low, high) = bounds_of(outline);
    let mut open = vec![(0.5 * (low + high), 0.5 * (high - low).max_element())];
    while let Some((middle, half)) = open.pop() {
        let square = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|c| middle + half * DVec2::from(c));
        let piece = sides(outline).fold(square.to_vec(), |rest, side| clip(&rest, |p| inside(side, *p)));
        if piece.is_empty() {
            continue;
        }
        let at = piece.iter().sum::<DVec2>() / piece.len() as f64;
        let far = piece.iter().map(|p| p.distance(at)).fold(0.0, f64::max);
        let p = flat.lift(at);
        found.clear();
        index.query(&Region::cuboid(&Aabb { min: p - most, max: p + most }), &mut found);
        compare(found.all().count())?;
        let off = |k: u32| under[k as usize].local.distance(p) - under[k as usize].local.reach;
        let off = found.all().map(off).fold(f64::INFINITY, f64::min);
        if off > 0.0 {
            return Ok(Some(p));
        }
        if off + far > SLACK * most {
            let quarter = 0.5 * half;
            open.extend(
                [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
                    .map(|c| (middle + quarter * DVec2::from(c), quarter)),
            );
        }
    }
    Ok(None)
}

#[cfg(test)]
mod tests {
    use crate::place::lies_on;
    use glam::DVec3;

    /// A square of 10 x 10 tiles, each a centimetre wide and up to 4 mm off the plane, without some of them.
    fn lies(tolerance: f64, is_gap: impl Fn(i32, i32) -> bool) -> bool {
        let corner = |x: i32, y: i32| {
            DVec3::new(0.01 * f64::from(x), 0.01 * f64::from(y), 0.002 * f64::from((x * 3 + y * 5) % 5 - 2))
        };
        let halves = |x: i32, y: i32| {
            let c = [corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)];
            [[c[0], c[1], c[2]], [c[0], c[2], c[3]]]
        };
        let tiles = (0..100).map(|k| (k % 10, k / 10)).filter(|(x, y)| !is_gap(*x, *y));
        let patch = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.1]].map(|[x, y]| DVec3::new(x, y, 0.0));
        lies_on(&patch, tiles.flat_map(|(x, y)| halves(x, y)), tolerance, &|_| Ok(())).unwrap()
    }

    #[test]
    fn gaps_wider_than_the_tolerance_are_found() {
        assert!(lies(0.02, |_, _| false));
        // The middle of a gap of 3 x 3 tiles is 15 mm from its rim, of 5 x 5 tiles 25 mm.
        assert!(lies(0.02, |x, y| (3..6).contains(&x) && (3..6).contains(&y)));
        assert!(!lies(0.02, |x, y| (3..8).contains(&x) && (3..8).contains(&y)));
        // A strip along the border 3 cm wide is off, one 1 cm wide is not.
        assert!(!lies(0.02, |x, _| x < 3) && lies(0.02, |x, _| x < 1));
    }
}
