//! Spans: one interval of samples per polygon and line, then inverse depth along it (paper section 3.2, Fig. 6).

use super::Bands;
use super::batch::{Batch, NOTHING, SetUp, shade, winner};
use crate::sensor::LineGrid;
use glam::DVec3;

/// The z-buffer of a band, line by line.
#[derive(Default)]
pub(super) struct Buffer {
    /// 1 / depth in the frame of the rays; 0 is nothing.
    pub inverse: Vec<f64>,
    /// See [`winner`].
    pub winner: Vec<u32>,
    /// Least inverse depth of every tile, see [`super::hidden`].
    pub farthest: Vec<f64>,
}

impl Buffer {
    pub fn clear(&mut self, pixels: usize) {
        self.inverse.clear();
        self.inverse.resize(pixels, 0.0);
        self.winner.clear();
        self.winner.resize(pixels, NOTHING);
    }
}

/// Lines whose intervals are found together.
const TOGETHER: usize = 8;

/// Draws the polygons of a band that the batches from `first_batch` on hold.
#[inline(always)]
pub(super) fn rasterize(
    buffer: &mut Buffer,
    grid: &LineGrid,
    batches: &[Batch],
    first_batch: usize,
    bands: &Bands,
    band: usize,
) {
    let lines = bands.lines(band);
    for (b, batch) in batches.iter().enumerate().skip(first_batch) {
        for &i in batch.in_band(band) {
            let polygon = &batch.polygons[i as usize];
            let edges = &batch.edges[polygon.first_edge as usize..];
            let number = winner(b, i);
            let start = lines.start.max(polygon.first_line as usize);
            let end = lines.end.min(polygon.end_line as usize);
            for first in (start..end).step_by(TOGETHER) {
                let count = TOGETHER.min(end - first);
                let (c0, c1) = (&grid.c0()[first..first + count], &grid.c1()[first..first + count]);
                let (least, greatest) = bounds_of_lines(polygon, edges, c0, c1);
                for l in 0..count {
                    if least[l] > greatest[l] {
                        continue;
                    }
                    let (from, to) = (grid.samples_below(least[l]), grid.samples_up_to(greatest[l]));
                    if from < to {
                        let row = (first + l - lines.start) * bands.samples;
                        let scale = polygon.m.x * c0[l] + polygon.m.y * c1[l];
                        draw(buffer, grid, row, from..to, [scale, polygon.m.z], number, batches);
                    }
                }
            }
        }
    }
}

/// Where the polygon's cone begins and ends on up to [`TOGETHER`] lines, as positions t.
#[inline(always)]
fn bounds_of_lines(polygon: &SetUp, edges: &[DVec3], c0: &[f64], c1: &[f64]) -> ([f64; TOGETHER], [f64; TOGETHER]) {
    let (lower, rest) = edges.split_at(usize::from(polygon.lower));
    let (upper, rest) = rest.split_at(usize::from(polygon.upper));
    let mut a = [0.0; TOGETHER];
    let mut b = [0.0; TOGETHER];
    a[..c0.len()].copy_from_slice(c0);
    b[..c1.len()].copy_from_slice(c1);
    let mut least = [f64::NEG_INFINITY; TOGETHER];
    let mut greatest = [f64::INFINITY; TOGETHER];
    for e in lower {
        for l in 0..TOGETHER {
            let t = e.x * a[l] + e.y * b[l];
            least[l] = if t > least[l] { t } else { least[l] };
        }
    }
    for e in upper {
        for l in 0..TOGETHER {
            let t = e.x * a[l] + e.y * b[l];
            greatest[l] = if t < greatest[l] { t } else { greatest[l] };
        }
    }
    for e in &rest[..usize::from(polygon.steep)] {
        for l in 0..TOGETHER {
            greatest[l] = if e.x * a[l] + e.y * b[l] < 0.0 { f64::NEG_INFINITY } else { greatest[l] };
        }
    }
    (least, greatest)
}

/// Spans below this length are drawn one by one.
const SHORT: usize = 8;

#[inline(always)]
fn draw(
    buffer: &mut Buffer,
    grid: &LineGrid,
    row: usize,
    span: std::ops::Range<usize>,
    [scale, slope]: [f64; 2],
    number: u32,
    batches: &[Batch],
) {
    let pixels = row + span.start..row + span.end;
    let inverse = &mut buffer.inverse[pixels.clone()];
    let winners = &mut buffer.winner[pixels];
    let w0 = &grid.w0()[span.clone()];
    let w1 = &grid.w1()[span];
    let n = inverse.len();
    assert!(winners.len() == n && w0.len() == n && w1.len() == n);
    let mut tie = false;
    if n < SHORT {
        for i in 0..n {
            let k = scale * w0[i] + slope * w1[i];
            if k > inverse[i] {
                inverse[i] = k;
                winners[i] = number;
            } else {
                tie |= k == inverse[i];
            }
        }
    } else {
        for i in 0..n {
            let k = scale * w0[i] + slope * w1[i];
            let before = inverse[i];
            let nearer = k > before;
            tie |= k == before;
            inverse[i] = if nearer { k } else { before };
            winners[i] = if nearer { number } else { winners[i] };
        }
    }
    if tie {
        settle_ties(inverse, winners, w0, w1, [scale, slope], number, batches);
    }
}

/// On bit-equal inverse depth the lower slot wins.
#[cold]
fn settle_ties(
    inverse: &[f64],
    winners: &mut [u32],
    w0: &[f64],
    w1: &[f64],
    [scale, slope]: [f64; 2],
    number: u32,
    batches: &[Batch],
) {
    let slot = shade(batches, number).slot;
    for i in 0..inverse.len() {
        let k = scale * w0[i] + slope * w1[i];
        if k == inverse[i] && winners[i] != NOTHING && slot < shade(batches, winners[i]).slot {
            winners[i] = number;
        }
    }
}
