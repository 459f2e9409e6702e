//! Tables of rays in tiles of 8 x 8, with the cone around each tile and bounds on all rays. Built once per sensor.

use super::cone_tree::ConeTree;
use super::direction_map::DirectionMap;
use super::grid::{Octet, PositionFinder};
use super::pixel_fit::PixelFit;
use crate::error::Result;
use crate::memory;
use crate::statistics::upper_median;
use glam::{DVec2, DVec3};
use pulp::Simd;

/// A square of pixels with the cone that holds its rays.
#[derive(Clone, Copy, Debug)]
pub struct Tile {
    /// First column.
    pub column: u32,
    /// First row.
    pub row: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Unit axis of the cone.
    pub axis: DVec3,
    /// Half angle of the cone, radians, rounded up; negative if the tile has no ray.
    pub half_angle: f64,
}

impl Tile {
    /// The cone around the rays of a tile of pixels.
    pub fn around(column: u32, row: u32, width: u32, height: u32, ray: impl Fn(u32, u32) -> Option<DVec3>) -> Self {
        let pixels = || (row..row + height).flat_map(|r| (column..column + width).map(move |c| (c, r)));
        let sum: DVec3 = pixels().filter_map(|(c, r)| ray(c, r)).sum();
        let axis = if sum.length() > 1e-6 { sum.normalize() } else { DVec3::X };
        let half_angle = pixels().filter_map(|(c, r)| ray(c, r)).map(|u| axis.angle_between(u)).fold(-1.0, f64::max);
        Self { column, row, width, height, axis, half_angle: if half_angle < 0.0 { -1.0 } else { half_angle + 1e-7 } }
    }
}

/// Side of the tiles of a [`RayGrid`], pixels.
pub const TILE_SIDE: u32 = Octet::LEN as u32;

const SIDE: usize = TILE_SIDE as usize;

/// The rays of a tile by row and column, for vector loops; NaN where a ray is missing.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub struct TileRays {
    /// x of the rays.
    pub x: [[f64; SIDE]; SIDE],
    /// y of the rays.
    pub y: [[f64; SIDE]; SIDE],
    /// z of the rays.
    pub z: [[f64; SIDE]; SIDE],
}

impl TileRays {
    const NONE: Self = Self { x: [[f64::NAN; SIDE]; SIDE], y: [[f64::NAN; SIDE]; SIDE], z: [[f64::NAN; SIDE]; SIDE] };
}

/// The cones of eight neighbouring tiles, for vector loops. A tile's unit rays are within `chord` of its unit axis.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub struct Cones {
    /// x of the axes.
    pub x: [f64; Octet::LEN],
    /// y of the axes.
    pub y: [f64; Octet::LEN],
    /// z of the axes.
    pub z: [f64; Octet::LEN],
    /// Squared sine of the half angle; above 1 if the cone is too wide to bound.
    pub sine_squared: [f64; Octet::LEN],
    /// Maximum distance of a unit ray from the unit axis.
    pub chord: [f64; Octet::LEN],
}

impl Cones {
    /// Packs up to eight tiles; unused lanes hold arbitrary values.
    fn of(tiles: &[Tile]) -> Self {
        let nothing = [0.0; Octet::LEN];
        let mut cones = Self { x: nothing, y: nothing, z: nothing, sine_squared: nothing, chord: nothing };
        for (i, tile) in tiles.iter().enumerate() {
            let half_angle = tile.half_angle.max(0.0) + SLACK;
            let sine = if half_angle < 1.5 { half_angle.sin() } else { 2.0 };
            (cones.x[i], cones.y[i], cones.z[i]) = tile.axis.into();
            cones.sine_squared[i] = sine * sine;
            cones.chord[i] = 2.0 * (0.5 * half_angle).min(std::f64::consts::FRAC_PI_2).sin() + 1e-12;
        }
        cones
    }
}

/// Half angle of the cone around all rays, radians. Wider tables get a [`DirectionMap`].
const WIDE: f64 = 0.75;

/// Finds the tiles that a polygon may cover, where there is no [`DirectionMap`] or the polygon is too large for it.
#[derive(Clone, Debug)]
pub enum TileLookup {
    /// All rays lie in front of one plane.
    Ahead(Box<ForwardView>),
    /// Fisheyes past 90 degrees, and rays in all directions.
    Around(ConeTree),
}

/// Rays in front of a plane, as points on the parallel plane at distance 1.
#[derive(Clone, Debug)]
pub struct ForwardView {
    /// right, down and forward in the image frame; `None` if these are the axes of the image frame.
    pub turn: Option<[DVec3; 3]>,
    /// Rows of tiles, downwards.
    pub rows: TileSpans,
    /// Columns of tiles, to the right.
    pub columns: TileSpans,
}

/// The intervals that rows (or columns) of tiles cover on the plane, and lookups from an interval to its rows.
#[derive(Clone, Debug)]
pub struct TileSpans {
    /// Bounds over all rows.
    pub least: f64,
    pub greatest: f64,
    /// Running maximum of the upper ends; rising.
    greatest_so_far: PositionFinder,
    /// Running minimum of the lower ends, from the last row back; rising.
    least_from_here: PositionFinder,
}

/// Maps all positions to -1..1, monotonically. Infinities and NaN are clamped.
#[inline(always)]
#[expect(clippy::manual_clamp, reason = "clamp would keep NaN")]
fn squeezed(t: f64) -> f64 {
    let t = t.max(-1e30).min(1e30);
    t / (1.0 + t.abs())
}

impl TileSpans {
    fn new(of_each: &[[f64; 2]]) -> Self {
        let mut greatest_so_far: Vec<f64> = of_each.iter().map(|s| s[1]).collect();
        let mut least_from_here: Vec<f64> = of_each.iter().map(|s| s[0]).collect();
        for i in 1..of_each.len() {
            greatest_so_far[i] = greatest_so_far[i].max(greatest_so_far[i - 1]);
        }
        for i in (1..of_each.len()).rev() {
            least_from_here[i - 1] = least_from_here[i - 1].min(least_from_here[i]);
        }
        // Rows without rays are infinitely far away and must stay so.
        let place = |t: &f64| if t.is_infinite() { *t } else { squeezed(*t) };
        let finder = |bounds: &[f64]| PositionFinder::new(&bounds.iter().map(place).collect::<Vec<_>>());
        Self {
            least: least_from_here[0],
            greatest: greatest_so_far[of_each.len() - 1],
            greatest_so_far: finder(&greatest_so_far),
            least_from_here: finder(&least_from_here),
        }
    }

    /// For each interval, the first and the end of the rows of tiles that have a ray in it, or slightly more rows.
    #[inline(always)]
    pub fn tiles_around<S: Simd>(
        &self,
        simd: S,
        low: &[f64; Octet::LEN],
        high: &[f64; Octet::LEN],
    ) -> [[u32; Octet::LEN]; 2] {
        let first = self.greatest_so_far.surely_below(simd, &low.map(squeezed));
        [first, self.least_from_here.perhaps_up_to(simd, &high.map(squeezed))]
    }
}

impl ForwardView {
    /// Flatter rays would meet the plane too far away.
    const FLATTEST: f64 = 0.05;

    /// Returns `None` if a ray is not in front. Tries the axes of the image frame first, then axes along the mean ray.
    fn of(width: u32, height: u32, directions: &[DVec3], whole: &Tile) -> Option<Self> {
        let known = || directions.iter().filter(|d| !d.is_nan());
        let is_ahead = |forward: DVec3| known().all(|d| d.dot(forward) >= Self::FLATTEST);
        let turn = if is_ahead(DVec3::Z) {
            None
        } else {
            let forward = whole.axis;
            let middle = 0.5 * f64::from(width - 1);
            let columns = directions.iter().zip((0..height).flat_map(|_| 0..width));
            let columns = columns.filter(|(d, _)| !d.is_nan());
            let across: DVec3 = columns.map(|(d, column)| *d * (f64::from(column) - middle)).sum();
            let right = (across - forward * across.dot(forward)).try_normalize();
            let right = right.unwrap_or_else(|| forward.any_orthonormal_vector());
            is_ahead(forward).then_some(Some([right, forward.cross(right), forward]))?
        };
        let [right, down, forward] = turn.unwrap_or([DVec3::X, DVec3::Y, DVec3::Z]);
        let nothing = [f64::INFINITY, f64::NEG_INFINITY];
        let mut rows = vec![nothing; height.div_ceil(TILE_SIDE) as usize];
        let mut columns = vec![nothing; width.div_ceil(TILE_SIDE) as usize];
        for (d, (row, column)) in directions.iter().zip((0..height).flat_map(|r| (0..width).map(move |c| (r, c)))) {
            if d.is_nan() {
                continue;
            }
            let depth = d.dot(forward);
            let hold = |stretch: &mut [f64; 2], t: f64| *stretch = [stretch[0].min(t), stretch[1].max(t)];
            hold(&mut rows[(row / TILE_SIDE) as usize], d.dot(down) / depth);
            hold(&mut columns[(column / TILE_SIDE) as usize], d.dot(right) / depth);
        }
        Some(Self { turn, rows: TileSpans::new(&rows), columns: TileSpans::new(&columns) })
    }

    /// Inward normals of the planes that enclose all rays.
    fn sides(&self) -> Vec<DVec3> {
        let [right, down, forward] = self.turn.unwrap_or([DVec3::X, DVec3::Y, DVec3::Z]);
        let beyond = |axis: DVec3, least: f64| (axis - forward * (least - SLACK * (1.0 + least.abs()))).normalize();
        vec![
            forward,
            beyond(right, self.columns.least),
            beyond(-right, -self.columns.greatest),
            beyond(down, self.rows.least),
            beyond(-down, -self.rows.greatest),
        ]
    }
}

/// Margin of bounds, radians, far above the rounding of angles and products: selection may keep too much, never too
/// little.
const SLACK: f64 = 1e-9;

/// Bounds on the rays of a table, as planes through the centre with unit normals in the image frame.
#[derive(Clone, Debug)]
pub enum Sides {
    /// Inside the pyramid between these planes, with inward normals; no planes means anywhere.
    Within(Vec<DVec3>),
    /// Outside the pyramid between these planes.
    Outside(Vec<DVec3>),
}

impl Sides {
    /// Planes around a cone, or around a pyramid in the complement of a wide cone.
    fn of(cone: &Tile) -> Self {
        let (side, up) = cone.axis.any_orthonormal_pair();
        let half_angle = cone.half_angle + SLACK;
        if !(0.0..=3.0).contains(&half_angle) {
            return Self::Within(Vec::new());
        }
        if half_angle < 1.5 {
            let (sin, cos) = half_angle.sin_cos();
            return Self::Within([side, -side, up, -up].map(|d| cone.axis * sin + d * cos).to_vec());
        }
        if half_angle < 1.65 {
            return Self::Within(Vec::new());
        }
        // A hexagonal pyramid whose edges lie in the complement, a microradian inside.
        let left = std::f64::consts::PI - half_angle - 1e-6;
        let (sin, cos) = (left.tan() * (std::f64::consts::PI / 6.0).cos()).atan().sin_cos();
        let turned = (0..6).map(|k| DVec2::from_angle(f64::from(k) * std::f64::consts::TAU / 6.0));
        Self::Outside(turned.map(|t| (side * t.x + up * t.y) * cos - cone.axis * sin).collect())
    }
}

/// Median angle between neighbouring rays of a tile, radians.
fn spacing(tiles: &[Tile]) -> f64 {
    let of_tile = |t: &Tile| {
        let pixels = DVec2::new(f64::from(t.width - 1), f64::from(t.height - 1));
        (t.half_angle > 0.0 && pixels.length() > 0.0).then(|| 2.0 * t.half_angle / pixels.length())
    };
    let mut all: Vec<f64> = tiles.iter().filter_map(of_tile).collect();
    upper_median(&mut all, f64::total_cmp).unwrap_or(0.0)
}

/// A table of rays in tiles of 8 x 8.
#[derive(Clone, Debug)]
pub struct RayGrid {
    width: u32,
    height: u32,
    tiles: Vec<Tile>,
    /// For each tile.
    rays: Vec<TileRays>,
    /// For each tile: true if a ray is missing.
    gaps: Vec<bool>,
    /// By row of tiles, in groups of eight tiles.
    cones: Vec<Cones>,
    map: Option<DirectionMap>,
    fit: PixelFit,
    view: TileLookup,
    sides: Sides,
}

impl RayGrid {
    /// Bytes of a table of `width` x `height` rays, without the direction map of a wide view.
    pub(super) fn bytes_for(width: u32, height: u32) -> u64 {
        let tiles = u64::from(width.div_ceil(TILE_SIDE)) * u64::from(height.div_ceil(TILE_SIDE));
        tiles * (size_of::<Tile>() + size_of::<TileRays>() + size_of::<Cones>() / Octet::LEN + 1) as u64
    }

    /// `directions` are unit vectors in the image frame, row-major; NaN means no ray.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if the system refuses the memory.
    pub(super) fn new(width: u32, height: u32, directions: &[DVec3]) -> Result<Self> {
        Self::with_fit(width, height, directions, PixelFit::new(width, directions)?)
    }

    /// [`RayGrid::new`] with a given pixel fit.
    ///
    /// # Errors
    /// As [`RayGrid::new`].
    pub(super) fn with_fit(width: u32, height: u32, directions: &[DVec3], fit: PixelFit) -> Result<Self> {
        let ray = |c: u32, r: u32| {
            let d = directions[(r * width + c) as usize];
            (!d.is_nan()).then_some(d)
        };
        let count = height.div_ceil(TILE_SIDE) as usize * width.div_ceil(TILE_SIDE) as usize;
        let (mut tiles, mut rays) = (memory::reserved(count)?, memory::reserved(count)?);
        let mut gaps = memory::reserved(count)?;
        for row in (0..height).step_by(SIDE) {
            for column in (0..width).step_by(SIDE) {
                let (w, h) = (TILE_SIDE.min(width - column), TILE_SIDE.min(height - row));
                tiles.push(Tile::around(column, row, w, h, ray));
                let (mut own, mut gap) = (TileRays::NONE, false);
                for (r, c) in (0..h).flat_map(|r| (0..w).map(move |c| (r as usize, c as usize))) {
                    let d = directions[(row as usize + r) * width as usize + column as usize + c];
                    (own.x[r][c], own.y[r][c], own.z[r][c]) = d.into();
                    gap |= d.is_nan();
                }
                rays.push(own);
                gaps.push(gap);
            }
        }
        let across = width.div_ceil(TILE_SIDE) as usize;
        let cones = tiles.chunks(across).flat_map(|row| row.chunks(Octet::LEN)).map(Cones::of).collect();
        let whole = Tile::around(0, 0, width, height, ray);
        let (view, sides) = match ForwardView::of(width, height, directions, &whole) {
            Some(ahead) if whole.half_angle >= 0.0 => {
                let sides = Sides::Within(ahead.sides());
                (TileLookup::Ahead(Box::new(ahead)), sides)
            }
            _ => (TileLookup::Around(ConeTree::new(&tiles, across)), Sides::of(&whole)),
        };
        // For a wide view, rows and columns of tiles select poorly, and the tree is slow.
        let wide = matches!(view, TileLookup::Around(_)) || whole.half_angle > WIDE;
        let map = if wide { Some(DirectionMap::new(width, directions, spacing(&tiles))?) } else { None };
        Ok(Self { width, height, tiles, rays, gaps, cones, map, fit, view, sides })
    }

    /// Columns.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Unit direction of a pixel in the image frame; NaN means no ray.
    pub fn direction(&self, column: u32, row: u32) -> DVec3 {
        let tile = &self.rays[(row / TILE_SIDE) as usize * self.tiles_across() + (column / TILE_SIDE) as usize];
        let (r, c) = ((row % TILE_SIDE) as usize, (column % TILE_SIDE) as usize);
        DVec3::new(tile.x[r][c], tile.y[r][c], tile.z[r][c])
    }

    /// Unit directions in the image frame, row-major; NaN means no ray.
    pub fn directions(&self) -> impl Iterator<Item = DVec3> + '_ {
        (0..self.height).flat_map(move |r| (0..self.width).map(move |c| self.direction(c, r)))
    }

    /// Tiles, row-major.
    pub fn tiles(&self) -> &[Tile] {
        &self.tiles
    }

    /// Number of tiles in a row.
    pub fn tiles_across(&self) -> usize {
        self.width.div_ceil(TILE_SIDE) as usize
    }

    /// The rays of a tile.
    #[inline(always)]
    pub fn rays_of(&self, tile: usize) -> &TileRays {
        &self.rays[tile]
    }

    /// True if a tile lacks a ray.
    pub fn has_gaps(&self, tile: usize) -> bool {
        self.gaps[tile]
    }

    /// The cones of a row of tiles, in groups of eight.
    #[inline(always)]
    pub fn cones_of_row(&self, row: usize) -> &[Cones] {
        let eights = self.tiles_across().div_ceil(Octet::LEN);
        &self.cones[row * eights..(row + 1) * eights]
    }

    /// Finds the pixels that a small polygon may cover; present if the view is wide.
    #[inline(always)]
    pub fn direction_map(&self) -> Option<&DirectionMap> {
        self.map.as_ref()
    }

    /// Approximates the pixel of a direction.
    #[inline(always)]
    pub fn pixel_fit(&self) -> &PixelFit {
        &self.fit
    }

    /// Finds the tiles that a polygon may cover.
    pub fn view(&self) -> &TileLookup {
        &self.view
    }

    /// Bounds on all rays.
    pub fn sides(&self) -> &Sides {
        &self.sides
    }

    /// Bytes of memory that the tables take.
    pub fn bytes(&self) -> u64 {
        let tree = if let TileLookup::Around(tree) = &self.view { tree.bytes() } else { 0 };
        let map = self.map.as_ref().map_or(0, DirectionMap::bytes);
        let own = size_of_val(&*self.rays) + size_of_val(&*self.tiles) + size_of_val(&*self.cones);
        (own + tree + map + self.fit.bytes()) as u64
    }
}
