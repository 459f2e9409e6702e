//! Shared by the two schemes of cells over x and y: boxes by id, filtering a cell, and renewal.

use glam::DVec3;
use presight_model::geometry::Aabb;
use presight_model::index::boxes::{Box32, Boxes8, LANES, Shift};
use presight_model::index::{Params, QueryResult, Region, Shape, SpatialIndex, Traversal};
use std::fmt::Debug;

/// Cells that hold ids; the boxes of the ids are in [`Boxes`].
pub trait Cells: Clone + Debug + Default + Send + Sync + 'static {
    /// As [`SpatialIndex::name`].
    const NAME: &'static str;

    /// Fits empty cells to the boxes.
    fn fit(&mut self, params: &Params, boxes: &Boxes);

    /// Adds an id.
    fn place(&mut self, id: u32, b: &Box32);

    /// Removes an id that was placed with this box.
    fn remove(&mut self, id: u32, b: &Box32);

    /// Makes more cells after an insertion, if there are too few.
    fn grow(&mut self, _params: &Params, _boxes: &Boxes) {}

    /// As [`Traversal::walk`].
    fn walk<S: Shape>(&self, filter: bool, boxes: &Boxes, shape: &S, region: &Region, found: &mut QueryResult);

    /// Memory in bytes, without the cells' own struct.
    fn bytes(&self) -> usize;

    /// Panics if an invariant is violated. `built` is the number of ids at the last fit.
    fn assert_well_formed(&self, boxes: &Boxes, built: usize);
}

/// An index of cells. The cells are fitted again after as many changes as there were ids at the last fit.
#[derive(Clone, Debug)]
pub struct CellIndex<C> {
    params: Params,
    boxes: Boxes,
    cells: C,
    /// Number of ids at the last fit, and changes since.
    built: usize,
    changes: usize,
}

impl<C: Cells> CellIndex<C> {
    /// Builds an index.
    pub fn build(params: Params, boxes: &[(u32, Aabb)]) -> Self {
        let mut index = Self { params, boxes: Boxes::new(boxes), cells: C::default(), built: 0, changes: 0 };
        index.fit();
        index
    }

    fn fit(&mut self) {
        self.boxes.tighten();
        (self.built, self.changes) = (self.boxes.count, 0);
        self.cells.fit(&self.params, &self.boxes);
        for (id, b) in self.boxes.iter() {
            self.cells.place(id, &b);
        }
    }

    fn wear(&mut self) {
        self.changes += 1;
        if self.changes > self.built {
            self.fit();
        }
    }
}

impl<C: Cells> Traversal for CellIndex<C> {
    #[inline(always)]
    fn walk<S: Shape>(&self, shape: &S, region: &Region, found: &mut QueryResult) {
        self.cells.walk(self.params.filter, &self.boxes, shape, region, found);
    }
}

impl<C: Cells> SpatialIndex for CellIndex<C> {
    fn name(&self) -> &'static str {
        C::NAME
    }

    fn rebuilt(&self, boxes: &[(u32, Aabb)]) -> Box<dyn SpatialIndex> {
        Box::new(Self::build(self.params, boxes))
    }

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
        if self.built == 0 {
            self.fit();
        } else {
            self.cells.place(id, &b);
            self.wear();
        }
        self.cells.grow(&self.params, &self.boxes);
    }

    fn remove(&mut self, id: u32) -> bool {
        let Some(b) = self.boxes.take(id) else { return false };
        self.cells.remove(id, &b);
        self.wear();
        true
    }

    fn query(&self, region: &Region, found: &mut QueryResult) {
        self.traverse(region, found);
    }

    fn bytes(&self) -> usize {
        size_of::<Self>() + self.boxes.by_id.capacity() * size_of::<Box32>() + self.cells.bytes()
    }

    fn boxed_clone(&self) -> Box<dyn SpatialIndex> {
        Box::new(self.clone())
    }

    fn assert_well_formed(&self) {
        assert!(self.boxes.iter().all(|(_, b)| self.boxes.reach.holds(&b)));
        self.cells.assert_well_formed(&self.boxes, self.built);
    }
}

/// Takes an id out of a cell.
pub(super) fn take_out(cell: &mut Vec<u32>, id: u32) {
    if let Some(at) = cell.iter().position(|i| *i == id) {
        cell.swap_remove(at);
    }
}

/// Boxes by id, relative to an origin.
#[derive(Clone, Debug)]
pub struct Boxes {
    pub(super) origin: DVec3,
    /// Contains every box since the last fit.
    pub(super) reach: Box32,
    pub(super) count: usize,
    /// EMPTY for ids without a box.
    by_id: Vec<Box32>,
}

impl Boxes {
    fn new(boxes: &[(u32, Aabb)]) -> Self {
        let whole = boxes.iter().fold(Aabb::EMPTY, |all, (_, b)| all.union(*b));
        let origin = if whole.is_empty() { DVec3::ZERO } else { whole.center() };
        let mut all = Self { origin, reach: Box32::EMPTY, count: 0, by_id: Vec::new() };
        all.by_id.reserve_exact(boxes.iter().map(|(id, _)| *id as usize + 1).max().unwrap_or(0));
        for (id, b) in boxes {
            all.set(*id, b);
        }
        all
    }

    fn set(&mut self, id: u32, b: &Aabb) -> Box32 {
        let b = Box32::around(b, self.origin);
        if self.by_id.len() <= id as usize {
            self.by_id.resize(id as usize + 1, Box32::EMPTY);
        }
        let old = std::mem::replace(&mut self.by_id[id as usize], b);
        self.count += usize::from(old == Box32::EMPTY);
        self.reach = self.reach.union(&b);
        b
    }

    pub(super) fn get(&self, id: u32) -> Option<Box32> {
        self.by_id.get(id as usize).copied().filter(|b| *b != Box32::EMPTY)
    }

    fn take(&mut self, id: u32) -> Option<Box32> {
        let b = self.get(id)?;
        self.by_id[id as usize] = Box32::EMPTY;
        self.count -= 1;
        Some(b)
    }

    /// Every id with its box.
    pub(super) fn iter(&self) -> impl Iterator<Item = (u32, Box32)> + '_ {
        (0..).zip(self.by_id.iter().copied()).filter(|(_, b)| *b != Box32::EMPTY)
    }

    /// Shrinks `reach` to the current boxes.
    fn tighten(&mut self) {
        self.reach = self.iter().fold(Box32::EMPTY, |all, (_, b)| all.union(&b));
    }

    pub(super) fn shift(&self, region: &Region) -> Shift {
        Shift::new(self.origin, region.origin(), &self.reach, 2)
    }

    /// The extent of a region along x and y, relative to the origin.
    pub(super) fn window(&self, region: &Region) -> [(f64, f64); 2] {
        let bounds = region.bounds();
        [0, 1].map(|k| {
            let (min, max) = (bounds.min[k] - self.origin[k], bounds.max[k] - self.origin[k]);
            let slack = 1e-12 * (min.abs().max(max.abs()).min(1e12) + self.origin[k].abs());
            (min - slack, max + slack)
        })
    }

    /// Appends the ids of a cell that meet the shape, eight at a time.
    #[inline(always)]
    pub(super) fn filter<S: Shape>(&self, ids: &[u32], shape: &S, shift: &Shift, found: &mut QueryResult) {
        found.tested += ids.len();
        for ids in ids.chunks(LANES) {
            let mut eight = Boxes8::EMPTY;
            for (lane, id) in ids.iter().enumerate() {
                eight.set(lane, &self.by_id[*id as usize]);
            }
            let mut met = eight.meet(shape, shift) & ((1 << ids.len()) - 1);
            while met != 0 {
                found.ids.push(ids[met.trailing_zeros() as usize]);
                met &= met - 1;
            }
        }
    }
}
