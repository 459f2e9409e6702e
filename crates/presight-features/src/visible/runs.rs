//! Decides segments by whole runs of samples instead of single samples.
//!
//! A segment is straight in space, so a polygon hides one interval of it, in closed form. Its image is straight in a
//! pinhole camera; elsewhere it is cut into nearly straight runs ([`Run`]). The ends of the interval show which samples
//! of the runs it contains.

use super::VisibilityContext;
use super::candidates::{BLOCKS_APART, CLEARLY, NONE};
use super::polygon::{PreparedPolygon, RelativeDepth, within_edges};
use super::strategy::{Decision, FeatureQuery, Workspace};
use super::tally::{SampleState, Tally};
use super::tiles::Look;
use crate::sample::{Part, Piece, Run, Sample};
use crate::{FeatureStats, Reason};
use glam::{DVec2, DVec3};
use presight_model::environment::FeatureShape;
use std::ops::Range;

/// Maximum number of extra blocks of pixels that are searched in the gaps between the regular ones.
const MAX_LOOKS: usize = 8;

/// The parts of a segment, and the occluders of its samples. Its memory belongs to one worker.
#[derive(Default)]
pub(super) struct SampledSegment {
    parts: Vec<Part>,
    /// By part: the number of its first sample.
    firsts: Vec<u32>,
    /// By sample: the slot of its occluder.
    by: Vec<u32>,
    /// Both ends, image frame.
    ends: [DVec3; 2],
    /// Minimum and maximum range of the part in the image.
    ranges: [f64; 2],
    rounding: f64,
}

impl SampledSegment {
    /// Samples a segment; returns false if it has to be decided sample by sample.
    fn take(&mut self, query: &FeatureQuery<'_>, [a, b]: [DVec3; 2]) -> bool {
        let Self { parts, firsts, .. } = self;
        parts.clear();
        firsts.clear();
        let (mut count, mut is_sound) = (0, true);
        let (mut from, mut to) = (1.0f64, 0.0f64);
        query.frame.sampler.parts(a, b, &mut |part| {
            firsts.push(count);
            let (t, samples) = match &part {
                Part::Run(run) => {
                    is_sound &= run.t[0] < run.t[1];
                    (run.t, run.count as u32)
                }
                Part::One(Piece::Inside(sample)) => (sample.t, 1),
                Part::One(Piece::Outside { .. }) => ([1.0, 0.0], 0),
            };
            (from, to) = (from.min(t[0]), to.max(t[1]));
            count += samples;
            parts.push(part);
        });
        self.by.clear();
        self.by.resize(count as usize, NONE);
        let [p, q] = [from, to].map(|t| if t == 1.0 { b } else { a + t * (b - a) });
        let foot = p + share_of_foot(p, q) * (q - p);
        (self.ends, self.ranges) = ([a, b], [foot.length(), p.length().max(q.length())]);
        self.rounding = query.own.rounding();
        let ([near, far], spec) = (self.ranges, query.frame.sensor.spec());
        is_sound && (count == 0 || near >= spec.range_min && far <= spec.range_max && near > 0.0)
    }

    /// The index of the part that has a sample.
    fn part_of(&self, sample: usize) -> usize {
        self.firsts.partition_point(|first| *first as usize <= sample) - 1
    }

    fn middle(&self, sample: usize) -> DVec3 {
        let part = self.part_of(sample);
        match &self.parts[part] {
            Part::Run(run) => run.middle(sample - self.firsts[part] as usize).0,
            Part::One(Piece::Inside(sample)) => sample.at,
            Part::One(Piece::Outside { .. }) => self.ends[0],
        }
    }

    /// The pixel coordinates of the middle of a sample.
    fn pixel(&self, sample: usize) -> DVec2 {
        let part = self.part_of(sample);
        match &self.parts[part] {
            Part::Run(run) => run.middle(sample - self.firsts[part] as usize).1,
            Part::One(Piece::Inside(sample)) => sample.pixel,
            Part::One(Piece::Outside { .. }) => DVec2::ZERO,
        }
    }

    /// The share of the segment's length before a place on it.
    fn t(&self, at: DVec3) -> f64 {
        let [a, b] = self.ends;
        (at - a).dot(b - a) / (b - a).length_squared().max(f64::MIN_POSITIVE)
    }

    /// The fractional number of the sample at a share of the length; whole numbers are middles of samples.
    fn number(&self, t: f64) -> f64 {
        let end_of = |part: &Part| match part {
            Part::Run(run) => run.t[1],
            Part::One(Piece::Inside(Sample { t, .. }) | Piece::Outside { t, .. }) => t[1],
        };
        let part = self.parts.partition_point(|part| end_of(part) < t).min(self.parts.len() - 1);
        let first = f64::from(self.firsts[part]);
        match &self.parts[part] {
            Part::Run(run) => first + run.number(t),
            // Before, at or after the sample's middle.
            Part::One(Piece::Inside(sample)) => first + (t - self.t(sample.at)).clamp(-0.25, 0.25),
            Part::One(Piece::Outside { .. }) => first - 0.5,
        }
    }

    /// Marks the samples that a polygon hides; `None` if the polygon's range there is unknown.
    fn hide(&mut self, known: &PreparedPolygon, planes: &[DVec3], stretch: &Stretch) -> Option<()> {
        let Stretch { some, ends: [p, q], t } = stretch;
        let shares = [known.inverse.dot(*p), known.inverse.dot(*q)];
        if !(shares[0] > 1.0 || shares[1] > 1.0) {
            return Some(());
        }
        let Some([from, to]) = within_edges(planes, *p, *q) else { return Some(()) };
        let share_at = |s: f64| shares[0] + s * (shares[1] - shares[0]);
        let within = [share_at(from), share_at(to)];
        if !(within[0].max(within[1]) > 1.0 - CLEARLY) {
            return Some(());
        }
        let number = |share: f64| self.number(t[0] + share * (t[1] - t[0]));
        let first = if from > 0.0 { (number(from).ceil() as usize).max(some.start) } else { some.start };
        let end = if to < 1.0 { ((number(to) + 1.0) as usize).min(some.end) } else { some.end };
        if first >= end {
            return Some(());
        }
        let [near, far] = self.ranges;
        let least = [near, far].map(|range| known.min_share(within[0].max(within[1]), range, self.rounding));
        let least = least[0].max(least[1]);
        if within.iter().all(|share| *share > least * (1.0 + CLEARLY)) {
            self.by[first..end].iter_mut().filter(|by| **by == NONE).for_each(|by| *by = known.slot);
            return Some(());
        }
        // The polygon crosses the segment, or nearly does: test each sample.
        for sample in first..end {
            if self.by[sample] == NONE {
                let at = self.middle(sample);
                match known.nearer(known.inverse.dot(at), at.length(), self.rounding) {
                    RelativeDepth::Yes => self.by[sample] = known.slot,
                    RelativeDepth::No => {}
                    RelativeDepth::Unknown => return None,
                }
            }
        }
        Some(())
    }

    fn stretch(&self, some: Range<usize>) -> Stretch {
        let ends = [self.middle(some.start), self.middle(some.end - 1)];
        Stretch { some, ends, t: ends.map(|at| self.t(at)) }
    }

    /// Number of samples that are not hidden.
    fn open(&self) -> usize {
        self.by.iter().filter(|by| **by == NONE).count()
    }

    /// The first sample in a range that is not hidden.
    fn open_in(&self, some: Range<usize>) -> usize {
        let open = self.by[some.clone()].iter().position(|by| *by == NONE);
        open.map_or(some.end, |more| some.start + more)
    }
}

/// A non-empty range of samples.
struct Stretch {
    some: Range<usize>,
    /// The middles of the first and last sample, and their shares of the segment's length.
    ends: [DVec3; 2],
    t: [f64; 2],
}

/// The share of the line from a to b at which it is nearest to the sensor.
fn share_of_foot(a: DVec3, b: DVec3) -> f64 {
    let d = b - a;
    (-a.dot(d) / d.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
}

/// Decides a segment if only occlusion can hide it; `None` if that needs more care.
pub(super) fn decide(query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<Decision> {
    let FeatureQuery { frame, shape: FeatureShape::Segment { .. }, points: [a, b], own, .. } = query else {
        return None;
    };
    if frame.sampler.is_one_row() || !own.is_plain() || frame.sensor.spec().max_incidence.is_some() {
        return None;
    }
    let mut segment = std::mem::take(&mut workspace.segment);
    let decision = segment.take(query, [*a, *b]).then(|| segment.decide(query, workspace)).flatten();
    workspace.segment = segment;
    decision
}

impl SampledSegment {
    fn decide(&mut self, query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<Decision> {
        let count = self.by.len();
        let mut stats = FeatureStats { features: 1, samples: count, ..FeatureStats::default() };
        if count > 0 {
            self.hide_by_image(query, workspace)?;
            let left = self.open();
            self.hide_by_tiles(query, workspace)?;
            stats.visible = self.open();
            stats.hidden_by_neighbours = count - left;
            stats.hidden_in_space = left - stats.visible;
        }
        Some(Decision { tally: self.tally(query.frame), stats })
    }

    /// Marks the samples hidden by polygons seen around some of the samples; `None` if more care is needed.
    fn hide_by_image(&mut self, query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<()> {
        let FeatureQuery { frame, own, .. } = query;
        let Workspace { polygons, candidates, .. } = workspace;
        candidates.propose(query, polygons, |add| {
            let mut last: Option<DVec2> = None;
            let mut add_apart = |pixel: DVec2, is_apart: bool| {
                if is_apart || last.is_none_or(|last| last.distance_squared(pixel) >= BLOCKS_APART * BLOCKS_APART) {
                    last = Some(pixel);
                    add(pixel);
                }
            };
            for part in &self.parts {
                match part {
                    // Search all places of a long run, with its end; short runs follow each other closely.
                    Part::Run(run) => {
                        let is_long = run.length >= BLOCKS_APART;
                        run.places(BLOCKS_APART).enumerate().for_each(|(i, at)| add_apart(at, is_long && i > 0));
                    }
                    Part::One(Piece::Inside(sample)) => add_apart(sample.pixel, false),
                    Part::One(Piece::Outside { .. }) => {}
                }
            }
        });
        let count = self.by.len();
        let whole = self.stretch(0..count);
        for number in candidates.numbers() {
            let known = polygons.get(*number);
            self.hide(known, polygons.planes_of(known), &whole)?;
        }
        if query.hints.is_some() {
            return Some(());
        }
        // Search the middle of each remaining gap: building a tile that reaches behind it would take longer.
        let mut start = self.open_in(0..count);
        for _ in 0..MAX_LOOKS {
            if start == count {
                break;
            }
            let end = self.by[start..].iter().position(|by| *by != NONE).map_or(count, |more| start + more);
            let middle = start.midpoint(end);
            let known = candidates.numbers().len();
            candidates.add_around(frame, polygons, self.pixel(middle), own);
            for number in &candidates.numbers()[known..] {
                let known = polygons.get(*number);
                self.hide(known, polygons.planes_of(known), &whole)?;
            }
            start = self.open_in(if self.by[middle] == NONE { end } else { start }..count);
        }
        Some(())
    }

    /// Marks the samples hidden by polygons that the index finds, tile by tile; `None` if more care is needed.
    fn hide_by_tiles(&mut self, query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<()> {
        let FeatureQuery { frame, own, .. } = query;
        let Workspace { polygons, tiles, near, .. } = workspace;
        let count = self.by.len();
        let end = self.by.iter().rposition(|by| *by == NONE).map_or(0, |last| last + 1);
        let mut start = self.open_in(0..count);
        while start < end {
            let [first, last] = [start, end - 1].map(|sample| self.middle(sample));
            let stop = match tiles.of(first).1.left_at(first, last) {
                share if share < 1.0 => {
                    let t = self.t(first) + share * (self.t(last) - self.t(first));
                    (self.number(t) as usize + 1).clamp(start + 1, end)
                }
                _ => end,
            };
            for look in [Look::First, Look::All] {
                let stretch = self.stretch(start..stop);
                let farthest = stretch.ends[0].length().max(stretch.ends[1].length());
                let (tile, has_all) = tiles.tile(frame, polygons, first, farthest, look);
                tiles.between(tile, &stretch.ends, own, polygons, near);
                for number in near.iter() {
                    let known = polygons.get(*number);
                    self.hide(known, polygons.planes_of(known), &stretch)?;
                }
                start = self.open_in(start..stop);
                if has_all || start == stop {
                    break;
                }
            }
            start = self.open_in(stop..end);
        }
        Some(())
    }

    fn tally(&self, frame: &VisibilityContext<'_>) -> Tally {
        let mut tally = Tally::default();
        let state = |by: u32| match by {
            NONE => SampleState::Seen,
            slot => SampleState::Hidden(Reason::Occluded, Some(slot)),
        };
        let foot = share_of_foot(self.ends[0], self.ends[1]);
        for (part, first) in self.parts.iter().zip(&self.firsts) {
            let first = *first as usize;
            match part {
                Part::Run(run) => take_run(&mut tally, frame, run, &self.by[first..first + run.count], foot),
                Part::One(piece @ Piece::Inside(_)) => tally.take(frame, piece, state(self.by[first])),
                Part::One(Piece::Outside { t, reason }) => {
                    let piece = Piece::Outside { t: *t, reason: *reason };
                    tally.take(frame, &piece, SampleState::Hidden(*reason, None));
                }
            }
        }
        tally
    }
}

/// Adds the samples of a run, whose occluders are `by`; `foot` is where the segment is nearest to the sensor.
fn take_run(tally: &mut Tally, frame: &VisibilityContext<'_>, run: &Run, by: &[u32], foot: f64) {
    let nearest = run.number(foot);
    let mut start = 0;
    for some in by.chunk_by(|a, b| a == b) {
        let end = start + some.len();
        let ((t0, p0), (t1, p1)) = (run.bound(start), run.bound(end));
        let state = match some[0] {
            NONE => SampleState::Seen,
            slot => SampleState::Hidden(Reason::Occluded, Some(slot)),
        };
        tally.take_some(state, [t0, t1], [p0, p1], [0.0, some.len() as f64]);
        if state == SampleState::Seen {
            for i in [nearest.floor(), nearest.ceil()] {
                tally.see_at(run.middle((i.max(0.0) as usize).clamp(start, end - 1)).0);
            }
            if frame.options.feature_id {
                (start..end).for_each(|i| tally.mark(frame, run.middle(i).1));
            }
        }
        start = end;
    }
    // Sum sample by sample: the sums then equal those of [`super::samples`] exactly, whichever occluders were found.
    let weight = run.weight();
    by.iter().for_each(|by| tally.weigh(weight, if *by == NONE { weight } else { 0.0 }));
}
