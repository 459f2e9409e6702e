//! Normals of surfaces, from the points of neighbouring pixels.

use super::view::View;
use glam::Vec3;

/// Maximum second difference of 1 / range between neighbouring pixels, 1 / m. 1 / range is linear on a plane, so a
/// larger difference is a step. The noise of a depth camera's disparity is smaller.
const STEP: f32 = 0.02;
/// Minimum cosine of incidence: at more grazing rays, normals and ranges are unreliable.
pub(crate) const MIN_COSINE: f32 = 0.1;

/// The point, the unit normal towards the sensor and the cosine of incidence at a pixel, in the image frame. `None` at
/// a depth step or a missing range.
pub(crate) fn oriented(view: &View, pixel: usize) -> Option<(Vec3, Vec3, f32)> {
    let width = view.width();
    let [left, right, above, below] = [pixel - 1, pixel + 1, pixel - width, pixel + width];
    let inverse = |i: usize| 1.0 / view.ranges[i];
    let here = 2.0 * inverse(pixel);
    let is_flat = |a: usize, b: usize| (inverse(a) + inverse(b) - here).abs() < STEP;
    // The comparisons are false for NaN.
    if !(is_flat(left, right) && is_flat(above, below)) {
        return None;
    }
    let across = view.in_image(right) - view.in_image(left);
    let down = view.in_image(below) - view.in_image(above);
    let normal = down.cross(across).try_normalize()?;
    let p = view.in_image(pixel);
    let cosine = normal.dot(p) / p.length();
    let normal = if cosine > 0.0 { -normal } else { normal };
    (cosine.abs() > MIN_COSINE).then_some((p, normal, cosine.abs()))
}
