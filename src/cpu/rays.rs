//! Ray tables (lens distortion, listed rays): each polygon against the rays of the tiles that its cone may touch.

use super::Bands;
use super::batch::{Batch, NOTHING, SetUp};
use super::spans::{Buffer, EIGHT};
use crate::sensor::{RayGrid, Tile};
use glam::DVec3;

/// Bands hold whole rows of tiles.
pub(super) const BAND_MULTIPLE: usize = 8;

/// Draws the polygons of some batches into a band.
#[inline(always)]
pub(super) fn rasterize(
    buffer: &mut Buffer,
    grid: &RayGrid,
    batches: &[Batch],
    slots: &[u32],
    bands: &Bands,
    band: usize,
) {
    let lines = bands.lines(band);
    let tiles: Vec<(&Tile, f64)> = grid
        .tiles()
        .iter()
        .filter(|t| lines.contains(&(t.row as usize)) && t.half_angle >= 0.0)
        .map(|t| (t, if t.half_angle < 1.5 { t.half_angle.sin() } else { 2.0 }))
        .collect();
    for batch in batches {
        for &i in batch.in_band(band) {
            let polygon = &batch.polygons[i as usize];
            let first = polygon.first_edge as usize;
            let edges = &batch.edges[first..first + usize::from(polygon.steep)];
            for (tile, sine) in &tiles {
                if edges.iter().all(|e| e.dot(tile.axis) >= -sine * e.length()) {
                    draw(buffer, grid, (slots, batch.first_number + i), polygon, edges, tile, lines.start);
                }
            }
        }
    }
}

#[inline(always)]
fn draw(
    buffer: &mut Buffer,
    grid: &RayGrid,
    (slots, number): (&[u32], u32),
    polygon: &SetUp,
    edges: &[DVec3],
    tile: &Tile,
    first_line: usize,
) {
    let width = grid.width() as usize;
    for row in tile.row as usize..(tile.row + tile.height) as usize {
        let columns = tile.column as usize..(tile.column + tile.width) as usize;
        for column in columns {
            // A missing ray is NaN and fails every test.
            let ray = grid.directions()[row * width + column];
            if !edges.iter().all(|e| e.dot(ray) >= 0.0) {
                continue;
            }
            let k = polygon.m.dot(ray);
            let (at, i) = (buffer.at(row - first_line, column / EIGHT), column % EIGHT);
            let (inverse, before) = (&mut buffer.inverse[at].0[i], &mut buffer.winner[at].0[i]);
            let held = *before as u32;
            let lower = || held != NOTHING && slots[number as usize] < slots[held as usize];
            if k > *inverse || (k == *inverse && lower()) {
                *inverse = k;
                *before = number.into();
            }
        }
    }
}
