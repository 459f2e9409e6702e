//! Convex polygons on a grid of square cells, row by row.

use super::cut::{half_into, heights};
use glam::{DVec2, DVec3};
use std::ops::Range;

/// Maximum distance between a cell and a surface that touches it, metres.
const TOUCH: f64 = 1e-6;

/// Square cells, row by row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridFrame {
    /// Outer corner of the first cell, metres in the world.
    pub origin: DVec2,
    /// Side of a cell, metres.
    pub cell: f64,
    /// Columns, along x.
    pub width: usize,
    /// Rows, along y.
    pub height: usize,
}

impl GridFrame {
    /// Number of cells.
    pub fn count(&self) -> usize {
        self.width * self.height
    }

    /// Corners of a cell, metres from the origin.
    pub(super) fn square(&self, column: usize, row: usize) -> [DVec2; 4] {
        let min = self.cell * DVec2::new(column as f64, row as f64);
        let max = self.cell * DVec2::new((column + 1) as f64, (row + 1) as f64);
        [min, DVec2::new(max.x, min.y), max, DVec2::new(min.x, max.y)]
    }

    /// A polygon of the world in metres from the origin; heights remain.
    pub(super) fn local(&self, corners: &[DVec3]) -> Vec<DVec3> {
        corners.iter().map(|p| *p - self.origin.extend(0.0)).collect()
    }

    /// The cells that a range of the plane touches along one axis.
    fn touched(&self, low: f64, high: f64, count: usize) -> Range<usize> {
        let at = |x: f64| (x / self.cell).floor();
        let (first, last) = (at(low - TOUCH).max(0.0), at(high + TOUCH).min(count as f64 - 1.0));
        if first <= last { first as usize..last as usize + 1 } else { 0..0 }
    }

    /// The rows that a polygon touches, metres from the origin.
    pub(super) fn rows(&self, corners: &[DVec3]) -> Range<usize> {
        let (low, high) = corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p.y), b.max(p.y)));
        self.touched(low, high, self.height)
    }

    /// Calls `visit` with each of these rows that a polygon touches, its columns there, and the part of the polygon in
    /// the row; metres from the origin.
    pub(super) fn strips(
        &self,
        corners: &[DVec3],
        rows: &Range<usize>,
        mut visit: impl FnMut(usize, Range<usize>, &[DVec3]),
    ) {
        let own = self.rows(corners);
        let is_one_row = own.len() == 1;
        let (mut above, mut part) = (Vec::new(), Vec::new());
        for row in own.start.max(rows.start)..own.end.min(rows.end) {
            let strip = if is_one_row {
                corners
            } else {
                let (low, high) = (row as f64 * self.cell - TOUCH, (row + 1) as f64 * self.cell + TOUCH);
                half_into(corners, |p| p.y - low, &mut above);
                half_into(&above, |p| high - p.y, &mut part);
                &part
            };
            let (low, high) =
                strip.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p.x), b.max(p.x)));
            let columns = self.touched(low, high, self.width);
            if !columns.is_empty() {
                visit(row, columns, strip);
            }
        }
    }

    /// Calls `visit` with each cell that a convex polygon of the world touches, and with the lowest and highest point
    /// of the polygon there, metres.
    pub fn each_touched(&self, polygon: &[DVec3], visit: impl FnMut(usize, f64, f64)) {
        self.each_cell(&self.local(polygon), &(0..self.height), visit);
    }

    /// As [`Self::each_touched`] for some rows, and a polygon in metres from the origin.
    pub(super) fn each_cell(&self, corners: &[DVec3], rows: &Range<usize>, mut visit: impl FnMut(usize, f64, f64)) {
        self.strips(corners, rows, |row, columns, strip| {
            let of_strip = heights(strip);
            let is_level = of_strip.0 == of_strip.1 || columns.len() == 1;
            for column in columns {
                let (low, high) = if is_level { of_strip } else { self.heights_in(strip, column) };
                visit(row * self.width + column, low, high);
            }
        });
    }

    /// Lowest and highest point of a strip in a column, metres.
    pub(super) fn heights_in(&self, strip: &[DVec3], column: usize) -> (f64, f64) {
        let (low, high) = (column as f64 * self.cell - TOUCH, (column + 1) as f64 * self.cell + TOUCH);
        let mut range = (f64::INFINITY, f64::NEG_INFINITY);
        let mut add = |z: f64| range = (range.0.min(z), range.1.max(z));
        // The corners of the part in the column: corners of the strip, and points where its sides leave the column.
        for (k, p) in strip.iter().enumerate() {
            let q = strip[(k + 1) % strip.len()];
            if low <= p.x && p.x <= high {
                add(p.z);
            }
            for (a, b) in [(p.x - low, q.x - low), (high - p.x, high - q.x)] {
                if a * b < 0.0 {
                    add(p.z + (q.z - p.z) * (a / (a - b)));
                }
            }
        }
        range
    }

    /// The columns of a row whose cells lie wholly inside all sides, given by outward normals and offsets, metres from
    /// the origin.
    pub(super) fn inside(&self, sides: &[(DVec2, f64)], row: usize, columns: &Range<usize>) -> Range<usize> {
        let (low, high) = (row as f64 * self.cell, (row + 1) as f64 * self.cell);
        let (mut first, mut end) = (columns.start as f64, columns.end as f64);
        for (outward, offset) in sides {
            // The corner of a cell that lies farthest out must be inside.
            let left = offset - (outward.y * low).max(outward.y * high);
            if outward.x > 0.0 {
                end = end.min((left / outward.x / self.cell).floor());
            } else if outward.x < 0.0 {
                first = first.max((left / outward.x / self.cell).ceil());
            } else if left < 0.0 {
                return 0..0;
            }
        }
        if first < end { first as usize..end as usize } else { 0..0 }
    }
}
