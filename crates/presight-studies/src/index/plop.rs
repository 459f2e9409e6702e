//! PLOP hashing (piecewise linear order preserving): H.-P. Kriegel and B. Seeger, "PLOP-Hashing: A grid file without
//! directory", 1988. Hyperplanes that follow the distribution cut each axis into slices. An id is in the cell of its
//! centroid's slices, and each slice records the extent of its ids.

use super::cells::{Boxes, CellIndex, Cells, take_out};
use presight_model::index::boxes::Box32;
use presight_model::index::{Params, QueryResult, Region, Shape};

/// A PLOP hash table over x and y.
pub type Plop = CellIndex<PlopCells>;

/// The cells of a [`Plop`].
///
/// They grow as in the paper: when the load exceeds the most polygons per cell, one slice of one axis, in turn, is cut
/// at the median of its content.
#[derive(Clone, Debug, Default)]
pub struct PlopCells {
    axes: [Axis; 2],
    /// A column for each x slice, in order of creation; in it a cell for each y slice, also in order of creation.
    columns: Vec<Vec<Vec<u32>>>,
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

impl Slice {
    fn empty(address: usize) -> Self {
        Self { address, count: 0, min: f32::INFINITY, max: f32::NEG_INFINITY }
    }
}

impl PlopCells {
    /// The address of a box's cell. Calls `change` on both of its slices.
    fn addresses(&mut self, b: &Box32, change: impl Fn(&mut Slice, f32, f32)) -> [usize; 2] {
        [0, 1].map(|k| {
            let at = self.axes[k].slot(b.middle(k));
            let slice = &mut self.axes[k].slices[at];
            change(slice, b.min[k], b.max[k]);
            slice.address
        })
    }

    /// Slices of both axes whose extents meet the region's bounds.
    fn slices(&self, boxes: &Boxes, region: &Region) -> [Vec<Slice>; 2] {
        let window = boxes.window(region);
        [0, 1].map(|k| {
            let touched = |s: &&Slice| f64::from(s.min) <= window[k].1 && f64::from(s.max) >= window[k].0;
            self.axes[k].slices.iter().filter(touched).copied().collect()
        })
    }
}

impl Cells for PlopCells {
    const NAME: &'static str = "plop";

    /// Places slices at quantiles of the content.
    fn fit(&mut self, params: &Params, boxes: &Boxes) {
        (self.turn, self.grow_at) = (0, 0);
        let cells = boxes.count.div_ceil(params.cell_polygons.max(1)).max(1);
        let slices = (cells as f64).sqrt().ceil() as usize;
        for k in 0..2 {
            let mut middles: Vec<f32> = boxes.iter().map(|(_, b)| b.middle(k)).collect();
            middles.sort_unstable_by(f32::total_cmp);
            let mut planes: Vec<f32> = (1..slices).map(|i| middles[i * middles.len() / slices]).collect();
            planes.dedup();
            let least = 2.0 * params.min_cell as f32;
            let mut last = f32::NEG_INFINITY;
            planes.retain(|p| {
                let kept = p - last > least;
                last = if kept { *p } else { last };
                kept
            });
            self.axes[k] = Axis { slices: (0..=planes.len()).map(Slice::empty).collect(), planes };
        }
        self.columns = vec![vec![Vec::new(); self.axes[1].slices.len()]; self.axes[0].slices.len()];
    }

    fn place(&mut self, id: u32, b: &Box32) {
        let [x, y] = self.addresses(b, |slice, min, max| {
            slice.count += 1;
            slice.min = slice.min.min(min);
            slice.max = slice.max.max(max);
        });
        self.columns[x][y].push(id);
    }

    fn remove(&mut self, id: u32, b: &Box32) {
        let [x, y] = self.addresses(b, |slice, _, _| slice.count -= 1);
        take_out(&mut self.columns[x][y], id);
    }

    /// Cuts the fullest slice of the axis whose turn it is, if there are too many ids per cell.
    fn grow(&mut self, params: &Params, boxes: &Boxes) {
        let cells = self.axes[0].slices.len() * self.axes[1].slices.len();
        if boxes.count <= (cells * params.cell_polygons.max(1)).max(self.grow_at) {
            return;
        }
        let k = self.turn;
        self.turn = 1 - k;
        let slices = &self.axes[k].slices;
        let Some(at) = (0..slices.len()).max_by_key(|i| slices[*i].count) else { return };
        let address = slices[at].address;
        let mut held: Vec<(f32, u32)> = Vec::with_capacity(slices[at].count);
        let mut gather = |cell: &mut Vec<u32>| {
            held.extend(cell.drain(..).filter_map(|id| boxes.get(id).map(|b| (b.middle(k), id))));
        };
        if k == 0 {
            self.columns[address].iter_mut().for_each(&mut gather);
        } else {
            self.columns.iter_mut().for_each(|column| gather(&mut column[address]));
        }
        held.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let plane = held[held.len() / 2].0;
        let least = 2.0 * params.min_cell as f32;
        let axis = &mut self.axes[k];
        let wide = plane > held[0].0 && held[held.len() - 1].0 - held[0].0 > least;
        axis.slices[at] = Slice::empty(address);
        if !wide {
            // All centroids coincide, so a cut would separate nothing. Try again after more insertions.
            self.grow_at = boxes.count + boxes.count / 4;
        } else {
            axis.planes.insert(at, plane);
            axis.slices.insert(at + 1, Slice::empty(axis.slices.len()));
            if k == 0 {
                self.columns.push(vec![Vec::new(); self.axes[1].slices.len()]);
            } else {
                self.columns.iter_mut().for_each(|column| column.push(Vec::new()));
            }
        }
        for (_, id) in held {
            let Some(b) = boxes.get(id) else { continue };
            // The slice of the other axis counts it already.
            let other = self.axes[1 - k].slot(b.middle(1 - k));
            self.axes[1 - k].slices[other].count -= 1;
            self.place(id, &b);
        }
    }

    #[inline(always)]
    fn walk<S: Shape>(&self, filter: bool, boxes: &Boxes, shape: &S, region: &Region, found: &mut QueryResult) {
        let (shift, reach) = (boxes.shift(region), boxes.reach);
        let [xs, ys] = self.slices(boxes, region);
        for x in &xs {
            for y in &ys {
                let cell = &self.columns[x.address][y.address];
                found.visited += 1;
                if cell.is_empty() {
                    continue;
                }
                let b = Box32 { min: [x.min, y.min, reach.min[2]], max: [x.max, y.max, reach.max[2]] };
                let here = shift.apply(&b);
                if !shape.meets(&here) {
                    continue;
                }
                if !filter || shape.covers(&here) {
                    found.ids.extend_from_slice(cell);
                } else {
                    boxes.filter(cell, shape, &shift, found);
                }
            }
        }
    }

    fn bytes(&self) -> usize {
        let cells = self.columns.iter().flatten();
        let lists: usize = cells.map(|c| c.capacity() * size_of::<u32>() + size_of::<Vec<u32>>()).sum();
        let axes: usize =
            self.axes.iter().map(|a| a.slices.capacity() * size_of::<Slice>() + a.planes.capacity() * 4).sum();
        lists + axes + self.columns.capacity() * size_of::<Vec<u32>>()
    }

    fn assert_well_formed(&self, boxes: &Boxes, _built: usize) {
        for axis in &self.axes {
            assert_eq!(axis.slices.len(), axis.planes.len() + 1);
            assert!(axis.planes.windows(2).all(|p| p[0] < p[1]), "hyperplanes rise");
            assert_eq!(axis.slices.iter().map(|s| s.count).sum::<usize>(), boxes.count);
            let mut addresses: Vec<usize> = axis.slices.iter().map(|s| s.address).collect();
            addresses.sort_unstable();
            assert!(addresses.into_iter().eq(0..axis.slices.len()));
        }
        assert_eq!(self.columns.len(), self.axes[0].slices.len());
        assert!(self.columns.iter().all(|c| c.len() == self.axes[1].slices.len()));
        assert_eq!(self.columns.iter().flatten().map(Vec::len).sum::<usize>(), boxes.count);
        for (id, b) in boxes.iter() {
            let slice = |k: usize| self.axes[k].slices[self.axes[k].slot(b.middle(k))];
            for k in 0..2 {
                assert!(slice(k).min <= b.min[k] && slice(k).max >= b.max[k], "a box reaches out of its slice");
            }
            assert!(self.columns[slice(0).address][slice(1).address].contains(&id));
        }
    }
}
