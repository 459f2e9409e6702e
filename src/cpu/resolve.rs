//! Resolve: the asked images from inverse depth and winner.

use super::Bands;
use super::batch::{Batch, NOTHING, Shade, shade};
use super::spans::Buffer;
use crate::plan::{FramePlan, Images, Output};
use crate::sensor::{LineAxis, PixelGrid};
use std::ops::Range;

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

/// What the resolve of a frame needs to know, besides the z-buffer.
struct Frame<'a> {
    plan: &'a FramePlan,
    batches: &'a [Batch],
    range_min: f64,
    range_max: f64,
}

/// Fills the asked images of a band.
#[inline(always)]
pub(super) fn resolve(
    buffer: &Buffer,
    plan: &FramePlan,
    batches: &[Batch],
    lines: Range<usize>,
    target: &mut Target<'_>,
) {
    let spec = plan.sensor.spec();
    let frame = Frame { plan, batches, range_min: spec.range_min, range_max: spec.range_max };
    let samples = buffer.inverse.len() / lines.len();
    for (j, line) in lines.enumerate() {
        let pixels = j * samples..(j + 1) * samples;
        resolve_line(&frame, line, j, &buffer.inverse[pixels.clone()], &buffer.winner[pixels], target);
    }
}

/// Ray length over depth (1 where depth is range) and the ray's z in the image frame, by sample of a line.
enum Rays<'a> {
    /// Rays of unit length.
    Unit,
    /// A pinhole row: depth is depth_z; the length of (x, y, 1) from its parts.
    Pinhole { x: &'a [f64], x_scale: f64, y_squared: f64 },
    /// A row of a ray table.
    Table(&'a [glam::DVec3]),
}

#[inline(always)]
fn resolve_line(frame: &Frame<'_>, line: usize, j: usize, inverse: &[f64], winners: &[u32], target: &mut Target<'_>) {
    let outputs = frame.plan.request.outputs;
    let columns = match frame.plan.sensor.grid() {
        PixelGrid::Lines(grid) => grid.axis() == LineAxis::Columns,
        PixelGrid::Rays(_) => false,
    };
    let rays = rays_of_line(frame.plan, line);
    let mut known = NOTHING;
    let mut seen = Shade { distance: 0.0, slot: 0, polygon_id: 0, object_id: 0 };
    for (i, (&k, &number)) in inverse.iter().zip(winners).enumerate() {
        let (row, column) = if columns { (i, j) } else { (j, i) };
        let (length, ray_z) = match &rays {
            Rays::Unit => (1.0, 1.0),
            Rays::Pinhole { x, x_scale, y_squared } => {
                let x = x[i] * x_scale;
                ((x * x + y_squared).sqrt(), 1.0)
            }
            Rays::Table(directions) => (1.0, directions[i].z),
        };
        let no_ray = ray_z.is_nan();
        let range = if number == NOTHING { f64::INFINITY } else { length / k };
        let hit = range <= frame.range_max && number != NOTHING;
        if hit && number != known {
            known = number;
            seen = *shade(frame.batches, number);
        }
        let near = range < frame.range_min;
        let metres = |value: f64| match (no_ray, hit, near) {
            (true, ..) => f32::NAN,
            (_, false, _) => f32::INFINITY,
            (_, _, true) => f32::NEG_INFINITY,
            _ => value as f32,
        };
        if outputs.has(Output::Range) {
            target.range[row][column] = metres(range);
        }
        if outputs.has(Output::DepthZ) {
            // Pinhole depth is 1 / k itself; along a unit ray it is range x z.
            target.depth_z[row][column] = metres(if matches!(rays, Rays::Table(_)) { range * ray_z } else { 1.0 / k });
        }
        if outputs.has(Output::CosIncidence) {
            let cos = seen.distance / range;
            target.cos_incidence[row][column] = if hit { cos.min(1.0) as f32 } else { f32::NAN };
        }
        if outputs.has(Output::PolygonId) {
            target.polygon_id[row][column] = if hit { seen.polygon_id } else { 0 };
        }
        if outputs.has(Output::ObjectId) {
            target.object_id[row][column] = if hit { seen.object_id } else { 0 };
        }
    }
}

#[inline(always)]
fn rays_of_line(plan: &FramePlan, line: usize) -> Rays<'_> {
    match plan.sensor.grid() {
        PixelGrid::Lines(grid) if grid.axis() == LineAxis::Columns => Rays::Unit,
        PixelGrid::Lines(grid) => {
            let image_from_line = grid.image_from_line();
            let y = image_from_line.x_axis.y * grid.lines()[line][0];
            Rays::Pinhole { x: grid.positions(), x_scale: image_from_line.z_axis.x, y_squared: y * y + 1.0 }
        }
        PixelGrid::Rays(grid) => {
            let width = grid.width() as usize;
            Rays::Table(&grid.directions()[line * width..(line + 1) * width])
        }
    }
}
