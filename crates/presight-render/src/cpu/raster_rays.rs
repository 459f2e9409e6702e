//! Draws ray tables (lens distortion, listed rays), eight tiles of 8 x 8 rays at a time: tiles that a polygon may
//! cover, found by their cones, without tiles in which all rays have nearer polygons. Within a tile it draws ray by
//! ray, by the edges that the tile's cone does not decide.

use super::Bands;
use super::batch::{Batch, NOTHING, PolygonSetup};
use super::cull::TILE;
use super::raster_lines::{Buffer, EIGHT};
use glam::DVec3;
use presight_model::limits::MAX_CORNERS;
use presight_model::sensor::{Cones, RayGrid, TileRays};
use pulp::Simd;
use std::ops::Range;

/// Removes all polygons. Lanes without a ray are never drawn, and hide no polygon.
pub(super) fn clear(buffer: &mut Buffer, grid: &RayGrid, bands: &Bands, band: usize) {
    let lines = bands.lines(band);
    buffer.clear(bands.axis, lines.len(), bands.samples);
    buffer.clear_farthest(lines.len(), bands.samples, 0.0);
    for row in lines.clone().step_by(TILE) {
        for column in 0..grid.tiles_across() {
            let tile = row / TILE * grid.tiles_across() + column;
            if !grid.has_gaps(tile) {
                continue;
            }
            let rays = grid.rays_of(tile);
            let mut some = false;
            for line in row..lines.end.min(row + TILE) {
                let at = buffer.at(line - lines.start, column);
                for (inverse, x) in buffer.inverse[at].0.iter_mut().zip(&rays.x[line - row]) {
                    *inverse = if x.is_nan() { f64::INFINITY } else { *inverse };
                    some |= !x.is_nan();
                }
            }
            if !some {
                *buffer.farthest_of((row - lines.start) / TILE, column) = f64::INFINITY;
            }
        }
    }
}

/// A polygon to be drawn.
struct Polygon<'a> {
    m: DVec3,
    /// Length of `m`.
    length: f64,
    edges: &'a [DVec3],
    /// Squared lengths of the edges.
    squares: &'a [f64],
    number: u32,
}

/// Relation of a polygon to eight tiles.
#[derive(Default)]
struct TileOverlap {
    /// Not zero if the polygon may be visible.
    shows: [u64; EIGHT],
    /// A bit for each edge that does not have all of the tile inside.
    open: [u64; EIGHT],
}

/// Draws the polygons of some batches into a band. Returns the numbers of tested samples and of tiles.
#[inline(always)]
pub(super) fn rasterize<S: Simd>(
    simd: S,
    buffer: &mut Buffer,
    grid: &RayGrid,
    batches: &[Batch],
    slots: &[u32],
    bands: &Bands,
    band: usize,
) -> [u64; 2] {
    let lines = bands.lines(band);
    let (mut octets, mut tiles) = (0, 0);
    let (mut squares, mut open) = ([0.0; MAX_CORNERS], [DVec3::ZERO; MAX_CORNERS]);
    for batch in batches {
        for &i in batch.in_band(band) {
            let set_up = &batch.polygons[i as usize];
            let first = set_up.first_edge as usize;
            let edges = &batch.edges[first..first + usize::from(set_up.steep)];
            for (square, e) in squares.iter_mut().zip(edges) {
                *square = e.length_squared();
            }
            let squares = &squares[..edges.len()];
            let number = batch.first_number + i;
            let polygon = Polygon { m: set_up.m, length: set_up.m.length(), edges, squares, number };
            let [rows, columns] = tiles_of(set_up, &lines);
            for row in rows {
                let eights = columns.start / EIGHT..columns.end.div_ceil(EIGHT);
                for (eight, cones) in eights.clone().zip(&grid.cones_of_row(row)[eights]) {
                    let farthest = buffer.farthest_of_eight(row - lines.start / TILE, eight);
                    let meeting = polygon.meet(simd, cones, farthest);
                    let held = columns.start.max(eight * EIGHT)..columns.end.min((eight + 1) * EIGHT);
                    for column in held {
                        if meeting.shows[column % EIGHT] != 0 {
                            let rays = grid.rays_of(row * grid.tiles_across() + column);
                            let held =
                                lines.start.max(set_up.first_line as usize)..lines.end.min(set_up.end_line as usize);
                            let inner = |line: usize| line.saturating_sub(row * TILE).min(TILE);
                            let drawn = inner(held.start)..inner(held.end);
                            octets += drawn.len();
                            tiles += 1;
                            let count = TILE.min(lines.end - row * TILE);
                            let place = TilePlace { first: row * TILE - lines.start, count, drawn, column };
                            let count = take(edges, meeting.open[column % EIGHT], &mut open);
                            if polygon.paint(simd, buffer, rays, &place, &open[..count]) {
                                polygon.settle_ties(buffer, rays, &place, slots);
                            }
                        }
                    }
                }
            }
        }
    }
    [octets * EIGHT, tiles].map(|count| count as u64)
}

/// Copies the edges whose bit is set, and returns their number.
#[inline(always)]
fn take(edges: &[DVec3], mut bits: u64, taken: &mut [DVec3; MAX_CORNERS]) -> usize {
    let mut count = 0;
    while bits != 0 {
        taken[count] = edges[bits.trailing_zeros() as usize];
        count += 1;
        bits &= bits - 1;
    }
    count
}

/// Ranges of rows and columns of the polygon's tiles on some lines.
#[inline(always)]
fn tiles_of(polygon: &PolygonSetup, lines: &Range<usize>) -> [Range<usize>; 2] {
    let (first, end) = (lines.start.max(polygon.first_line as usize), lines.end.min(polygon.end_line as usize));
    let columns = polygon.first_sample as usize / TILE..(polygon.end_sample as usize).div_ceil(TILE);
    [first / TILE..end.div_ceil(TILE), columns]
}

/// Position of a tile in a buffer.
struct TilePlace {
    /// Its first line, and the number of lines.
    first: usize,
    count: usize,
    /// Range of these lines that may be drawn.
    drawn: Range<usize>,
    /// Its column of tiles.
    column: usize,
}

impl Polygon<'_> {
    /// The overlap with eight tiles, in which all rays have polygons at least as near as `farthest`.
    #[inline(always)]
    fn meet<S: Simd>(&self, simd: S, cones: &Cones, farthest: &[f64; EIGHT]) -> TileOverlap {
        let mut meeting = TileOverlap::default();
        let (none, all) = (simd.splat_u64s(0), simd.splat_u64s(u64::MAX));
        for i in 0..EIGHT / S::F64_LANES {
            let of = |lanes: &[f64; EIGHT]| S::as_simd_f64s(lanes).0[i];
            let axis = [of(&cones.x), of(&cones.y), of(&cones.z)];
            let sine_squared = of(&cones.sine_squared);
            // No ray of a tile has a greater m . u than its axis by more than |m| times its chord.
            let reach = simd.mul_f64s(simd.splat_f64s(self.length), of(&cones.chord));
            let most = simd.add_f64s(dot(simd, self.m, axis), reach);
            let behind = simd.less_than_or_equal_f64s(most, of(farthest));
            let mut shows = simd.select_u64s(behind, none, all);
            let mut open = none;
            for (k, (e, square)) in self.edges.iter().zip(self.squares).enumerate() {
                let d = dot(simd, *e, axis);
                let signed = simd.mul_f64s(d, simd.abs_f64s(d));
                let least = simd.mul_f64s(simd.splat_f64s(*square), sine_squared);
                let beside = simd.less_than_f64s(signed, simd.neg_f64s(least));
                shows = simd.select_u64s(beside, none, shows);
                let inside = simd.greater_than_f64s(signed, least);
                open = simd.or_u64s(open, simd.select_u64s(inside, none, simd.splat_u64s(1 << k)));
            }
            S::as_mut_simd_u64s(&mut meeting.shows).0[i] = shows;
            S::as_mut_simd_u64s(&mut meeting.open).0[i] = open;
        }
        meeting
    }

    /// Draws the part of a tile inside some edges. Returns true if the buffer held a bit-equal depth anywhere.
    #[inline(always)]
    fn paint<S: Simd>(
        &self,
        simd: S,
        buffer: &mut Buffer,
        rays: &TileRays,
        place: &TilePlace,
        edges: &[DVec3],
    ) -> bool {
        let (number, zero) = (simd.splat_u64s(self.number.into()), simd.splat_f64s(0.0));
        let (none, all, nowhere) = (simd.splat_u64s(0), simd.splat_u64s(u64::MAX), simd.splat_f64s(-1.0));
        let (mut ties, mut written) = (none, none);
        for line in place.drawn.clone() {
            let at = buffer.at(place.first + line, place.column);
            let inverse = S::as_mut_simd_f64s(&mut buffer.inverse[at].0).0;
            let winners = S::as_mut_simd_u64s(&mut buffer.winner[at].0).0;
            let (x, y) = (S::as_simd_f64s(&rays.x[line]).0, S::as_simd_f64s(&rays.y[line]).0);
            let z = S::as_simd_f64s(&rays.z[line]).0;
            // `max`, because a select before a store would become a masked store. The winners are written in the same
            // manner.
            for i in 0..EIGHT / S::F64_LANES {
                let ray = [x[i], y[i], z[i]];
                let k = dot(simd, self.m, ray);
                // False for lanes without a ray.
                let mut inside = simd.equal_f64s(k, k);
                for e in edges {
                    inside = simd.and_m64s(inside, simd.greater_than_or_equal_f64s(dot(simd, *e, ray), zero));
                }
                let k = simd.select_f64s(inside, k, nowhere);
                let before = inverse[i];
                let nearer = simd.select_u64s(simd.greater_than_f64s(k, before), all, none);
                ties = simd.select_u64s(simd.equal_f64s(k, before), all, ties);
                written = simd.or_u64s(written, nearer);
                inverse[i] = simd.max_f64s(k, before);
                winners[i] = simd.xor_u64s(winners[i], simd.and_u64s(simd.xor_u64s(winners[i], number), nearer));
            }
        }
        let any = |lanes: S::u64s| {
            let mut all = [0; EIGHT];
            S::as_mut_simd_u64s(&mut all).0[0] = lanes;
            all.iter().fold(0, |any, lane| any | lane) != 0
        };
        if any(written) {
            measure(simd, buffer, place);
        }
        any(ties)
    }

    /// Gives samples with bit-equal inverse depths to the lower slot.
    #[cold]
    #[inline(never)]
    fn settle_ties(&self, buffer: &mut Buffer, rays: &TileRays, place: &TilePlace, slots: &[u32]) {
        let own = slots[self.number as usize];
        for line in place.drawn.clone() {
            let at = buffer.at(place.first + line, place.column);
            for i in 0..EIGHT {
                let ray = DVec3::new(rays.x[line][i], rays.y[line][i], rays.z[line][i]);
                let winner = &mut buffer.winner[at].0[i];
                let drawn = *winner != u64::from(NOTHING);
                let tied = drawn && self.m.dot(ray) == buffer.inverse[at].0[i] && own < slots[*winner as usize];
                if tied && self.edges.iter().all(|e| e.dot(ray) >= 0.0) {
                    *winner = self.number.into();
                }
            }
        }
    }
}

/// Records the farthest depth of a tile.
#[inline(always)]
fn measure<S: Simd>(simd: S, buffer: &mut Buffer, place: &TilePlace) {
    let mut farthest = simd.splat_f64s(f64::INFINITY);
    for line in 0..place.count {
        let at = buffer.at(place.first + line, place.column);
        for &inverse in S::as_simd_f64s(&buffer.inverse[at].0).0 {
            farthest = simd.min_f64s(farthest, inverse);
        }
    }
    *buffer.farthest_of(place.first / TILE, place.column) = simd.reduce_min_f64s(farthest);
}

/// Dot products with eight vectors, rounded in the same way as by glam.
#[inline(always)]
fn dot<S: Simd>(simd: S, a: DVec3, [x, y, z]: [S::f64s; 3]) -> S::f64s {
    let xy = simd.add_f64s(simd.mul_f64s(simd.splat_f64s(a.x), x), simd.mul_f64s(simd.splat_f64s(a.y), y));
    simd.add_f64s(xy, simd.mul_f64s(simd.splat_f64s(a.z), z))
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::sensor::{Geometry, PixelGrid, RayTable, Sensor, SensorSpec};
    use proptest::prelude::*;

    fn direction() -> impl Strategy<Value = DVec3> {
        let some = proptest::array::uniform3(-1.0..1.0f64).prop_map(DVec3::from);
        some.prop_filter("no direction", |v| v.length() > 0.1).prop_map(DVec3::normalize)
    }

    struct OverlapTest<'a>(&'a Polygon<'a>, &'a Cones, &'a [f64; EIGHT]);

    impl pulp::WithSimd for OverlapTest<'_> {
        type Output = TileOverlap;

        fn with_simd<S: Simd>(self, simd: S) -> TileOverlap {
            self.0.meet(simd, self.1, self.2)
        }
    }

    /// Eight tiles of rays up to `spread` off an axis, some of them missing.
    fn tiles(axis: DVec3, spread: f64, seeds: &[DVec3]) -> Sensor {
        let ray = |i: usize| {
            let aside = seeds[i % seeds.len()] * (i / seeds.len() + 1) as f64 * spread / 40.0;
            if i % 37 == 5 { DVec3::NAN } else { (axis + aside).try_normalize().unwrap_or(axis) }
        };
        let table = RayTable::new(60, 7, (0..60 * 7).map(ray).collect()).unwrap();
        Sensor::new(SensorSpec::new("tiles", "laser", Geometry::Rays(table))).unwrap()
    }

    proptest! {
        /// Coverage and occlusion, decided ray by ray: every tile and edge left out would have made no difference.
        #[test]
        fn a_tile_is_left_out_only_if_no_ray_of_it_matters(
            axis in direction(),
            spread in prop_oneof![Just(0.0), 0.0..0.1f64, 0.0..3.0f64],
            seeds in proptest::collection::vec(direction(), 11),
            edges in proptest::collection::vec((direction(), 1e-9..1e9f64), 3..7),
            m in (direction(), 1e-3..1e3f64),
            nearer in -1.0..1.0f64,
        ) {
            let sensor = tiles(axis, spread, &seeds);
            let PixelGrid::Rays(grid) = sensor.grid() else { unreachable!() };
            let edges: Vec<DVec3> = edges.iter().map(|(e, length)| *e * *length).collect();
            let squares: Vec<f64> = edges.iter().map(|e| e.length_squared()).collect();
            let m = m.0 * m.1;
            let polygon = Polygon { m, length: m.length(), edges: &edges, squares: &squares, number: 1 };
            let depth = |t: usize| m.dot(grid.tiles()[t].axis) + nearer * m.length() * spread;
            let farthest: [f64; EIGHT] = std::array::from_fn(depth);
            let meeting = pulp::Arch::new().dispatch(OverlapTest(&polygon, &grid.cones_of_row(0)[0], &farthest));
            for (row, column) in (0..7).flat_map(|r| (0..60).map(move |c| (r, c))) {
                let Some(ray) = sensor.ray(column, row) else { continue };
                let t = column as usize / TILE;
                let inside = edges.iter().all(|e| e.dot(ray) >= 0.0);
                if meeting.shows[t] == 0 {
                    prop_assert!(!inside || m.dot(ray) < farthest[t], "{} in tile {}", ray, t);
                }
                for (k, e) in edges.iter().enumerate() {
                    let sound = meeting.open[t] >> k & 1 == 1 || e.dot(ray) >= 0.0;
                    prop_assert!(sound, "{} and edge {} of tile {}", ray, k, t);
                }
            }
        }
    }

    /// A filter that keeps every tile would pass the test above.
    #[test]
    fn tiles_beside_and_behind_are_left_out() {
        let ray = |c: u32, r: u32| DVec3::new(1.0, 0.01 * f64::from(c), 0.01 * f64::from(r));
        let rays = (0..8).flat_map(|r| (0..64).map(move |c| ray(c, r))).collect();
        let table = RayTable::new(64, 8, rays).unwrap();
        let sensor = Sensor::new(SensorSpec::new("tiles", "laser", Geometry::Rays(table))).unwrap();
        let PixelGrid::Rays(grid) = sensor.grid() else { unreachable!() };
        // y / x of at least 0.2: within the third tile of 0.16 to 0.23. A plane 2 m ahead.
        let edges = [DVec3::new(-0.2, 1.0, 0.0)];
        let polygon = Polygon { m: DVec3::X * 0.5, length: 0.5, edges: &edges, squares: &[1.04], number: 1 };
        let mut farthest = [0.0; EIGHT];
        farthest[6] = 0.51;
        let meeting = pulp::Arch::new().dispatch(OverlapTest(&polygon, &grid.cones_of_row(0)[0], &farthest));
        let shows = meeting.shows.map(|s| s != 0);
        assert_eq!(shows, [false, false, true, true, true, true, false, true]);
        assert_eq!(meeting.open.map(|o| o & 1)[2..], [1, 0, 0, 0, 0, 0]);
    }
}
