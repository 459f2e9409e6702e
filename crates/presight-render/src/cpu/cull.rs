//! Occlusion culling. Runs are drawn nearest first, in waves. Before each wave, runs whose box is entirely behind the
//! z-buffer are dropped, so that cost follows the visible polygons.

use super::Bands;
use super::bounds::{Bounds, Footprint, LANES, Lanes, SLACK};
use super::instance::RayInstance;
use super::raster_lines::{Buffer, EIGHT};
use crate::plan::{FramePlan, Run};
use glam::DVec3;
use presight_model::geometry::Aabb;
use presight_model::sensor::{LineAxis, PixelGrid};
use pulp::Simd;

/// Side of the squares of pixels for which the farthest depth is kept.
pub(super) const TILE: usize = EIGHT;

/// Upper bound of the inverse depth in a footprint; infinite if unknown.
#[inline(always)]
pub(super) fn nearest_inverse(footprint: &Footprint) -> f64 {
    let nearest = footprint.nearest * (1.0 - SLACK);
    if nearest > 0.0 { 1.0 / nearest } else { f64::INFINITY }
}

/// The runs that may be visible: all but those behind the content of the bands.
#[inline(always)]
pub(super) fn visible<S: Simd>(
    simd: S,
    plan: &FramePlan,
    bounds: &Bounds<'_>,
    runs: &[Run],
    canvas: &[Buffer],
    bands: &Bands,
) -> Vec<Run> {
    let mut kept = Vec::with_capacity(runs.len());
    let mut placed: Option<(u32, RayInstance<'_>)> = None;
    for eight in runs.chunks(LANES) {
        let mut corners = [[[0.0; LANES]; 3]; 8];
        let mut nearest = [0.0; LANES];
        for (l, run) in eight.iter().enumerate() {
            let known = placed.take().filter(|(i, _)| *i == run.instance);
            let (_, at) = placed.insert(
                known.unwrap_or_else(|| (run.instance, RayInstance::new(plan, &plan.instances[run.instance as usize]))),
            );
            let around = place_box(at, run, l, &mut corners);
            nearest[l] = nearest_depth(&around, plan.sensor.grid());
        }
        for (l, footprint) in bounds.cover(simd, &corners).iter().enumerate().take(eight.len()) {
            // In front of the sensor and away from its axis; other boxes have no useful footprint.
            let hidden = nearest[l] > 0.0 && is_behind(footprint, 1.0 / nearest[l], canvas, bands);
            if !hidden {
                kept.push(eight[l]);
            }
        }
    }
    kept
}

/// Puts a run's box into a lane. Returns the box around it in the frame of the rays.
#[inline(always)]
fn place_box(at: &RayInstance<'_>, run: &Run, lane: usize, corners: &mut [[Lanes; 3]; 8]) -> Aabb {
    let Aabb { min, max } = at.mesh.cluster_of(run.first).1.bounds;
    let mut around = Aabb::EMPTY;
    for (i, corner) in corners.iter_mut().enumerate() {
        let pick = |bit: usize, low: f64, high: f64| if i >> bit & 1 == 0 { low } else { high };
        let p = DVec3::new(pick(0, min.x, max.x), pick(1, min.y, max.y), pick(2, min.z, max.z));
        let w = at.ray_from_mesh * (p - at.center);
        around = around.with(w);
        (corner[0][lane], corner[1][lane], corner[2][lane]) = (w.x, w.y, w.z);
    }
    around
}

/// Minimum depth of a box in the frame of the rays; 0 if it has no bound.
#[inline(always)]
fn nearest_depth(around: &Aabb, grid: &PixelGrid) -> f64 {
    let distance = || around.distance_squared(DVec3::ZERO).sqrt() * (1.0 - SLACK);
    match grid {
        PixelGrid::Rays(_) => distance(),
        // Pinhole depth is the middle coordinate of the line frame.
        PixelGrid::Lines(lines) if lines.axis() == LineAxis::Rows => around.min.y * (1.0 - SLACK),
        // A box around the scanner's axis has no azimuth interval.
        PixelGrid::Lines(_) => {
            let beside = around.min.max(-around.max).truncate().max_element() > 0.0;
            if beside { distance() } else { 0.0 }
        }
    }
}

/// True if all pixels in every tile of the footprint are nearer than `inverse`.
#[inline(always)]
fn is_behind(footprint: &Footprint, inverse: f64, canvas: &[Buffer], bands: &Bands) -> bool {
    let columns = footprint.samples.start as usize / TILE..(footprint.samples.end as usize).div_ceil(TILE);
    footprint.lines.iter().filter(|lines| !lines.is_empty()).all(|lines| {
        let rows = lines.start as usize / TILE..(lines.end as usize).div_ceil(TILE);
        rows.into_iter().all(|row| {
            let (band, first) = (row * TILE / bands.per_band, row * TILE % bands.per_band / TILE);
            canvas[band].farthest_of_row(first)[columns.clone()].iter().all(|&k| k > inverse)
        })
    })
}

/// Measures the minimum inverse depth of every tile of a band; 0 where a ray has hit no polygon yet.
#[inline(always)]
pub(super) fn measure(buffer: &mut Buffer, lines: usize, samples: usize) {
    buffer.clear_farthest(lines, samples, f64::INFINITY);
    if let Some(few) = buffer.few {
        for row in 0..lines.div_ceil(TILE) {
            let octets = buffer.inverse[row * few..(row + 1) * few].iter();
            let least = octets.flat_map(|octet| octet.0).fold(f64::INFINITY, |a, b| if b < a { b } else { a });
            *buffer.farthest_of(row, 0) = least;
        }
        return;
    }
    for first in (0..lines).step_by(TILE) {
        for column in 0..samples.div_ceil(TILE) {
            let mut least = [f64::INFINITY; EIGHT];
            for line in first..lines.min(first + TILE) {
                let inverse = &buffer.inverse[buffer.at(line, column)].0;
                for i in 0..EIGHT {
                    least[i] = if inverse[i] < least[i] { inverse[i] } else { least[i] };
                }
            }
            let mut all = f64::INFINITY;
            for k in least {
                all = if k < all { k } else { all };
            }
            *buffer.farthest_of(first / TILE, column) = all;
        }
    }
}
