//! Segments in a pinhole camera: samples in equal steps of a straight image, decided run by run and not one by one.

use super::VisibilityContext;
use super::polygon::{PolygonCache, PreparedPolygon, RelativeDepth, within_edges};
use super::strategy::{Decision, FeatureQuery, Workspace};
use super::tally::{SampleState, Tally};
use super::tiles::{Look, Square};
use crate::environment::FeatureShape;
use crate::features::sample::Straight;
use crate::features::{FeatureStats, Reason};
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

    /// Marks what a polygon hides; `None` if nothing is known about its range there.
    fn hide(&self, known: &PreparedPolygon, polygons: &PolygonCache, by: &mut [u32]) -> Option<()> {
        let [p, q] = self.ends;
        let shares = [known.inverse.dot(p), known.inverse.dot(q)];
        if !(shares[0] > 1.0 || shares[1] > 1.0) {
            return Some(());
        }
        let Some([from, to]) = within_edges(polygons.planes_of(known), p, q) else { return Some(()) };
        let number = |share: f64| self.part.number_at(p + share * (q - p));
        let first = if from > 0.0 { (number(from).ceil() as usize).max(self.some.start) } else { self.some.start };
        let end = if to < 1.0 { ((number(to) + 1.0) as usize).min(self.some.end) } else { self.some.end };
        let Some(by) = by.get_mut(first..end) else { return Some(()) };
        let [near, far] = self.ranges;
        let least = [near, far].map(|range| known.least_share(shares[0].max(shares[1]), range, self.rounding));
        let least = least[0].max(least[1]);
        if shares[0] > least && shares[1] > least {
            by.iter_mut().filter(|by| **by == NONE).for_each(|by| *by = known.slot);
            return Some(());
        }
        // It crosses the segment, or nearly: one by one.
        for (i, by) in by.iter_mut().enumerate().filter(|(_, by)| **by == NONE) {
            let at = self.part.middle(first + i).0;
            match known.nearer(known.inverse.dot(at), at.length(), self.rounding) {
                RelativeDepth::Yes => *by = known.slot,
                RelativeDepth::No => {}
                RelativeDepth::Unknown => return None,
            }
        }
        Some(())
    }
}

/// Decides about a segment in a straight image, if only what is in between decides, and no more care is needed.
pub(super) fn decide(query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<Decision> {
    let FeatureQuery { frame, shape: FeatureShape::Segment { .. }, points: [a, b], own, .. } = query else {
        return None;
    };
    let spec = frame.sensor.spec();
    if !own.is_plain() || spec.max_incidence.is_some() {
        return None;
    }
    let part = frame.sampler.straight_part(*a, *b)?;
    let ranges = ranges(&part);
    if part.count < 3 || !(ranges[0] >= spec.range_min && ranges[1] <= spec.range_max && ranges[0] > 0.0) {
        return None;
    }
    let mut by = vec![NONE; part.count];
    let whole = Stretch::new(&part, 0..part.count, ranges, own.rounding());
    hide_by_image(&whole, query, workspace, &mut by)?;
    let left = open(&by);
    let first = by.iter().position(|b| *b == NONE).unwrap_or(part.count);
    let end = by.iter().rposition(|b| *b == NONE).map_or(first, |last| last + 1);
    hide_by_tiles(&whole, first..end, query, workspace, &mut by)?;
    let visible = open(&by);
    let stats = FeatureStats {
        features: 1,
        samples: part.count,
        hidden_by_neighbours: part.count - left,
        hidden_in_space: left - visible,
        visible,
        ..FeatureStats::default()
    };
    Some(Decision { tally: tally_of(frame, &part, [*a, *b], &by), stats })
}

/// How many samples nothing hides.
fn open(by: &[u32]) -> usize {
    by.iter().filter(|by| **by == NONE).count()
}

/// Marks what polygons seen around a part of the samples hide; `None` if more care is needed.
fn hide_by_image(
    whole: &Stretch<'_>,
    query: &FeatureQuery<'_>,
    workspace: &mut Workspace,
    by: &mut [u32],
) -> Option<()> {
    let FeatureQuery { frame, own, .. } = query;
    let Workspace { polygons, candidates, .. } = workspace;
    candidates.begin();
    match query.hints {
        Some(hints) => candidates.add_hints(frame, polygons, hints, own),
        None => {
            let [from, to] = whole.part.pixels;
            let blocks = ((to - from).abs().max_element() / BLOCKS_APART).ceil().max(1.0);
            for i in 0..=blocks as u32 {
                candidates.add_around(frame, polygons, from.lerp(to, f64::from(i) / blocks), own);
            }
        }
    }
    let hide = |number: &u32| whole.hide(polygons.get(*number), polygons, by);
    candidates.numbers().iter().try_for_each(hide)
}

/// Marks whatever hides some samples, tile by tile; `None` if more care is needed.
fn hide_by_tiles(
    whole: &Stretch<'_>,
    some: Range<usize>,
    query: &FeatureQuery<'_>,
    workspace: &mut Workspace,
    by: &mut [u32],
) -> Option<()> {
    let FeatureQuery { frame, own, .. } = query;
    let Workspace { polygons, tiles, near, .. } = workspace;
    let part = whole.part;
    let open_from = |start: usize, by: &[u32]| {
        let open = by[start..some.end].iter().position(|by| *by == NONE);
        open.map_or(some.end, |more| start + more)
    };
    let mut start = some.start;
    while start < some.end {
        let first = part.middle(start).0;
        let end = end_in(part, &tiles.of(first).1, start..some.end);
        for look in [Look::First, Look::All] {
            let stretch = Stretch::new(part, start..end, whole.ranges, whole.rounding);
            let farthest = stretch.ends[0].length().max(stretch.ends[1].length());
            let (tile, has_all) = tiles.tile(frame, polygons, first, farthest, look);
            tiles.between(tile, &stretch.ends, own, polygons, near);
            for number in near.iter() {
                stretch.hide(polygons.get(*number), polygons, by)?;
            }
            start = open_from(start, by).min(end);
            if has_all || start == end {
                break;
            }
        }
        start = open_from(end, by);
    }
    Some(())
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
        tally.take_run(state, run.len(), [t0, t1], [p0, p1]);
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
    // Not of parts, which depend on which of several polygons is known to hide them.
    tally.weigh(part.length, 0.0);
    tally
}
