//! Resolve: the asked images from inverse depth and winner.

use super::Bands;
use super::batch::{Batch, NOTHING, Shade, shade};
use super::spans::Buffer;
use crate::plan::{FramePlan, Images, Output};
use crate::sensor::{LineAxis, LineGrid, PixelGrid};

/// The parts of the images that one band fills: for every image row it touches, its pixels.
#[derive(Default)]
pub(super) struct Target<'a> {
    range: Vec<&'a mut [f32]>,
    depth_z: Vec<&'a mut [f32]>,
    cos_incidence: Vec<&'a mut [f32]>,
    polygon_id: Vec<&'a mut [u32]>,
    object_id: Vec<&'a mut [u32]>,
}

/// Cuts the images into the bands' targets.
pub(super) fn split<'a>(images: &'a mut Images, bands: &Bands) -> Vec<Target<'a>> {
    let width = images.width as usize;
    let mut targets: Vec<Target<'a>> = (0..bands.count()).map(|_| Target::default()).collect();
    fn deal<'a, 't, T>(
        image: &'a mut [T],
        width: usize,
        bands: &Bands,
        targets: &'t mut [Target<'a>],
        part: impl Fn(&'t mut Target<'a>) -> &'t mut Vec<&'a mut [T]>,
    ) {
        let mut parts: Vec<_> = targets.iter_mut().map(part).collect();
        for (y, row) in image.chunks_mut(width).enumerate() {
            match bands.axis {
                LineAxis::Rows => parts[y / bands.per_band].push(row),
                LineAxis::Columns => {
                    row.chunks_mut(bands.per_band).zip(&mut parts).for_each(|(piece, part)| part.push(piece))
                }
            }
        }
    }
    deal(&mut images.range, width, bands, &mut targets, |t| &mut t.range);
    deal(&mut images.depth_z, width, bands, &mut targets, |t| &mut t.depth_z);
    deal(&mut images.cos_incidence, width, bands, &mut targets, |t| &mut t.cos_incidence);
    deal(&mut images.polygon_id, width, bands, &mut targets, |t| &mut t.polygon_id);
    deal(&mut images.object_id, width, bands, &mut targets, |t| &mut t.object_id);
    targets
}

/// The images of a few lines before they go to their place: written along the line, read across.
#[derive(Default)]
pub(super) struct Block {
    range: Vec<f32>,
    depth_z: Vec<f32>,
    cos_incidence: Vec<f32>,
    polygon_id: Vec<u32>,
    object_id: Vec<u32>,
}

/// Lines of a block: two cache lines of a row at a time. Every row of a scanner's image is a page of its own, and each
/// visit to it may miss in the address translation.
pub(super) const BLOCK_LINES: usize = 32;

/// Fills the asked images of a band.
#[inline(always)]
pub(super) fn resolve(
    buffer: &mut Buffer,
    block: &mut Block,
    plan: &FramePlan,
    batches: &[Batch],
    bands: &Bands,
    band: usize,
    target: &mut Target<'_>,
) {
    let lines = bands.lines(band);
    let samples = bands.samples;
    let outputs = plan.request.outputs;
    let len = |o| if outputs.has(o) { BLOCK_LINES * samples } else { 0 };
    block.range.resize(len(Output::Range), 0.0);
    block.depth_z.resize(len(Output::DepthZ), 0.0);
    block.cos_incidence.resize(len(Output::CosIncidence), 0.0);
    block.polygon_id.resize(len(Output::PolygonId), 0);
    block.object_id.resize(len(Output::ObjectId), 0);
    for first in lines.clone().step_by(BLOCK_LINES) {
        let count = BLOCK_LINES.min(lines.end - first);
        for j in 0..count {
            let line = first - lines.start + j;
            let pixels = line * samples..(line + 1) * samples;
            let inverse = &mut buffer.inverse[pixels.clone()];
            resolve_line(plan, batches, first + j, inverse, &buffer.winner[pixels], block, j * samples);
        }
        let at = first - lines.start;
        place(&block.range, &mut target.range, bands.axis, at, count, samples);
        place(&block.depth_z, &mut target.depth_z, bands.axis, at, count, samples);
        place(&block.cos_incidence, &mut target.cos_incidence, bands.axis, at, count, samples);
        place(&block.polygon_id, &mut target.polygon_id, bands.axis, at, count, samples);
        place(&block.object_id, &mut target.object_id, bands.axis, at, count, samples);
    }
}

/// Moves a block's lines to the rows of the image.
#[inline(always)]
fn place<T: Copy>(block: &[T], rows: &mut [&mut [T]], axis: LineAxis, at: usize, count: usize, samples: usize) {
    if block.is_empty() {
        return;
    }
    match axis {
        LineAxis::Rows => {
            for j in 0..count {
                rows[at + j].copy_from_slice(&block[j * samples..(j + 1) * samples]);
            }
        }
        LineAxis::Columns => {
            for (i, row) in rows.iter_mut().enumerate() {
                for (out, line) in row[at..at + count].iter_mut().zip(block.chunks_exact(samples)) {
                    *out = line[i];
                }
            }
        }
    }
}

/// Resolves a line into a block, run of equal winners by run; leaves ranges in `inverse`.
#[inline(always)]
fn resolve_line(
    plan: &FramePlan,
    batches: &[Batch],
    line: usize,
    inverse: &mut [f64],
    winners: &[u32],
    block: &mut Block,
    at: usize,
) {
    let outputs = plan.request.outputs;
    let spec = plan.sensor.spec();
    let (range_min, range_max) = (spec.range_min, spec.range_max);
    let samples = winners.len();
    if outputs.has(Output::DepthZ) {
        depth_line(plan, line, inverse, range_min, range_max, &mut block.depth_z[at..at + samples]);
    }
    ranges_of_line(plan, line, inverse);
    let ranges = &*inverse;
    if outputs.has(Output::Range) {
        for (out, &range) in block.range[at..at + samples].iter_mut().zip(ranges) {
            *out = metres(range, range, range_min, range_max);
        }
    }
    if !(outputs.has(Output::CosIncidence) || outputs.has(Output::PolygonId) || outputs.has(Output::ObjectId)) {
        return;
    }
    let mut start = 0;
    while start < samples {
        let number = winners[start];
        let length = winners[start..].iter().position(|&w| w != number).unwrap_or(samples - start);
        let run = at + start..at + start + length;
        let ranges = &ranges[start..start + length];
        let seen = if number == NOTHING {
            Shade { distance: f64::NAN, slot: 0, polygon_id: 0, object_id: 0 }
        } else {
            *shade(batches, number)
        };
        if outputs.has(Output::CosIncidence) {
            for (out, &range) in block.cos_incidence[run.clone()].iter_mut().zip(ranges) {
                let cos = (seen.distance / range) as f32;
                *out = if range <= range_max { if cos > 1.0 { 1.0 } else { cos } } else { f32::NAN };
            }
        }
        if outputs.has(Output::PolygonId) {
            for (out, &range) in block.polygon_id[run.clone()].iter_mut().zip(ranges) {
                *out = if range <= range_max { seen.polygon_id } else { 0 };
            }
        }
        if outputs.has(Output::ObjectId) {
            for (out, &range) in block.object_id[run].iter_mut().zip(ranges) {
                *out = if range <= range_max { seen.object_id } else { 0 };
            }
        }
        start += length;
    }
}

/// A distance as images show it, by the range it belongs to: misses are at infinite range, missing rays at NaN.
#[inline(always)]
fn metres(value: f64, range: f64, range_min: f64, range_max: f64) -> f32 {
    let shown = if range < range_min { f32::NEG_INFINITY } else { value as f32 };
    let shown = if range > range_max { f32::INFINITY } else { shown };
    if range.is_nan() { f32::NAN } else { shown }
}

/// Turns inverse depths into ranges: 1 / 0 makes a miss infinite.
#[inline(always)]
fn ranges_of_line(plan: &FramePlan, line: usize, inverse: &mut [f64]) {
    match plan.sensor.grid() {
        PixelGrid::Lines(grid) if grid.axis() == LineAxis::Columns => {
            for k in inverse {
                *k = 1.0 / *k;
            }
        }
        PixelGrid::Lines(grid) => {
            let (x_per_t, y_squared) = pinhole_row(grid, line);
            for (k, &t) in inverse.iter_mut().zip(grid.positions()) {
                let x = t * x_per_t;
                *k = (x * x + y_squared + 1.0).sqrt() / *k;
            }
        }
        PixelGrid::Rays(grid) => {
            let width = grid.width() as usize;
            for (k, ray) in inverse.iter_mut().zip(&grid.directions()[line * width..]) {
                *k = if ray.x.is_nan() { f64::NAN } else { 1.0 / *k };
            }
        }
    }
}

/// Planar depths of a camera's row from its inverse depths.
#[inline(always)]
fn depth_line(plan: &FramePlan, line: usize, inverse: &[f64], range_min: f64, range_max: f64, out: &mut [f32]) {
    match plan.sensor.grid() {
        PixelGrid::Lines(grid) => {
            let (x_per_t, y_squared) = pinhole_row(grid, line);
            for ((out, &k), &t) in out.iter_mut().zip(inverse).zip(grid.positions()) {
                let x = t * x_per_t;
                let depth = 1.0 / k;
                *out = metres(depth, (x * x + y_squared + 1.0).sqrt() * depth, range_min, range_max);
            }
        }
        PixelGrid::Rays(grid) => {
            let width = grid.width() as usize;
            for ((out, &k), ray) in out.iter_mut().zip(inverse).zip(&grid.directions()[line * width..]) {
                let range = if ray.x.is_nan() { f64::NAN } else { 1.0 / k };
                *out = metres(range * ray.z, range, range_min, range_max);
            }
        }
    }
}

/// x per position and y^2 of a pinhole row, normalized image coordinates.
#[inline(always)]
fn pinhole_row(grid: &LineGrid, line: usize) -> (f64, f64) {
    let image_from_line = grid.image_from_line();
    let y = image_from_line.x_axis.y * grid.lines()[line][0];
    (image_from_line.z_axis.x, y * y)
}
