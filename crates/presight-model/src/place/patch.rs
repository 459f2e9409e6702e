//! Finds the polygons under a plane patch.

use super::coplanar::CoplanarPart;
use super::local::Local;
use super::plane::PatchPlane;
use super::{Support, cover, squares};
use crate::error::{Error, Result};
use crate::geometry::plane_of_polygon;
use glam::{DVec2, DVec3};

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
