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
    w0: Vec<f64>,
    w1: Vec<f64>,
}

impl Buffer {
    pub fn clear(&mut self, pixels: usize) {
        self.inverse.clear();
        self.inverse.resize(pixels, 0.0);
        self.winner.clear();
        self.winner.resize(pixels, NOTHING);
    }
}

/// Draws all polygons of a band.
#[inline(always)]
pub(super) fn rasterize(buffer: &mut Buffer, grid: &LineGrid, batches: &[Batch], bands: &Bands, band: usize) {
    let lines = bands.lines(band);
    buffer.clear(lines.len() * bands.samples);
    if buffer.w0.len() != bands.samples {
        buffer.w0 = grid.weights().iter().map(|w| w[0]).collect();
        buffer.w1 = grid.weights().iter().map(|w| w[1]).collect();
    }
    for (b, batch) in batches.iter().enumerate() {
        for &i in batch.in_band(band) {
            let polygon = &batch.polygons[i as usize];
            let edges = &batch.edges[polygon.first_edge as usize..];
            let number = winner(b, i);
            let first = lines.start.max(polygon.first_line as usize);
            let end = lines.end.min(polygon.end_line as usize);
            for line in first..end {
                let c = grid.lines()[line];
                let Some((from, to)) = interval(grid, polygon, edges, c) else {
                    continue;
                };
                let row = (line - lines.start) * bands.samples;
                let scale = polygon.m.x * c[0] + polygon.m.y * c[1];
                draw(buffer, row, from..to, [scale, polygon.m.z], number, batches);
            }
        }
    }
}

/// The samples of a line inside a polygon's cone.
#[inline(always)]
fn interval(grid: &LineGrid, polygon: &SetUp, edges: &[DVec3], [c0, c1]: [f64; 2]) -> Option<(usize, usize)> {
    let (lower, rest) = edges.split_at(usize::from(polygon.lower));
    let (upper, rest) = rest.split_at(usize::from(polygon.upper));
    let mut least = f64::NEG_INFINITY;
    for e in lower {
        least = least.max(e.x * c0 + e.y * c1);
    }
    let mut greatest = f64::INFINITY;
    for e in upper {
        greatest = greatest.min(e.x * c0 + e.y * c1);
    }
    if least > greatest {
        return None;
    }
    for e in &rest[..usize::from(polygon.steep)] {
        if e.x * c0 + e.y * c1 < 0.0 {
            return None;
        }
    }
    let from = grid.samples_below(least);
    let to = grid.samples_up_to(greatest);
    (from < to).then_some((from, to))
}

/// Spans below this length are drawn one by one.
const SHORT: usize = 8;

#[inline(always)]
fn draw(
    buffer: &mut Buffer,
    row: usize,
    span: std::ops::Range<usize>,
    [scale, slope]: [f64; 2],
    number: u32,
    batches: &[Batch],
) {
    let pixels = row + span.start..row + span.end;
    let inverse = &mut buffer.inverse[pixels.clone()];
    let winners = &mut buffer.winner[pixels];
    let w0 = &buffer.w0[span.clone()];
    let w1 = &buffer.w1[span];
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
