//! Decides sample by sample: segments with curved images, small patches, points.

use super::strategy::{Decision, FeatureQuery, Workspace};
use super::tally::{SampleState, Tally};
use super::tiles::{FEW_FOR_TILES, Look};
use super::undecided::{Line, UndecidedSample, hide_along};
use super::windows::Windows;
use super::{Visibility, rays};
use crate::sample::Piece;
use crate::{FeatureStats, Reason};
use glam::{DVec2, DVec3};
use presight_model::environment::FeatureShape;

#[derive(Default)]
pub(super) struct Samples {
    pieces: Vec<Piece>,
    /// By piece: its state; [`SampleState::Seen`] while it is undecided.
    states: Vec<SampleState>,
    /// Samples that only occlusion can still hide.
    pub open: Vec<UndecidedSample>,
    /// The indices of the pieces of `open`.
    pieces_of_open: Vec<u32>,
}

impl Samples {
    /// Samples a feature in the workspace's memory.
    pub fn of(query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Self {
        let mut samples = std::mem::take(&mut workspace.samples);
        samples.take_pieces(query);
        samples.sort(query);
        samples
    }

    fn take_pieces(&mut self, query: &FeatureQuery<'_>) {
        let FeatureQuery { frame, shape, points, .. } = query;
        let sampler = &frame.sampler;
        self.pieces.clear();
        let mut take = |piece: Piece| self.pieces.push(piece);
        match shape {
            FeatureShape::Point { .. } | FeatureShape::Reflector { .. } | FeatureShape::Contour { .. } => {
                take(sampler.point(points[0]));
            }
            FeatureShape::Segment { .. } => sampler.segment(points[0], points[1], &mut take),
            FeatureShape::Patch { .. } | FeatureShape::Fiducial { .. } => match frame.options.visibility {
                Visibility::Image => sampler.small_patch(points, &mut take),
                Visibility::Rays => sampler.patch(points, &mut take),
            },
        }
    }

    /// Separates the samples that geometry alone decides from the undecided ones.
    fn sort(&mut self, query: &FeatureQuery<'_>) {
        self.states.clear();
        self.open.clear();
        self.pieces_of_open.clear();
        for (number, piece) in self.pieces.iter().enumerate() {
            let state = match piece {
                Piece::Outside { reason, .. } => SampleState::Hidden(*reason, None),
                Piece::Inside(sample) => {
                    let range = sample.at.length();
                    match query.own.before_occlusion(query.frame, sample.at, range) {
                        Some(reason) => SampleState::Hidden(reason, None),
                        None => {
                            self.open.push(UndecidedSample::new(sample.at, range));
                            self.pieces_of_open.push(number as u32);
                            SampleState::Seen
                        }
                    }
                }
            };
            self.states.push(state);
        }
    }

    /// The pixel coordinates of an undecided sample.
    fn pixel_of(&self, open: usize) -> DVec2 {
        match &self.pieces[self.pieces_of_open[open] as usize] {
            Piece::Inside(sample) => sample.pixel,
            Piece::Outside { .. } => DVec2::ZERO,
        }
    }

    /// The undecided samples: positions (image frame) and nearest pixels (row-major).
    pub fn queries(&self, query: &FeatureQuery<'_>) -> super::QuerySamples {
        let width = i64::from(query.frame.images.width);
        let number = |i: usize| {
            let (column, row) = query.frame.sampler.nearest_pixel(self.pixel_of(i));
            (row * width + column) as u32
        };
        self.open.iter().enumerate().map(|(i, o)| (o.at, number(i))).collect()
    }

    /// Merges the results of the undecided samples with all others.
    pub fn decision(&mut self, query: &FeatureQuery<'_>, mut stats: FeatureStats) -> Decision {
        for (open, piece) in self.open.iter().zip(&self.pieces_of_open) {
            let state = open.state();
            self.states[*piece as usize] = state;
            stats.hidden_in_space += usize::from(open.by.is_some());
            stats.undecided += usize::from(state == SampleState::Hidden(Reason::Undecided, None));
            stats.visible += usize::from(state == SampleState::Seen);
        }
        stats.hidden_in_space -= stats.hidden_by_neighbours;
        let mut tally = Tally::default();
        if query.frame.options.regions && query.shape.is_area() {
            let place = |piece: &Piece| if let Piece::Inside(sample) = piece { Some(sample.pixel) } else { None };
            tally.windows = Some(Windows::new(self.pieces.iter().filter_map(place)).into());
        }
        for (piece, state) in self.pieces.iter().zip(&self.states) {
            tally.take(query.frame, piece, *state);
        }
        Decision { tally, stats }
    }
}

/// Decides any feature.
pub(super) fn decide(query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<Decision> {
    let mut samples = Samples::of(query, workspace);
    let line = match query.shape {
        FeatureShape::Segment { .. } => Some(Line::new(query.points[0], query.points[1])),
        _ => None,
    };
    match (line, query.hints) {
        (Some(line), _) => image_along(line, query, &mut samples, workspace),
        (None, Some(hints)) => hints_at_samples(hints, query, &mut samples, workspace),
        (None, None) => image_at_samples(query, &mut samples, workspace),
    }
    let hidden_by_neighbours = samples.open.iter().filter(|o| o.by.is_some()).count();
    let first = samples.open.iter().position(|o| o.by.is_none());
    let last = samples.open.iter().rposition(|o| o.by.is_none());
    if let (Some(first), Some(last)) = (first, last) {
        let left = &mut samples.open[first..=last];
        match line {
            Some(line) => space_along(line, left, query, workspace),
            None => space_at_samples(left, query, workspace),
        }
    }
    let count = samples.open.len();
    let stats = FeatureStats { features: 1, samples: count, hidden_by_neighbours, ..FeatureStats::default() };
    let decision = samples.decision(query, stats);
    workspace.samples = samples;
    Some(decision)
}

/// Tests the polygons seen around a segment's image against the whole segment.
fn image_along(line: Line, query: &FeatureQuery<'_>, samples: &mut Samples, workspace: &mut Workspace) {
    let Workspace { polygons, candidates, .. } = workspace;
    candidates.propose(query, polygons, |add| (0..samples.open.len()).for_each(|i| add(samples.pixel_of(i))));
    for number in candidates.numbers() {
        let known = polygons.get(*number);
        hide_along(known, polygons.planes_of(known), line, &mut samples.open, query.own.rounding());
    }
}

/// Tests the polygons seen around every sample against that sample.
fn image_at_samples(query: &FeatureQuery<'_>, samples: &mut Samples, workspace: &mut Workspace) {
    let FeatureQuery { frame, own, .. } = query;
    let Workspace { polygons, candidates, .. } = workspace;
    candidates.begin();
    for i in 0..samples.open.len() {
        let pixel = samples.pixel_of(i);
        if candidates.moves(frame, pixel) {
            candidates.begin();
            candidates.add_around(frame, polygons, pixel, own);
        }
        for number in candidates.numbers() {
            samples.open[i].hide_by(polygons.get(*number), polygons, own.rounding());
        }
    }
}

/// Tests the polygons of hints, each against its sample.
fn hints_at_samples(hints: &[Option<u32>], query: &FeatureQuery<'_>, samples: &mut Samples, workspace: &mut Workspace) {
    let FeatureQuery { frame, own, .. } = query;
    let Workspace { polygons, candidates, .. } = workspace;
    debug_assert_eq!(hints.len(), samples.open.len());
    for (sample, hint) in samples.open.iter_mut().zip(hints) {
        candidates.begin();
        candidates.add_hints(frame, polygons, &[*hint], own);
        for number in candidates.numbers() {
            sample.hide_by(polygons.get(*number), polygons, own.rounding());
        }
    }
}

/// Tests the polygons that the index finds against the samples of a segment, tile by tile.
fn space_along(line: Line, left: &mut [UndecidedSample], query: &FeatureQuery<'_>, workspace: &mut Workspace) {
    let FeatureQuery { frame, own, .. } = query;
    let Workspace { polygons, tiles, near, .. } = workspace;
    let mut start = 0;
    while start < left.len() {
        let number = tiles.of(left[start].at).0;
        let more = left[start..].iter().position(|o| tiles.of(o.at).0 != number);
        let end = more.map_or(left.len(), |more| start + more);
        let some = &mut left[start..end];
        if some.iter().any(|o| o.by.is_none()) {
            let farthest = some.iter().map(|o| o.range).fold(0.0, f64::max);
            let ends = [some[0].at, some[some.len() - 1].at];
            for look in [Look::First, Look::All] {
                let (tile, has_all) = tiles.tile(frame, polygons, ends[0], farthest, look);
                tiles.between(tile, &ends, own, polygons, near);
                for number in near.iter() {
                    let known = polygons.get(*number);
                    hide_along(known, polygons.planes_of(known), line, some, own.rounding());
                }
                if has_all || some.iter().all(|o| o.by.is_some()) {
                    break;
                }
            }
        }
        start = end;
    }
}

/// Tests the polygons that the index finds against the samples of a point or patch; by tiles unless they are few.
pub(super) fn space_at_samples(left: &mut [UndecidedSample], query: &FeatureQuery<'_>, workspace: &mut Workspace) {
    let FeatureQuery { frame, own, .. } = query;
    let open = |i: &usize| left[*i].by.is_none();
    let mut by_tile: Vec<(u32, usize)> =
        (0..left.len()).filter(open).map(|i| (workspace.tiles.of(left[i].at).0, i)).collect();
    by_tile.sort_unstable();
    let mut places: Vec<DVec3> = Vec::new();
    for some in by_tile.chunk_by(|a, b| a.0 == b.0) {
        places.clear();
        places.extend(some.iter().map(|(_, i)| left[*i].at));
        let farthest = some.iter().map(|(_, i)| left[*i].range).fold(0.0, f64::max);
        if by_tile.len() < FEW_FOR_TILES && !workspace.tiles.knows(some[0].0, farthest) {
            some.iter().for_each(|(_, i)| rays::hide(&mut left[*i], query, workspace));
            continue;
        }
        let Workspace { polygons, tiles, near, .. } = &mut *workspace;
        for look in [Look::First, Look::All] {
            let (tile, has_all) = tiles.tile(frame, polygons, places[0], farthest, look);
            tiles.between(tile, &places, own, polygons, near);
            for (_, i) in some {
                for number in near.iter() {
                    left[*i].hide_by(polygons.get(*number), polygons, own.rounding());
                }
            }
            if has_all || some.iter().all(|(_, i)| left[*i].by.is_some()) {
                break;
            }
        }
    }
}
