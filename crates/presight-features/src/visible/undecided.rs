//! Samples that only occlusion can still hide, and their occluders.

use super::polygon::{PolygonCache, PreparedPolygon, RelativeDepth};
use super::tally::SampleState;
use crate::Reason;
use glam::DVec3;

/// A sample that only occlusion can still hide.
pub(super) struct UndecidedSample {
    /// Image frame.
    pub at: DVec3,
    pub range: f64,
    /// The nearest polygon that hides it so far, and the ratio of the sample's range to the polygon's.
    pub by: Option<u32>,
    share: f64,
    /// A polygon of unknown range covers it.
    unknown: bool,
}

impl UndecidedSample {
    /// A sample at a place in the image frame.
    pub fn new(at: DVec3, range: f64) -> Self {
        Self { at, range, by: None, share: 0.0, unknown: false }
    }

    pub fn state(&self) -> SampleState {
        match self.by {
            Some(slot) => SampleState::Hidden(Reason::Occluded, Some(slot)),
            None if self.unknown => SampleState::Hidden(Reason::Undecided, None),
            None => SampleState::Seen,
        }
    }

    #[inline]
    fn hide(&mut self, slot: u32, share: f64) {
        if share > self.share {
            (self.by, self.share) = (Some(slot), share);
        }
    }

    #[inline]
    pub fn hide_by(&mut self, known: &PreparedPolygon, polygons: &PolygonCache, rounding: f64) {
        let share = known.inverse.dot(self.at);
        if !(share > 1.0) || !polygons.holds(known, self.at) {
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
    a: DVec3,
    d: DVec3,
    /// The t of a place p is its product with p - a.
    along: DVec3,
}

impl Line {
    /// The line from a to b.
    pub fn new(a: DVec3, b: DVec3) -> Self {
        let d = b - a;
        Self { a, d, along: d / d.length_squared().max(f64::MIN_POSITIVE) }
    }

    fn t(&self, at: DVec3) -> f64 {
        self.along.dot(at - self.a)
    }
}

/// Marks the samples of a segment that a polygon hides; they are in order along it. All conditions are linear along it:
/// e_k . p(t) >= 0 leaves one interval, and the polygon is nearer where n . p(t) / d > 1.
pub(super) fn hide_along(
    known: &PreparedPolygon,
    planes: &[DVec3],
    line: Line,
    open: &mut [UndecidedSample],
    rounding: f64,
) {
    let (Some(first), Some(last)) = (open.first(), open.last()) else { return };
    let (ends, inverse) = ([first.at, last.at], known.inverse);
    if !(inverse.dot(ends[0]) > 1.0 || inverse.dot(ends[1]) > 1.0) {
        return;
    }
    let start_t = line.t(first.at);
    let (mut from, mut to) = (start_t, line.t(last.at));
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
    let start = if from > start_t { open.partition_point(|o| line.t(o.at) < from) } else { 0 };
    for o in open[start..].iter_mut().take_while(|o| line.t(o.at) <= to) {
        let share = inverse.dot(o.at);
        match known.nearer(share, o.range, rounding) {
            RelativeDepth::Yes => o.hide(known.slot, share),
            RelativeDepth::Unknown => o.unknown = true,
            RelativeDepth::No => {}
        }
    }
}
