//! Samples the area of a convex patch on a grid in the image.

use super::patch_columns::{ColumnRays, PatchColumns};
use super::patch_cone::{Cells, PatchCone, PatchOutline};
use super::{MAX_PATCH_SAMPLES, Part, Piece, STEP, Sample, Sampler};
use crate::columns;
use glam::{DVec2, DVec3};
use presight_model::sensor::Geometry;

/// Maximum number of cells of the grid around a patch with few samples.
const MAX_PATCH_CELLS: usize = 1 << 16;

impl Sampler<'_> {
    /// Samples the area of a convex patch (corners in the image frame). Each sample has the interval 0..=1 and the area
    /// of its cell as weight. Without samples, one piece gives the reason. Columns may lie beyond the seam.
    pub fn patch(&self, corners: &[DVec3], visit: &mut impl FnMut(Piece)) {
        // Scale the limit with the density; otherwise finer steps would not change large patches.
        let times = (STEP / self.step).powi(2).clamp(1.0, 64.0);
        self.patch_in_cells(corners, (MAX_PATCH_SAMPLES as f64 * times) as usize, visit);
    }

    /// Samples a patch that covers few pixels, however long and thin it is.
    pub(crate) fn small_patch(&self, corners: &[DVec3], visit: &mut impl FnMut(Piece)) {
        self.patch_in_cells(corners, MAX_PATCH_CELLS, visit);
    }

    fn patch_in_cells(&self, corners: &[DVec3], most: usize, visit: &mut impl FnMut(Piece)) {
        let Some(cone) = PatchCone::new(corners) else {
            // Practically edge-on.
            return visit(self.edge_on(corners));
        };
        let mut any = false;
        if let Some(cells) = self.cells(corners, &cone, most) {
            self.visit_cells(&cone, &cells, &mut |at, pixel| {
                any = true;
                visit(Piece::Inside(Sample { t: [0.0, 1.0], at, pixel, ends: [pixel, pixel], weight: cells.weight }));
            });
        }
        if !any {
            visit(self.edge_on(corners));
        }
    }

    /// The grid over a patch; `None` if the patch is not in the image.
    fn cells(&self, corners: &[DVec3], cone: &PatchCone, most: usize) -> Option<Cells> {
        Some(self.cells_in(self.patch_bounds(corners, cone)?, most))
    }

    fn cells_in(&self, [low, high]: [DVec2; 2], most: usize) -> Cells {
        let flat = self.cone.is_some_and(|[l, h]| l == h);
        let size = high - low;
        let area = if flat { size.x * self.step } else { size.x * size.y };
        let step = (area / most as f64).sqrt().max(self.step);
        let columns = (size.x / step).ceil().max(1.0);
        let rows = if flat { 1.0 } else { (size.y / step).ceil().max(1.0) };
        let cell = DVec2::new(size.x / columns, size.y / rows);
        let at = |low: f64, cell: f64, count: f64| -> Vec<f64> {
            (0..count as u32).map(|i| low + cell * (f64::from(i) + 0.5)).collect()
        };
        let (columns, rows) = (at(low.x, cell.x, columns), at(low.y, cell.y, rows));
        let rows = if flat { vec![0.0] } else { rows };
        Cells { columns, rows, cell, weight: if flat { cell.x } else { cell.x * cell.y } }
    }

    /// The outline of a patch in the image; `None` if the sensor is in its plane.
    pub(crate) fn patch_outline(&self, corners: &[DVec3]) -> Option<PatchOutline> {
        let cone = PatchCone::new(corners)?;
        let bounds = self.patch_bounds(corners, &cone);
        Some(PatchOutline { cone, bounds })
    }

    /// Returns true if a patch surely covers at most `most` pixels.
    pub(crate) fn covers_at_most(&self, outline: &PatchOutline, most: usize) -> bool {
        // Other images may show the patch twice.
        let is_once = self.pinhole.is_some() || self.is_all_around();
        let pixels = |size: f64| (size + 1e-6).floor() + 1.0;
        let [low, high] = outline.bounds.unwrap_or_default();
        is_once && pixels(high.x - low.x) * pixels(high.y - low.y) <= most as f64
    }

    /// Returns true for a scanner of several rows without gaps whose image is exactly one turn.
    fn is_all_around(&self) -> bool {
        self.turn.is_some() && self.cone.is_none() && self.beams.is_none()
    }

    /// The samples of [`Sampler::small_patch`] by column; `None` without samples, or if columns do not see straight
    /// lines.
    pub(crate) fn patch_columns(&self, outline: PatchOutline) -> Option<PatchColumns> {
        if self.cone.is_some() || self.beams.is_some() {
            return None;
        }
        let PatchOutline { cone, bounds } = outline;
        let cells = self.cells_in(bounds?, MAX_PATCH_CELLS);
        let (parts, axis, times) = self.sensor.rays_by_column(&cells.columns, &cells.rows)?;
        PatchColumns::new(cone, cells, ColumnRays { parts, axis, times })
    }

    /// Visits the centres of the grid cells in which a patch is seen, row by row: their positions and pixels.
    fn visit_cells(&self, cone: &PatchCone, Cells { columns, rows, .. }: &Cells, visit: &mut impl FnMut(DVec3, DVec2)) {
        let mut meet = |ray: Option<DVec3>, pixel: DVec2| {
            let at = ray.and_then(|ray| cone.meet(ray));
            if let Some(at) = at.filter(|at| self.holds(*at, pixel)) {
                visit(at, pixel);
            }
        };
        let Some((parts, axis, times)) = self.sensor.rays_by_column(columns, rows) else {
            for v in rows {
                columns.iter().for_each(|u| meet(self.sensor.ray_at(*u, *v), DVec2::new(*u, *v)));
            }
            return;
        };
        // A column sees the patch between two rows only. This skips most cells of a long and thin patch.
        let between: Vec<[f64; 2]> = parts.iter().map(|part| cone.between(*part, axis)).collect();
        for (v, times) in rows.iter().zip(times) {
            for ((u, part), [from, to]) in columns.iter().zip(&parts).zip(&between) {
                if times >= *from && times <= *to {
                    meet(Some(*part + times * axis), DVec2::new(*u, *v));
                }
            }
        }
    }

    /// The sample of a patch too small or too flat for a grid: its middle, if that is in the image.
    fn edge_on(&self, corners: &[DVec3]) -> Piece {
        self.point(corners.iter().sum::<DVec3>() / corners.len().max(1) as f64)
    }

    /// Places along the border of the image, and its middle, with their rays; places without a ray are left out.
    fn border(&self) -> &[(DVec2, DVec3)] {
        self.border.get_or_init(|| {
            let (least, greatest) = (DVec2::splat(-0.5), self.size - 0.5);
            let mut border = vec![0.5 * (least + greatest)];
            for i in 0..=16 {
                let s = f64::from(i) / 16.0;
                let (x, y) = (least.x + s * self.size.x, least.y + s * self.size.y);
                border.extend([(x, least.y), (x, greatest.y), (least.x, y), (greatest.x, y)].map(DVec2::from));
                if self.cone.is_some() {
                    border.push(DVec2::new(x, 0.0));
                }
            }
            border.into_iter().filter_map(|p| Some((p, self.sensor.ray_at(p.x, p.y)?))).collect()
        })
    }

    /// A box around a patch's image, clipped to the image; over a seam its columns continue beyond the width.
    pub(crate) fn patch_bounds(&self, corners: &[DVec3], cone: &PatchCone) -> Option<[DVec2; 2]> {
        let (least, greatest) = (DVec2::splat(-0.5), self.size - 0.5);
        if self.is_all_around()
            && let Some(columns) = columns::of_corners(self.sensor, corners)
            && let Some(rows) = columns::rows_of_outline(self.sensor, corners)
        {
            // The patch does not surround the axis, so its outline contains its highest and lowest places.
            let is_seen = rows[1] >= least.y && rows[0] <= greatest.y;
            let [low, high] = [0, 1].map(|k| DVec2::new(columns[k], rows[k].clamp(least.y, greatest.y)));
            return is_seen.then(|| widened(low, high));
        }
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let mut take = |p: DVec2| {
            let p = p.clamp(least, greatest);
            (low, high) = (low.min(p), high.max(p));
        };
        for (k, a) in corners.iter().enumerate() {
            let b = corners[(k + 1) % corners.len()];
            self.parts(*a, b, &mut |part| match part {
                // The ends of a straight image bound it.
                Part::Run(run) => run.pixels.into_iter().for_each(&mut take),
                Part::One(Piece::Inside(s)) => s.ends.into_iter().chain([s.pixel]).for_each(&mut take),
                Part::One(Piece::Outside { .. }) => {}
            });
        }
        // The part of the image's border that is inside the patch is also a border of the patch's image.
        let covered = self.border().iter().filter(|(_, ray)| cone.meet(*ray).is_some());
        covered.for_each(|(p, _)| take(*p));
        if low.x > high.x {
            return None;
        }
        if self.pinhole.is_none() && self.sensor.is_camera() || matches!(self.sensor.spec().geometry, Geometry::Rays(_))
        {
            // The outlines are followed, but ray tables may have holes and folds next to them.
            (low, high) = ((low - 1.0).max(least), (high + 1.0).min(greatest));
        }
        if self.turn.is_some() {
            [low.x, high.x] = columns::of_corners(self.sensor, corners).unwrap_or([least.x, greatest.x]);
        }
        Some(widened(low, high))
    }
}

/// Widens a box to at least the width of one sample, for a row without height or an edge-on sliver.
fn widened(low: DVec2, high: DVec2) -> [DVec2; 2] {
    let (mid, half) = (0.5 * (low + high), (0.5 * (high - low)).max(DVec2::splat(1e-9)));
    [mid - half, mid + half]
}
