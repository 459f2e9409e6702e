//! The CPU twin of resolve.wgsl: from keys to the asked images. On a software adapter it takes the stage's place.

use super::layout::{Params, Slot};
use crate::plan::{FramePlan, IdScheme, Images};
use crate::sensor::{LineAxis, PixelGrid};

/// What a pixel shows.
enum PixelContent {
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
                let z = grid.direction(column, row).z;
                (!z.is_nan()).then_some((1.0, z as f32, index))
            }
        }
    }

    fn seen(&self, column: u32, row: u32) -> PixelContent {
        let Some((ray, depth, index)) = self.scale(column, row) else { return PixelContent::NoRay };
        let [id, bits] = self.keys[index];
        if bits == 0 || id == 0 {
            return PixelContent::Nothing;
        }
        let k = f32::from_bits(bits);
        let range = ray / k;
        if range > self.params.range_max {
            return PixelContent::Nothing;
        }
        PixelContent::Hit(Hit { slot: !id, k, ray, depth, below: range < self.params.range_min })
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

/// Some rows of every image; those not asked for are empty.
struct Rows<'a> {
    first: u32,
    count: u32,
    range: &'a mut [f32],
    depth_z: &'a mut [f32],
    polygon_id: &'a mut [u32],
    object_id: &'a mut [u32],
    cos_incidence: &'a mut [f32],
}

/// Pixels that are not worth another thread.
const FEW_PIXELS: u32 = 4096;

impl Rows<'_> {
    /// The upper and the lower half.
    fn halves(&mut self, width: usize) -> (Rows<'_>, Rows<'_>) {
        let upper = self.count / 2;
        let at = upper as usize * width;
        let range = cut(self.range, at);
        let depth_z = cut(self.depth_z, at);
        let polygon_id = cut(self.polygon_id, at);
        let object_id = cut(self.object_id, at);
        let cos_incidence = cut(self.cos_incidence, at);
        let rows = |first, count, range, depth_z, polygon_id, object_id, cos_incidence| Rows {
            first,
            count,
            range,
            depth_z,
            polygon_id,
            object_id,
            cos_incidence,
        };
        (
            rows(self.first, upper, range.0, depth_z.0, polygon_id.0, object_id.0, cos_incidence.0),
            rows(
                self.first + upper,
                self.count - upper,
                range.1,
                depth_z.1,
                polygon_id.1,
                object_id.1,
                cos_incidence.1,
            ),
        )
    }
}

/// Two parts, both empty of an image that is not there.
fn cut<T>(image: &mut [T], at: usize) -> (&mut [T], &mut [T]) {
    let at = at.min(image.len());
    image.split_at_mut(at)
}

/// Writes where the image is there.
fn put<T>(image: &mut [T], index: usize, value: T) {
    if let Some(pixel) = image.get_mut(index) {
        *pixel = value;
    }
}

/// Fills the images that are there; the answer is the number of hits without an id.
pub(super) fn resolve(
    plan: &FramePlan,
    params: &Params,
    keys: &[[u32; 2]],
    slots: &[Slot],
    images: &mut Images,
) -> u32 {
    let rows = Rows {
        first: 0,
        count: params.height,
        range: &mut images.range,
        depth_z: &mut images.depth_z,
        polygon_id: &mut images.polygon_id,
        object_id: &mut images.object_id,
        cos_incidence: &mut images.cos_incidence,
    };
    fill(&Keys { plan, params, keys }, slots, rows);
    keys.iter().filter(|[id, bits]| *bits != 0 && *id == 0).count() as u32
}

/// Halves the rows until they are few: no list of them is made.
fn fill(keys: &Keys<'_>, slots: &[Slot], mut rows: Rows<'_>) {
    let width = keys.params.width;
    if rows.count > 1 && rows.count * width > FEW_PIXELS {
        let (upper, lower) = rows.halves(width as usize);
        rayon::join(|| fill(keys, slots, upper), || fill(keys, slots, lower));
        return;
    }
    let source = keys.plan.drawn_ids() == IdScheme::Source;
    for row in 0..rows.count {
        for column in 0..width {
            let (length, depth, ids, cosine) = match keys.seen(column, rows.first + row) {
                PixelContent::NoRay => (f32::NAN, f32::NAN, [0; 2], f32::NAN),
                PixelContent::Nothing => (f32::INFINITY, f32::INFINITY, [0; 2], f32::NAN),
                PixelContent::Hit(h) => {
                    let slot = slots[h.slot as usize];
                    let id = if source { slot.source } else { h.slot + 1 };
                    let cosine = (h.k * slot.distance / h.ray).min(1.0);
                    let limited = |value: f32| if h.below { f32::NEG_INFINITY } else { value };
                    (limited(h.ray / h.k), limited(h.depth / h.k), [id, slot.object], cosine)
                }
            };
            let i = (row * width + column) as usize;
            put(rows.range, i, length);
            put(rows.depth_z, i, depth);
            put(rows.polygon_id, i, ids[0]);
            put(rows.object_id, i, ids[1]);
            put(rows.cos_incidence, i, cosine);
        }
    }
}
