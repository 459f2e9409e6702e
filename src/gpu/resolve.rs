//! The CPU twin of resolve.wgsl: from keys to the asked images. On a software adapter it takes the stage's place.

use super::layout::{Params, SLOT_WORDS};
use crate::plan::{FramePlan, IdScheme, Images};
use crate::sensor::{LineAxis, PixelGrid};
use rayon::prelude::*;

/// What a pixel shows.
enum Seen {
    NoRay,
    Nothing,
    Hit(Hit),
}

struct Keys<'a> {
    plan: &'a FramePlan,
    params: &'a Params,
    keys: &'a [[u32; 2]],
}

impl Keys<'_> {
    /// Length of the ray whose inverse depth was rasterized, depth per unit of it, and where its key lies.
    fn scale(&self, column: u32, row: u32) -> Option<(f32, f32, usize)> {
        let p = self.params;
        let index = (row * p.width + column) as usize;
        match self.plan.sensor.grid() {
            PixelGrid::Lines(grid) if grid.axis() == LineAxis::Rows => {
                let x = (p.first_sample + column as f32) / p.fx;
                let y = (p.first_line + row as f32) / p.fy;
                Some(((1.0 + x * x + y * y).sqrt(), 1.0, index))
            }
            PixelGrid::Lines(_) => Some((1.0, 0.0, (column * p.height + row) as usize)),
            PixelGrid::Rays(grid) => {
                let z = grid.directions()[index].z;
                (!z.is_nan()).then_some((1.0, z as f32, index))
            }
        }
    }

    fn seen(&self, column: u32, row: u32) -> Seen {
        let Some((ray, depth, index)) = self.scale(column, row) else { return Seen::NoRay };
        let [id, bits] = self.keys[index];
        if bits == 0 || id == 0 {
            return Seen::Nothing;
        }
        let k = f32::from_bits(bits);
        let range = ray / k;
        if range > self.params.range_max {
            return Seen::Nothing;
        }
        Seen::Hit(Hit { slot: !id, k, ray, depth, below: range < self.params.range_min })
    }
}

#[derive(Clone, Copy)]
struct Hit {
    slot: u32,
    k: f32,
    ray: f32,
    depth: f32,
    below: bool,
}

/// One row of every image; those not asked for are empty.
struct Row<'a> {
    range: &'a mut [f32],
    depth_z: &'a mut [f32],
    polygon_id: &'a mut [u32],
    object_id: &'a mut [u32],
    cos_incidence: &'a mut [f32],
}

/// The next row, or nothing of an image that is not there.
fn next<'a, T>(rows: &mut std::slice::ChunksMut<'a, T>) -> &'a mut [T] {
    rows.next().unwrap_or_default()
}

/// Writes where the image is there.
fn put<T>(row: &mut [T], column: usize, value: T) {
    if let Some(pixel) = row.get_mut(column) {
        *pixel = value;
    }
}

/// Fills the images that are there; the answer is the number of hits without an id.
pub(super) fn resolve(
    plan: &FramePlan,
    params: &Params,
    keys: &[[u32; 2]],
    slots: &[[u32; SLOT_WORDS as usize]],
    images: &mut Images,
) -> u32 {
    let width = params.width as usize;
    let (mut range, mut depth_z) = (images.range.chunks_mut(width), images.depth_z.chunks_mut(width));
    let (mut polygon, mut object) = (images.polygon_id.chunks_mut(width), images.object_id.chunks_mut(width));
    let mut cosine = images.cos_incidence.chunks_mut(width);
    let mut rows: Vec<Row<'_>> = (0..params.height)
        .map(|_| Row {
            range: next(&mut range),
            depth_z: next(&mut depth_z),
            polygon_id: next(&mut polygon),
            object_id: next(&mut object),
            cos_incidence: next(&mut cosine),
        })
        .collect();
    let all = Keys { plan, params, keys };
    let source = plan.request.ids == IdScheme::Source;
    rows.par_iter_mut().enumerate().with_min_len(8).for_each(|(i, row)| {
        for column in 0..width {
            let (length, depth, ids, cosine) = match all.seen(column as u32, i as u32) {
                Seen::NoRay => (f32::NAN, f32::NAN, [0; 2], f32::NAN),
                Seen::Nothing => (f32::INFINITY, f32::INFINITY, [0; 2], f32::NAN),
                Seen::Hit(h) => {
                    let [distance, object, source_id, _] = slots[h.slot as usize];
                    let id = if source { source_id } else { h.slot + 1 };
                    let cosine = (h.k * f32::from_bits(distance) / h.ray).min(1.0);
                    let limited = |value: f32| if h.below { f32::NEG_INFINITY } else { value };
                    (limited(h.ray / h.k), limited(h.depth / h.k), [id, object], cosine)
                }
            };
            put(row.range, column, length);
            put(row.depth_z, column, depth);
            put(row.polygon_id, column, ids[0]);
            put(row.object_id, column, ids[1]);
            put(row.cos_incidence, column, cosine);
        }
    });
    keys.iter().filter(|[id, bits]| *bits != 0 && *id == 0).count() as u32
}
