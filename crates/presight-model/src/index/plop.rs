//! PLOP hashing (piecewise linear order preserving): H.-P. Kriegel and B. Seeger, "PLOP-Hashing: A grid file without
//! directory", 1988. Hyperplanes that follow the distribution cut each axis into slices. An id is in the cell of its
//! centroid's slices, and each slice records the extent of its ids.

use super::boxes::{Box32, Shift};
use super::cells::Boxes;
use super::shapes::Shape;
use super::{Params, QueryResult, Region, SpatialIndex, Traversal, ask};
use crate::geometry::Aabb;

/// A PLOP hash table over x and y.
///
/// It grows as in the paper: when the load exceeds the most polygons per cell, one slice of one axis, in turn, is cut
/// at the median of its content. After as many changes as it had entries when built, it is rebuilt.
#[derive(Clone, Debug)]
pub struct Plop {
    params: Params,
    boxes: Boxes,
    axes: [Axis; 2],
    /// A column for each x slice, in order of creation; in it a cell for each y slice, also in order of creation.
    columns: Vec<Vec<Vec<u32>>>,
    built: usize,
    changes: usize,
    /// The axis that grows next, and the number of ids from which it may grow.
    turn: usize,
    grow_at: usize,
}

/// Slices of one axis.
#[derive(Clone, Debug, Default)]
struct Axis {
    /// Hyperplanes between the slices, rising: twice a centroid's coordinate.
    planes: Vec<f32>,
    /// By position along the axis.
    slices: Vec<Slice>,
}

#[derive(Clone, Copy, Debug)]
struct Slice {
    /// Index of its cells: the order of creation.
    address: usize,
    count: usize,
    /// Extent of its ids.
    min: f32,
    max: f32,
}

impl Axis {
    fn slot(&self, middle: f32) -> usize {
        self.planes.partition_point(|p| *p <= middle)
    }
}

impl Plop {
    /// Builds a table.
    pub fn build(params: Params, boxes: &[(u32, Aabb)]) -> Self {
        let mut table = Self {
            params,
            boxes: Boxes::new(boxes),
            axes: Default::default(),
            columns: Vec::new(),
            built: 0,
            changes: 0,
            turn: 0,
            grow_at: 0,
        };
        table.fit();
        table
    }

    /// Places slices at quantiles of the content, and fills the cells.
    fn fit(&mut self) {
        self.boxes.tighten();
        let count = self.boxes.count;
        (self.built, self.changes, self.turn, self.grow_at) = (count, 0, 0, 0);
        let cells = count.div_ceil(self.params.cell_polygons.max(1)).max(1);
        let slices = (cells as f64).sqrt().ceil() as usize;
        for k in 0..2 {
            let mut middles: Vec<f32> = self.boxes.iter().map(|(_, b)| b.middle(k)).collect();
            middles.sort_unstable_by(f32::total_cmp);
            let mut planes: Vec<f32> = (1..slices).map(|i| middles[i * middles.len() / slices]).collect();
            planes.dedup();
            let least = 2.0 * self.params.least_cell as f32;
            let mut last = f32::NEG_INFINITY;
            planes.retain(|p| {
                let kept = p - last > least;
                last = if kept { *p } else { last };
                kept
            });
            let empty = |address| Slice { address, count: 0, min: f32::INFINITY, max: f32::NEG_INFINITY };
            self.axes[k] = Axis { slices: (0..=planes.len()).map(empty).collect(), planes };
        }
        self.columns = vec![vec![Vec::new(); self.axes[1].slices.len()]; self.axes[0].slices.len()];
        let all: Vec<(u32, Box32)> = self.boxes.iter().collect();
        for (id, b) in all {
            self.place(id, &b);
        }
    }

    fn place(&mut self, id: u32, b: &Box32) {
        let [x, y] = self.addresses(b, |slice, min, max| {
            slice.count += 1;
            slice.min = slice.min.min(min);
            slice.max = slice.max.max(max);
        });
        self.columns[x][y].push(id);
    }

    /// The address of a box's cell. Calls `change` on both of its slices.
    fn addresses(&mut self, b: &Box32, change: impl Fn(&mut Slice, f32, f32)) -> [usize; 2] {
        [0, 1].map(|k| {
            let at = self.axes[k].slot(b.middle(k));
            let slice = &mut self.axes[k].slices[at];
            change(slice, b.min[k], b.max[k]);
            slice.address
        })
    }

    fn wear(&mut self) {
        self.changes += 1;
        if self.changes > self.built {
            self.fit();
        }
    }

    /// Cuts the fullest slice of the axis whose turn it is, if there are too many ids per cell.
    fn grow(&mut self) {
        let cells = self.axes[0].slices.len() * self.axes[1].slices.len();
        if self.boxes.count <= (cells * self.params.cell_polygons.max(1)).max(self.grow_at) {
            return;
        }
        let k = self.turn;
        self.turn = 1 - k;
        let slices = &self.axes[k].slices;
        let Some(at) = (0..slices.len()).max_by_key(|i| slices[*i].count) else { return };
        let address = slices[at].address;
        let mut held: Vec<(f32, u32)> = Vec::with_capacity(slices[at].count);
        let mut gather = |cell: &mut Vec<u32>| {
            held.extend(cell.drain(..).filter_map(|id| self.boxes.get(id).map(|b| (b.middle(k), id))));
        };
        if k == 0 {
            self.columns[address].iter_mut().for_each(&mut gather);
        } else {
            self.columns.iter_mut().for_each(|column| gather(&mut column[address]));
        }
        held.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let plane = held[held.len() / 2].0;
        let least = 2.0 * self.params.least_cell as f32;
        let axis = &mut self.axes[k];
        let wide = plane > held[0].0 && held[held.len() - 1].0 - held[0].0 > least;
        let empty = |address| Slice { address, count: 0, min: f32::INFINITY, max: f32::NEG_INFINITY };
        axis.slices[at] = empty(address);
        if !wide {
            // All centroids coincide, so a cut would separate nothing. Try again after more insertions.
            self.grow_at = self.boxes.count + self.boxes.count / 4;
        } else {
            axis.planes.insert(at, plane);
            axis.slices.insert(at + 1, empty(axis.slices.len()));
            if k == 0 {
                self.columns.push(vec![Vec::new(); self.axes[1].slices.len()]);
            } else {
                self.columns.iter_mut().for_each(|column| column.push(Vec::new()));
            }
        }
        for (_, id) in held {
            let Some(b) = self.boxes.get(id) else { continue };
            // The slice of the other axis counts it already.
            let other = self.axes[1 - k].slot(b.middle(1 - k));
            self.axes[1 - k].slices[other].count -= 1;
            self.place(id, &b);
        }
    }

    fn shift(&self, region: &Region) -> Shift {
        Shift::new(self.boxes.origin, region.origin(), &self.boxes.reach, 2)
    }

    /// Slices of both axes whose extents meet the region's bounds.
    fn slices(&self, region: &Region) -> [Vec<Slice>; 2] {
        let bounds = region.bounds();
        [0, 1].map(|k| {
            let (min, max) = (bounds.min[k] - self.boxes.origin[k], bounds.max[k] - self.boxes.origin[k]);
            let slack = 1e-12 * (min.abs().max(max.abs()).min(1e12) + self.boxes.origin[k].abs());
            let touched = |s: &&Slice| f64::from(s.min) <= max + slack && f64::from(s.max) >= min - slack;
            self.axes[k].slices.iter().filter(touched).copied().collect()
        })
    }

    fn cell_box(&self, x: &Slice, y: &Slice) -> Box32 {
        let reach = self.boxes.reach;
        Box32 { min: [x.min, y.min, reach.min[2]], max: [x.max, y.max, reach.max[2]] }
    }
}

impl Traversal for Plop {
    #[inline(always)]
    fn walk<S: Shape>(&self, shape: &S, region: &Region, found: &mut QueryResult) {
        let shift = self.shift(region);
        let [xs, ys] = self.slices(region);
        for x in &xs {
            for y in &ys {
                let cell = &self.columns[x.address][y.address];
                found.visited += 1;
                if cell.is_empty() {
                    continue;
                }
                let here = shift.apply(&self.cell_box(x, y));
                if !shape.meets(&here) {
                    continue;
                }
                if !self.params.filter || shape.covers(&here) {
                    found.ids.extend_from_slice(cell);
                } else {
                    self.boxes.filter(cell, shape, &shift, found);
                }
            }
        }
    }
}

impl SpatialIndex for Plop {
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
        self.place(id, &b);
        self.wear();
        self.grow();
    }

    fn remove(&mut self, id: u32) -> bool {
        let Some(b) = self.boxes.take(id) else { return false };
        let [x, y] = self.addresses(&b, |slice, _, _| slice.count -= 1);
        let cell = &mut self.columns[x][y];
        let at = cell.iter().position(|i| *i == id);
        at.map(|at| cell.swap_remove(at));
        self.wear();
        true
    }

    fn query(&self, region: &Region, found: &mut QueryResult) {
        ask(self, region, found);
    }

    fn bytes(&self) -> usize {
        let cells = self.columns.iter().flatten();
        let lists: usize = cells.map(|c| c.capacity() * size_of::<u32>() + size_of::<Vec<u32>>()).sum();
        let axes: usize =
            self.axes.iter().map(|a| a.slices.capacity() * size_of::<Slice>() + a.planes.capacity() * 4).sum();
        size_of::<Self>() + self.boxes.bytes() + lists + axes + self.columns.capacity() * size_of::<Vec<u32>>()
    }

    fn boxed_clone(&self) -> Box<dyn SpatialIndex> {
        Box::new(self.clone())
    }

    fn assert_well_formed(&self) {
        for axis in &self.axes {
            assert_eq!(axis.slices.len(), axis.planes.len() + 1);
            assert!(axis.planes.windows(2).all(|p| p[0] < p[1]), "hyperplanes rise");
            assert_eq!(axis.slices.iter().map(|s| s.count).sum::<usize>(), self.boxes.count);
            let mut addresses: Vec<usize> = axis.slices.iter().map(|s| s.address).collect();
            addresses.sort_unstable();
            assert!(addresses.into_iter().eq(0..axis.slices.len()));
        }
        assert_eq!(self.columns.len(), self.axes[0].slices.len());
        assert!(self.columns.iter().all(|c| c.len() == self.axes[1].slices.len()));
        assert_eq!(self.columns.iter().flatten().map(Vec::len).sum::<usize>(), self.boxes.count);
        for (id, b) in self.boxes.iter() {
            assert!(self.boxes.reach.holds(&b));
            let slice = |k: usize| self.axes[k].slices[self.axes[k].slot(b.middle(k))];
            for k in 0..2 {
                assert!(slice(k).min <= b.min[k] && slice(k).max >= b.max[k], "a box reaches out of its slice");
            }
            assert!(self.columns[slice(0).address][slice(1).address].contains(&id));
        }
    }
}
