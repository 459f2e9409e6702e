//! Segments behind a sheet that they lie on.
//!
//! What a segment lies on does not hide it. But where something touches a sheet from behind, its edges lie in the middle of the sheet: seen
//! from the front, the sheet hides them, however thin it is.

use super::VisibilityContext;
use super::polygon::PolygonCache;
use crate::PlacedFeature;
use glam::{DMat3, DVec3};
use presight_model::environment::FeatureShape;
use std::borrow::Cow;

/// Shares of a segment at which is looked.
const PLACES: [f64; 3] = [0.5, 0.2, 0.8];

/// How far beside it, metres.
const BESIDE: f64 = 1e-3;

/// Sine of the angle by which a polygon leans off a sheet, three degrees.
const OFF: f64 = 0.052;

/// How far behind its sheet a segment is moved, so that this hides it: metres, and as a part of the range. More than what lies on a
/// polygon within rounding is off it.
const BEHIND: [f64; 2] = [2e-5, 1e-6];

/// A direction in which a polygon leaves the segment.
struct Wing {
    slot: u32,
    along: DVec3,
    hides: bool,
}

/// Moves a segment just behind the sheet in whose middle it lies, if nothing leaves it to the sensor's side and something to the
/// other. Returns the slots of what does not hide it: without the sheet's.
pub(super) fn set_behind<'p>(
    frame: &VisibilityContext<'_>,
    polygons: &mut PolygonCache,
    placed: &'p PlacedFeature,
    (points, ..): &mut (Vec<DVec3>, DMat3, f64),
) -> Cow<'p, [u32]> {
    let slots = &placed.slots;
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

/// The normal, on the sensor's side, of a sheet that goes on over the segment and has all else that leaves it behind it.
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
