//! Uniform grid: equal square cells over x and y; each polygon is in every cell that it overlaps (paper section 2.2).

use super::boxes::{Box32, Shift};
use super::cells::Boxes;
use super::shapes::Shape;
use super::{Params, QueryResult, Region, SpatialIndex, Traversal, ask};
use crate::geometry::Aabb;

/// A uniform grid.
///
/// Area and cell size are refitted after as many changes as it had entries. Border cells reach to infinity and hold
/// everything outside the area. An id that overlaps very many cells is kept in a separate list: memory stays linear.
#[derive(Clone, Debug)]
pub struct Grid {
    params: Params,
    boxes: Boxes,
    /// Least corner relative to the origin, and side of a cell, metres.
    corner: [f32; 2],
    side: f32,
    size: [usize; 2],
    /// By row, then by column.
    cells: Vec<Vec<u32>>,
    /// Ids that overlap more than [`WIDE`] cells.
    wide: Vec<u32>,
    /// Number of entries at the last fit, and changes since.
    built: usize,
    changes: usize,
}

/// Most cells that an id may overlap before it moves to the separate list.
const WIDE: usize = 1024;
/// Most cells per id.
const CELLS_PER_ID: usize = 2;

impl Grid {
    /// Builds a grid.
    pub fn build(params: Params, boxes: &[(u32, Aabb)]) -> Self {
        let mut grid = Self {
            params,
            boxes: Boxes::new(boxes),
            corner: [0.0; 2],
            side: 1.0,
            size: [0; 2],
            cells: Vec::new(),
            wide: Vec::new(),
            built: 0,
            changes: 0,
        };
        grid.fit();
        grid
    }

    /// Fits area and cell size to the content, and fills the cells.
    fn fit(&mut self) {
        self.boxes.tighten();
        let count = self.boxes.count;
        (self.built, self.changes) = (count, 0);
        self.wide.clear();
        self.cells.clear();
        self.size = [0; 2];
        if count == 0 {
            return;
        }
        let reach = self.boxes.reach;
        let extent = [0, 1].map(|k| f64::from(reach.max[k]) - f64::from(reach.min[k]));
        let cells = (count.div_ceil(self.params.cell_polygons.max(1)) as f64).max(1.0);
        // Square cells. Things on a line have no area, so their length decides.
        let by_area = (extent[0] * extent[1] / cells).sqrt();
        let by_length = extent[0].max(extent[1]) / (CELLS_PER_ID * count + 64) as f64;
        self.side = (by_area.max(by_length).max(self.params.least_cell).max(1e-6)) as f32;
        self.corner = [reach.min[0], reach.min[1]];
        self.size = extent.map(|e| (e / f64::from(self.side)) as usize + 1);
        self.cells = vec![Vec::new(); self.size[0] * self.size[1]];
        let all: Vec<(u32, Box32)> = self.boxes.iter().collect();
        for (id, b) in all {
            self.place(id, &b);
        }
    }

    /// The cell of a coordinate; border cells reach to infinity.
    fn slot(&self, axis: usize, x: f64) -> usize {
        let at = (x - f64::from(self.corner[axis])) / f64::from(self.side);
        // The cast saturates.
        (at.floor().max(0.0) as usize).min(self.size[axis] - 1)
    }

    /// Columns and rows that a box overlaps.
    fn span(&self, b: &Box32) -> [(usize, usize); 2] {
        [0, 1].map(|k| (self.slot(k, f64::from(b.min[k])), self.slot(k, f64::from(b.max[k]))))
    }

    fn lists(&mut self, b: &Box32, mut change: impl FnMut(&mut Vec<u32>)) {
        let [(x0, x1), (y0, y1)] = self.span(b);
        if (x1 - x0 + 1) * (y1 - y0 + 1) > WIDE {
            change(&mut self.wide);
            return;
        }
        for y in y0..=y1 {
            for x in x0..=x1 {
                change(&mut self.cells[y * self.size[0] + x]);
            }
        }
    }

    fn place(&mut self, id: u32, b: &Box32) {
        self.lists(b, |list| list.push(id));
    }

    fn wear(&mut self) {
        self.changes += 1;
        if self.changes > self.built {
            self.fit();
        }
    }

    /// The box of a cell. Border cells reach as far as the content.
    fn cell_box(&self, x: usize, y: usize) -> Box32 {
        let mut b = self.boxes.reach;
        for (k, i) in [x, y].into_iter().enumerate() {
            let edge = |i: usize| f64::from(self.corner[k]) + f64::from(self.side) * i as f64;
            // Neighbours overlap by their rounding.
            if i > 0 {
                b.min[k] = (edge(i) as f32).next_down();
            }
            if i + 1 < self.size[k] {
                b.max[k] = (edge(i + 1) as f32).next_up();
            }
        }
        b
    }

    /// Columns and rows that a region may touch.
    fn window(&self, region: &Region) -> Option<[(usize, usize); 2]> {
        if self.cells.is_empty() {
            return None;
        }
        let bounds = region.bounds();
        let span = |k: usize| {
            let (min, max) = (bounds.min[k] - self.boxes.origin[k], bounds.max[k] - self.boxes.origin[k]);
            let slack = 1e-12 * (min.abs().max(max.abs()).min(1e12) + self.boxes.origin[k].abs());
            (self.slot(k, min - slack), self.slot(k, max + slack))
        };
        Some([span(0), span(1)])
    }

    fn shift(&self, region: &Region) -> Shift {
        Shift::new(self.boxes.origin, region.origin(), &self.boxes.reach, 2)
    }

    /// Appends the ids of a cell that no earlier cell had; unless `whole`, only those meeting the shape.
    #[inline(always)]
    fn first_time<S: Shape>(&self, ids: &[u32], whole: bool, shape: &S, shift: &Shift, found: &mut QueryResult) {
        const AT_ONCE: usize = 64;
        for ids in ids.chunks(AT_ONCE) {
            let mut fresh = [0u32; AT_ONCE];
            let mut count = 0;
            for id in ids {
                let at = *id as usize;
                if found.seen.len() <= at {
                    found.seen.resize(at + 1, 0);
                }
                fresh[count] = *id;
                count += usize::from(found.seen[at] != found.epoch);
                found.seen[at] = found.epoch;
            }
            if whole {
                found.ids.extend_from_slice(&fresh[..count]);
            } else {
                self.boxes.filter(&fresh[..count], shape, shift, found);
            }
        }
    }
}

impl Traversal for Grid {
    #[inline(always)]
    fn walk<S: Shape>(&self, shape: &S, region: &Region, found: &mut QueryResult) {
        let Some([(x0, x1), (y0, y1)]) = self.window(region) else { return };
        let shift = self.shift(region);
        found.epoch = found.epoch.wrapping_add(1);
        if found.epoch == 0 {
            found.seen.fill(0);
            found.epoch = 1;
        }
        for y in y0..=y1 {
            for x in x0..=x1 {
                let cell = &self.cells[y * self.size[0] + x];
                found.visited += 1;
                if cell.is_empty() {
                    continue;
                }
                let here = shift.apply(&self.cell_box(x, y));
                if shape.meets(&here) {
                    let whole = !self.params.filter || shape.covers(&here);
                    self.first_time(cell, whole, shape, &shift, found);
                }
            }
        }
        self.first_time(&self.wide, !self.params.filter, shape, &shift, found);
    }
}

impl SpatialIndex for Grid {
    fn len(&self) -> usize {
        self.boxes.count
    }

    fn bounds_of(&self, id: u32) -> Option<Aabb> {
        self.boxes.get(id).map(|b| b.in_world(self.boxes.origin))
    }

    fn insert(&mut self, id: u32, bounds: &Aabb) {
        self.remove(id);
        if self.boxes.count == 0 {
            self.boxes.origin = bounds.center();
        }
        let b = self.boxes.set(id, bounds);
        if self.cells.is_empty() {
            self.fit();
        } else {
            self.place(id, &b);
            self.wear();
        }
    }

    fn remove(&mut self, id: u32) -> bool {
        let Some(b) = self.boxes.take(id) else { return false };
        self.lists(&b, |list| {
            let at = list.iter().position(|i| *i == id);
            at.map(|at| list.swap_remove(at));
        });
        self.wear();
        true
    }

    fn query(&self, region: &Region, found: &mut QueryResult) {
        ask(self, region, found);
    }

    fn bytes(&self) -> usize {
        let lists: usize = self.cells.iter().map(|c| c.capacity() * size_of::<u32>()).sum();
        size_of::<Self>()
            + self.boxes.bytes()
            + self.cells.capacity() * size_of::<Vec<u32>>()
            + lists
            + self.wide.capacity() * size_of::<u32>()
    }

    fn boxed_clone(&self) -> Box<dyn SpatialIndex> {
        Box::new(self.clone())
    }

    fn assert_well_formed(&self) {
        assert_eq!(self.cells.len(), self.size[0] * self.size[1]);
        assert!(self.cells.len() <= 4 * (CELLS_PER_ID * self.built + 64));
        let mut entries = 0;
        for (id, b) in self.boxes.iter() {
            assert!(self.boxes.reach.holds(&b));
            let [(x0, x1), (y0, y1)] = self.span(&b);
            if (x1 - x0 + 1) * (y1 - y0 + 1) > WIDE {
                assert!(self.wide.contains(&id));
                entries += 1;
                continue;
            }
            for (x, y) in (y0..=y1).flat_map(|y| (x0..=x1).map(move |x| (x, y))) {
                assert!(self.cells[y * self.size[0] + x].contains(&id), "{id} is missing in a cell");
                entries += 1;
            }
        }
        let held = self.wide.len() + self.cells.iter().map(Vec::len).sum::<usize>();
        assert_eq!(held, entries, "an id is in a cell it does not overlap, or twice");
    }
}
