//! Samples that only what is between them and the sensor decides, and what hides them.

use super::polygon::{Faces, PreparedPolygon, RelativeDepth};
use glam::DVec3;

/// A sample that only what is between it and the sensor decides.
pub(super) struct UndecidedSample {
    pub piece: u32,
    pub at: DVec3,
    pub range: f64,
    /// Where on the segment it is: samples rise with it.
    pub t: f64,
    /// The nearest polygon that hides it so far, and its share of the range.
    pub by: Option<u32>,
    pub share: f64,
    /// A polygon of unknown range covers it.
    pub unknown: bool,
}

impl UndecidedSample {
    #[inline]
    fn hide(&mut self, slot: u32, share: f64) {
        if share > self.share {
            (self.by, self.share) = (Some(slot), share);
        }
    }

    /// Marks it if a polygon hides it.
    #[inline]
    pub fn hide_by(&mut self, known: &PreparedPolygon, faces: &Faces, rounding: f64) {
        let share = known.inverse.dot(self.at);
        if !(share > 1.0) || !faces.holds(known, self.at) {
            return;
        }
        match known.nearer(share, self.range, rounding) {
            RelativeDepth::Yes => self.hide(known.slot, share),
            RelativeDepth::Unknown => self.unknown = true,
            RelativeDepth::No => {}
        }
    }
}

/// A segment's points a + t d, image frame.
#[derive(Clone, Copy)]
pub(super) struct Line {
    pub a: DVec3,
    pub d: DVec3,
}

/// Marks what a polygon hides of some samples of a segment. All that decides is linear along it: e_k . p(t) >= 0 leaves
/// one interval, and n . p(t) / d > 1 is where the polygon is nearer.
pub(super) fn hide_along(
    known: &PreparedPolygon,
    planes: &[DVec3],
    line: Line,
    open: &mut [UndecidedSample],
    rounding: f64,
) {
    let (Some(first), Some(last)) = (open.first(), open.last()) else { return };
    let (mut from, mut to) = (first.t, last.t);
    let (ends, inverse) = ([first.at, last.at], known.inverse);
    if !(inverse.dot(ends[0]) > 1.0 || inverse.dot(ends[1]) > 1.0) {
        return;
    }
    for e in planes {
        let [p, q] = ends.map(|at| e.dot(at));
        if p < 0.0 && q < 0.0 {
            return;
        }
        if p < 0.0 || q < 0.0 {
            let t = -e.dot(line.a) / e.dot(line.d);
            if p < 0.0 { from = from.max(t) } else { to = to.min(t) }
        }
    }
    if !(from <= to) {
        return;
    }
    let start = if from > first.t { open.partition_point(|o| o.t < from) } else { 0 };
    for o in open[start..].iter_mut().take_while(|o| o.t <= to) {
        let share = inverse.dot(o.at);
        match known.nearer(share, o.range, rounding) {
            RelativeDepth::Yes => o.hide(known.slot, share),
            RelativeDepth::Unknown => o.unknown = true,
            RelativeDepth::No => {}
        }
    }
}
