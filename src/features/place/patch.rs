//! The polygons under a plane patch.

use super::local::Local;
use super::{LYING, Lie};
use crate::error::{Error, Result};
use crate::geometry::plane_of_polygon;
use glam::{DVec2, DVec3};

/// Pieces a patch may be cut into before its outline counts as too ragged.
const MOST_PIECES: usize = 1 << 16;
/// So many polygons are taken out of a piece one by one; of a piece near more, halves are looked at.
const TAKEN_OUT: usize = 24;

/// A plane with axes; heights are taken from the mean of the patch's corners.
struct Flat {
    x: DVec3,
    y: DVec3,
    normal: DVec3,
    offset: f64,
}

impl Flat {
    fn project(&self, p: DVec3) -> DVec2 {
        DVec2::new(self.x.dot(p), self.y.dot(p))
    }

    fn lift(&self, p: DVec2) -> DVec3 {
        self.x * p.x + self.y * p.y + self.normal * self.offset
    }
}

/// A polygon that is as good as coplanar.
struct Under<'a> {
    local: &'a Local,
    /// The part within the tolerance of the patch's plane, seen from above, counter-clockwise.
    part: Vec<DVec2>,
    /// Holds every point of the plane that is on the polygon.
    bounds: (DVec2, DVec2),
}

/// A patch with these corners, the first of them the origin.
pub(super) fn lie(near: &[Local], corners: &[DVec3]) -> Result<Lie> {
    let plane = plane_of_polygon(corners)
        .ok_or_else(|| Error::invalid("the patch has no area", "give corners that are not on one line"))?;
    // x, y and the normal are right-handed, so that the patch is counter-clockwise in them.
    let x = plane.normal.any_orthonormal_vector();
    let y = plane.normal.cross(x);
    let flat = Flat { x, y, normal: plane.normal, offset: plane.offset };
    let under: Vec<Under<'_>> = near.iter().filter_map(|local| Under::new(local, &flat)).collect();
    if let Some(off) = corners.iter().find(|c| !under.iter().any(|u| u.local.holds(**c))) {
        return Ok(Lie::Off(*off));
    }
    let outline: Vec<DVec2> = corners.iter().map(|c| flat.project(*c)).collect();
    if let Some(off) = uncovered(&outline, &under, &flat)? {
        return Ok(Lie::Off(flat.lift(off)));
    }
    let overlapping = under.iter().filter(|u| u.overlaps(&outline)).map(|u| u.local.slot);
    let mut slots: Vec<u32> = overlapping.collect();
    if slots.is_empty() {
        // It lies within the tolerance beside them: better those than none.
        slots.extend(under.iter().filter(|u| corners.iter().any(|c| u.local.holds(*c))).map(|u| u.local.slot));
    }
    Ok(Lie::On(slots))
}

impl<'a> Under<'a> {
    fn new(local: &'a Local, flat: &Flat) -> Option<Self> {
        let heights = || local.corners.iter().map(|c| flat.normal.dot(*c) - flat.offset);
        let (low, high) = heights().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
        let turned = local.normal.map_or(0.0, |n| n.cross(flat.normal).length());
        if low > local.reach || high < -local.reach || (turned > LYING && high - low > 2.0 * local.reach) {
            return None;
        }
        let height = |p: &DVec3| flat.normal.dot(*p) - flat.offset;
        let part = clip(&local.corners, |p| local.reach - height(p));
        let part = clip(&part, |p| local.reach + height(p));
        let mut part: Vec<DVec2> = part.iter().map(|p| flat.project(*p)).collect();
        if doubled_area(&part) < 0.0 {
            part.reverse();
        }
        let seen = local.corners.iter().map(|c| flat.project(*c));
        let start = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let (min, max) = seen.fold(start, |(min, max), p| (min.min(p), max.max(p)));
        Some(Self { local, part, bounds: (min - local.reach, max + local.reach) })
    }

    fn meets(&self, (min, max): (DVec2, DVec2)) -> bool {
        self.bounds.0.cmple(max).all() && self.bounds.1.cmpge(min).all()
    }

    /// True if more than a seam of both coincides.
    fn overlaps(&self, outline: &[DVec2]) -> bool {
        let common = sides(&self.part).fold(outline.to_vec(), |rest, side| clip(&rest, |p| inside(side, *p)));
        let least = self.local.reach.min(0.5 * width(outline)).min(0.5 * width(&self.part));
        width(&common) > least
    }
}

/// A point of a convex outline that is on no polygon, within the tolerance.
///
/// A piece of it is settled if one polygon holds all its corners: polygons are convex, and so is what is within a
/// distance of them. Of other pieces the polygons near are taken out, and what is left is halved.
fn uncovered(outline: &[DVec2], under: &[Under<'_>], flat: &Flat) -> Result<Option<DVec2>> {
    let mut stack = vec![(outline.to_vec(), (0..under.len()).collect::<Vec<usize>>(), false)];
    let mut pieces = 0;
    while let Some((piece, candidates, taken_out)) = stack.pop() {
        pieces += 1;
        if pieces > MOST_PIECES {
            return Err(Error::invalid(
                format!("the patch lies on polygons with so many gaps that {MOST_PIECES} pieces do not settle it"),
                "split the patch, or raise the layer's tolerance",
            ));
        }
        let bounds = bounds_of(&piece);
        let near: Vec<usize> = candidates.into_iter().filter(|&k| under[k].meets(bounds)).collect();
        let holds = |k: usize, p: DVec2| under[k].local.holds(flat.lift(p));
        if near.iter().any(|&k| piece.iter().all(|p| holds(k, *p))) {
            continue;
        }
        let middle = piece.iter().sum::<DVec2>() / piece.len() as f64;
        if let Some(off) = [middle].iter().chain(&piece).find(|p| !near.iter().any(|&k| holds(k, **p))) {
            return Ok(Some(*off));
        }
        if !taken_out && near.len() <= TAKEN_OUT {
            let mut left = vec![piece];
            for &k in &near {
                left = left.iter().flat_map(|p| without(p, &under[k].part)).collect();
            }
            stack.extend(left.into_iter().map(|p| (p, near.clone(), true)));
            continue;
        }
        let size = bounds.1 - bounds.0;
        // All corners and the middle are on polygons, and nothing is farther than this from one of them.
        if size.max_element() < 0.125 * near.iter().map(|&k| under[k].local.reach).fold(f64::INFINITY, f64::min) {
            continue;
        }
        let axis = if size.x >= size.y { DVec2::X } else { DVec2::Y };
        let at = axis.dot(bounds.0 + 0.5 * size);
        stack.push((clip(&piece, |p| axis.dot(*p) - at), near.clone(), taken_out));
        stack.push((clip(&piece, |p| at - axis.dot(*p)), near, taken_out));
    }
    Ok(None)
}

/// What is left of a convex piece without a convex part, in convex pieces.
fn without(piece: &[DVec2], part: &[DVec2]) -> Vec<Vec<DVec2>> {
    let mut left = Vec::new();
    let mut rest = piece.to_vec();
    if !(doubled_area(part) > 0.0) {
        return vec![rest];
    }
    for side in sides(part) {
        let outer = clip(&rest, |p| -inside(side, *p));
        if doubled_area(&outer) > 0.0 {
            left.push(outer);
        }
        rest = clip(&rest, |p| inside(side, *p));
        if rest.len() < 3 {
            break;
        }
    }
    left
}

trait Point: Copy {
    fn between(self, other: Self, t: f64) -> Self;
}

impl Point for DVec2 {
    fn between(self, other: Self, t: f64) -> Self {
        self.lerp(other, t)
    }
}

impl Point for DVec3 {
    fn between(self, other: Self, t: f64) -> Self {
        self.lerp(other, t)
    }
}

/// Keeps of a convex polygon where a linear function is not negative.
fn clip<P: Point>(polygon: &[P], value: impl Fn(&P) -> f64) -> Vec<P> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (k, p) in polygon.iter().enumerate() {
        let q = &polygon[(k + 1) % polygon.len()];
        let (at_p, at_q) = (value(p), value(q));
        if at_p >= 0.0 {
            kept.push(*p);
        }
        if (at_p > 0.0 && at_q < 0.0) || (at_p < 0.0 && at_q > 0.0) {
            kept.push(p.between(*q, at_p / (at_p - at_q)));
        }
    }
    kept
}

fn sides(polygon: &[DVec2]) -> impl Iterator<Item = (DVec2, DVec2)> + '_ {
    (0..polygon.len()).map(|k| (polygon[k], polygon[(k + 1) % polygon.len()]))
}

/// Positive to the left of a side.
fn inside((u, v): (DVec2, DVec2), p: DVec2) -> f64 {
    (v - u).perp_dot(p - u)
}

fn doubled_area(polygon: &[DVec2]) -> f64 {
    sides(polygon).map(|(u, v)| (u - polygon[0]).perp_dot(v - polygon[0])).sum()
}

/// About the width of a narrow polygon: twice its area over its circumference, 0 without area.
fn width(polygon: &[DVec2]) -> f64 {
    let around: f64 = sides(polygon).map(|(u, v)| u.distance(v)).sum();
    if around > 0.0 { doubled_area(polygon).abs() / around } else { 0.0 }
}

fn bounds_of(piece: &[DVec2]) -> (DVec2, DVec2) {
    let start = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    piece.iter().fold(start, |(min, max), p| (min.min(*p), max.max(*p)))
}
