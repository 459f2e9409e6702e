//! The rays of a sensor as engines use them: straight lines of samples where possible, else a table in tiles.

use super::part::ImagePart;
use super::ray_grid::RayGrid;
use glam::{DMat3, DVec3};
use pulp::Simd;
use std::ops::Range;

/// All rays of a sensor, in the image frame.
#[derive(Clone, Debug)]
pub enum PixelGrid {
    /// Pinhole cameras and scanners.
    Lines(LineGrid),
    /// Lens distortion and free ray tables.
    Rays(RayGrid),
}

impl PixelGrid {
    /// Unit ray of a pixel in the image frame; `None` where there is no ray.
    pub fn ray(&self, column: u32, row: u32) -> Option<DVec3> {
        match self {
            Self::Lines(grid) => Some(grid.ray(column, row)),
            Self::Rays(grid) => {
                let ray = grid.direction(column, row);
                (!ray.is_nan()).then_some(ray)
            }
        }
    }
}

/// The image axis of the lines of a [`LineGrid`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LineAxis {
    /// A line is an image row, a sample a column (pinhole cameras).
    Rows,
    /// A line is an image column, a sample a row (scanners).
    Columns,
}

/// Rays in planes through the centre: `s(line, sample) = (c0 w0, c1 w0, w1)` in the line frame.
///
/// A linear function e . s of a ray is `w0 (A + B t)` with `A = e.x c0 + e.y c1`, `B = e.z`, `t = w1 / w0` rising
/// with the sample and `w0 >= 0`. A convex cone therefore covers one interval of samples on every line, and the paper's
/// incremental spans and its spherical projection (section 3.2) become the same loop.
#[derive(Clone, Debug)]
pub struct LineGrid {
    axis: LineAxis,
    line_from_image: DMat3,
    image_from_line: DMat3,
    lines: Vec<[f64; 2]>,
    weights: Vec<[f64; 2]>,
    positions: Vec<f64>,
    /// Pixels of a camera from line to line and from sample to sample.
    stride: f64,
    finder: PositionFinder,
    /// The values as separate arrays for vector loops. The arrays of the lines are padded by eight zeros.
    c: [Vec<f64>; 2],
    octets: Vec<Octet>,
}

/// Eight samples of a line for vector loops. Past the last sample, t is NaN and w0, w1 are 0.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
pub struct Octet {
    /// First weight of each sample.
    pub w0: [f64; Octet::LEN],
    /// Second weight of each sample.
    pub w1: [f64; Octet::LEN],
    /// Position of each sample along the line.
    pub t: [f64; Octet::LEN],
}

impl Octet {
    /// Number of samples.
    pub const LEN: usize = 8;

    fn of(weights: &[[f64; 2]], positions: &[f64]) -> Self {
        let mut octet = Self { w0: [0.0; Self::LEN], w1: [0.0; Self::LEN], t: [f64::NAN; Self::LEN] };
        for (i, (w, t)) in weights.iter().zip(positions).enumerate() {
            (octet.w0[i], octet.w1[i], octet.t[i]) = (w[0], w[1], *t);
        }
        octet
    }
}

impl LineGrid {
    /// `lines` are (c0, c1), `weights` (w0, w1) with w1 / w0 rising.
    pub(super) fn new(axis: LineAxis, line_from_image: DMat3, lines: Vec<[f64; 2]>, weights: Vec<[f64; 2]>) -> Self {
        let positions: Vec<f64> = weights.iter().map(|[w0, w1]| w1 / w0).collect();
        debug_assert!(positions.windows(2).all(|p| p[0] < p[1]));
        let finder = PositionFinder::new(&positions);
        let padding = [0.0; Octet::LEN];
        let c = [0, 1].map(|i| lines.iter().map(|c| c[i]).chain(padding).collect());
        let octets =
            weights.chunks(Octet::LEN).zip(positions.chunks(Octet::LEN)).map(|(w, t)| Octet::of(w, t)).collect();
        let image_from_line = line_from_image.inverse();
        Self { axis, line_from_image, image_from_line, lines, weights, positions, stride: 1.0, finder, c, octets }
    }

    /// The lines and samples of an image part.
    pub(super) fn part(&self, part: &ImagePart) -> Self {
        let step = part.stride as usize;
        let columns = part.first_column as usize..part.end_column as usize;
        let (lines, samples) = match self.axis {
            LineAxis::Rows => (0..self.lines.len(), columns),
            LineAxis::Columns => (columns, 0..self.weights.len()),
        };
        let pick = |all: &[[f64; 2]], which: Range<usize>| all[which].iter().step_by(step).copied().collect();
        let (lines, weights) = (pick(&self.lines, lines), pick(&self.weights, samples));
        Self { stride: f64::from(part.stride), ..Self::new(self.axis, self.line_from_image, lines, weights) }
    }

    /// Distance between neighbouring lines and samples in camera pixels: 1 unless this is a part of a grid.
    pub fn stride(&self) -> f64 {
        self.stride
    }

    /// Number of samples at positions below `t`: the first one at or above it.
    #[inline(always)]
    pub fn samples_below(&self, t: f64) -> usize {
        self.finder.find(&self.positions, t, |position, t| position < t)
    }

    /// Number of samples at positions up to and including `t`.
    #[inline(always)]
    pub fn samples_up_to(&self, t: f64) -> usize {
        self.finder.find(&self.positions, t, |position, t| position <= t)
    }

    /// The image axis along which a line runs.
    pub fn axis(&self) -> LineAxis {
        self.axis
    }

    /// Turns and scales the image frame into the line frame; its determinant may be negative.
    pub fn line_from_image(&self) -> DMat3 {
        self.line_from_image
    }

    /// The inverse of [`LineGrid::line_from_image`].
    pub fn image_from_line(&self) -> DMat3 {
        self.image_from_line
    }

    /// (c0, c1) of every line.
    pub fn lines(&self) -> &[[f64; 2]] {
        &self.lines
    }

    /// (w0, w1) of every sample.
    pub fn weights(&self) -> &[[f64; 2]] {
        &self.weights
    }

    /// c0 and c1 of eight lines; past the last one they are 0.
    #[inline(always)]
    pub fn eight_lines(&self, first: usize) -> [&[f64; Octet::LEN]; 2] {
        self.c.each_ref().map(|c| c[first..].first_chunk().expect("padded by eight"))
    }

    /// The samples in groups of eight.
    pub fn octets(&self) -> &[Octet] {
        &self.octets
    }

    /// For each interval of t: the first and the end index of a sample range that holds all samples of the interval and
    /// at most one more on either side. For an interval without samples, the end may be at or before the first.
    #[inline(always)]
    pub fn samples_around<S: Simd>(
        &self,
        simd: S,
        least: &[f64; Octet::LEN],
        greatest: &[f64; Octet::LEN],
    ) -> [[u32; Octet::LEN]; 2] {
        [self.finder.surely_below(simd, least), self.finder.perhaps_up_to(simd, greatest)]
    }

    /// t = w1 / w0 of every sample, rising; infinite at a pole.
    pub fn positions(&self) -> &[f64] {
        &self.positions
    }

    /// Line and sample of a pixel.
    pub fn line_sample(&self, column: u32, row: u32) -> (usize, usize) {
        match self.axis {
            LineAxis::Rows => (row as usize, column as usize),
            LineAxis::Columns => (column as usize, row as usize),
        }
    }

    /// The ray in the line frame, not normalized for cameras.
    pub fn line_ray(&self, line: usize, sample: usize) -> DVec3 {
        let [c0, c1] = self.lines[line];
        let [w0, w1] = self.weights[sample];
        DVec3::new(c0 * w0, c1 * w0, w1)
    }

    fn ray(&self, column: u32, row: u32) -> DVec3 {
        let (line, sample) = self.line_sample(column, row);
        (self.image_from_line * self.line_ray(line, sample)).normalize()
    }
}

/// Finds a position among the rising positions of a line in constant time: it looks up an equal-width cell, then steps
/// once or twice. The result is exact because the table only has to start low enough.
#[derive(Clone, Debug)]
pub(super) struct PositionFinder {
    start: f64,
    cells_per_unit: f64,
    /// For each cell, the number of positions below its lower end.
    below: Vec<u32>,
    /// For each entry (the cell ends and one before them): the number of positions certainly below any t nearest to
    /// that entry, and the number of positions possibly up to it.
    surely_below: Vec<u32>,
    up_to: Vec<u32>,
}

impl PositionFinder {
    pub fn new(positions: &[f64]) -> Self {
        let mut finite = positions.iter().copied().filter(|t| t.is_finite());
        let start = finite.next().unwrap_or(0.0);
        let end = finite.next_back().unwrap_or(start);
        let cells = 4 * positions.len();
        let cells_per_unit = if end > start { cells as f64 / (end - start) } else { 0.0 };
        let below: Vec<u32> = (0..=cells)
            .map(|cell| {
                // Slightly low, so that rounding in `find` cannot start too high.
                let t = if cells_per_unit > 0.0 { start + (cell as f64 - 1e-3) / cells_per_unit } else { start };
                positions.partition_point(|&p| p < t) as u32
            })
            .collect();
        let n = positions.len() as u32;
        // A t belongs to its nearest entry. The margin covers rounding in `entries`.
        let at = |entry: f64| start + (entry - 1.0) / cells_per_unit;
        let entries = 0..cells + 2;
        let surely_below = entries.clone().map(|i| match i {
            1.. if cells_per_unit > 0.0 => positions.partition_point(|&p| p < at(i as f64 - 0.501)) as u32,
            _ => 0,
        });
        let up_to = entries.map(|i| {
            let inner = cells_per_unit > 0.0 && i <= cells;
            if inner { positions.partition_point(|&p| p <= at(i as f64 + 0.501)) as u32 } else { n }
        });
        let (surely_below, up_to) = (surely_below.collect(), up_to.collect());
        Self { start, cells_per_unit, below, surely_below, up_to }
    }

    /// For each t, at most the number of positions below it.
    #[inline(always)]
    pub fn surely_below<S: Simd>(&self, simd: S, t: &[f64; Octet::LEN]) -> [u32; Octet::LEN] {
        self.entries(simd, t).map(|entry| self.surely_below[entry as u32 as usize])
    }

    /// For each t, at least the number of positions up to and including it.
    #[inline(always)]
    pub fn perhaps_up_to<S: Simd>(&self, simd: S, t: &[f64; Octet::LEN]) -> [u32; Octet::LEN] {
        self.entries(simd, t).map(|entry| self.up_to[entry as u32 as usize])
    }

    /// Indices into `surely_below` and `up_to`, in the low 32 bits: adding 2^52 leaves no fraction bits.
    #[inline(always)]
    fn entries<S: Simd>(&self, simd: S, t: &[f64; Octet::LEN]) -> [u64; Octet::LEN] {
        let (start, scale) = (simd.splat_f64s(self.start), simd.splat_f64s(self.cells_per_unit));
        let (zero, one) = (simd.splat_f64s(0.0), simd.splat_f64s(1.0));
        let last = simd.splat_f64s((self.surely_below.len() - 1) as f64);
        let integer = simd.splat_f64s(4_503_599_627_370_496.0);
        let mut entries = [0; Octet::LEN];
        for (to, &t) in S::as_mut_simd_u64s(&mut entries).0.iter_mut().zip(S::as_simd_f64s(t).0) {
            let entry = simd.add_f64s(simd.mul_f64s(simd.sub_f64s(t, start), scale), one);
            let entry = simd.min_f64s(simd.max_f64s(entry, zero), last);
            *to = simd.transmute_u64s_f64s(simd.add_f64s(entry, integer));
        }
        entries
    }

    #[inline(always)]
    fn find(&self, positions: &[f64], t: f64, below: impl Fn(f64, f64) -> bool) -> usize {
        // A cast saturates: -inf and NaN become cell 0, +inf the last one.
        let cell = (((t - self.start) * self.cells_per_unit) as usize).min(self.below.len() - 1);
        let mut i = if t > self.start { self.below[cell] as usize } else { 0 };
        while i < positions.len() && below(positions[i], t) {
            i += 1;
        }
        i
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    struct Entries<'a>(&'a PositionFinder, f64);

    impl pulp::WithSimd for Entries<'_> {
        type Output = [u64; Octet::LEN];

        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            self.0.entries(simd, &[self.1; Octet::LEN])
        }
    }

    proptest! {
        #[test]
        fn finder_agrees_with_a_search(
            mut positions in proptest::collection::vec(-50.0..50.0f64, 1..40),
            t in -60.0..60.0f64,
            pick in 0usize..40,
            pole in proptest::bool::ANY,
        ) {
            positions.sort_by(f64::total_cmp);
            positions.dedup();
            if pole {
                positions.insert(0, f64::NEG_INFINITY);
                positions.push(f64::INFINITY);
            }
            let finder = PositionFinder::new(&positions);
            for t in [t, positions[pick % positions.len()], f64::INFINITY, f64::NEG_INFINITY] {
                prop_assert_eq!(finder.find(&positions, t, |p, t| p < t), positions.partition_point(|&p| p < t));
                prop_assert_eq!(finder.find(&positions, t, |p, t| p <= t), positions.partition_point(|&p| p <= t));
                let [entry, ..] = pulp::Arch::new().dispatch(Entries(&finder, t)).map(|e| e as u32 as usize);
                prop_assert!(finder.surely_below[entry] as usize <= positions.partition_point(|&p| p < t));
                prop_assert!(finder.up_to[entry] as usize >= positions.partition_point(|&p| p <= t));
            }
        }
    }
}
