//! The CPU twin of resolve.wgsl: from keys to the asked images. On a software adapter it takes the stage's place.

use super::layout::{Params, SLOT_WORDS};
use crate::plan::{FramePlan, IdScheme, Images};
use crate::sensor::{LineAxis, PixelGrid};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};

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

    /// Fills one image, rows side by side.
    fn fill<T: Copy + Send + Sync>(&self, image: &mut [T], no_ray: T, nothing: T, hit: impl Fn(Hit) -> T + Sync) {
        let width = self.params.width as usize;
        image.par_chunks_mut(width * 8).enumerate().for_each(|(band, pixels)| {
            for (i, pixel) in pixels.iter_mut().enumerate() {
                let (column, row) = ((i % width) as u32, (band * 8 + i / width) as u32);
                *pixel = match self.seen(column, row) {
                    Seen::NoRay => no_ray,
                    Seen::Nothing => nothing,
                    Seen::Hit(found) => hit(found),
                };
            }
        });
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

/// Fills the images that are there; the answer is the number of hits without an id.
pub(super) fn resolve(
    plan: &FramePlan,
    params: &Params,
    keys: &[[u32; 2]],
    slots: &[[u32; SLOT_WORDS as usize]],
    images: &mut Images,
) -> u32 {
    let all = Keys { plan, params, keys };
    let lost = AtomicU32::new(0);
    keys.par_chunks(1 << 14).for_each(|some| {
        let missing = some.iter().filter(|[id, bits]| *bits != 0 && *id == 0).count();
        lost.fetch_add(missing as u32, Ordering::Relaxed);
    });
    let limited = |value: f32, below: bool| if below { f32::NEG_INFINITY } else { value };
    all.fill(&mut images.range, f32::NAN, f32::INFINITY, |h| limited(h.ray / h.k, h.below));
    all.fill(&mut images.depth_z, f32::NAN, f32::INFINITY, |h| limited(h.depth / h.k, h.below));
    all.fill(&mut images.cos_incidence, f32::NAN, f32::NAN, |h| {
        (h.k * f32::from_bits(slots[h.slot as usize][0]) / h.ray).min(1.0)
    });
    all.fill(&mut images.object_id, 0, 0, |h| slots[h.slot as usize][1]);
    match plan.request.ids {
        IdScheme::Model => all.fill(&mut images.polygon_id, 0, 0, |h| h.slot + 1),
        IdScheme::Source => all.fill(&mut images.polygon_id, 0, 0, |h| slots[h.slot as usize][2]),
    }
    lost.into_inner()
}
