//! Segments that lie on the back of a thin sheet.
//!
//! A polygon does not hide a segment that lies on it. But where an object touches a sheet from behind, its edges lie in
//! the middle of the sheet. Seen from the front, the sheet hides them, however thin it is.

use super::VisibilityContext;
use super::context::InImage;
use super::polygon::PolygonCache;
use crate::PlacedFeature;
use glam::DVec3;
use presight_model::environment::FeatureShape;
use std::borrow::Cow;

/// Shares of a segment's length at which its polygons are tested.
const PLACES: [f64; 3] = [0.5, 0.2, 0.8];

/// Distance from the segment at which a polygon must continue, metres.
const BESIDE: f64 = 1e-3;

/// Sine of the angle above which a polygon leaves the sheet, three degrees.
const OFF: f64 = 0.052;

/// Distance by which a segment is moved behind its sheet so that the sheet hides it: metres, and part of the range. It
/// exceeds the rounding of features on polygons.
const BEHIND: [f64; 2] = [2e-5, 1e-6];

/// A direction in which a polygon extends from the segment.
struct Wing {
    slot: u32,
    along: DVec3,
    hides: bool,
}

/// Moves a segment just behind the sheet in whose middle it lies if its other polygons all leave it behind the sheet.
/// Returns the slots of the polygons that do not hide it, which then exclude the sheet's.
pub(super) fn set_behind<'p>(
    frame: &VisibilityContext<'_>,
    polygons: &mut PolygonCache,
    placed: &'p PlacedFeature,
    in_image: &mut InImage,
) -> Cow<'p, [u32]> {
    let (slots, points) = (&placed.slots, &mut in_image.points);
    let (FeatureShape::Segment { .. }, [a, b], true) = (&placed.feature.shape, &points[..], slots.len() > 1) else {
        return Cow::Borrowed(slots);
    };
    let Some(direction) = (*b - *a).try_normalize() else { return Cow::Borrowed(slots) };
    let (mut toward, mut sheets) = (DVec3::ZERO, Vec::new());
    for share in PLACES {
        let at = a.lerp(*b, share);
        let wings = wings(frame, polygons, slots, at, direction);
        let Some(front) = sheet(&wings, direction, at) else { return Cow::Borrowed(slots) };
        toward = front;
        sheets.extend(wings.iter().filter(|w| w.along.dot(front).abs() <= OFF).map(|w| w.slot));
    }
    let [near, part] = BEHIND;
    points.iter_mut().for_each(|p| *p -= toward * (near + part * p.length()));
    Cow::Owned(slots.iter().copied().filter(|slot| !sheets.contains(slot)).collect())
}

fn wings(
    frame: &VisibilityContext<'_>,
    polygons: &mut PolygonCache,
    slots: &[u32],
    at: DVec3,
    direction: DVec3,
) -> Vec<Wing> {
    let mut wings = Vec::new();
    for slot in slots {
        let Some(number) = polygons.of_slot(frame, *slot) else { continue };
        let known = polygons.get(number);
        let Some(across) = known.normal.cross(direction).try_normalize() else { continue };
        for along in [across, -across] {
            if polygons.holds(known, at + BESIDE * along) {
                wings.push(Wing { slot: *slot, along, hides: known.covers });
            }
        }
    }
    wings
}

/// The sensor-side normal of a sheet that continues across the segment, with all other polygons behind it.
fn sheet(wings: &[Wing], direction: DVec3, at: DVec3) -> Option<DVec3> {
    wings.iter().filter(|w| w.hides).find_map(|w| {
        let normal = w.along.cross(direction);
        let front = if normal.dot(at) > 0.0 { -normal } else { normal };
        let goes_on = wings.iter().any(|o| o.hides && o.along.dot(w.along) < 0.0 && o.along.dot(front).abs() <= OFF);
        let before = wings.iter().any(|o| o.along.dot(front) > OFF);
        let behind = wings.iter().any(|o| o.along.dot(front) < -OFF);
        (goes_on && behind && !before).then_some(front)
    })
}
