//! Segments in a pinhole camera: samples in equal steps of a straight image, decided run by run and not one by one.

use super::polygon::{PreparedPolygon, RelativeDepth};
use super::tally::{SampleState, Tally};
use super::tiles::Square;
use super::worker::{FeatureSurface, Worker};
use super::{Visibility, VisibilityContext};
use crate::features::Reason;
use crate::features::straight::Straight;
use glam::DVec3;
use std::ops::Range;

/// How far apart are the blocks of three by three pixels along a segment that are looked through, pixels. Nearly all that
/// hides it shows in them; finding the rest by tiles is faster than looking through more.
const BLOCKS_APART: f64 = 24.0;

/// No slot.
const NONE: u32 = u32::MAX;

/// Some samples of a segment, and what decides about all of them.
struct Stretch<'s> {
    part: &'s Straight,
    /// Numbers of samples; not empty.
    some: Range<usize>,
    /// Middles of the first and the last.
    ends: [DVec3; 2],
    /// Least and greatest range of the whole part.
    ranges: [f64; 2],
    rounding: f64,
}

impl<'s> Stretch<'s> {
    fn new(part: &'s Straight, some: Range<usize>, ranges: [f64; 2], rounding: f64) -> Self {
        let ends = [part.middle(some.start).0, part.middle(some.end - 1).0];
        Self { part, some, ends, ranges, rounding }
    }

    /// Marks what a polygon hides; false if nothing is known about its range there.
    fn hide(&self, known: &PreparedPolygon, planes: &[DVec3], by: &mut [u32]) -> bool {
        let [p, q] = self.ends;
        let shares = [known.inverse.dot(p), known.inverse.dot(q)];
        if !(shares[0] > 1.0 || shares[1] > 1.0) {
            return true;
        }
        // Shares of the way from p to q.
        let (mut from, mut to) = (0.0f64, 1.0f64);
        for e in planes {
            let (f, g) = (e.dot(p), e.dot(q));
            if f < 0.0 && g < 0.0 {
                return true;
            }
            if f < 0.0 {
                from = from.max(f / (f - g));
            } else if g < 0.0 {
                to = to.min(f / (f - g));
            }
        }
        if !(from <= to) {
            return true;
        }
        let number = |share: f64| self.part.number_at(p + share * (q - p));
        let first = if from > 0.0 { (number(from).ceil() as usize).max(self.some.start) } else { self.some.start };
        let end = if to < 1.0 { ((number(to) + 1.0) as usize).min(self.some.end) } else { self.some.end };
        let Some(by) = by.get_mut(first..end) else { return true };
        let [near, far] = self.ranges;
        let least = [near, far].map(|range| known.least_share(shares[0].max(shares[1]), range, self.rounding));
        let least = least[0].max(least[1]);
        if shares[0] > least && shares[1] > least {
            by.iter_mut().filter(|by| **by == NONE).for_each(|by| *by = known.slot);
            return true;
        }
        // It crosses the segment, or nearly: one by one.
        for (i, by) in by.iter_mut().enumerate().filter(|(_, by)| **by == NONE) {
            let at = self.part.middle(first + i).0;
            match known.nearer(known.inverse.dot(at), at.length(), self.rounding) {
                RelativeDepth::Yes => *by = known.slot,
                RelativeDepth::No => {}
                RelativeDepth::Unknown => return false,
            }
        }
        true
    }
}

impl Worker<'_> {
    /// Decides about a segment; `None` if it takes more than what is in between, or more care.
    pub(super) fn straight(
        &mut self,
        [a, b]: [DVec3; 2],
        own: &FeatureSurface<'_>,
        told: Option<&[Option<u32>]>,
    ) -> Option<Tally> {
        let frame = self.frame;
        if frame.options.visibility != Visibility::Image
            || !own.is_plain()
            || frame.sensor.spec().max_incidence.is_some()
        {
            return None;
        }
        let part = frame.sampler.straight_part(a, b)?;
        let ranges = ranges(&part);
        let spec = frame.sensor.spec();
        if part.count < 3 || !(ranges[0] >= spec.range_min && ranges[1] <= spec.range_max && ranges[0] > 0.0) {
            return None;
        }
        let mut by = std::mem::take(&mut self.by);
        by.clear();
        by.resize(part.count, NONE);
        let decided = self.decide_straight(&part, ranges, own, told, &mut by);
        let tally = decided.then(|| tally_of(frame, &part, [a, b], &by));
        self.by = by;
        tally
    }

    fn decide_straight(
        &mut self,
        part: &Straight,
        ranges: [f64; 2],
        own: &FeatureSurface<'_>,
        told: Option<&[Option<u32>]>,
        by: &mut [u32],
    ) -> bool {
        self.begin();
        match told {
            Some(told) => self.take_told(told, own),
            None => {
                let [from, to] = part.pixels;
                let blocks = ((to - from).abs().max_element() / BLOCKS_APART).ceil().max(1.0);
                (0..=blocks as u32).for_each(|i| self.gather(from.lerp(to, f64::from(i) / blocks), own));
            }
        }
        if !self.hide_near(&Stretch::new(part, 0..part.count, ranges, own.rounding()), by) {
            return false;
        }
        let open = |by: &[u32]| by.iter().filter(|by| **by == NONE).count();
        let left = open(by);
        let first = by.iter().position(|b| *b == NONE).unwrap_or(part.count);
        let end = by.iter().rposition(|b| *b == NONE).map_or(first, |last| last + 1);
        if !self.confirm(part, first..end, ranges, own, by) {
            return false;
        }
        self.stats.samples = part.count;
        self.stats.hidden_by_neighbours = part.count - left;
        self.stats.visible = open(by);
        self.stats.hidden_in_space = left - self.stats.visible;
        true
    }

    /// Whatever may hide samples, tile by tile.
    fn confirm(
        &mut self,
        part: &Straight,
        left: Range<usize>,
        ranges: [f64; 2],
        own: &FeatureSurface<'_>,
        by: &mut [u32],
    ) -> bool {
        let open_from = |start: usize, by: &[u32]| {
            let open = by[start..left.end].iter().position(|by| *by == NONE);
            open.map_or(left.end, |more| start + more)
        };
        let mut start = left.start;
        while start < left.end {
            let first = part.middle(start).0;
            let end = end_in(part, &self.tiles.of(first).1, start..left.end);
            let farthest = first.length().max(part.middle(end - 1).0.length());
            let tile = self.tiles.tile(self.frame, &mut self.faces, first, farthest);
            let stretch = Stretch::new(part, start..end, ranges, own.rounding());
            for face in self.tiles.between(tile, &stretch.ends, own, &self.faces) {
                let known = &self.faces.known[face as usize];
                if !stretch.hide(known, self.faces.planes_of(known), by) {
                    return false;
                }
            }
            start = open_from(end, by);
        }
        true
    }

    fn hide_near(&self, stretch: &Stretch<'_>, by: &mut [u32]) -> bool {
        self.near.iter().all(|face| {
            let known = &self.faces.known[*face as usize];
            stretch.hide(known, self.faces.planes_of(known), by)
        })
    }
}

/// The first of some samples that is not in a tile any more, of which the first is.
fn end_in(part: &Straight, square: &Square, some: Range<usize>) -> usize {
    let [p, q] = [some.start, some.end - 1].map(|i| part.middle(i).0);
    match square.left_at(p, q) {
        share if share < 1.0 => (part.number_at(p.lerp(q, share)) as usize + 1).clamp(some.start + 1, some.end),
        _ => some.end,
    }
}

/// Least and greatest distance of a part from the sensor.
fn ranges(part: &Straight) -> [f64; 2] {
    let [p, q] = part.ends;
    let foot = p + foot(part) * (q - p);
    [foot.length(), p.length().max(q.length())]
}

/// The share of a part at which it is nearest to the sensor.
fn foot(part: &Straight) -> f64 {
    let [p, q] = part.ends;
    let d = q - p;
    (-p.dot(d) / d.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
}

/// Intervals and shares of samples hidden by slots.
fn tally_of(frame: &VisibilityContext<'_>, part: &Straight, [a, b]: [DVec3; 2], by: &[u32]) -> Tally {
    let mut tally = Tally::default();
    let outside = |tally: &mut Tally, piece| {
        if let crate::features::Piece::Outside { reason, .. } = piece {
            tally.take(frame, &piece, SampleState::Hidden(reason, None));
        }
    };
    part.before(a, b, &mut |piece| outside(&mut tally, piece));
    let nearest = part.number(foot(part));
    let mut start = 0;
    for run in by.chunk_by(|a, b| a == b) {
        let end = start + run.len();
        let ((t0, p0), (t1, p1)) = (part.bound(start), part.bound(end));
        let state = match run[0] {
            NONE => SampleState::Seen,
            slot => SampleState::Hidden(Reason::Occluded, Some(slot)),
        };
        tally.take_run(frame, state, run.len(), [t0, t1], [p0, p1]);
        if state == SampleState::Seen {
            for i in [nearest.floor(), nearest.ceil()] {
                tally.see_at(part.middle((i.max(0.0) as usize).clamp(start, end - 1)).0);
            }
            if frame.options.feature_id {
                (start..end).for_each(|i| tally.mark(frame, part.middle(i).1));
            }
        }
        start = end;
    }
    part.after(a, b, &mut |piece| outside(&mut tally, piece));
    tally
}
