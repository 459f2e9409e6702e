//! Polygons in the plane of a patch.

use super::LYING;
use super::local::Local;
use super::plane::{PatchPlane, bounds_of, clip, doubled_area, inside, sides, width};
use glam::{DVec2, DVec3};

/// A polygon that is practically coplanar with the patch.
pub(super) struct CoplanarPart<'a> {
    pub local: &'a Local,
    /// The part within the tolerance of the patch's plane, projected onto it, counter-clockwise.
    pub part: Vec<DVec2>,
    /// Heights of its corners above the plane.
    pub heights: Vec<f64>,
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
    pub(super) fn overlaps(&self, outline: &[DVec2]) -> bool {
        let (own, of_outline) = (bounds_of(&self.part), bounds_of(outline));
        if !(own.0.cmple(of_outline.1).all() && own.1.cmpge(of_outline.0).all()) {
            return false;
        }
        let common = sides(&self.part).fold(outline.to_vec(), |rest, side| clip(&rest, |p| inside(side, *p)));
        let least = self.local.reach.min(0.5 * width(outline)).min(0.5 * width(&self.part));
        width(&common) > least
    }
}
