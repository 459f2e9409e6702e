//! The CPU twin of resolve.wgsl, which replaces the stage on a software adapter: converts a device's keys (the nearest
//! polygon and inverse depth of every ray) to images.

use super::{FramePlan, IdScheme, Images};
use presight_model::sensor::{LineAxis, PixelGrid};

/// The content of a pixel.
enum PixelContent {
    NoRay,
    Nothing,
    Hit(Hit),
}

/// The surface of a slot, with the values that pixels show.
pub struct KeySurface {
    /// Distance from the sensor to its plane, metres.
    pub distance: f32,
    /// Values of the id images, from 1.
    pub object: u32,
    /// Number of the source triangle, from 1.
    pub source: u32,
}

/// Keys of all rays, with the parameters of their drawing.
pub struct Keys<'a> {
    /// The frame.
    pub plan: &'a FramePlan,
    /// For cameras: column and row of the first pixel relative to the principal point, and focal lengths, pixels.
    pub first: [f32; 2],
    /// Focal lengths, pixels.
    pub focal: [f32; 2],
    /// Minimum and maximum range, metres.
    pub range: [f32; 2],
    /// The inverted slot and the bits of the inverse depth; column-major for scanners.
    pub keys: &'a [[u32; 2]],
}

impl Keys<'_> {
    fn size(&self) -> [u32; 2] {
        [self.plan.sensor.width(), self.plan.sensor.height()]
    }

    /// Length of the ray whose inverse depth was rasterized, depth per unit of it, and index of its key.
    fn scale(&self, column: u32, row: u32) -> Option<(f32, f32, usize)> {
        let [width, height] = self.size();
        let index = (row * width + column) as usize;
        match self.plan.sensor.grid() {
            PixelGrid::Lines(grid) if grid.axis() == LineAxis::Rows => {
                let x = (self.first[0] + column as f32) / self.focal[0];
                let y = (self.first[1] + row as f32) / self.focal[1];
                Some(((1.0 + x * x + y * y).sqrt(), 1.0, index))
            }
            PixelGrid::Lines(_) => Some((1.0, 0.0, (column * height + row) as usize)),
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
        if range > self.range[1] {
            return PixelContent::Nothing;
        }
        PixelContent::Hit(Hit { slot: !id, k, ray, depth, below: range < self.range[0] })
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

/// Some rows of every image; images that were not requested are empty.
struct Rows<'a> {
    first: u32,
    count: u32,
    range: &'a mut [f32],
    depth_z: &'a mut [f32],
    polygon_id: &'a mut [u32],
    object_id: &'a mut [u32],
    cos_incidence: &'a mut [f32],
}

/// An image of at most this size is not split over threads.
const FEW_PIXELS: u32 = 4096;

impl Rows<'_> {
    /// Splits into the upper and the lower half.
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

/// Splits an image at `at`; both parts of an empty image are empty.
fn cut<T>(image: &mut [T], at: usize) -> (&mut [T], &mut [T]) {
    let at = at.min(image.len());
    image.split_at_mut(at)
}

/// Writes a pixel unless the image is empty.
fn put<T>(image: &mut [T], index: usize, value: T) {
    if let Some(pixel) = image.get_mut(index) {
        *pixel = value;
    }
}

/// Fills the images that are not empty. Returns the number of hits without an id.
pub fn resolve_keys(keys: &Keys<'_>, surface_of: &(impl Fn(u32) -> KeySurface + Sync), images: &mut Images) -> u32 {
    let rows = Rows {
        first: 0,
        count: keys.size()[1],
        range: &mut images.range,
        depth_z: &mut images.depth_z,
        polygon_id: &mut images.polygon_id,
        object_id: &mut images.object_id,
        cos_incidence: &mut images.cos_incidence,
    };
    fill(keys, surface_of, rows);
    keys.keys.iter().filter(|[id, bits]| *bits != 0 && *id == 0).count() as u32
}

/// Splits the rows recursively, without a list of parts.
fn fill(keys: &Keys<'_>, surface_of: &(impl Fn(u32) -> KeySurface + Sync), mut rows: Rows<'_>) {
    let width = keys.size()[0];
    if rows.count > 1 && rows.count * width > FEW_PIXELS {
        let (upper, lower) = rows.halves(width as usize);
        rayon::join(|| fill(keys, surface_of, upper), || fill(keys, surface_of, lower));
        return;
    }
    let source = keys.plan.drawn_ids() == IdScheme::Source;
    for row in 0..rows.count {
        for column in 0..width {
            let (length, depth, ids, cosine) = match keys.seen(column, rows.first + row) {
                PixelContent::NoRay => (f32::NAN, f32::NAN, [0; 2], f32::NAN),
                PixelContent::Nothing => (f32::INFINITY, f32::INFINITY, [0; 2], f32::NAN),
                PixelContent::Hit(h) => {
                    let surface = surface_of(h.slot);
                    let id = if source { surface.source } else { h.slot + 1 };
                    let cosine = (h.k * surface.distance / h.ray).min(1.0);
                    let limited = |value: f32| if h.below { f32::NEG_INFINITY } else { value };
                    (limited(h.ray / h.k), limited(h.depth / h.k), [id, surface.object], cosine)
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
