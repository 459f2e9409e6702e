//! Bounds of polygons in ray tables: the tiles with rays that each polygon may cover.

use super::footprint::{Extent, Footprint, LANES, Lanes, NOTHING, SLACK};
use glam::DVec3;
use presight_model::limits;
use presight_model::sensor::{ConeTree, DirectionMap, ForwardView, RayGrid, TILE_SIDE, TileLookup};
use pulp::Simd;
use std::ops::Range;

/// The footprints of [`LANES`] polygons, in whole tiles.
#[inline(always)]
pub(super) fn cover<S: Simd>(
    simd: S,
    grid: &RayGrid,
    range_max_squared: f64,
    corners: &[[Lanes; 3]],
) -> [Footprint; LANES] {
    match grid.view() {
        TileLookup::Ahead(view) => ahead(simd, grid, view, range_max_squared, corners),
        TileLookup::Around(tree) => around(simd, grid, tree, range_max_squared, corners),
    }
}

fn everything(grid: &RayGrid) -> Footprint {
    Footprint { lines: [0..grid.height(), 0..0], samples: 0..grid.width(), nearest: 0.0 }
}

/// The footprint from ranges of rows and columns of tiles.
#[inline(always)]
fn of_tiles(
    grid: &RayGrid,
    [first_row, end_row]: [u32; 2],
    [first_column, end_column]: [u32; 2],
    nearest: f64,
) -> Footprint {
    if first_row >= end_row || first_column >= end_column {
        return NOTHING;
    }
    Footprint {
        lines: [first_row * TILE_SIDE..(end_row * TILE_SIDE).min(grid.height()), 0..0],
        samples: first_column * TILE_SIDE..(end_column * TILE_SIDE).min(grid.width()),
        nearest,
    }
}

#[inline(always)]
fn ahead<S: Simd>(
    simd: S,
    grid: &RayGrid,
    view: &ForwardView,
    range_max_squared: f64,
    corners: &[[Lanes; 3]],
) -> [Footprint; LANES] {
    let sides = [view.rows.least, view.rows.greatest, view.columns.least, view.columns.greatest];
    let widened = |t: f64, by: f64| t + by * SLACK * (1.0 + t.abs());
    let sides = [widened(sides[0], -1.0), widened(sides[1], 1.0), widened(sides[2], -1.0), widened(sides[3], 1.0)];
    let mut e = Extent::new();
    for corner in corners {
        match &view.turn {
            None => e.hold_ahead([&corner[1], &corner[2], &corner[0]], sides),
            Some([right, down, forward]) => {
                let along = |axis: &DVec3| {
                    let mut lanes = [0.0; LANES];
                    for l in 0..LANES {
                        lanes[l] = axis.x * corner[0][l] + axis.y * corner[1][l] + axis.z * corner[2][l];
                    }
                    lanes
                };
                e.hold_ahead([&along(down), &along(forward), &along(right)], sides);
            }
        }
    }
    for axis in 0..2 {
        for l in 0..LANES {
            e.low[axis][l] -= SLACK * (1.0 + e.low[axis][l].abs());
            e.high[axis][l] += SLACK * (1.0 + e.high[axis][l].abs());
        }
    }
    let rows = view.rows.tiles_around(simd, &e.low[0], &e.high[0]);
    let columns = view.columns.tiles_around(simd, &e.low[1], &e.high[1]);
    let mut footprints = [const { NOTHING }; LANES];
    let mut caps = None;
    for l in 0..LANES {
        if e.is_beside(l, range_max_squared) {
            continue;
        }
        if !(e.least[1][l] > 0.0) {
            footprints[l] = everything(grid);
            continue;
        }
        let found = of_tiles(grid, [rows[0][l], rows[1][l]], [columns[0][l], columns[1][l]], e.least[1][l]);
        if !found.samples.is_empty() {
            let caps = caps.get_or_insert_with(|| Caps::around(corners));
            let (axis, cosine) = (caps.axis(l), caps.cosine[l]);
            let found = mapped(grid.direction_map(), axis, cosine, found.nearest).unwrap_or(found);
            footprints[l] = narrowed(simd, grid, found, axis, cosine);
        }
    }
    footprints
}

/// The cones around the corners of [`LANES`] polygons. A cone of less than a right angle is convex and contains the
/// polygon.
struct Caps {
    axis: [Lanes; 3],
    /// Cosine of the half angle; NaN if a corner is at the sensor.
    cosine: Lanes,
}

impl Caps {
    #[inline(always)]
    fn around(corners: &[[Lanes; 3]]) -> Self {
        let mut per_length = [[0.0; LANES]; limits::MAX_CORNERS];
        let mut axis = [[0.0; LANES]; 3];
        for (corner, per_length) in corners.iter().zip(&mut per_length) {
            for l in 0..LANES {
                let [x, y, z] = [corner[0][l], corner[1][l], corner[2][l]];
                per_length[l] = 1.0 / (x * x + y * y + z * z).sqrt();
            }
            for a in 0..3 {
                for l in 0..LANES {
                    axis[a][l] += corner[a][l] * per_length[l];
                }
            }
        }
        let mut per_axis = [0.0; LANES];
        for l in 0..LANES {
            let [x, y, z] = [axis[0][l], axis[1][l], axis[2][l]];
            per_axis[l] = 1.0 / (x * x + y * y + z * z).sqrt();
        }
        for a in 0..3 {
            for l in 0..LANES {
                axis[a][l] *= per_axis[l];
            }
        }
        let mut cosine = [1.0; LANES];
        for (corner, per_length) in corners.iter().zip(&per_length) {
            for l in 0..LANES {
                let dot = axis[0][l] * corner[0][l] + axis[1][l] * corner[1][l] + axis[2][l] * corner[2][l];
                let own = dot * per_length[l];
                // Keeps NaN.
                cosine[l] = if own >= cosine[l] { cosine[l] } else { own };
            }
        }
        Self { axis, cosine }
    }

    #[inline(always)]
    fn axis(&self, l: usize) -> DVec3 {
        DVec3::new(self.axis[0][l], self.axis[1][l], self.axis[2][l])
    }
}

/// The footprint of a polygon if its cone is narrow enough for the map.
#[inline(always)]
fn mapped(map: Option<&DirectionMap>, axis: DVec3, cosine: f64, nearest: f64) -> Option<Footprint> {
    let found = map?.pixels_in(axis, cosine)?;
    let lines = u32::from(found.first_row)..u32::from(found.end_row);
    let samples = u32::from(found.first_column)..u32::from(found.end_column);
    Some(if lines.is_empty() { NOTHING } else { Footprint { lines: [lines, 0..0], samples, nearest } })
}

/// Maximum number of tiles of a footprint whose rays are tested one by one.
const FEW: usize = 4;

/// Narrows a footprint of few tiles to the lines on which a cone has a ray: most small polygons lie between rays.
/// Returns larger footprints unchanged.
#[inline(always)]
fn narrowed<S: Simd>(simd: S, grid: &RayGrid, footprint: Footprint, axis: DVec3, cosine: f64) -> Footprint {
    let tiles = |range: &Range<u32>| range.start / TILE_SIDE..range.end.div_ceil(TILE_SIDE);
    let lines = footprint.lines[0].clone();
    let (rows, columns) = (tiles(&lines), tiles(&footprint.samples));
    let few = rows.len() * columns.len() <= FEW;
    // Also returns for NaN.
    if !(few && cosine > WIDEST) {
        return footprint;
    }
    let least = simd.splat_f64s(cosine - ROUNDING);
    let (ax, ay, az) = (simd.splat_f64s(axis.x), simd.splat_f64s(axis.y), simd.splat_f64s(axis.z));
    // A bit for each line.
    let (mut held, none) = (simd.splat_u64s(0), simd.splat_u64s(0));
    for (row, column) in rows.clone().flat_map(|row| columns.clone().map(move |column| (row, column))) {
        let rays = grid.rays_of(row as usize * grid.tiles_across() + column as usize);
        let first = row * TILE_SIDE;
        for line in lines.start.max(first)..lines.end.min(first + TILE_SIDE) {
            let bit = simd.splat_u64s(1 << (line - lines.start));
            let within = (line - first) as usize;
            let (x, y) = (S::as_simd_f64s(&rays.x[within]).0, S::as_simd_f64s(&rays.y[within]).0);
            let z = S::as_simd_f64s(&rays.z[within]).0;
            for i in 0..LANES / S::F64_LANES {
                let xy = simd.add_f64s(simd.mul_f64s(ax, x[i]), simd.mul_f64s(ay, y[i]));
                let inside = simd.greater_than_or_equal_f64s(simd.add_f64s(xy, simd.mul_f64s(az, z[i])), least);
                held = simd.or_u64s(held, simd.select_u64s(inside, bit, none));
            }
        }
    }
    let mut lanes = [0; LANES];
    S::as_mut_simd_u64s(&mut lanes).0[0] = held;
    let bits = lanes.iter().fold(0, |bits, lane| bits | lane);
    if bits == 0 {
        return NOTHING;
    }
    let held = lines.start + bits.trailing_zeros()..lines.start + u64::BITS - bits.leading_zeros();
    Footprint { lines: [held, 0..0], ..footprint }
}

/// Cosine of the widest cone that bounds a footprint.
const WIDEST: f64 = 1e-2;

/// More than the rounding of cosines and of products of unit vectors.
const ROUNDING: f64 = 1e-14;

/// Footprints by the cone around each polygon's corners.
#[inline(always)]
fn around<S: Simd>(
    simd: S,
    grid: &RayGrid,
    tree: &ConeTree,
    range_max_squared: f64,
    corners: &[[Lanes; 3]],
) -> [Footprint; LANES] {
    let mut e = Extent::new();
    corners.iter().for_each(|corner| e.hold(corner));
    let caps = Caps::around(corners);
    let (distance_squared, _) = e.box_distances_squared();
    let mut footprints = [const { NOTHING }; LANES];
    for l in 0..LANES {
        if distance_squared[l] > range_max_squared {
            continue;
        }
        let (axis, cosine) = (caps.axis(l), caps.cosine[l]);
        if !(cosine > WIDEST) {
            footprints[l] = everything(grid);
            continue;
        }
        let nearest = distance_squared[l].sqrt();
        let found = if let Some(found) = mapped(grid.direction_map(), axis, cosine, nearest) {
            found
        } else {
            let [rows, columns] = tree.tiles_met(simd, axis, cosine);
            of_tiles(grid, [rows.start, rows.end], [columns.start, columns.end], nearest)
        };
        if !found.samples.is_empty() {
            footprints[l] = narrowed(simd, grid, found, axis, cosine);
        }
    }
    footprints
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::sensor::{Camera, Distortion, Geometry, PixelGrid, RayTable, Sensor, SensorSpec};
    use proptest::prelude::*;

    struct RayCover<'a>(&'a RayGrid, &'a [DVec3]);

    impl pulp::WithSimd for RayCover<'_> {
        type Output = Footprint;

        fn with_simd<S: Simd>(self, simd: S) -> Footprint {
            let corners: Vec<[Lanes; 3]> = self.1.iter().map(|p| p.to_array().map(|v| [v; LANES])).collect();
            let [footprint, ..] = cover(simd, self.0, f64::INFINITY, &corners);
            footprint
        }
    }

    fn footprint(sensor: &Sensor, corners: &[DVec3]) -> Footprint {
        let PixelGrid::Rays(grid) = sensor.grid() else { unreachable!() };
        pulp::Arch::new().dispatch(RayCover(grid, corners))
    }

    fn sensor(geometry: Geometry) -> Sensor {
        Sensor::new(SensorSpec::new("s", "laser", geometry)).unwrap()
    }

    fn lens(f: f64, distortion: Distortion) -> Sensor {
        sensor(Geometry::Camera(Camera { distortion, ..Camera::pinhole(101, 75, f, 1.1 * f, 47.3, 39.1) }))
    }

    /// 101 x 75 rays, given by right, down and forward in their own frame.
    fn table(frame: [DVec3; 3], wide: f64, holes: u32) -> Sensor {
        let ray = |i: u32| {
            let (x, y) = (wide * (f64::from(i % 101) / 50.0 - 1.0), wide * (f64::from(i / 101) / 50.0 - 0.75));
            let ahead = x.cos() * y.cos();
            if i % 100 < holes { DVec3::NAN } else { frame[0] * x.sin() + frame[1] * y.sin() + frame[2] * ahead }
        };
        let rays: Vec<DVec3> = (0..101 * 75).map(ray).collect();
        sensor(Geometry::Rays(RayTable::new(101, 75, rays).unwrap()))
    }

    fn sensors() -> impl Strategy<Value = Sensor> {
        let frame = (direction(), direction()).prop_map(|(a, b)| {
            let right = (b - a * a.dot(b)).try_normalize().unwrap_or_else(|| a.any_orthonormal_vector());
            [right, a.cross(right), a]
        });
        prop_oneof![
            (40.0..300.0f64, -0.3..0.1f64)
                .prop_map(|(f, k)| lens(f, Distortion::PlumbBob([k, 0.02, 1e-3, -2e-3, 0.0]))),
            (18.0..200.0f64).prop_map(|f| lens(f, Distortion::Equidistant([0.01, 0.0, 0.0, 0.0]))),
            (frame, prop_oneof![0.0..0.1f64, 0.1..3.2f64], 0..100u32)
                .prop_map(|(frame, w, holes)| table(frame, w, holes)),
        ]
    }

    fn direction() -> impl Strategy<Value = DVec3> {
        let some = proptest::array::uniform3(-1.0..1.0f64).prop_map(DVec3::from);
        some.prop_filter("no direction", |v| v.length() > 0.1).prop_map(DVec3::normalize)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(600))]

        #[test]
        fn every_ray_through_a_triangle_is_in_its_footprint(
            sensor in sensors(),
            (column, row) in (0..101u32, 0..75u32),
            size in prop_oneof![1e-4..1e-1f64, 0.1..3.0f64],
            distance in prop_oneof![Just(1.0), 1e-3..1e3f64],
            offsets in proptest::array::uniform3(direction()),
        ) {
            let Some(ahead) = sensor.ray(column, row) else { return Ok(()) };
            let corners = offsets.map(|o| (ahead + o * size) * distance);
            let [a, b, c] = corners;
            let side = (b - a).cross(c - a).dot(a);
            prop_assume!(side.abs() > 1e-9 * distance.powi(3) * size * size);
            let edges = [[a, b], [b, c], [c, a]].map(|[p, q]| p.cross(q - p) * side.signum());
            let found = footprint(&sensor, &corners);
            for (r, c) in (0..75).flat_map(|r| (0..101).map(move |c| (r, c))) {
                let Some(ray) = sensor.ray(c, r) else { continue };
                if edges.iter().all(|e| e.dot(ray) >= 0.0) {
                    let held = found.lines[0].contains(&r) && found.samples.contains(&c);
                    prop_assert!(held, "{},{} in {:?}", c, r, found);
                }
            }
        }
    }

    /// Footprints of the whole image would pass the test above.
    #[test]
    fn footprints_are_tight() {
        let plumb_bob = lens(100.0, Distortion::PlumbBob([-0.2, 0.02, 0.0, 0.0, 0.0]));
        let wide = lens(22.0, Distortion::Equidistant([0.0; 4]));
        let turned = table([DVec3::Z, DVec3::Y, DVec3::NEG_X], 0.5, 3);
        for sensor in [plumb_bob, wide, turned] {
            for (column, row) in [(20, 20), (52, 36), (90, 60)] {
                let at = sensor.ray(column, row).unwrap();
                let (x, y) = at.any_orthonormal_pair();
                let found = footprint(&sensor, &[at + x * 1e-3, at + y * 1e-3, at - x * 1e-3]);
                let (lines, samples) = (found.lines[0].clone(), found.samples);
                assert!(lines.contains(&row) && samples.contains(&column), "{column},{row}: {lines:?} {samples:?}");
                assert!(lines.len() <= 24 && samples.len() <= 24, "{column},{row}: {lines:?} {samples:?}");
            }
        }
        let ahead = lens(100.0, Distortion::PlumbBob([-0.2, 0.02, 0.0, 0.0, 0.0]));
        let behind = footprint(&ahead, &[DVec3::NEG_Z, DVec3::new(1.0, 0.0, -1.0), DVec3::new(0.0, 1.0, -1.0)]);
        assert!(behind.lines[0].is_empty());
    }
}
