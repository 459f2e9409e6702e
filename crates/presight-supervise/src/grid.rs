//! The cells of a corridor.

use glam::{DVec2, DVec3};
use presight_model::error::{Error, Result};
use presight_predict::virtual_sensors::Corridor;
use serde::Serialize;

/// Maximum number of cells of a corridor and of the box around it.
const MAX_CELLS: f64 = 4_194_304.0;

/// The cells of a corridor: columns of square cells that touch it, each cut into layers. Cells are numbered column by
/// column, from the lowest layer up.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cells {
    /// Minimum corner of the box around the corridor, in the corridor's frame, metres.
    pub origin: [f64; 3],
    /// Side of a cell, metres.
    pub side: f64,
    /// Height of a layer, metres.
    pub layer_height: f64,
    /// Number of layers.
    pub layers: usize,
    /// Column and row of each column of cells, counted from the origin along x and y.
    pub columns: Vec<[u32; 2]>,
    /// Distance along the corridor to the nearest part of each column, metres.
    pub along: Vec<f64>,
    /// Columns and rows of the box around the corridor.
    #[serde(skip)]
    size: [usize; 2],
    /// Number of the column of cells at each place of the box; `u32::MAX` outside of the corridor.
    #[serde(skip)]
    column_at: Vec<u32>,
}

impl Cells {
    /// Cuts a corridor into cells of this side, metres.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for a side that is not above 0 or gives too many cells.
    pub fn new(corridor: &Corridor, side: f64) -> Result<Self> {
        let remedy = "give the side of cells in metres, such as 0.1";
        if !(side > 0.0 && side.is_finite()) {
            return Err(Error::usage(format!("cells of {side} m"), remedy));
        }
        let ([min, max], [low, high]) = (corridor.bounds(), corridor.heights());
        let parts = |length: f64| (length / side - 1e-9).ceil().max(1.0);
        let (nx, ny, layers) = (parts(max.x - min.x), parts(max.y - min.y), parts(high - low));
        if nx * ny * layers > MAX_CELLS {
            let what = format!("a corridor of {nx} x {ny} x {layers} cells of {side} m");
            return Err(Error::usage(what, "give a shorter corridor or larger cells"));
        }
        let size = [nx as usize, ny as usize];
        let (mut columns, mut along, mut column_at) = (Vec::new(), Vec::new(), vec![u32::MAX; size[0] * size[1]]);
        for row in 0..size[1] {
            for column in 0..size[0] {
                // Nine points from edge to edge, slightly inside, so that contact with a neighbour's edge is ignored.
                let offsets = [1e-6, 0.5, 1.0 - 1e-6];
                let points = offsets.iter().flat_map(|x| offsets.iter().map(move |y| DVec2::new(*x, *y)));
                let at = DVec2::new(column as f64, row as f64);
                let arcs = points.filter_map(|p| corridor.arc_length_from_above(min + side * (at + p)));
                if let Some(arc) = arcs.reduce(f64::min) {
                    column_at[row * size[0] + column] = columns.len() as u32;
                    columns.push([column as u32, row as u32]);
                    along.push(arc);
                }
            }
        }
        let layer_height = (high - low) / layers;
        let origin = min.extend(low).to_array();
        Ok(Self { origin, side, layer_height, layers: layers as usize, columns, along, size, column_at })
    }

    /// Number of cells.
    pub fn count(&self) -> usize {
        self.columns.len() * self.layers
    }

    /// Side and height of a cell as a vector.
    fn extent(&self) -> DVec3 {
        DVec3::new(self.side, self.side, self.layer_height)
    }

    /// The cell that holds a point of the corridor's frame.
    pub fn cell_at(&self, p: DVec3) -> Option<usize> {
        let at = (p - DVec3::from(self.origin)) / self.extent();
        let inside = at.cmpge(DVec3::ZERO).all() && at.x < self.size[0] as f64 && at.y < self.size[1] as f64;
        // The upper boundary belongs to the last layer.
        if !(inside && at.z <= self.layers as f64) {
            return None;
        }
        let column = self.column_at[at.y as usize * self.size[0] + at.x as usize];
        (column != u32::MAX).then(|| column as usize * self.layers + (at.z as usize).min(self.layers - 1))
    }

    /// The middle of a cell, in the corridor's frame, metres.
    pub fn middle(&self, cell: usize) -> DVec3 {
        let [x, y] = self.columns[cell / self.layers];
        let at = DVec3::new(f64::from(x), f64::from(y), (cell % self.layers) as f64);
        DVec3::from(self.origin) + self.extent() * (at + 0.5)
    }

    /// Numbers of a cell's eight corners among [`Cells::corner_count`].
    pub(crate) fn corners(&self, cell: usize) -> [usize; 8] {
        let [x, y] = self.columns[cell / self.layers].map(|i| i as usize);
        let z = cell % self.layers;
        let corner = |k: usize| {
            let (x, y, z) = (x + (k & 1), y + (k >> 1 & 1), z + (k >> 2));
            (y * (self.size[0] + 1) + x) * (self.layers + 1) + z
        };
        std::array::from_fn(corner)
    }

    /// Number of corners of the cells of the box around the corridor.
    pub(crate) fn corner_count(&self) -> usize {
        (self.size[0] + 1) * (self.size[1] + 1) * (self.layers + 1)
    }

    /// A corner, in the corridor's frame, metres.
    pub(crate) fn corner(&self, number: usize) -> DVec3 {
        let (z, place) = (number % (self.layers + 1), number / (self.layers + 1));
        let at = DVec3::new((place % (self.size[0] + 1)) as f64, (place / (self.size[0] + 1)) as f64, z as f64);
        DVec3::from(self.origin) + self.extent() * at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corridor_is_cut_into_its_cells() {
        let corridor = Corridor::polygon(vec![[0.0, -0.4], [4.0, -0.4], [4.0, 0.4], [0.0, 0.4]], 0.06, 1.8).unwrap();
        let cells = Cells::new(&corridor, 0.1).unwrap();
        assert_eq!((cells.columns.len(), cells.layers, cells.count()), (320, 18, 5760));
        let p = DVec3::new(2.31, -0.22, 0.5);
        let cell = cells.cell_at(p).unwrap();
        assert!((cells.middle(cell) - p).abs().cmple(DVec3::new(0.05, 0.05, 0.05)).all());
        assert!((cells.along[cell / 18] - 2.3f64.hypot(0.2)).abs() < 0.01);
        let middle: DVec3 = cells.corners(cell).iter().map(|c| cells.corner(*c)).sum::<DVec3>() / 8.0;
        assert!(middle.distance(cells.middle(cell)) < 1e-12);
        for outside in [[-0.1, 0.0, 0.5], [4.05, 0.0, 0.5], [1.0, 0.45, 0.5], [1.0, 0.0, 0.05], [1.0, 0.0, 1.81]] {
            assert_eq!(cells.cell_at(outside.into()), None, "{outside:?}");
        }
        for side in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-4] {
            assert!(Cells::new(&corridor, side).is_err(), "{side}");
        }
    }
}
