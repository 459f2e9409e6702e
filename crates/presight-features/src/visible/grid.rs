//! Decides small patches in pinhole cameras and scanners, column by column of a grid of samples.
//!
//! A column sees a straight line of a plane patch, and an occluder hides one interval of it. Along the interval every
//! tested value is linear in the ray, or a monotonic quotient of two linear values. So the two ends decide all of it.

use super::VisibilityContext;
use super::candidates::{BLOCKS_APART, CLEARLY, NONE};
use super::polygon::{PreparedPolygon, RelativeDepth, within_edges};
use super::rays;
use super::strategy::{Decision, FeatureQuery, Workspace};
use super::tally::{SampleState, Tally};
use super::tiles::{FEW_FOR_TILES, Look};
use super::undecided::UndecidedSample;
use super::windows::Windows;
use crate::sample::{Column, PatchColumns, PatchOutline};
use crate::{FeatureStats, Reason};
use glam::DVec3;
use std::ops::Range;

/// The samples of a patch, and their occluders.
struct Grid {
    samples: PatchColumns,
    /// By sample: the slot of its occluder.
    by: Vec<u32>,
    ranges: [f64; 2],
    rounding: f64,
}

/// Samples of a column that lie in one tile.
struct Piece {
    tile: u32,
    column: u32,
    rows: Range<usize>,
}

/// Decides a patch in straight columns if only occlusion can hide it; `None` if that needs more care.
pub(super) fn decide(query: &FeatureQuery<'_>, outline: PatchOutline, workspace: &mut Workspace) -> Option<Decision> {
    let FeatureQuery { frame, points, own, .. } = query;
    let spec = frame.sensor.spec();
    if !own.is_plain() || spec.max_incidence.is_some() {
        return None;
    }
    let samples = frame.sampler.patch_columns(outline)?;
    let ranges = [samples.distance(), points.iter().map(|p| p.length()).fold(0.0, f64::max)];
    if !(ranges[0] >= spec.range_min && ranges[1] <= spec.range_max && ranges[0] > 0.0) {
        return None;
    }
    let count = samples.count;
    let mut grid = Grid { samples, by: vec![NONE; count], ranges, rounding: own.rounding() };
    grid.hide_by_image(query, workspace)?;
    let left = grid.open();
    grid.hide_by_tiles(query, workspace)?;
    let visible = grid.open();
    let stats = FeatureStats {
        features: 1,
        samples: count,
        hidden_by_neighbours: count - left,
        hidden_in_space: left - visible,
        visible,
        ..FeatureStats::default()
    };
    Some(Decision { tally: grid.tally(frame), stats })
}

impl Grid {
    /// Number of samples that are not hidden.
    fn open(&self) -> usize {
        self.by.iter().filter(|by| **by == NONE).count()
    }

    fn by(&mut self, column: usize, rows: Range<usize>) -> &mut [u32] {
        let column = &self.samples.columns[column];
        let first = column.first + rows.start - column.rows.start;
        &mut self.by[first..first + rows.len()]
    }

    /// The rows from the first to the last sample that is not hidden.
    fn open_in(&mut self, column: usize, rows: Range<usize>) -> Range<usize> {
        let by = self.by(column, rows.clone());
        let first = by.iter().position(|by| *by == NONE);
        let last = by.iter().rposition(|by| *by == NONE);
        first.zip(last).map_or(rows.end..rows.end, |(first, last)| rows.start + first..rows.start + last + 1)
    }

    /// Marks the samples that a polygon hides, in at least one row; `None` if the polygon's range there is unknown.
    fn hide(&mut self, known: &PreparedPolygon, planes: &[DVec3], column: usize, rows: &Range<usize>) -> Option<()> {
        let of = &self.samples.columns[column];
        let [p, q] = [rows.start, rows.end - 1].map(|row| self.samples.ray(of, row));
        let Some([from, to]) = within_edges(planes, p, q) else { return Some(()) };
        let rows = self.samples.rows_at(rows.clone(), [from, to]);
        if rows.is_empty() {
            return Some(());
        }
        let share = |row: usize| known.inverse.dot(self.samples.at(of, row));
        let shares = [rows.start, rows.end - 1].map(share);
        let most = shares[0].max(shares[1]);
        if !(most > 1.0 - CLEARLY) {
            return Some(());
        }
        let least = self.ranges.map(|range| known.min_share(most, range, self.rounding));
        if shares.iter().all(|share| *share > least[0].max(least[1]) * (1.0 + CLEARLY)) {
            self.by(column, rows).iter_mut().filter(|by| **by == NONE).for_each(|by| *by = known.slot);
            return Some(());
        }
        // The polygon crosses the patch, or nearly does: test each sample.
        for row in rows {
            let at = self.samples.at(&self.samples.columns[column], row);
            match known.nearer(known.inverse.dot(at), at.length(), self.rounding) {
                RelativeDepth::Yes => {
                    let by = &mut self.by(column, row..row + 1)[0];
                    *by = if *by == NONE { known.slot } else { *by };
                }
                RelativeDepth::No => {}
                RelativeDepth::Unknown => return None,
            }
        }
        Some(())
    }

    /// Marks the samples hidden by polygons seen around some of the samples; `None` if more care is needed.
    fn hide_by_image(&mut self, query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<()> {
        let Workspace { polygons, candidates, .. } = workspace;
        candidates.propose(query, polygons, |add| {
            let apart = (BLOCKS_APART / self.samples.cell()).as_usizevec2().max(glam::USizeVec2::ONE);
            let columns = &self.samples.columns;
            for column in columns.iter().step_by(apart.x).chain(columns.last()) {
                let rows = column.rows.clone().step_by(apart.y).chain([column.rows.end - 1]);
                rows.for_each(|row| add(self.samples.pixel(column, row)));
            }
        });
        for number in candidates.numbers() {
            let known = polygons.get(*number);
            for column in 0..self.samples.columns.len() {
                let rows = self.samples.columns[column].rows.clone();
                self.hide(known, polygons.planes_of(known), column, &rows)?;
            }
        }
        Some(())
    }

    /// The samples that are not hidden yet, by tile.
    fn pieces(&mut self, workspace: &Workspace) -> Vec<Piece> {
        let mut pieces = Vec::new();
        for column in 0..self.samples.columns.len() {
            let rows = self.samples.columns[column].rows.clone();
            let mut open = self.open_in(column, rows);
            while !open.is_empty() {
                let (samples, of) = (&self.samples, &self.samples.columns[column]);
                let tile = workspace.tiles.of(samples.at(of, open.start)).0;
                let is_in = |row: usize| workspace.tiles.of(samples.at(of, row)).0 == tile;
                // A tile is convex, so the samples inside it come first.
                let (mut inside, mut outside) = (open.start, open.end);
                if is_in(open.end - 1) {
                    inside = open.end - 1;
                }
                while outside - inside > 1 {
                    let middle = inside.midpoint(outside);
                    if is_in(middle) { inside = middle } else { outside = middle }
                }
                pieces.push(Piece { tile, column: column as u32, rows: open.start..outside });
                open = self.open_in(column, outside..open.end);
            }
        }
        pieces.sort_by_key(|piece| piece.tile);
        pieces
    }

    /// Marks the samples hidden by polygons that the index finds; `None` if more care is needed.
    fn hide_by_tiles(&mut self, query: &FeatureQuery<'_>, workspace: &mut Workspace) -> Option<()> {
        let FeatureQuery { frame, own, .. } = query;
        let pieces = self.pieces(workspace);
        let count: usize = pieces.iter().map(|piece| piece.rows.len()).sum();
        let mut places: Vec<DVec3> = Vec::new();
        for some in pieces.chunk_by(|a, b| a.tile == b.tile) {
            places.clear();
            for piece in some {
                let column = &self.samples.columns[piece.column as usize];
                places.extend([piece.rows.start, piece.rows.end - 1].map(|row| self.samples.at(column, row)));
            }
            let farthest = places.iter().map(|at| at.length()).fold(0.0, f64::max);
            if count < FEW_FOR_TILES && !workspace.tiles.knows(some[0].tile, farthest) {
                some.iter().for_each(|piece| self.hide_by_rays(piece, query, workspace));
                continue;
            }
            let Workspace { polygons, tiles, near, .. } = &mut *workspace;
            for look in [Look::First, Look::All] {
                let (tile, has_all) = tiles.tile(frame, polygons, places[0], farthest, look);
                tiles.between(tile, &places, own, polygons, near);
                for number in near.iter() {
                    let known = polygons.get(*number);
                    for piece in some {
                        self.hide(known, polygons.planes_of(known), piece.column as usize, &piece.rows)?;
                    }
                }
                if has_all || some.iter().all(|piece| !self.is_open(piece)) {
                    break;
                }
            }
        }
        Some(())
    }

    /// Returns true if some sample of the piece is not hidden.
    fn is_open(&mut self, piece: &Piece) -> bool {
        self.by(piece.column as usize, piece.rows.clone()).contains(&NONE)
    }

    fn hide_by_rays(&mut self, piece: &Piece, query: &FeatureQuery<'_>, workspace: &mut Workspace) {
        let column = piece.column as usize;
        for row in piece.rows.clone() {
            if self.by(column, row..row + 1)[0] == NONE {
                let at = self.samples.at(&self.samples.columns[column], row);
                let mut sample = UndecidedSample::new(at, at.length());
                rays::hide(&mut sample, query, workspace);
                self.by(column, row..row + 1)[0] = sample.by.unwrap_or(NONE);
            }
        }
    }

    fn tally(&self, frame: &VisibilityContext<'_>) -> Tally {
        let mut tally = Tally::default();
        let samples = &self.samples;
        if frame.options.regions {
            let ends = |column: &Column| [column.rows.start, column.rows.end - 1].map(|row| samples.pixel(column, row));
            tally.windows = Some(Windows::new(samples.columns.iter().flat_map(ends)).into());
        }
        for column in &samples.columns {
            let mut start = column.rows.start;
            for some in self.by[column.first..column.first + column.rows.len()].chunk_by(|a, b| a == b) {
                let end = start + some.len();
                let state = match some[0] {
                    NONE => SampleState::Seen,
                    slot => SampleState::Hidden(Reason::Occluded, Some(slot)),
                };
                // All samples have the same weight.
                tally.take_pixels(state, some.len());
                if state == SampleState::Seen {
                    tally.reach_between(samples.pixel(column, start), samples.pixel(column, end - 1));
                    for row in samples.nearest_of(column, start..end) {
                        tally.see_at(samples.at(column, row));
                    }
                    if frame.options.feature_id {
                        (start..end).for_each(|row| tally.mark(frame, samples.pixel(column, row)));
                    }
                }
                start = end;
            }
        }
        tally
    }
}
