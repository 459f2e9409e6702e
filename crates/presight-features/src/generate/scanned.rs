//! Patches on the planes of scanned meshes: rectangles in which facets cover the plane without a gap.
//!
//! The outline of scanned facets is ragged, and patches are convex. The plane is divided into cells, and the largest
//! rectangle of covered cells is taken until none is large enough.

use super::FeatureKind;
use super::drafts::Draft;
use glam::{DVec2, DVec3};
use presight_model::environment::Object;
use presight_model::flat::{FlatSurface, FlatSurfaces};
use presight_model::geometry::Plane;

/// Tolerance of a layer in tolerances of its planes. A cell is half a tolerance wide, and its middle is at most
/// [`presight_model::flat::FRINGE`] tolerances from a facet, so a corner is within 1.38 tolerances, less than three
/// quarters of this.
pub(super) const LAYER: f64 = 2.0;

/// Rectangles of a plane may have this part of the least area of a plane: an eighth of its sides.
pub(super) const PART: f64 = 1.0 / 64.0;

/// Maximum number of cells in a plane. Larger planes have wider cells, and patches over gaps in them are split.
const MAX_CELLS: f64 = (1 << 26) as f64;

/// Maximum number of columns, and of rows, in a part of a plane whose rectangles are found together: the time for each
/// rectangle grows with the number of cells.
const BLOCK: usize = 1024;

/// A grid over a plane, in the world.
struct Grid {
    origin: DVec3,
    /// Unit vectors along columns and rows.
    axes: [DVec3; 2],
    /// Width of a cell, metres.
    cell: f64,
    columns: usize,
    /// By row and column: true if a facet covers the middle.
    covered: Vec<bool>,
}

/// Columns and rows from the first up to, but without, the second.
type Rectangle = [[usize; 2]; 2];

/// The patches of an object on vertical and horizontal planes, whose least area is `least` square metres.
pub(super) fn patches(object: &Object, number: u32, flat: &FlatSurfaces, tilt: f64, least: f64) -> Vec<Draft> {
    let turn = object.world_from_object.rotation_matrix();
    let normal_of = |s: &FlatSurface| turn * s.plane.normal;
    let is_vertical = |normal: DVec3| normal.z.abs() <= tilt.sin();
    // Floors usually end at walls, so their patches are parallel to the largest one.
    let walls = flat.surfaces.iter().filter(|s| is_vertical(normal_of(s)));
    let wall = walls.max_by(|a, b| a.area.total_cmp(&b.area)).map_or(DVec3::X, normal_of);
    let mut drafts = Vec::new();
    for surface in &flat.surfaces {
        let normal = normal_of(surface);
        let (kind, along) = match normal.z.abs() {
            z if z >= tilt.cos() => (FeatureKind::Horizontal, wall),
            _ if is_vertical(normal) => (FeatureKind::Vertical, DVec3::Z),
            _ => continue,
        };
        let Some(x) = normal.cross(along).try_normalize() else { continue };
        let mut grid = Grid::new(object, surface, normal, x, flat.tolerance);
        for block in grid.blocks() {
            while let Some(rectangle) = grid.largest(block, PART * least) {
                let draft = Draft::new(kind, number, grid.take(rectangle));
                drafts.push(Draft { normal: Some(normal), tolerance: LAYER * flat.tolerance, ..draft });
            }
        }
    }
    drafts
}

impl Grid {
    fn new(object: &Object, surface: &FlatSurface, normal: DVec3, x: DVec3, tolerance: f64) -> Self {
        let axes = [x, normal.cross(x)];
        let Plane { normal: own, offset } = surface.plane;
        let origin = object.world_from_object.transform_point(own * offset);
        let flat = |p: DVec3| DVec2::new(axes[0].dot(p - origin), axes[1].dot(p - origin));
        let world_from_mesh = object.world_from_mesh();
        let corners_of = |polygon: u32| {
            let corners = object.mesh.corners_of(polygon);
            corners.map(|p| flat(world_from_mesh.transform_point3(p))).collect::<Vec<DVec2>>()
        };
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for p in surface.polygons.iter().flat_map(|p| corners_of(*p)) {
            (low, high) = (low.min(p), high.max(p));
        }
        let size = high - low;
        let cell = (0.5 * tolerance).max((size.x * size.y / MAX_CELLS).sqrt());
        let [columns, rows] = (size / cell).to_array().map(|n| n.ceil() as usize + 1);
        let origin = origin + axes[0] * low.x + axes[1] * low.y;
        let mut grid = Self { origin, axes, cell, columns, covered: vec![false; columns * rows] };
        for polygon in &surface.polygons {
            let corners: Vec<DVec2> = corners_of(*polygon).iter().map(|p| (*p - low) / cell - 0.5).collect();
            grid.cover(&corners);
        }
        grid
    }

    /// Marks the cells whose middles a convex polygon holds; middles have whole coordinates.
    fn cover(&mut self, corners: &[DVec2]) {
        let (low, high) = corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p.y), h.max(p.y)));
        for row in low.ceil().max(0.0) as usize..=high.floor().max(0.0) as usize {
            let y = row as f64;
            let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
            for (k, a) in corners.iter().enumerate() {
                let b = corners[(k + 1) % corners.len()];
                if (a.y <= y) == (b.y <= y) && a.y != y && b.y != y {
                    continue;
                }
                let t = if a.y == b.y { 0.0 } else { ((y - a.y) / (b.y - a.y)).clamp(0.0, 1.0) };
                let x = a.x + t * (b.x - a.x);
                (from, to) = (from.min(x), to.max(x));
            }
            let first = row * self.columns;
            for column in from.ceil().max(0.0) as usize..(to.floor() + 1.0).clamp(0.0, self.columns as f64) as usize {
                if let Some(covered) = self.covered.get_mut(first + column) {
                    *covered = true;
                }
            }
        }
    }

    /// Equal parts of at most [`BLOCK`] columns and rows.
    fn blocks(&self) -> Vec<Rectangle> {
        let parts = |count: usize| {
            let width = count.div_ceil(count.div_ceil(BLOCK).max(1)).max(1);
            (0..count).step_by(width).map(move |from| [from, (from + width).min(count)])
        };
        let rows = self.covered.len() / self.columns;
        parts(rows).flat_map(|r| parts(self.columns).map(move |c| [[c[0], r[0]], [c[1], r[1]]])).collect()
    }

    /// The largest rectangle of covered cells in a block, if it has `least` square metres.
    fn largest(&self, [start, end]: Rectangle, least: f64) -> Option<Rectangle> {
        let mut best = (0, [[0; 2]; 2]);
        let mut heights = vec![0; end[0] - start[0]];
        // Columns where a rectangle may begin, with its height.
        let mut open: Vec<(usize, usize)> = Vec::new();
        for row in start[1]..end[1] {
            let covered = &self.covered[row * self.columns + start[0]..row * self.columns + end[0]];
            for (height, covered) in heights.iter_mut().zip(covered) {
                *height = if *covered { *height + 1 } else { 0 };
            }
            for column in start[0]..=end[0] {
                let height = heights.get(column - start[0]).copied().unwrap_or(0);
                let mut begin = column;
                while let Some((from, tall)) = open.pop_if(|o| o.1 >= height) {
                    if tall * (column - from) > best.0 {
                        best = (tall * (column - from), [[from, row + 1 - tall], [column, row + 1]]);
                    }
                    begin = from;
                }
                open.push((begin, height));
            }
            open.clear();
        }
        (best.0 > 0 && best.0 as f64 * self.cell * self.cell >= least).then_some(best.1)
    }

    /// Removes a rectangle and returns its corners, counter-clockwise about the normal.
    fn take(&mut self, [from, to]: Rectangle) -> Vec<DVec3> {
        for row in from[1]..to[1] {
            self.covered[row * self.columns + from[0]..row * self.columns + to[0]].fill(false);
        }
        let at = |column: usize, row: usize| {
            self.origin + (self.axes[0] * column as f64 + self.axes[1] * row as f64) * self.cell
        };
        vec![at(from[0], from[1]), at(to[0], from[1]), at(to[0], to[1]), at(from[0], to[1])]
    }
}

/// The two halves of a rectangle across its longer sides, if each has `least` square metres.
pub(super) fn halves(draft: &Draft, least: f64) -> Vec<Draft> {
    let [a, b, c, d] = draft.points[..] else { return Vec::new() };
    if a.distance(b) * a.distance(d) < 2.0 * least {
        return Vec::new();
    }
    let parts = if a.distance(b) >= a.distance(d) {
        let [m, n] = [a.midpoint(b), c.midpoint(d)];
        [[a, m, n, d], [m, b, c, n]]
    } else {
        let [m, n] = [a.midpoint(d), b.midpoint(c)];
        [[a, b, n, m], [m, n, c, d]]
    };
    parts.map(|corners| Draft { points: corners.to_vec(), ..draft.clone() }).to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(rows: &[&str]) -> Grid {
        let covered = rows.iter().flat_map(|row| row.bytes().map(|b| b == b'#')).collect();
        Grid { origin: DVec3::ZERO, axes: [DVec3::X, DVec3::Y], cell: 1.0, columns: rows[0].len(), covered }
    }

    #[test]
    fn the_largest_rectangles_come_first() {
        let mut grid = grid(&["##....", "######", "######", "...##."]);
        let all = grid.blocks()[0];
        assert_eq!((grid.blocks().len(), all), (1, [[0, 0], [6, 4]]));
        assert_eq!(grid.largest(all, 3.0), Some([[0, 1], [6, 3]]));
        let corners = grid.take([[0, 1], [6, 3]]);
        assert_eq!(corners[0], DVec3::new(0.0, 1.0, 0.0));
        assert_eq!(corners[2], DVec3::new(6.0, 3.0, 0.0));
        assert_eq!((grid.largest(all, 2.0), grid.largest(all, 3.0)), (Some([[0, 0], [2, 1]]), None));
        assert_eq!(grid.largest([[3, 0], [6, 4]], 2.0), Some([[3, 3], [5, 4]]));
        assert_eq!(self::grid(&["...", "..."]).largest([[0, 0], [3, 2]], 0.0), None);
    }

    #[test]
    fn a_polygon_covers_the_middles_inside() {
        let mut grid = grid(&["....", "....", "...."]);
        // Middles have whole coordinates: (0, 0), (1, 0), (2, 0), (0, 1), (1, 1) and (0, 2) are in the triangle.
        grid.cover(&[DVec2::new(-0.1, -0.1), DVec2::new(2.3, -0.1), DVec2::new(-0.1, 2.3)]);
        let expected = self::grid(&["###.", "##..", "#..."]);
        assert_eq!(grid.covered, expected.covered);
        // Beyond the grid nothing happens.
        grid.cover(&[DVec2::new(-9.0, -9.0), DVec2::new(-8.0, -9.0), DVec2::new(-9.0, -8.0)]);
        assert_eq!(grid.covered, expected.covered);
    }
}
