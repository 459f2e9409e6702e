//! Finds the polygons under a plane patch.

use super::local::Local;
use super::plane::{PatchPlane, bounds_of, clip, doubled_area, inside, sides, width};
use super::{LYING, Support, cover, squares};
use crate::error::{Error, Result};
use crate::geometry::plane_of_polygon;
use glam::{DVec2, DVec3};

/// A polygon that is practically coplanar with the patch.
pub(super) struct CoplanarPart<'a> {
    pub local: &'a Local,
    /// The part within the tolerance of the patch's plane, projected onto it, counter-clockwise.
    pub part: Vec<DVec2>,
    /// Heights of its corners above the plane.
    pub heights: Vec<f64>,
}

/// A patch with these corners, the first at the origin; `compare` is called with the number of pairs before comparing.
pub(super) fn lie(near: &[Local], corners: &[DVec3], compare: &dyn Fn(usize) -> Result<()>) -> Result<Support> {
    let plane = plane_of_polygon(corners)
        .ok_or_else(|| Error::invalid("the patch has no area", "give corners that are not on one line"))?;
    let flat = PatchPlane::of(&plane);
    let under: Vec<CoplanarPart<'_>> = near.iter().filter_map(|local| CoplanarPart::new(local, &flat)).collect();
    if let Some(off) = corners.iter().find(|c| !under.iter().any(|u| u.local.holds(**c))) {
        return Ok(Support::Off(*off));
    }
    let outline: Vec<DVec2> = corners.iter().map(|c| flat.project(*c)).collect();
    let uncovered = if squares::are_fewer(&outline, &under) { squares::uncovered } else { cover::uncovered };
    if let Some(off) = uncovered(&outline, &under, &flat, compare)? {
        return Ok(Support::Off(off));
    }
    let overlapping = under.iter().filter(|u| u.overlaps(&outline)).map(|u| u.local.slot);
    let mut slots: Vec<u32> = overlapping.collect();
    if slots.is_empty() {
        // It lies next to its polygons, within the tolerance; return these rather than none.
        slots.extend(under.iter().filter(|u| corners.iter().any(|c| u.local.holds(*c))).map(|u| u.local.slot));
    }
    Ok(Support::On(slots))
}

impl<'a> CoplanarPart<'a> {
    pub(super) fn new(local: &'a Local, flat: &PatchPlane) -> Option<Self> {
        let heights = || local.corners.iter().map(|c| flat.height(*c));
        let (low, high) = heights().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
        let turned = local.normal.map_or(0.0, |n| n.cross(flat.normal).length());
        if low > local.reach || high < -local.reach || (turned > LYING && high - low > 2.0 * local.reach) {
            return None;
        }
        let part = clip(&local.corners, |p| local.reach - flat.height(*p));
        let mut part = clip(&part, |p| local.reach + flat.height(*p));
        let project = |part: &[DVec3]| part.iter().map(|p| flat.project(*p)).collect::<Vec<DVec2>>();
        if doubled_area(&project(&part)) < 0.0 {
            part.reverse();
        }
        Some(Self { local, part: project(&part), heights: part.iter().map(|p| flat.height(*p)).collect() })
    }

    /// Returns true if the two overlap by more than a seam.
    fn overlaps(&self, outline: &[DVec2]) -> bool {
        let (own, of_outline) = (bounds_of(&self.part), bounds_of(outline));
        if !(own.0.cmple(of_outline.1).all() && own.1.cmpge(of_outline.0).all()) {
            return false;
        }
        let common = sides(&self.part).fold(outline.to_vec(), |rest, side| clip(&rest, |p| inside(side, *p)));
        let least = self.local.reach.min(0.5 * width(outline)).min(0.5 * width(&self.part));
        width(&common) > least
    }
}
