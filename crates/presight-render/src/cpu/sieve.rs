//! The first test of the polygons of a cluster. Each vertex is located among lines and samples once, and polygons whose
//! corners all lie between the same two lines, or samples, are rejected. That rejects most small polygons at a fraction
//! of the cost of bounding each.

use super::bounds::{AZIMUTH_SLACK, atan2_approximately};
use super::footprint::{LANES, Lanes, Reach, SLACK};
use super::instance::RayInstance;
use super::lanes::CLEAR;
use crate::plan::Run;
use glam::DVec3;
use presight_model::environment::{MAX_VERTICES, Positions};
use presight_model::sensor::{FitCell, Geometry, LineGrid, PixelGrid, RayGrid, Sensor, on_side};
use pulp::Simd;
use std::f64::consts::TAU;

/// The reach of a polygon that may be anywhere.
const ANYWHERE: f32 = -1e6;

/// Runs of up to this number of polygons are bounded one by one, because a cluster has more vertices.
const FEW: u32 = 12;

/// True if lines and samples are bounded.
#[inline(always)]
pub(super) fn is_bounded(reach: &Reach) -> bool {
    (reach[0] >= 0.0) & (reach[1] >= 0.0)
}

/// Maximum tangent of the azimuth between the middle of a cluster and its vertices.
const NARROW: f64 = 0.5;

/// Tests clusters for one sensor.
pub(super) struct Sieve<'a> {
    kind: Option<Kind<'a>>,
    reaches: [Reach; MAX_VERTICES],
}

#[derive(Clone, Copy)]
enum Kind<'a> {
    Camera(&'a LineGrid),
    /// With the azimuth of column 0 and the step from column to column, radians.
    Scanner(&'a LineGrid, [f64; 2]),
    Rays(&'a RayGrid),
}

impl<'a> Sieve<'a> {
    /// Listed azimuths have no sieve: it passes all polygons.
    pub fn new(sensor: &'a Sensor) -> Self {
        let kind = match (sensor.grid(), &sensor.spec().geometry) {
            (PixelGrid::Lines(grid), Geometry::Scanner(_)) => {
                sensor.uniform_columns().map(|columns| Kind::Scanner(grid, columns.map(f64::to_radians)))
            }
            (PixelGrid::Lines(grid), _) => Some(Kind::Camera(grid)),
            (PixelGrid::Rays(grid), _) => Some(Kind::Rays(grid)),
        };
        Self { kind, reaches: [[ANYWHERE; 4]; MAX_VERTICES] }
    }

    /// Collects the polygons of a run that may cover a sample, in their order, with their reach. Polygons that rounding
    /// may draw elsewhere get an unbounded reach. Returns the positions of the cluster if it was tested.
    #[inline(always)]
    pub fn pass<'m, S: Simd>(
        &mut self,
        simd: S,
        at: &RayInstance<'m>,
        run: &Run,
        mut passes: impl FnMut(u32, Reach),
    ) -> Option<&'m [Positions]> {
        let polygons = run.first..run.first + run.count;
        let Some((far, positions)) = self.kind.and_then(|kind| self.place(simd, kind, at, run)) else {
            polygons.for_each(|polygon| passes(polygon, [ANYWHERE; 4]));
            return None;
        };
        // A margin for planes and offsets, far above their rounding.
        let clear = 2.0 * CLEAR * far;
        let by_cluster = at.mesh.cluster_vertices();
        let own = run.first as usize..(run.first + run.count) as usize;
        let parts = at.mesh.polygons()[own.clone()].iter().zip(&at.mesh.planes()[own]);
        for (polygon, (record, plane)) in polygons.zip(parts) {
            let locals = by_cluster.locals(record);
            let mut reach = self.reaches[usize::from(locals[0])];
            for &local in &locals[1..] {
                let corner = &self.reaches[usize::from(local)];
                for k in 0..4 {
                    reach[k] = if corner[k] < reach[k] { corner[k] } else { reach[k] };
                }
            }
            let off = plane.offset - plane.normal.dot(at.center);
            let is_clear = off.abs() > clear + 1e-12 * plane.offset.abs();
            let may_cover = (reach[0] + reach[2] <= 0.0) & (reach[1] + reach[3] <= 0.0);
            if may_cover | !is_clear {
                passes(polygon, if is_clear { reach } else { [ANYWHERE; 4] });
            }
        }
        Some(positions)
    }

    /// Locates the vertices of a run's cluster. Returns their maximum distance from the sensor, in the mesh frame, and
    /// the positions; `None` if the cluster has no bounds or the test would cost more than it saves.
    #[inline(always)]
    fn place<'m, S: Simd>(
        &mut self,
        simd: S,
        kind: Kind<'_>,
        at: &RayInstance<'m>,
        run: &Run,
    ) -> Option<(f64, &'m [Positions])> {
        if run.count < FEW {
            return None;
        }
        let (number, cluster) = at.mesh.cluster_of(run.first);
        if run.first + run.count > cluster.first + cluster.count {
            return None;
        }
        let positions = at.mesh.cluster_vertices().of(number);
        if positions.is_empty() {
            return None;
        }
        match kind {
            Kind::Camera(grid) => {
                for (eight, reaches) in positions.iter().zip(self.reaches.chunks_exact_mut(LANES)) {
                    ahead(grid, &placed(at, eight), reaches);
                }
            }
            Kind::Scanner(grid, columns) => {
                let middle = at.ray_from_mesh * (cluster.bounds.center() - at.center);
                let around = Around::new(at, positions, middle)?;
                let columns = Columns::new(&around, columns, grid.lines().len());
                for (eight, reaches) in positions.iter().zip(self.reaches.chunks_exact_mut(LANES)) {
                    around.place(simd, grid, columns.as_ref(), &placed(at, eight), reaches);
                }
            }
            Kind::Rays(grid) => {
                let middle = at.ray_from_mesh * (cluster.bounds.center() - at.center);
                let (side, cell) = grid.pixel_fit().around(middle)?;
                let widest = at.mesh.cluster_vertices().widest(number) * at.stretch;
                let fit = Fit::new(grid, side, cell, at, positions, widest)?;
                for (eight, reaches) in positions.iter().zip(self.reaches.chunks_exact_mut(LANES)) {
                    fit.place(&placed(at, eight), reaches);
                }
            }
        }
        let bounds = &cluster.bounds;
        Some(((bounds.min - at.center).abs().max((bounds.max - at.center).abs()).length(), positions))
    }
}

/// Eight vertices in the frame of the rays.
#[inline(always)]
fn placed(at: &RayInstance<'_>, eight: &Positions) -> [Lanes; 3] {
    let (m, center) = (&at.ray_from_mesh, at.center);
    let mut placed = [[0.0; LANES]; 3];
    for l in 0..LANES {
        let (x, y, z) =
            (f64::from(eight[0][l]) - center.x, f64::from(eight[1][l]) - center.y, f64::from(eight[2][l]) - center.z);
        placed[0][l] = m.x_axis.x * x + m.y_axis.x * y + m.z_axis.x * z;
        placed[1][l] = m.x_axis.y * x + m.y_axis.y * y + m.z_axis.y * z;
        placed[2][l] = m.x_axis.z * x + m.y_axis.z * y + m.z_axis.z * z;
    }
    placed
}

/// The first whole number from `low` on, and the last one up to `high`, negated; in 0..n or just outside.
#[inline(always)]
fn between(low: f64, high: f64, n: f64) -> [f32; 2] {
    let first = low.ceil();
    let first = if first < n { first } else { n };
    let first = if first > 0.0 { first } else { 0.0 };
    let last = high.floor();
    let last = if last < n - 1.0 { last } else { n - 1.0 };
    let last = if last > -1.0 { last } else { -1.0 };
    [first as f32, -last as f32]
}

/// Locates vertices in a camera's line frame, (fy y, z, fx x).
#[inline(always)]
fn ahead(grid: &LineGrid, [y, z, x]: &[Lanes; 3], reaches: &mut [Reach]) {
    let (lines, samples) = (grid.lines(), grid.positions());
    let (first_line, first_sample, per_stride) = (lines[0][0], samples[0], 1.0 / grid.stride());
    let (line_count, sample_count) = (lines.len() as f64, samples.len() as f64);
    let mut all = [[0.0; LANES]; 4];
    for l in 0..LANES {
        let per_z = 1.0 / z[l];
        let (line, sample) = (y[l] * per_z, x[l] * per_z);
        let slack = [SLACK * (1.0 + line.abs()), SLACK * (1.0 + sample.abs())];
        let place = |t: f64, first: f64, slack: f64, n: f64| {
            between((t - slack - first) * per_stride, (t + slack - first) * per_stride, n)
        };
        let of_line = place(line, first_line, slack[0], line_count);
        let of_sample = place(sample, first_sample, slack[1], sample_count);
        let known = z[l] > 1e-12 * (x[l].abs() + y[l].abs());
        let reach = [of_line[0], of_sample[0], of_line[1], of_sample[1]];
        for k in 0..4 {
            all[k][l] = if known { reach[k] } else { ANYWHERE };
        }
    }
    store(&all, reaches);
}

#[inline(always)]
fn store(all: &[[f32; LANES]; 4], reaches: &mut [Reach]) {
    for (l, reach) in reaches.iter_mut().enumerate().take(LANES) {
        *reach = [all[0][l], all[1][l], all[2][l], all[3][l]];
    }
}

/// A cluster on one side of a plane through a scanner's axis.
struct Around {
    /// Direction from the axis to its middle, of any length.
    towards: [f64; 2],
    /// Maximum tangent of the azimuth between this direction and a vertex.
    widest: f64,
    /// Maximum rise of elevation between two of its vertices: on a plane through the sensor the positions t are a
    /// cosine of the azimuth.
    rise: f64,
}

impl Around {
    #[inline(always)]
    fn new(at: &RayInstance<'_>, positions: &[Positions], middle: DVec3) -> Option<Self> {
        let towards = [middle.x, middle.y];
        let (mut least, mut widest) = ([f64::INFINITY; LANES], [0.0; LANES]);
        for eight in positions {
            let [x, y, _] = placed(at, eight);
            for l in 0..LANES {
                let (along, aside) =
                    (x[l] * towards[0] + y[l] * towards[1], (y[l] * towards[0] - x[l] * towards[1]).abs());
                let tangent = aside / along;
                least[l] = if along > least[l] { least[l] } else { along };
                widest[l] = if tangent > widest[l] { tangent } else { widest[l] };
            }
        }
        let least = least.into_iter().fold(f64::INFINITY, |a, b| if b > a { a } else { b });
        let widest = widest.into_iter().fold(0.0, |a, b| if a > b { a } else { b });
        let sound = least > 0.0 && widest < NARROW;
        sound.then(|| Self { towards, widest, rise: (1.0 + widest * widest).sqrt() * (1.0 + SLACK) })
    }

    /// Locates vertices of the line frame, (x, y, -z).
    #[inline(always)]
    fn place<S: Simd>(
        &self,
        simd: S,
        grid: &LineGrid,
        columns: Option<&Columns>,
        [x, y, z]: &[Lanes; 3],
        reaches: &mut [Reach],
    ) {
        let (mut low, mut high) = ([0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            let t = z[l] / (x[l] * x[l] + y[l] * y[l]).sqrt();
            let risen = t * self.rise;
            let slack = SLACK * (1.0 + t.abs());
            low[l] = if risen < t { risen } else { t } - slack;
            high[l] = if risen > t { risen } else { t } + slack;
        }
        let [first, end] = grid.samples_around(simd, &low, &high);
        let t = grid.positions();
        let n = t.len() as u32;
        let mut all = [[ANYWHERE; LANES]; 4];
        for l in 0..LANES {
            // One line more at either side is possible.
            let first = first[l] + u32::from(first[l] < n && t[first[l].min(n - 1) as usize] < low[l]);
            let end = end[l] - u32::from(end[l] > 0 && t[end[l].max(1) as usize - 1] > high[l]);
            (all[1][l], all[3][l]) = (first as f32, 1.0 - end as f32);
        }
        if let Some(columns) = columns {
            for l in 0..LANES {
                let (along, aside) =
                    (x[l] * self.towards[0] + y[l] * self.towards[1], y[l] * self.towards[0] - x[l] * self.towards[1]);
                let column = columns.middle + atan2_approximately(aside, along) * columns.per_radian;
                [all[0][l], all[2][l]] = between(column - columns.slack, column + columns.slack, columns.count);
            }
        }
        store(&all, reaches);
    }
}

/// The columns of a cluster entirely before or behind the seam.
struct Columns {
    /// Column of the cluster's middle.
    middle: f64,
    per_radian: f64,
    slack: f64,
    count: f64,
}

impl Columns {
    #[inline(always)]
    fn new(around: &Around, [start, step]: [f64; 2], count: usize) -> Option<Self> {
        let (per_radian, turn) = (1.0 / step, TAU / step.abs());
        let middle = (around.towards[1].atan2(around.towards[0]) - start) * per_radian;
        let middle = middle - (middle / turn).floor() * turn;
        let slack = AZIMUTH_SLACK * per_radian.abs();
        let reach = around.widest * per_radian.abs() + slack + 1.0;
        let count = count as f64;
        // Columns before the first one are also behind the last one.
        let over = middle - reach < 0.0 && middle - reach + turn < count;
        let again = middle + reach > turn;
        (!over && !again).then_some(Self { middle, per_radian, slack, count })
    }
}

/// Directions around a cluster in a ray table.
struct Fit<'a> {
    cell: &'a FitCell,
    side: usize,
    /// Maximum distance between a computed position and a ray of its polygon, pixels.
    wide: [f64; 2],
    count: [f64; 2],
}

impl<'a> Fit<'a> {
    /// For polygons of this size in metres; `None` if the cell has no approximation.
    #[inline(always)]
    fn new(
        grid: &RayGrid,
        side: usize,
        cell: &'a FitCell,
        at: &RayInstance<'_>,
        positions: &[Positions],
        widest: f64,
    ) -> Option<Self> {
        let mut nearest = [f64::INFINITY; LANES];
        for eight in positions {
            let placed = placed(at, eight);
            for l in 0..LANES {
                let [along, ..] = on_side(side, [placed[0][l], placed[1][l], placed[2][l]]);
                nearest[l] = if along < nearest[l] { along } else { nearest[l] };
            }
        }
        let nearest = nearest.into_iter().fold(f64::INFINITY, |a, b| if b < a { b } else { a });
        if !(nearest > 0.0) {
            return None;
        }
        // On the side of the cube, out to 1.2 from its middle, a metre across is at most twice a metre over the
        // distance.
        let apart = 2.0 * widest / nearest * FitCell::PER_UNIT;
        let wide = match &cell.fitted {
            Some(both) => both.map(|fitted| fitted.off + 0.25 * fitted.bend * apart * apart + 1e-6),
            None if cell.is_empty => [0.0; 2],
            None => return None,
        };
        let count = [grid.width(), grid.height()].map(f64::from);
        wide.iter().all(|wide| *wide < 0.5).then_some(Self { cell, side, wide, count })
    }

    #[inline(always)]
    fn place(&self, [x, y, z]: &[Lanes; 3], reaches: &mut [Reach]) {
        let [column, row] = self.cell.fitted.unwrap_or_default();
        let mut all = [[0.0; LANES]; 4];
        for l in 0..LANES {
            let [along, u, v] = on_side(self.side, [x[l], y[l], z[l]]);
            let per_along = 1.0 / along;
            let (u, v) = (
                (u * per_along - self.cell.middle[0]) * FitCell::PER_UNIT,
                (v * per_along - self.cell.middle[1]) * FitCell::PER_UNIT,
            );
            let known = (u.abs() < 1.0) & (v.abs() < 1.0);
            let (column, row) = (column.at(u, v), row.at(u, v));
            let of_column = between(column - self.wide[0], column + self.wide[0], self.count[0]);
            let of_row = between(row - self.wide[1], row + self.wide[1], self.count[1]);
            let reach = if self.cell.is_empty { [1.0; 4] } else { [of_row[0], of_column[0], of_row[1], of_column[1]] };
            for k in 0..4 {
                all[k][l] = if known { reach[k] } else { ANYWHERE };
            }
        }
        store(&all, reaches);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::{FramePlan, ImageRequest};
    use glam::Vec3;
    use presight_model::environment::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
    use presight_model::geometry::Pose;
    use presight_model::sensor::{Angles, Camera, Distortion, RayTable, Scanner, SensorSpec};
    use presight_model::world::World;
    use proptest::prelude::*;

    struct Passed<'a>(&'a FramePlan, &'a Run);

    impl pulp::WithSimd for Passed<'_> {
        type Output = Vec<(u32, Reach)>;

        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let Self(plan, run) = self;
            let at = RayInstance::new(plan, &plan.instances[run.instance as usize]);
            let mut passed = Vec::new();
            let mut sieve = Sieve::new(&plan.sensor);
            let _ = sieve.pass(simd, &at, run, |polygon, reach| passed.push((polygon, reach)));
            passed
        }
    }

    fn sensor(kind: usize) -> Sensor {
        let camera = |f: f64, distortion| Camera { distortion, ..Camera::pinhole(61, 47, f, 1.1 * f, 28.3, 24.1) };
        let scanner = |start_deg, step_deg, count, rows: &[f64]| Scanner {
            azimuth: Angles::Uniform { start_deg, step_deg, count },
            elevation: Angles::Listed(rows.to_vec()),
            beam_height_deg: None,
        };
        let beams = (0..40u32 * 30).map(|i| {
            let (row, column) = (f64::from(i / 40), f64::from(i % 40) + 0.25 * f64::from(i / 40 % 2));
            let (azimuth, up) = (0.05 * column, 0.04 * row - 0.6);
            if i % 13 == 5 {
                DVec3::NAN
            } else {
                DVec3::new(azimuth.cos() * up.cos(), azimuth.sin() * up.cos(), up.sin())
            }
        });
        let rows: Vec<f64> = (0..30).map(|i| f64::from(i) * 2.0 - 31.0).collect();
        let geometry = match kind {
            0 => Geometry::Camera(camera(40.0, Distortion::None)),
            1 => Geometry::Scanner(scanner(-180.0, 4.0, 90, &rows)),
            2 => Geometry::Scanner(scanner(70.0, -2.5, 47, &rows)),
            3 => Geometry::Scanner(scanner(-180.0, 2.0, 180, &[0.0])),
            4 => Geometry::Scanner(scanner(-90.0, 2.0, 90, &[-7.0, 3.0])),
            5 => Geometry::Camera(camera(400.0, Distortion::PlumbBob([-0.2, 0.05, 1e-3, -1e-3, 0.0]))),
            6 => Geometry::Camera(camera(170.0, Distortion::Equidistant([-0.003, 0.0, 0.0, 0.0]))),
            7 => Geometry::Camera(camera(40.0, Distortion::PlumbBob([-0.2, 0.05, 1e-3, -1e-3, 0.0]))),
            8 => Geometry::Camera(camera(17.0, Distortion::Equidistant([-0.003, 0.0, 0.0, 0.0]))),
            _ => Geometry::Rays(RayTable::new(40, 30, beams.collect()).unwrap()),
        };
        Sensor::new(SensorSpec::new("s", "laser", geometry)).unwrap()
    }

    /// A wrinkled sheet of triangles in front of the sensor.
    fn plan(sensor: &Sensor, towards: DVec3, distance: f64, size: f64, wrinkles: &[f64]) -> FramePlan {
        let (right, up) = towards.any_orthonormal_pair();
        let lean = towards * wrinkles[0] * 0.8;
        let vertex = |i: usize| {
            let (x, y) = ((i % 6) as f64 - 2.5, (i / 6) as f64 - 2.5);
            let at = towards * distance + size * (right * x + (up + lean) * y + towards * wrinkles[i]);
            at.as_vec3()
        };
        let square = |i: u32| {
            let at = i / 5 * 6 + i % 5;
            [[at, at + 1, at + 7], [at, at + 7, at + 6]].map(|corners| Polygon::new(corners.to_vec(), 0))
        };
        let vertices: Vec<Vec3> = (0..36).map(vertex).collect();
        let mesh = Mesh::new("sheet", vertices, (0..25).flat_map(square).collect(), PolygonOrder::Given).unwrap();
        let mut environment = Environment::new();
        environment.add_material(Material::named("grey")).unwrap();
        environment.insert(NewObject::new("sheet", Pose::IDENTITY, mesh.into())).unwrap();
        FramePlan::new(&World::new(environment), sensor, &Pose::IDENTITY, ImageRequest::default()).unwrap()
    }

    /// Lines and samples with their rays.
    fn rays(sensor: &Sensor) -> Vec<([f32; 2], DVec3)> {
        let all = |lines: usize, samples: usize| (0..lines).flat_map(move |l| (0..samples).map(move |s| (l, s)));
        let rays: Vec<([f32; 2], DVec3)> = match sensor.grid() {
            PixelGrid::Lines(grid) => all(grid.lines().len(), grid.weights().len())
                .map(|(l, s)| ([l as f32, s as f32], grid.line_ray(l, s)))
                .collect(),
            PixelGrid::Rays(grid) => all(grid.height() as usize, grid.width() as usize)
                .map(|(l, s)| ([l as f32, s as f32], grid.direction(s as u32, l as u32)))
                .collect(),
        };
        rays.into_iter().filter(|(_, ray)| !ray.is_nan()).collect()
    }

    /// Numbers of rays that hit triangles with a bounded reach, of such rays on the outermost line or sample of a
    /// reach, and of triangles that the sieve rejects and passes.
    fn check(plan: &FramePlan) -> [usize; 4] {
        let all = rays(&plan.sensor);
        let mut counts = [0; 4];
        for run in &plan.runs {
            let passed = pulp::Arch::new().dispatch(Passed(plan, run));
            counts[2] += run.count as usize - passed.len();
            counts[3] += passed.len();
            let at = RayInstance::new(plan, &plan.instances[run.instance as usize]);
            for polygon in run.first..run.first + run.count {
                let corners: Vec<DVec3> =
                    at.mesh.corners_of(polygon).map(|p| at.ray_from_mesh * (p - at.center)).collect();
                let edges: Vec<DVec3> =
                    (0..3).map(|k| corners[k].cross(corners[(k + 1) % 3]).normalize_or_zero()).collect();
                let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
                let side = normal.dot(corners[0]).signum();
                let inside = |ray: DVec3| {
                    normal.dot(ray) * side > 0.0 && edges.iter().all(|e| e.dot(ray) * side > 1e-9 * ray.length())
                };
                let reach = passed.iter().find(|(p, _)| *p == polygon).map(|(_, reach)| *reach);
                for ([line, sample], _) in all.iter().filter(|(_, ray)| inside(*ray)) {
                    let reach = reach.unwrap_or_else(|| panic!("{polygon} covers {line}, {sample}"));
                    if is_bounded(&reach) {
                        counts[0] += 1;
                        let [first_line, first_sample, last_line, last_sample] =
                            [reach[0], reach[1], -reach[2], -reach[3]];
                        assert!((first_line..=last_line).contains(line), "{polygon}: {line} in {reach:?}");
                        assert!((first_sample..=last_sample).contains(sample), "{polygon}: {sample} in {reach:?}");
                        counts[1] += usize::from(
                            [first_line, last_line].contains(line) || [first_sample, last_sample].contains(sample),
                        );
                    }
                }
            }
        }
        counts
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]

        #[test]
        fn what_covers_a_ray_passes_with_it_in_reach(
            kind in 0..10usize,
            (azimuth, elevation) in (-3.2..3.2f64, -1.2..1.2f64),
            distance in 0.5..20.0f64,
            size in 0.003..0.3f64,
            wrinkles in proptest::collection::vec(-0.6..0.6f64, 36),
        ) {
            let towards = DVec3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
            check(&plan(&sensor(kind), towards, distance, size * distance, &wrinkles));
        }
    }

    /// A sieve that passes everything with unbounded reach would pass the test above, and so would reaches that are a
    /// line too wide.
    #[test]
    fn most_small_triangles_end_here_and_reaches_are_tight() {
        let wrinkles: Vec<f64> = (0..36).map(|i| 0.3 * f64::from(i * 7 % 5)).collect();
        for kind in 0..3 {
            let sensor = sensor(kind);
            let middle = rays(&sensor)[rays(&sensor).len() / 2 + 3].1;
            let image = match sensor.grid() {
                PixelGrid::Lines(grid) => grid.image_from_line() * middle,
                PixelGrid::Rays(_) => middle,
            };
            let towards = (sensor.body_from_image() * image).normalize();
            let [_, _, ended, passed] = check(&plan(&sensor, towards, 3.0, 0.006, &wrinkles));
            assert!(ended > 5 * passed, "sensor {kind}: {ended} of {} end", ended + passed);
            let [met, outermost, ..] = check(&plan(&sensor, towards, 3.0, 0.3, &wrinkles));
            assert!(met > 10 && 3 * outermost > met, "sensor {kind}: {outermost} of {met}");
        }
    }
}
