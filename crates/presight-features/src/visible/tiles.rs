//! Finds the polygons that may hide something in a direction; tiles of a cube around the sensor store them.
//!
//! A tile is a pyramid with its apex at the sensor. The index is queried once per tile, and the samples of all features
//! use the result. First the polygons outside or behind all samples of a feature in the tile are dropped; then each
//! sample is tested against the rest. The first query reaches only as far as the surfaces that the image shows in the
//! tile; a second one follows if a farther feature is still not hidden.

use super::VisibilityContext;
use super::polygon::{PolygonCache, PreparedPolygon};
use super::surface::FeatureSurface;
use glam::DVec3;
use presight_model::geometry::Aabb;
use presight_model::index::{QueryResult, Region};
use std::collections::HashMap;

/// Approximate width of a camera's tiles, pixels.
const PIXELS: f64 = 128.0;
/// Approximate width of a scanner's tiles. Its pixels are wide: large tiles would contain much of a building.
const SCANNER_PIXELS: f64 = 32.0;
/// Maximum number of tiles along a side of the cube, so that their numbers fit in 32 bits.
const MAX_ACROSS: f64 = 16_384.0;
/// Margin of a tile over its sides, in coordinates on the cube: rounding may move places between two of its places out.
const SLACK: f64 = 1e-9;
/// Factor on the queried range, so that the next feature need not query again.
const FARTHER: f64 = 1.25;
/// Margin, relative to the distance, by which a polygon is behind another: far more than the rounding of either.
const BEHIND: f64 = 1e-6;

/// A polygon that covers a ray of the tile. The values that exclude most polygons are stored with its number.
#[derive(Clone, Copy)]
struct TilePolygon {
    /// Its box on the tile's side of the cube.
    bounds: Bounds,
    inverse: DVec3,
    number: u32,
    /// Lower bound of its coordinate along the side's axis, within the tile.
    near: f32,
}

impl TilePolygon {
    fn new(polygons: &PolygonCache, number: u32, square: &Square) -> Self {
        let known = polygons.get(number);
        let corners = polygons.corners_of(known);
        let bounds = Bounds::of(corners, square);
        let (mut nearest, mut reach) = (f64::INFINITY, 0f64);
        for corner in corners {
            nearest = nearest.min(square.coordinates(*corner)[2]);
            reach = reach.max(corner.abs().max_element());
        }
        let near = if known.is_unknown() { 0.0 } else { before(nearest - BEHIND * BEHIND * reach) };
        Self { bounds, inverse: known.inverse, number, near }
    }

    /// Raises `near` to the bound given by its plane. `greatest` is its greatest product with a corner of the tile.
    fn beyond(self, greatest: f64, known: &PreparedPolygon) -> Self {
        let is_told = greatest > 0.0 && !known.is_unknown();
        Self { near: if is_told { self.near.max(before(greatest.recip())) } else { self.near }, ..self }
    }
}

/// Rounds a distance down, to at least 0.
fn before(distance: f64) -> f32 {
    (distance * (1.0 - BEHIND)).max(0.0) as f32
}

/// A box on a side of the cube: x0, x1, y0, y1.
#[derive(Clone, Copy, Debug)]
struct Bounds([f32; 4]);

impl Bounds {
    /// Margin of the box, for rounding.
    const SLACK: f32 = 1e-6;

    /// The box around places; all of the side if a place is not in front of it.
    fn of(places: &[DVec3], square: &Square) -> Self {
        let mut bounds = [f32::INFINITY, f32::NEG_INFINITY, f32::INFINITY, f32::NEG_INFINITY];
        for place in places {
            let [x, y, z] = square.coordinates(*place);
            if !(z > 0.0) {
                return Self([f32::NEG_INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::INFINITY]);
            }
            // No tile extends beyond 1.
            let [x, y] = [x, y].map(|x| (x / z).clamp(-2.0, 2.0) as f32);
            let [x0, x1, y0, y1] = bounds;
            bounds = [x0.min(x), x1.max(x), y0.min(y), y1.max(y)];
        }
        let [x0, x1, y0, y1] = bounds;
        Self([x0 - Self::SLACK, x1 + Self::SLACK, y0 - Self::SLACK, y1 + Self::SLACK])
    }

    /// Masks of the columns and rows, of 32 each, that the box touches in a square. Boxes that meet share bits in both.
    fn cells(&self, square: &Square) -> [u32; 2] {
        let ([x0, x1, y0, y1], [u, v]) = (self.0, square.bounds);
        let cell =
            |x: f32, [low, high]: [f64; 2]| ((f64::from(x) - low) * (32.0 / (high - low))).clamp(0.0, 31.0) as u32;
        let reach = |from: u32, to: u32| (u32::MAX << from) & (u32::MAX >> (31 - to));
        [reach(cell(x0, u), cell(x1, u)), reach(cell(y0, v), cell(y1, v))]
    }

    #[inline]
    fn meets(&self, other: &Self) -> bool {
        let ([a0, a1, a2, a3], [b0, b1, b2, b3]) = (self.0, other.0);
        (a0 <= b1) & (b0 <= a1) & (a2 <= b3) & (b2 <= a3)
    }
}

/// Tiles of the cube [-1, 1]^3 around the sensor, image axes. They are convex.
pub(super) struct Tiles {
    /// Number of tiles along a side.
    across: f64,
    numbers: HashMap<u32, u32>,
    tiles: Vec<Tile>,
    found: QueryResult,
}

/// Which polygons of a tile are needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Look {
    First,
    All,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Square {
    axis: usize,
    sign: f64,
    /// Bounds of the two coordinates that follow the axis cyclically, divided by the coordinate along the axis.
    bounds: [[f64; 2]; 2],
}

impl Square {
    fn coordinates(&self, at: DVec3) -> [f64; 3] {
        [at[(self.axis + 1) % 3], at[(self.axis + 2) % 3], self.sign * at[self.axis]]
    }

    /// Positive inside of each of the four sides; linear.
    fn sides(&self, at: DVec3) -> [f64; 4] {
        let [x, y, z] = self.coordinates(at);
        let [u, v] = self.bounds;
        [x - u[0] * z, u[1] * z - x, y - v[0] * z, v[1] * z - y]
    }

    /// The share of the line from `p`, inside up to rounding, to `q` at which it leaves the pyramid; 1 if it does not.
    pub fn left_at(&self, p: DVec3, q: DVec3) -> f64 {
        let crossings = self.sides(p).into_iter().zip(self.sides(q)).filter(|(_, g)| *g < 0.0);
        crossings.map(|(f, g)| f.max(0.0) / (f.max(0.0) - g)).fold(1.0, f64::min)
    }

    /// Rays along its edges, in order around it.
    fn corners(&self) -> [DVec3; 4] {
        let [u, v] = self.bounds.map(|[low, high]| [low - SLACK, high + SLACK]);
        [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(i, j)| {
            let mut ray = DVec3::ZERO;
            ray[self.axis] = self.sign;
            ray[(self.axis + 1) % 3] = u[i];
            ray[(self.axis + 2) % 3] = v[j];
            ray
        })
    }
}

/// A feature with fewer samples or pieces does not query a new tile: a ray for each is faster.
pub(super) const FEW_FOR_TILES: usize = 9;

/// Polygons of a tile, the nearest first, with their cells: comparing cells excludes many of them in one step.
#[derive(Default)]
struct TilePolygons {
    all: Vec<TilePolygon>,
    /// [`Bounds::cells`], columns and rows apart, so that one instruction compares several.
    columns: Vec<u32>,
    rows: Vec<u32>,
}

impl TilePolygons {
    fn new(mut all: Vec<TilePolygon>, square: &Square) -> Self {
        all.sort_by(|a, b| a.near.total_cmp(&b.near));
        let (columns, rows) = all.iter().map(|polygon| polygon.bounds.cells(square).into()).unzip();
        Self { all, columns, rows }
    }

    /// Visits, in order, the polygons that may share columns and rows and come nearer than `far` along the axis.
    fn visit(&self, [column, row]: [u32; 2], far: f32, mut visit: impl FnMut(&TilePolygon)) {
        const AT_ONCE: usize = 16;
        let meets = |(columns, rows): (&u32, &u32)| u32::from(columns & column != 0) & u32::from(rows & row != 0);
        let nearer = self.all.partition_point(|polygon| polygon.near < far);
        let (columns, rows) = (self.columns[..nearer].chunks(AT_ONCE), self.rows[..nearer].chunks(AT_ONCE));
        for ((some, columns), rows) in self.all[..nearer].chunks(AT_ONCE).zip(columns).zip(rows) {
            if columns.iter().zip(rows).fold(0, |any, of| any | meets(of)) != 0 {
                let of = some.iter().zip(columns.iter().zip(rows));
                of.filter(|(_, of)| meets(*of) != 0).for_each(|(polygon, _)| visit(polygon));
            }
        }
    }
}

/// The polygons of a tile up to a range, metres.
struct Tile {
    square: Square,
    radius: f64,
    candidates: TilePolygons,
}

impl Tile {
    /// A tile that keeps the polygons that cover one of its rays.
    fn new(square: Square, radius: f64, polygons: &PolygonCache, some: impl Iterator<Item = TilePolygon>) -> Self {
        let corners = square.corners();
        let bounds = Bounds::of(&corners, &square);
        let mut candidates = Vec::new();
        for candidate in some.filter(|c| c.bounds.meets(&bounds)) {
            let known = polygons.get(candidate.number);
            if polygons.planes_of(known).iter().any(|e| corners.iter().all(|c| e.dot(*c) < 0.0)) {
                continue;
            }
            let greatest = corners.into_iter().map(|c| known.inverse.dot(c)).fold(0.0, f64::max);
            candidates.push(candidate.beyond(greatest, known));
        }
        Self { square, radius, candidates: TilePolygons::new(candidates, &square) }
    }
}

/// The greatest range that the image shows in some directions of a tile. Polygons beyond it are probably hidden,
/// together with everything near them.
fn depth_of(frame: &VisibilityContext<'_>, polygons: &mut PolygonCache, square: &Square) -> f64 {
    /// Directions along each side.
    const LOOKS: u32 = 4;
    let [c00, c10, c11, c01] = square.corners();
    let share = |i: u32| (f64::from(i) + 0.5) / f64::from(LOOKS);
    let mut depth = 0f64;
    for (i, j) in (0..LOOKS).flat_map(|i| (0..LOOKS).map(move |j| (i, j))) {
        let ray = c00.lerp(c10, share(i)).lerp(c01.lerp(c11, share(i)), share(j));
        if let Some(number) = frame.slot_in(ray).and_then(|slot| polygons.of_slot(frame, slot)) {
            let known = polygons.get(number);
            let range = ray.length() / known.inverse.dot(ray);
            if known.covers && range.is_finite() {
                depth = depth.max(range);
            }
        }
    }
    depth
}

impl Tiles {
    /// Tiles for the sensor of a prediction.
    pub fn of_sensor(frame: &VisibilityContext<'_>) -> Self {
        let pixels = if frame.sensor.is_camera() { PIXELS } else { SCANNER_PIXELS };
        Self::new(pixels * frame.sampler.pixel_angle())
    }

    /// Tiles about as wide as an angle, radians.
    fn new(angle: f64) -> Self {
        let across = (2.0 / angle).ceil().clamp(1.0, MAX_ACROSS);
        Self { across, numbers: HashMap::new(), tiles: Vec::new(), found: QueryResult::default() }
    }

    /// The number and square of the tile that contains a place, which must not be the sensor's.
    #[inline]
    pub fn of(&self, at: DVec3) -> (u32, Square) {
        let size = at.abs();
        let axis = if size.x >= size.y && size.x >= size.z { 0 } else { 1 + usize::from(size.z > size.y) };
        let half = 0.5 * self.across / size[axis];
        let number = |other: usize| (at[other] * half + 0.5 * self.across).clamp(0.0, self.across - 1.0) as u32;
        let side = 2 * axis as u32 + u32::from(at[axis] < 0.0);
        let across = self.across as u32;
        let numbers = [number((axis + 1) % 3), number((axis + 2) % 3)];
        let bounds = numbers.map(|n| [n, n + 1].map(|n| 2.0 * f64::from(n) / self.across - 1.0));
        let square = Square { axis, sign: 1f64.copysign(at[axis]), bounds };
        ((side * across + numbers[0]) * across + numbers[1], square)
    }

    /// Returns true if a tile need not be queried to reach this range.
    pub fn knows(&self, number: u32, farthest: f64) -> bool {
        self.numbers.get(&number).is_some_and(|tile| self.tiles[*tile as usize].radius >= farthest)
    }

    /// The tile of a place, and whether it has all polygons up to the range `farthest`, metres. A first look may end
    /// behind the surfaces that the image shows: they hide nearly everything beyond, where most polygons are.
    pub fn tile(
        &mut self,
        frame: &VisibilityContext<'_>,
        polygons: &mut PolygonCache,
        at: DVec3,
        farthest: f64,
        look: Look,
    ) -> (u32, bool) {
        let (number, square) = self.of(at);
        if let Some(tile) = self.numbers.get(&number) {
            let has_all = self.tiles[*tile as usize].radius >= farthest;
            if has_all || look == Look::First {
                return (*tile, has_all);
            }
        }
        let mut radius = FARTHER * farthest;
        if look == Look::First {
            let depth = FARTHER * depth_of(frame, polygons, &square);
            if depth > 0.0 {
                radius = radius.min(depth);
            }
        }
        let (tile, found) = (self.tiles.len() as u32, self.find(frame, polygons, square, radius));
        self.numbers.insert(number, tile);
        self.tiles.push(found);
        (tile, radius >= farthest)
    }

    /// Collects the polygons, by number in the cache, that may hide something at the places or between them. Such a
    /// polygon meets the places' box on the side of the cube, is not behind all of their box in space, and is not the
    /// feature's own.
    pub fn between(
        &self,
        tile: u32,
        places: &[DVec3],
        own: &FeatureSurface<'_>,
        polygons: &PolygonCache,
        near: &mut Vec<u32>,
    ) {
        near.clear();
        let tile = &self.tiles[tile as usize];
        let bounds = Bounds::of(places, &tile.square);
        let cells = bounds.cells(&tile.square);
        let farthest = places.iter().map(|p| tile.square.coordinates(*p)[2]).fold(0.0, f64::max);
        let far = (farthest * (1.0 + BEHIND)) as f32;
        let Aabb { min, max } = Aabb::of(places.iter().copied());
        let greatest = |n: DVec3| n.max(DVec3::ZERO).dot(max) + n.min(DVec3::ZERO).dot(min);
        tile.candidates.visit(cells, far, |c| {
            if c.bounds.meets(&bounds) && greatest(c.inverse) > 1.0 && !own.holds(polygons.get(c.number).slot) {
                near.push(c.number);
            }
        });
    }

    fn find(
        &mut self,
        frame: &VisibilityContext<'_>,
        polygons: &mut PolygonCache,
        square: Square,
        radius: f64,
    ) -> Tile {
        let corners = square.corners();
        let middle: DVec3 = corners.iter().sum();
        let world_from_image = frame.image_from_world.transpose();
        let planes = [0, 1, 2, 3].map(|k| {
            let normal = corners[k].cross(corners[(k + 1) % 4]);
            world_from_image * (normal.dot(middle).signum() * normal.normalize())
        });
        let region = Region::frustum(frame.world_from_sensor.translation, &planes, radius);
        self.found.clear();
        frame.world.index().query(frame.environment, &region, &mut self.found);
        let some: Vec<u32> = self.found.all().filter_map(|slot| polygons.of_slot(frame, slot)).collect();
        let polygons = &*polygons;
        let some = some.into_iter().filter(|number| polygons.get(*number).covers);
        Tile::new(square, radius, polygons, some.map(|number| TilePolygon::new(polygons, number, &square)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// A line between two places in a tile stays in the tile's pyramid.
        #[test]
        fn tiles_are_convex(
            a in proptest::array::uniform3(-1.0..1.0f64),
            near in proptest::array::uniform3(-0.1..0.1f64),
            share in 0.0..=1.0f64,
            angle in 0.01..64.0f64,
        ) {
            let tiles = Tiles::new(angle);
            let (a, b) = (DVec3::from(a), 3.0 * (DVec3::from(a) + angle / 128.0 * DVec3::from(near)));
            prop_assume!(a.length() > 0.1 && tiles.of(a).0 == tiles.of(b).0);
            let corners = tiles.of(a).1.corners();
            let middle: DVec3 = corners.iter().sum();
            for k in 0..4 {
                let normal = corners[k].cross(corners[(k + 1) % 4]);
                let inward = normal.dot(middle).signum() * normal.normalize();
                for p in [a, b, a.lerp(b, share)] {
                    prop_assert!(inward.dot(p) >= 0.0, "{inward} {p}");
                }
            }
        }

        /// The line leaves the tile where it meets one of its sides.
        #[test]
        fn tiles_are_left_at_their_sides(
            a in proptest::array::uniform3(-1.0..1.0f64),
            b in proptest::array::uniform3(-1.0..1.0f64),
            angle in 0.1..64.0f64,
        ) {
            let (a, b) = (DVec3::from(a), DVec3::from(b));
            prop_assume!(a.length() > 0.1 && b.length() > 0.1);
            let tiles = Tiles::new(angle);
            let square = tiles.of(a).1;
            let share = square.left_at(a, b);
            prop_assert!((share == 1.0) == square.sides(b).iter().all(|s| *s >= 0.0));
            let most = square.sides(a.lerp(b, share)).into_iter().fold(f64::INFINITY, f64::min);
            prop_assert!(most >= -1e-12 && (share == 1.0 || most <= 1e-12), "{share} {most}");
        }
    }

    /// Only polygons nearer than the given distance are visited, the nearest first.
    #[test]
    fn what_is_farther_is_passed_over() {
        let square = Tiles::new(1.28).of(DVec3::Z).1;
        let bounds = Bounds([-1.0, 1.0, -1.0, 1.0]);
        let polygon = |(number, near)| TilePolygon { bounds, inverse: DVec3::Z, number, near };
        let polygons = TilePolygons::new([(0, 3.0), (1, 1.0), (2, 2.0)].map(polygon).to_vec(), &square);
        let visited = |far: f32| {
            let mut numbers = Vec::new();
            polygons.visit(bounds.cells(&square), far, |polygon| numbers.push(polygon.number));
            numbers
        };
        assert_eq!([2.5, 9.0, 1.0].map(visited), [vec![1, 2], vec![1, 2, 0], vec![]]);
        // Rounding never raises the distance.
        assert!([1e-3, 1.0, 33.3, 5e6].iter().all(|d| f64::from(before(*d)) < *d) && before(-1.0) == 0.0);
    }

    #[test]
    fn all_tiles_are_different() {
        let tiles = Tiles::new(1.28);
        let across = tiles.across as u32;
        let mut seen = std::collections::HashSet::new();
        for axis in 0..3 {
            for sign in [-1.0, 1.0] {
                for number in 0..across * across {
                    let at = |n: u32| (2.0 * f64::from(n) + 1.0) / tiles.across - 1.0;
                    let mut middle = DVec3::ZERO;
                    middle[axis] = sign;
                    middle[(axis + 1) % 3] = at(number / across);
                    middle[(axis + 2) % 3] = at(number % across);
                    let (number, square) = tiles.of(middle);
                    assert!(square.sides(middle).iter().all(|s| *s >= 0.0));
                    assert!(seen.insert(number));
                }
            }
        }
    }
}
