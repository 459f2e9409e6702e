//! Uniform grid: equal square cells over x and y; each polygon is in every cell that it overlaps (paper section 2.2).

use super::cells::{Boxes, CellIndex, Cells, take_out};
use presight_model::index::boxes::{Box32, Shift};
use presight_model::index::{Params, QueryResult, Region, Shape};
use std::cell::RefCell;

/// A uniform grid, whose area and cell size are fitted to the content.
pub type Grid = CellIndex<GridCells>;

/// The cells of a [`Grid`].
///
/// Border cells reach to infinity and hold everything outside the area. An id that overlaps very many cells is kept in
/// a separate list: memory stays linear.
#[derive(Clone, Debug, Default)]
pub struct GridCells {
    /// Lower corner relative to the origin, and side of a cell, metres.
    corner: [f32; 2],
    side: f32,
    size: [usize; 2],
    /// By row, then by column.
    cells: Vec<Vec<u32>>,
    /// Ids that overlap more than [`WIDE`] cells.
    wide: Vec<u32>,
}

/// Maximum number of cells that an id may overlap before it moves to the separate list.
const WIDE: usize = 1024;
/// Maximum number of cells per id.
const CELLS_PER_ID: usize = 2;

/// The queries of a thread, to drop ids found twice.
#[derive(Debug, Default)]
struct Seen {
    /// Number of the last query.
    epoch: u32,
    /// For each id, the last query that met it.
    by_id: Vec<u32>,
}

thread_local! {
    static SEEN: RefCell<Seen> = RefCell::default();
}

impl GridCells {
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

    /// The box of a cell. Border cells reach as far as the content.
    fn cell_box(&self, reach: &Box32, x: usize, y: usize) -> Box32 {
        let mut b = *reach;
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
}

impl Seen {
    fn start(&mut self) {
        self.epoch = self.epoch.wrapping_add(1);
        if self.epoch == 0 {
            self.by_id.fill(0);
            self.epoch = 1;
        }
    }

    /// Appends the ids of a cell that no earlier cell had; unless `whole`, only those meeting the shape.
    #[inline(always)]
    fn first_time<S: Shape>(
        &mut self,
        ids: &[u32],
        whole: bool,
        boxes: &Boxes,
        (shape, shift): (&S, &Shift),
        found: &mut QueryResult,
    ) {
        const AT_ONCE: usize = 64;
        for ids in ids.chunks(AT_ONCE) {
            let mut fresh = [0u32; AT_ONCE];
            let mut count = 0;
            for id in ids {
                let at = *id as usize;
                if self.by_id.len() <= at {
                    self.by_id.resize(at + 1, 0);
                }
                fresh[count] = *id;
                count += usize::from(self.by_id[at] != self.epoch);
                self.by_id[at] = self.epoch;
            }
            if whole {
                found.ids.extend_from_slice(&fresh[..count]);
            } else {
                boxes.filter(&fresh[..count], shape, shift, found);
            }
        }
    }
}

impl Cells for GridCells {
    const NAME: &'static str = "grid";

    fn fit(&mut self, params: &Params, boxes: &Boxes) {
        self.wide.clear();
        self.cells.clear();
        self.size = [0; 2];
        let count = boxes.count;
        if count == 0 {
            return;
        }
        let reach = boxes.reach;
        let extent = [0, 1].map(|k| f64::from(reach.max[k]) - f64::from(reach.min[k]));
        let cells = (count.div_ceil(params.cell_polygons.max(1)) as f64).max(1.0);
        // Square cells. Things on a line have no area, so their length decides.
        let by_area = (extent[0] * extent[1] / cells).sqrt();
        let by_length = extent[0].max(extent[1]) / (CELLS_PER_ID * count + 64) as f64;
        self.side = (by_area.max(by_length).max(params.min_cell).max(1e-6)) as f32;
        self.corner = [reach.min[0], reach.min[1]];
        self.size = extent.map(|e| (e / f64::from(self.side)) as usize + 1);
        self.cells = vec![Vec::new(); self.size[0] * self.size[1]];
    }

    fn place(&mut self, id: u32, b: &Box32) {
        self.lists(b, |list| list.push(id));
    }

    fn remove(&mut self, id: u32, b: &Box32) {
        self.lists(b, |list| take_out(list, id));
    }

    #[inline(always)]
    fn walk<S: Shape>(&self, filter: bool, boxes: &Boxes, shape: &S, region: &Region, found: &mut QueryResult) {
        if self.cells.is_empty() {
            return;
        }
        let window = boxes.window(region);
        let [(x0, x1), (y0, y1)] = [0, 1].map(|k| (self.slot(k, window[k].0), self.slot(k, window[k].1)));
        let shift = boxes.shift(region);
        let mut seen = SEEN.take();
        seen.start();
        for y in y0..=y1 {
            for x in x0..=x1 {
                let cell = &self.cells[y * self.size[0] + x];
                found.visited += 1;
                if cell.is_empty() {
                    continue;
                }
                let here = shift.apply(&self.cell_box(&boxes.reach, x, y));
                if shape.meets(&here) {
                    let whole = !filter || shape.covers(&here);
                    seen.first_time(cell, whole, boxes, (shape, &shift), found);
                }
            }
        }
        seen.first_time(&self.wide, !filter, boxes, (shape, &shift), found);
        SEEN.set(seen);
    }

    fn bytes(&self) -> usize {
        let lists: usize = self.cells.iter().map(|c| c.capacity() * size_of::<u32>()).sum();
        self.cells.capacity() * size_of::<Vec<u32>>() + lists + self.wide.capacity() * size_of::<u32>()
    }

    fn assert_well_formed(&self, boxes: &Boxes, built: usize) {
        assert_eq!(self.cells.len(), self.size[0] * self.size[1]);
        assert!(self.cells.len() <= 4 * (CELLS_PER_ID * built + 64));
        let mut entries = 0;
        for (id, b) in boxes.iter() {
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
