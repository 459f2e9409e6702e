//! Samples a small patch by column. In pinhole cameras and scanners each column sees a straight line of a patch.

use super::patch_cone::{Cells, PatchCone};
use glam::{DVec2, DVec3};
use std::ops::Range;

/// The samples of a patch by columns of a grid.
pub(crate) struct PatchColumns {
    cone: PatchCone,
    cells: Cells,
    /// A ray is a column's part plus a multiple of this axis.
    axis: DVec3,
    /// The multiples by row; they rise or fall.
    times: Vec<f64>,
    pub columns: Vec<Column>,
    /// Number of samples.
    pub count: usize,
}

/// Rays of columns and rows: the ray of a pixel has the direction `parts[column] + times[row] * axis`.
pub(super) struct ColumnRays {
    pub parts: Vec<DVec3>,
    pub axis: DVec3,
    pub times: Vec<f64>,
}

/// Samples of one column.
pub(crate) struct Column {
    /// Column, pixels.
    u: f64,
    part: DVec3,
    /// Never empty.
    pub rows: Range<usize>,
    /// Index of the first sample.
    pub first: usize,
}

impl PatchColumns {
    /// `None` if there are no samples.
    pub(super) fn new(cone: PatchCone, cells: Cells, rays: ColumnRays) -> Option<Self> {
        let ColumnRays { parts, axis, times } = rays;
        let mut all = Self { cone, cells, axis, times, columns: Vec::with_capacity(parts.len()), count: 0 };
        for (u, part) in all.cells.columns.iter().zip(parts) {
            let between = all.cone.between(part, axis);
            let Range { mut start, mut end } = all.rows_between(0..all.times.len(), between);
            // The range may be too wide by rounding.
            let is_met = |row: usize| all.cone.meet(part + all.times[row] * axis).is_some();
            while start < end && !is_met(start) {
                start += 1;
            }
            while start < end && !is_met(end - 1) {
                end -= 1;
            }
            if start < end {
                all.columns.push(Column { u: *u, part, rows: start..end, first: all.count });
                all.count += end - start;
            }
        }
        (all.count > 0).then_some(all)
    }

    fn rises(&self) -> bool {
        self.times.first() <= self.times.last()
    }

    /// The rows of `some` whose multiples lie between `low` and `high`.
    fn rows_between(&self, some: Range<usize>, [low, high]: [f64; 2]) -> Range<usize> {
        let (times, start) = (&self.times[some.clone()], some.start);
        let (first, end) = if self.rises() {
            (times.partition_point(|t| *t < low), times.partition_point(|t| *t <= high))
        } else {
            (times.partition_point(|t| *t > high), times.partition_point(|t| *t >= low))
        };
        start + first..start + end.max(first)
    }

    /// The rows of `some` between two shares of the turn from the first row's ray to the last one's.
    pub fn rows_at(&self, some: Range<usize>, [from, to]: [f64; 2]) -> Range<usize> {
        let [first, last] = [self.times[some.start], self.times[some.end - 1]];
        let bounds = [from, to].map(|share| first + share * (last - first));
        // Rounding must not drop the end rows.
        let mut rows = self.rows_between(some.clone(), [bounds[0].min(bounds[1]), bounds[0].max(bounds[1])]);
        if from <= 0.0 {
            rows.start = some.start;
        }
        if to >= 1.0 {
            rows.end = some.end;
        }
        rows
    }

    /// The ray of a sample, of any length.
    #[inline]
    pub fn ray(&self, column: &Column, row: usize) -> DVec3 {
        column.part + self.times[row] * self.axis
    }

    /// The position of a sample, image frame.
    #[inline]
    pub fn at(&self, column: &Column, row: usize) -> DVec3 {
        self.cone.place(self.ray(column, row))
    }

    pub fn pixel(&self, column: &Column, row: usize) -> DVec2 {
        DVec2::new(column.u, self.cells.rows[row])
    }

    pub fn cell(&self) -> DVec2 {
        self.cells.cell
    }

    /// Distance of the patch's plane, metres.
    pub fn distance(&self) -> f64 {
        self.cone.distance()
    }

    /// Two rows of a column. The nearest of the given samples is in one of them.
    pub fn nearest_of(&self, column: &Column, rows: Range<usize>) -> [usize; 2] {
        let last = rows.end - 1;
        let [a, b] = [rows.start, last].map(|row| self.at(column, row));
        let along = b - a;
        let share = -a.dot(along) / along.length_squared();
        if !(share > 0.0 && share < 1.0) {
            return [if share >= 1.0 { last } else { rows.start }; 2];
        }
        // A column's part is perpendicular to the axis.
        let foot = a + share * along;
        let times = foot.dot(self.axis) * column.part.length_squared() / foot.dot(column.part);
        let after = self.rows_between(rows.clone(), [times, times]).start;
        [after.saturating_sub(1), after].map(|row| row.clamp(rows.start, last))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall 2 m in front of a camera, 3 m wide, with multiples that rise or fall by row.
    fn wall(rises: bool) -> PatchColumns {
        let corners = [[-1.0, -1.0], [2.0, -1.0], [2.0, 1.0], [-1.0, 1.0]].map(|[x, y]| DVec3::new(x, y, 2.0));
        let rows: Vec<f64> = (0..41).map(f64::from).collect();
        let times = rows.iter().map(|row| if rises { 0.05 * row - 1.0 } else { 1.0 - 0.05 * row }).collect();
        let columns: Vec<f64> = (0..9).map(f64::from).collect();
        let parts = columns.iter().map(|u| DVec3::new(0.25 * u - 1.0, 0.0, 1.0)).collect();
        let cells = Cells { columns, rows, cell: DVec2::ONE, weight: 1.0 };
        let cone = PatchCone::new(&corners).unwrap();
        PatchColumns::new(cone, cells, ColumnRays { parts, axis: DVec3::Y, times }).unwrap()
    }

    #[test]
    fn columns_hold_what_the_patch_covers() {
        for wall in [wall(true), wall(false)] {
            // x / z from -0.5 to 1 in steps of 0.25, y / z from -0.5 to 0.5 in steps of 0.05.
            assert_eq!((wall.columns.len(), wall.count), (7, 7 * 21));
            for column in &wall.columns {
                assert_eq!(column.rows, 10..31);
                assert_eq!(wall.rows_at(10..31, [0.0, 1.0]), 10..31);
                // The middle is ten rows away; a range between two rows is empty.
                assert_eq!(wall.rows_at(10..31, [0.0, 0.51]), 10..21);
                assert_eq!(wall.rows_at(10..31, [0.49, 1.0]), 20..31);
                assert!(wall.rows_at(10..31, [0.51, 0.54]).is_empty());
                // The nearest sample is in the middle, or at the near end of a part of the column.
                assert!(wall.nearest_of(column, 10..31).contains(&20));
                assert!(wall.nearest_of(column, 24..31).contains(&24) && wall.nearest_of(column, 10..13).contains(&12));
                assert!((wall.at(column, 15).z - 2.0).abs() < 1e-12);
            }
        }
    }
}
