//! The floors of a scene on a grid.

use super::cover::{sides, uncovered};
use super::cut::{from_above, height_at, heights};
use super::level::{Level, Levels};
use super::raster::GridFrame;
use super::{Facing, Mobility};
use crate::error::{Error, Result};
use crate::threads::parallel_or_here;
use crate::union_find::UnionFind;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Maximum number of floors in all cells, which bounds their memory to 2 GB.
const MAX_SPANS: usize = 50_000_000;
/// Number of rows that are evaluated together, which bounds the memory for pieces of floors.
const BAND: usize = 64;
/// Minimum height of an obstacle above the highest point of the floor in its cell, metres: rounding.
const ABOVE: f64 = 1e-6;
/// The end of a list of pieces.
const END: u32 = u32::MAX;

crate::options! {
    /// The robot, and the heights that count as obstacles.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct FieldOptions {
        /// The robot.
        mobility: Mobility = Mobility::default(), with_mobility;
        /// Lower end of the heights above the floor that block a cell, metres. The upper end is the robot's height.
        from_height: f64 = Mobility::default().step, with_from_height;
    }
}

/// A floor that covers a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Span {
    /// Lowest and highest point in the cell, metres.
    pub low: f64,
    pub high: f64,
    pub faces_up: bool,
    /// True if a surface lies above it in the obstacles' heights.
    pub is_blocked: bool,
    /// True if a surface lies above it between the robot's step and its height.
    pub is_buried: bool,
}

/// A part of a floor polygon in a cell.
#[derive(Clone, Copy, Debug)]
struct Piece {
    low: f64,
    high: f64,
    polygon: u32,
    next: u32,
    covers_all: bool,
}

/// A polygon that is level enough for a floor, metres from the origin of the grid.
struct FloorPolygon {
    corners: Vec<DVec3>,
    outline: Vec<DVec2>,
    sides: Vec<(DVec2, f64)>,
    heights: (f64, f64),
    facing: Facing,
}

impl FloorPolygon {
    /// Lowest and highest point in a square that lies inside the polygon, metres.
    fn heights_in(&self, square: &[DVec2; 4]) -> (f64, f64) {
        let (low, high) = self.heights;
        if low == high {
            return self.heights;
        }
        let at = square.map(|p| height_at(&self.corners, p).clamp(low, high));
        (at.into_iter().fold(high, f64::min), at.into_iter().fold(low, f64::max))
    }
}

/// The floors of a scene in the cells of a grid, from the lowest to the highest in each cell.
#[derive(Clone, Debug)]
pub struct HeightField {
    frame: GridFrame,
    options: FieldOptions,
    /// Number of the first span of each cell, and the number of all spans.
    first: Vec<u32>,
    spans: Vec<Span>,
    roots: Vec<u32>,
    levels: Levels,
}

impl HeightField {
    /// The floors of convex polygons, given by their corners in the world, metres, counter-clockwise as seen from their
    /// fronts.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] for a robot whose numbers are not in order; [`crate::ErrorKind::Invalid`] for too
    /// many floors.
    pub fn new(polygons: &[Vec<DVec3>], frame: GridFrame, options: &FieldOptions) -> Result<Self> {
        let mobility = &options.mobility;
        if !mobility.is_sound() {
            let what = format!("{mobility:?}");
            return Err(Error::usage(what, "give a step below the height, and a slope of 0 to 60 degrees"));
        }
        let all: Vec<Vec<DVec3>> = polygons.iter().map(|corners| frame.local(corners)).collect();
        let floors: Vec<FloorPolygon> = all.iter().filter_map(|corners| floor_polygon(corners, mobility)).collect();
        let bands = |all: &mut dyn Iterator<Item = Range<usize>>| by_band(frame.height, all);
        let floors_by_band = bands(&mut floors.iter().map(|floor| frame.rows(&floor.corners)));
        let all_by_band = bands(&mut all.iter().map(|corners| frame.rows(corners)));
        let count = AtomicUsize::new(0);
        let made: Vec<Option<Band<'_>>> = parallel_or_here(|| {
            let bands = floors_by_band.par_iter().zip(&all_by_band).enumerate().with_max_len(1);
            let make = |(number, (near, above)): (usize, (&Vec<u32>, &Vec<u32>))| {
                if count.load(Ordering::Relaxed) > MAX_SPANS {
                    return None;
                }
                let rows = number * BAND..((number + 1) * BAND).min(frame.height);
                let mut band = Band { frame, options, rows, first: vec![0], spans: Vec::new() };
                band.add_floors(&floors, near);
                band.add_obstacles(above.iter().map(|k| all[*k as usize].as_slice()));
                count.fetch_add(band.spans.len(), Ordering::Relaxed);
                Some(band)
            };
            bands.map(make).collect()
        });
        if count.into_inner() > MAX_SPANS {
            let what = format!("the grid has more than {MAX_SPANS} floors");
            return Err(Error::invalid(what, "use larger cells"));
        }
        let mut field = Self {
            frame,
            options: *options,
            first: vec![0],
            spans: Vec::new(),
            roots: Vec::new(),
            levels: Levels::default(),
        };
        for band in made.into_iter().flatten() {
            let before = field.spans.len() as u32;
            field.first.extend(band.first[1..].iter().map(|first| before + first));
            field.spans.extend(band.spans);
        }
        let mut sets = field.connected();
        field.levels = Levels::new(&field.spans, &mut sets, mobility.step, frame.cell * frame.cell);
        field.roots = sets.into_roots();
        Ok(field)
    }

    /// Numbers and levels from the lowest to the highest, without levels much smaller than the largest one.
    pub fn levels(&self) -> Vec<(usize, Level)> {
        self.levels.listed().into_iter().map(|level| (level, self.levels.all[level])).collect()
    }

    /// A level by its number.
    pub fn level(&self, level: usize) -> &Level {
        &self.levels.all[level]
    }

    /// Number of the lowest large level with free room above; `None` without a floor.
    pub fn default_level(&self) -> Option<usize> {
        self.levels.usual()
    }

    /// Number of the level with the largest area within a step of a height, metres; `None` without one.
    pub fn level_at(&self, height: f64) -> Option<usize> {
        let step = self.options.mobility.step;
        let mut cells = vec![0usize; self.levels.all.len()];
        for (k, span) in self.spans.iter().enumerate().filter(|(_, span)| !span.is_buried) {
            if span.low <= height + step
                && span.high >= height - step
                && let Some(level) = self.levels.of(self.roots[k])
            {
                cells[level] += 1;
            }
        }
        // The first of equally large ones.
        let most = (0..cells.len()).rev().max_by_key(|level| cells[*level])?;
        (cells[most] > 0).then_some(most)
    }

    /// Height of a level in each cell, metres. Cells without a floor of the level have the height of a nearest one.
    pub fn heights(&self, level: usize) -> Vec<f64> {
        let mut heights = vec![f64::NAN; self.frame.count()];
        let usual = self.levels.all[level].height;
        let mut next = VecDeque::new();
        for (cell, height) in heights.iter_mut().enumerate() {
            for k in self.spans_of(cell).filter(|k| self.is_on(*k, level)) {
                let low = self.spans[k].low;
                if !((*height - usual).abs() <= (low - usual).abs()) {
                    *height = low;
                }
            }
            if !height.is_nan() {
                next.push_back(cell);
            }
        }
        let GridFrame { width, height: rows, .. } = self.frame;
        while let Some(cell) = next.pop_front() {
            let (x, y) = (cell % width, cell / width);
            let around = [
                (x > 0).then(|| cell - 1),
                (x + 1 < width).then(|| cell + 1),
                (y > 0).then(|| cell - width),
                (y + 1 < rows).then(|| cell + width),
            ];
            for other in around.into_iter().flatten() {
                if heights[other].is_nan() {
                    heights[other] = heights[cell];
                    next.push_back(other);
                }
            }
        }
        heights
    }

    /// True if a floor at a height, within a step, covers a cell and nothing is in the obstacles' heights above it.
    pub fn is_free(&self, cell: usize, height: f64) -> bool {
        let step = self.options.mobility.step;
        let is_near = |span: &Span| span.low <= height + step && span.high >= height - step;
        self.spans_of(cell).map(|k| &self.spans[k]).any(|span| is_near(span) && !span.is_blocked)
    }

    fn spans_of(&self, cell: usize) -> Range<usize> {
        self.first[cell] as usize..self.first[cell + 1] as usize
    }

    fn is_on(&self, span: usize, level: usize) -> bool {
        !self.spans[span].is_buried && self.levels.of(self.roots[span]) == Some(level)
    }

    /// Sets of floors with free room above, between which a robot can drive.
    fn connected(&self) -> UnionFind {
        let mut sets = UnionFind::new(self.spans.len());
        let GridFrame { width, height, .. } = self.frame;
        let step = self.options.mobility.step;
        for cell in 0..width * height {
            let neighbours = [
                ((cell + 1) % width != 0).then_some(cell + 1),
                (cell + width < width * height).then_some(cell + width),
            ];
            for other in neighbours.into_iter().flatten() {
                for a in self.spans_of(cell).filter(|k| !self.spans[*k].is_buried) {
                    for b in self.spans_of(other).filter(|k| !self.spans[*k].is_buried) {
                        let (p, q) = (&self.spans[a], &self.spans[b]);
                        if p.low - q.high <= step && q.low - p.high <= step {
                            sets.join(a as u32, b as u32);
                        }
                    }
                }
            }
        }
        sets
    }
}

/// Rows that are evaluated together.
struct Band<'a> {
    frame: GridFrame,
    options: &'a FieldOptions,
    rows: Range<usize>,
    /// Number of the first floor of each cell of the rows, and the number of all.
    first: Vec<u32>,
    spans: Vec<Span>,
}

impl Band<'_> {
    /// Adds the floors, of the polygons that reach into the rows.
    fn add_floors(&mut self, floors: &[FloorPolygon], near: &[u32]) {
        let (frame, width, rows) = (self.frame, self.frame.width, self.rows.clone());
        let mut last = vec![END; rows.len() * width];
        let mut pieces: Vec<Piece> = Vec::new();
        for &polygon in near {
            let floor = &floors[polygon as usize];
            let is_level = floor.heights.0 == floor.heights.1;
            frame.strips(&floor.corners, &rows, |row, columns, strip| {
                let inside = frame.inside(&floor.sides, row, &columns);
                for column in columns {
                    let covers_all = inside.contains(&column);
                    let (low, high) = match covers_all {
                        _ if is_level => floor.heights,
                        true => floor.heights_in(&frame.square(column, row)),
                        false => frame.heights_in(strip, column),
                    };
                    let list = &mut last[(row - rows.start) * width + column];
                    pieces.push(Piece { low, high, polygon, next: *list, covers_all });
                    *list = pieces.len() as u32 - 1;
                }
            });
        }
        let mut own: Vec<Piece> = Vec::new();
        for row in rows.start..rows.end {
            for column in 0..width {
                own.clear();
                let mut next = last[(row - rows.start) * width + column];
                while next != END {
                    own.push(pieces[next as usize]);
                    next = pieces[next as usize].next;
                }
                self.add_cell(&mut own, floors, &frame.square(column, row));
                self.first.push(self.spans.len() as u32);
            }
        }
    }

    /// Adds the floors of one cell.
    fn add_cell(&mut self, pieces: &mut [Piece], floors: &[FloorPolygon], square: &[DVec2; 4]) {
        let first = self.spans.len();
        pieces.sort_by(|a, b| a.low.total_cmp(&b.low));
        let mut rest = &*pieces;
        while let Some(lowest) = rest.first() {
            let (mut end, mut high) = (1, lowest.high);
            while end < rest.len() && rest[end].low - high <= self.options.mobility.step {
                high = high.max(rest[end].high);
                end += 1;
            }
            let (group, above) = rest.split_at(end);
            rest = above;
            let outlines = || group.iter().map(|piece| floors[piece.polygon as usize].outline.as_slice());
            if group.iter().any(|piece| piece.covers_all) || uncovered(square, outlines()).is_empty() {
                let faces_up = group.iter().any(|piece| floors[piece.polygon as usize].facing == Facing::Up);
                self.spans.push(Span { low: lowest.low, high, faces_up, is_blocked: false, is_buried: false });
            }
        }
        // A surface that faces down is a ceiling if one below it faces up, and the underside of a slab if the next one
        // above it faces up. Elsewhere it is a floor whose front is below.
        for k in (first..self.spans.len()).rev() {
            let Span { high, faces_up, .. } = self.spans[k];
            let top = self.spans[k + 1..].iter().find(|above| above.faces_up);
            let is_underside = top.is_some_and(|top| top.low - high < self.options.mobility.height);
            let is_ceiling = self.spans[first..k].iter().any(|below| below.faces_up);
            if !faces_up && (is_underside || is_ceiling) {
                self.spans.remove(k);
            }
        }
    }

    /// Marks the floors above which polygons, in metres from the origin, lie.
    fn add_obstacles<'p>(&mut self, polygons: impl Iterator<Item = &'p [DVec3]>) {
        let FieldOptions { mobility, from_height } = *self.options;
        let (first, spans, start) = (&self.first, &mut self.spans, self.rows.start * self.frame.width);
        let lowest = spans.iter().map(|span| span.high).fold(f64::INFINITY, f64::min) + ABOVE;
        let highest = spans.iter().map(|span| span.low).fold(f64::NEG_INFINITY, f64::max) + mobility.height;
        for corners in polygons {
            let (low, high) = heights(corners);
            if high < lowest || low > highest {
                continue;
            }
            self.frame.each_cell(corners, &self.rows, |cell, low, high| {
                let cell = cell - start;
                for span in &mut spans[first[cell] as usize..first[cell + 1] as usize] {
                    if low <= span.low + mobility.height {
                        span.is_blocked |= high >= (span.low + from_height).max(span.high + ABOVE);
                        span.is_buried |= high >= (span.low + mobility.step).max(span.high + ABOVE);
                    }
                }
            });
        }
    }
}

fn floor_polygon(corners: &[DVec3], mobility: &Mobility) -> Option<FloorPolygon> {
    let facing = mobility.facing(corners)?;
    let outline = from_above(corners);
    let sides = sides(&outline).collect();
    Some(FloorPolygon { corners: corners.to_vec(), outline, sides, heights: heights(corners), facing })
}

/// The numbers of the polygons that reach into each band of rows.
fn by_band(height: usize, rows: &mut dyn Iterator<Item = Range<usize>>) -> Vec<Vec<u32>> {
    let mut bands = vec![Vec::new(); height.div_ceil(BAND)];
    for (k, rows) in rows.enumerate().filter(|(_, rows)| !rows.is_empty()) {
        bands[rows.start / BAND..=(rows.end - 1) / BAND].iter_mut().for_each(|band| band.push(k as u32));
    }
    bands
}
