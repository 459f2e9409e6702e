//! Normals of surfaces, from the points of neighbouring pixels.

use super::view::View;
use glam::Vec3;

/// Largest second difference of 1 / range between neighbouring pixels, 1 / m. On a plane 1 / range is linear, so that
/// larger ones are steps. The disparity of depth cameras is noisy by less.
const STEP: f32 = 0.02;
/// Least cosine of incidence: normals and distances of flatter rays are of little worth.
pub(crate) const LEAST_COSINE: f32 = 0.1;

/// Point, unit normal towards the sensor and cosine of incidence of a pixel, in the image frame. `None` at steps.
pub(crate) fn oriented(view: &View, pixel: usize) -> Option<(Vec3, Vec3, f32)> {
    let width = view.width();
    let [left, right, above, below] = [pixel - 1, pixel + 1, pixel - width, pixel + width];
    let inverse = |i: usize| 1.0 / view.ranges[i];
    let here = 2.0 * inverse(pixel);
    let is_flat = |a: usize, b: usize| (inverse(a) + inverse(b) - here).abs() < STEP;
    // False where a range is NaN.
    if !(is_flat(left, right) && is_flat(above, below)) {
        return None;
    }
    let across = view.in_image(right) - view.in_image(left);
    let down = view.in_image(below) - view.in_image(above);
    let normal = down.cross(across).try_normalize()?;
    let p = view.in_image(pixel);
    let cosine = normal.dot(p) / p.length();
    let normal = if cosine > 0.0 { -normal } else { normal };
    (cosine.abs() > LEAST_COSINE).then_some((p, normal, cosine.abs()))
}
