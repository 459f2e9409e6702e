//! A lookup from a direction to pixels of a ray table, for small polygons and for any lens or table.

use super::ray_grid::Tile;
use crate::error::Result;
use crate::memory;
use glam::DVec3;

/// Rows and columns of pixels.
#[derive(Clone, Copy, Debug, Eq, PartialEq)]
pub struct PixelBox {
    /// First row.
    pub first_row: u16,
    /// One past the last row.
    pub end_row: u16,
    /// First column.
    pub first_column: u16,
    /// One past the last column.
    pub end_column: u16,
}

impl PixelBox {
    /// No pixel; extended by `hold`.
    const NOTHING: Self = Self { first_row: u16::MAX, end_row: 0, first_column: u16::MAX, end_column: 0 };

    fn of_pixel(row: u32, column: u32) -> Self {
        let (row, column) = (row as u16, column as u16);
        Self { first_row: row, end_row: row + 1, first_column: column, end_column: column + 1 }
    }

    fn of_tile(tile: &Tile) -> Self {
        let last = Self::of_pixel(tile.row + tile.height - 1, tile.column + tile.width - 1);
        Self { first_row: tile.row as u16, first_column: tile.column as u16, ..last }
    }

    fn hold(&mut self, other: &Self) {
        self.first_row = self.first_row.min(other.first_row);
        self.end_row = self.end_row.max(other.end_row);
        self.first_column = self.first_column.min(other.first_column);
        self.end_column = self.end_column.max(other.end_column);
    }

    #[cfg(test)]
    fn is_empty(&self) -> bool {
        self.first_row >= self.end_row
    }
}

/// Side of a cell, as a multiple of the half angle of the cones that its level serves.
const CELL: f64 = 1.5;

/// Number of levels, each with cones of twice the width of the level below. For wider cones, other lookups select
/// better.
const LEVELS: u32 = 3;

/// Bounds of the half angle of the finest level, radians.
const FINEST: [f64; 2] = [1e-5, 0.1];

/// Margin of all reaches, radians: far above the rounding of directions to f32.
const SLACK: f64 = 2e-5;

/// Maximum number of cells of the finest level per ray.
const CELLS_A_RAY: usize = 1;

/// Maximum number of cells of a level of tiles per tile.
const CELLS_A_TILE: usize = 4;

/// Half angle of the widest cones that get a level of tiles, radians.
const WIDEST: f64 = 0.4;

/// Cells that are always allowed, however few the rays or tiles.
const MIN_CELLS: usize = 4096;

/// Cosine of the largest angle between the middle of a cube side and a direction on that side.
const FACING: f64 = 0.577;

/// Cells of directions on the sides of a cube, in several levels: finer ones for narrow cones than for wide ones.
#[derive(Clone, Debug)]
pub struct DirectionMap {
    /// From narrow cones to wide ones.
    levels: Vec<Level>,
}

/// The cells for cones of up to `half_angle`.
#[derive(Clone, Debug)]
pub struct Level {
    /// Radians.
    pub half_angle: f64,
    /// Cosine of the half angle.
    cosine: f64,
    /// For each cell, the pixels whose rays may lie in a cone around any of its directions.
    pub cells: Cells,
}

impl Level {
    fn new(half_angle: f64, cells: Cells) -> Self {
        Self { half_angle, cosine: half_angle.cos(), cells }
    }
}

/// A box of pixels for each cell.
#[derive(Clone, Debug)]
pub struct Cells {
    /// Along an edge of the cube.
    pub across: u32,
    /// Indexed by twice the dominant axis of a direction, plus one if that component is negative.
    pub sides: [Side; 6],
    /// The box of each stored cell.
    pub boxes: Vec<PixelBox>,
}

/// The rectangle of stored cells on one side.
#[derive(Clone, Copy, Debug, Default)]
pub struct Side {
    pub first: [u32; 2],
    pub count: [u32; 2],
    /// Index of its first box. Boxes along the first axis are consecutive.
    pub start: usize,
}

/// The cube side of a direction, and the position on that side, each -1..=1.
#[inline(always)]
fn place(d: DVec3) -> (usize, [f64; 2]) {
    let [x, y, z] = [d.x.abs(), d.y.abs(), d.z.abs()];
    let axis = if x >= y && x >= z { 0 } else { 1 + usize::from(z > y) };
    let (along, u, v) = match axis {
        0 => (d.x, d.y, d.z),
        1 => (d.y, d.z, d.x),
        _ => (d.z, d.x, d.y),
    };
    (2 * axis + usize::from(along < 0.0), [u / along.abs(), v / along.abs()])
}

/// Calls `rectangle` for cube sides near `d`. Together they cover all directions up to `reach` radians from it.
fn near(d: DVec3, reach: f64, mut rectangle: impl FnMut(usize, [[f64; 2]; 2])) {
    for (axis, [along, u, v]) in [[d.x, d.y, d.z], [d.y, d.z, d.x], [d.z, d.x, d.y]].into_iter().enumerate() {
        for (sign, along) in [along, -along].into_iter().enumerate() {
            // A component changes by at most the angle.
            let [low, high] = [(along - reach).max(FACING), (along + reach).min(1.0)];
            if low > high {
                continue;
            }
            let bounds = [u, v].map(|t| {
                let (least, most) = (t - reach, t + reach);
                [least / if least < 0.0 { low } else { high }, most / if most > 0.0 { low } else { high }]
            });
            if bounds.iter().all(|[least, most]| *least <= 1.0 && *most >= -1.0) {
                rectangle(2 * axis + sign, bounds);
            }
        }
    }
}

/// The cell of a position along an axis.
#[inline(always)]
fn cell(t: f64, across: u32) -> u32 {
    // The cast saturates.
    ((0.5 * (t + 1.0) * f64::from(across)) as u32).min(across - 1)
}

impl Cells {
    /// Reserves a rectangle on each side that holds all cells up to a reach from the directions.
    fn around(reaches: impl Iterator<Item = (DVec3, f64)>, across: u32) -> Self {
        let mut held = [[[u32::MAX, 0]; 2]; 6];
        for (d, reach) in reaches {
            near(d, reach, |side, bounds| {
                for (held, [low, high]) in held[side].iter_mut().zip(bounds) {
                    *held = [held[0].min(cell(low, across)), held[1].max(cell(high, across) + 1)];
                }
            });
        }
        let mut start = 0;
        let sides = held.map(|[u, v]| {
            let count = [u[1].saturating_sub(u[0]), v[1].saturating_sub(v[0])];
            let side = Side { first: [u[0], v[0]], count, start };
            start += count[0] as usize * count[1] as usize;
            side
        });
        Self { across, sides, boxes: Vec::new() }
    }

    /// Number of reserved cells.
    fn room(&self) -> usize {
        self.sides.iter().map(|side| side.count[0] as usize * side.count[1] as usize).sum()
    }

    /// Fills the cells: each holds all pixels whose reach includes one of its directions.
    fn holding(mut self, pixels: impl Iterator<Item = (DVec3, f64, PixelBox)>) -> Result<Self> {
        self.boxes = memory::reserved(self.room())?;
        self.boxes.resize(self.room(), PixelBox::NOTHING);
        for (d, reach, pixels) in pixels {
            near(d, reach, |side, bounds| {
                let [u, v] = bounds.map(|[low, high]| [cell(low, self.across), cell(high, self.across)]);
                for row in v[0]..=v[1] {
                    let first = self.index(side, [u[0], row]).expect("there is room");
                    let boxes = &mut self.boxes[first..=first + (u[1] - u[0]) as usize];
                    boxes.iter_mut().for_each(|b| b.hold(&pixels));
                }
            });
        }
        Ok(self)
    }

    #[inline(always)]
    fn index(&self, side: usize, [u, v]: [u32; 2]) -> Option<usize> {
        let side = &self.sides[side];
        let (u, v) = (u.wrapping_sub(side.first[0]), v.wrapping_sub(side.first[1]));
        (u < side.count[0] && v < side.count[1]).then(|| side.start + v as usize * side.count[0] as usize + u as usize)
    }
}

impl DirectionMap {
    /// `directions` are unit vectors, row-major; NaN means no ray. Their `spacing` (radians) sets the resolution.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if the system refuses the memory, at most 12 bytes a ray.
    pub fn new(width: u32, directions: &[DVec3], spacing: f64) -> Result<Self> {
        let pixel = |i: u32| PixelBox::of_pixel(i / width, i % width);
        let rays = || directions.iter().zip(0u32..).filter(|(d, _)| !d.is_nan()).map(|(d, i)| (*d, pixel(i)));
        let reaching = |reach: f64| directions.iter().filter(|d| !d.is_nan()).map(move |d| (*d, reach));
        let most = CELLS_A_RAY * directions.len() + MIN_CELLS;
        let mut finest = spacing.clamp(FINEST[0], FINEST[1]);
        let across = loop {
            let coarsest = finest * f64::from(1 << (LEVELS - 1));
            let across = ((2.0 / (CELL * coarsest)).ceil() as u32) << (LEVELS - 1);
            if Cells::around(reaching(finest + SLACK), across).room() <= most {
                break across;
            }
            finest *= 1.5;
        };
        let mut levels = Vec::new();
        for level in 0..LEVELS {
            let half_angle = finest * f64::from(1 << level);
            let reach = half_angle + SLACK;
            let pixels = rays().map(|(d, pixel)| (d, reach, pixel));
            let cells = Cells::around(reaching(reach), across >> level).holding(pixels)?;
            levels.push(Level::new(half_angle, cells));
        }
        Ok(Self { levels })
    }

    /// All levels, from narrow cones to wide ones.
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// Levels for cones too wide for the map, built from whole tiles.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if the system refuses the memory.
    pub fn levels_of_tiles(&self, tiles: &[Tile]) -> Result<Vec<Level>> {
        let mut levels = Vec::new();
        let mut half_angle = self.levels.last().map_or(WIDEST, |level| 2.0 * level.half_angle);
        while half_angle <= WIDEST {
            let across = (2.0 / (CELL * half_angle)).ceil() as u32;
            let some = || tiles.iter().filter(|tile| tile.half_angle >= 0.0);
            let reach = |tile: &Tile| (tile.axis, tile.half_angle + half_angle + SLACK);
            let cells = Cells::around(some().map(reach), across);
            if cells.room() <= CELLS_A_TILE * tiles.len() + MIN_CELLS {
                let pixels = some().map(|tile| {
                    let (axis, reach) = reach(tile);
                    (axis, reach, PixelBox::of_tile(tile))
                });
                let cells = cells.holding(pixels)?;
                levels.push(Level::new(half_angle, cells));
            }
            half_angle *= 2.0;
        }
        Ok(levels)
    }

    /// A box around the pixels whose rays lie in a cone with this axis and cosine; `None` if the cone is too wide.
    #[inline(always)]
    pub fn pixels_in(&self, axis: DVec3, cosine: f64) -> Option<PixelBox> {
        let cells = &self.levels.iter().find(|level| cosine >= level.cosine)?.cells;
        let (side, [u, v]) = place(axis);
        let index = cells.index(side, [cell(u, cells.across), cell(v, cells.across)]);
        Some(index.map_or(PixelBox::NOTHING, |i| cells.boxes[i]))
    }

    /// Bytes of memory.
    pub fn bytes(&self) -> usize {
        self.levels.iter().map(|level| size_of_val(&*level.cells.boxes)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn some_direction() -> impl Strategy<Value = DVec3> {
        let some = proptest::array::uniform3(-1.0..1.0f64).prop_map(DVec3::from);
        some.prop_filter("no direction", |v| v.length() > 0.1).prop_map(DVec3::normalize)
    }

    /// 40 x 30 rays about an axis, every seventh missing.
    fn table(axis: DVec3, step: f64) -> Vec<DVec3> {
        let (right, down) = axis.any_orthonormal_pair();
        let ray = |i: u32| {
            let (x, y) = (step * (f64::from(i % 40) - 19.5), step * (f64::from(i / 40) - 14.5));
            let d = (axis * x.cos() + right * x.sin()) * y.cos() + down * y.sin();
            if i % 7 == 3 { DVec3::NAN } else { d }
        };
        (0..1200).map(ray).collect()
    }

    proptest! {
        #[test]
        fn all_rays_of_a_cone_are_in_its_box(
            axis in some_direction(),
            step in prop_oneof![1e-6..1e-3f64, 1e-3..0.2f64],
            spacing in prop_oneof![Just(1.0), 0.01..10.0f64],
            toward in 0..1200usize,
            aside in some_direction(),
            off in 0.0..3.0f64,
            half_angle in 1e-6..0.3f64,
        ) {
            let directions = table(axis, step);
            let map = DirectionMap::new(40, &directions, step * spacing).unwrap();
            let some = if directions[toward].is_nan() { axis } else { directions[toward] };
            let axis = (some + aside * off * half_angle).normalize();
            let Some(found) = map.pixels_in(axis, half_angle.cos()) else { return Ok(()) };
            for (i, d) in directions.iter().enumerate() {
                if axis.angle_between(*d) <= half_angle * 0.999_999 {
                    let (row, column) = ((i / 40) as u16, (i % 40) as u16);
                    let held = (found.first_row..found.end_row).contains(&row)
                        && (found.first_column..found.end_column).contains(&column);
                    prop_assert!(held, "{} {} is not in {:?}", row, column, found);
                }
            }
        }
    }

    /// Like the lookup above, for cones that are wider than the map's own.
    #[test]
    fn all_rays_of_a_wide_cone_are_in_its_box_of_tiles() {
        let directions = table(DVec3::new(0.3, -0.5, 0.6).normalize(), 0.01);
        let ray = |c: u32, r: u32| Some(directions[(r * 40 + c) as usize]).filter(|d| !d.is_nan());
        let corner = |i: u32| (8 * (i % 5), 8 * (i / 5));
        let tiles = (0..20).map(corner).map(|(c, r)| Tile::around(c, r, 8, if r == 24 { 6 } else { 8 }, ray));
        let tiles: Vec<Tile> = tiles.collect();
        let map = DirectionMap::new(40, &directions, 0.01).unwrap();
        let coarser = map.levels_of_tiles(&tiles).unwrap();
        assert!(coarser.len() >= 2 && coarser[0].half_angle > map.levels()[2].half_angle);
        let whole = DirectionMap { levels: coarser };
        let mut tight = false;
        for (axis, level) in
            directions.iter().filter(|d| !d.is_nan()).flat_map(|d| whole.levels.iter().map(move |l| (*d, l)))
        {
            let half_angle = 0.999 * level.half_angle;
            let found = whole.pixels_in(axis, half_angle.cos()).unwrap();
            tight |= found.end_row - found.first_row < 30 && found.end_column - found.first_column < 40;
            for (i, d) in directions.iter().enumerate().filter(|(_, d)| axis.angle_between(**d) <= half_angle) {
                let (row, column) = ((i / 40) as u16, (i % 40) as u16);
                assert!((found.first_row..found.end_row).contains(&row), "{d} {found:?}");
                assert!((found.first_column..found.end_column).contains(&column), "{d} {found:?}");
            }
        }
        assert!(tight, "the whole table would pass");
    }

    /// A box of the whole table would pass the test above.
    #[test]
    fn boxes_are_tight() {
        for axis in [DVec3::Z, DVec3::new(1.0, 1.0, 0.9).normalize(), DVec3::NEG_X] {
            let map = DirectionMap::new(40, &table(axis, 0.01), 0.01).unwrap();
            let found = map.pixels_in(axis, 0.009f64.cos()).unwrap();
            assert!((found.first_row..found.end_row).len() <= 6, "{found:?}");
            assert!((found.first_column..found.end_column).len() <= 6, "{found:?}");
            assert!(map.pixels_in(-axis, 0.009f64.cos()).unwrap().is_empty());
            assert_eq!(map.pixels_in(axis, 0.5f64.cos()), None);
        }
    }

    #[test]
    fn rays_that_are_scattered_need_bounded_room() {
        let scattered: Vec<DVec3> = (0..5000)
            .map(|i| DVec3::new((f64::from(i) * 7.1).sin(), (f64::from(i) * 3.3).cos(), 0.3).normalize())
            .collect();
        let map = DirectionMap::new(100, &scattered, 1e-9).unwrap();
        assert!(map.levels[0].cells.boxes.len() <= 5000 + 4096);
        assert!(DirectionMap::new(100, &[DVec3::NAN; 100], 0.0).unwrap().pixels_in(DVec3::X, 1.0).unwrap().is_empty());
    }
}
