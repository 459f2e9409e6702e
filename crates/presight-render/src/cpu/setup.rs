//! Setup: from runs of mesh polygons to planes and edges in the frame of the rays. Polygons that cover no ray are
//! dropped early.

use super::Bands;
use super::batch::{Batch, PolygonSetup};
use super::bounds::{Bounds, Footprint, LANES};
use super::cull;
use super::instance::RayInstance;
use super::lanes::PolygonLanes;
use super::sieve::{Sieve, is_bounded};
use crate::plan::{FramePlan, Run};
use glam::DVec3;
use presight_model::limits;
use presight_model::sensor::{LineGrid, PixelGrid};
use pulp::Simd;
use std::ops::Range;

/// Sets up the polygons of some runs, without those behind polygons drawn before.
#[inline(always)]
pub(super) fn fill<S: Simd>(simd: S, batch: &mut Batch, plan: &FramePlan, runs: &[Run], bands: &Bands) {
    batch.clear();
    let bounds = Bounds::new(&plan.sensor);
    let mut sieve = Sieve::new(&plan.sensor);
    let (mut passed, mut reaches) = (Vec::new(), Vec::new());
    let mut lanes = PolygonLanes::<LANES>::new();
    let mut room = Room::default();
    let mut placed: Option<(u32, RayInstance<'_>)> = None;
    for run in runs {
        let known = placed.take().filter(|(i, _)| *i == run.instance);
        let (_, at) = placed.insert(
            known.unwrap_or_else(|| (run.instance, RayInstance::new(plan, &plan.instances[run.instance as usize]))),
        );
        batch.placed += run.count as usize;
        passed.clear();
        reaches.clear();
        let cluster = sieve.pass(simd, at, run, |polygon, reach| {
            passed.push(polygon);
            reaches.push(reach);
        });
        batch.passed += passed.len();
        for (polygons, reaches) in passed.chunks(LANES).zip(reaches.chunks(LANES)) {
            lanes.load(at, polygons, cluster);
            let footprints = if reaches.iter().all(is_bounded) {
                bounds.cover_reached(lanes.corners(), reaches)
            } else {
                batch.bounded += polygons.len();
                bounds.cover(simd, lanes.corners())
            };
            set_up_loaded(batch, plan, at, polygons, &mut lanes, &footprints, &mut room);
        }
    }
    batch.bin(bands);
}

/// Sets up single polygons, given as sorted pairs of an object and a polygon of its mesh.
#[inline(always)]
pub(super) fn fill_polygons<S: Simd>(
    simd: S,
    batch: &mut Batch,
    plan: &FramePlan,
    polygons: &[(u32, u32)],
    lanes: &mut PolygonLanes<LANES>,
    bands: &Bands,
) {
    batch.clear();
    let (bounds, mut room) = (Bounds::new(&plan.sensor), Room::default());
    for of_object in polygons.chunk_by(|a, b| a.0 == b.0) {
        let instance = plan.instance_of(of_object[0].0);
        let at = RayInstance::new(plan, &instance);
        for some in of_object.chunks(LANES) {
            let mut eight = [0; LANES];
            eight.iter_mut().zip(some).for_each(|(to, (_, polygon))| *to = *polygon);
            let eight = &eight[..some.len()];
            lanes.load(&at, eight, None);
            let footprints = bounds.cover(simd, lanes.corners());
            set_up_loaded(batch, plan, &at, eight, lanes, &footprints, &mut room);
        }
    }
    batch.bin(bands);
}

/// Sets up the loaded polygons that may be visible.
#[inline(always)]
fn set_up_loaded(
    batch: &mut Batch,
    plan: &FramePlan,
    at: &RayInstance<'_>,
    polygons: &[u32],
    lanes: &mut PolygonLanes<LANES>,
    footprints: &[Footprint; LANES],
    room: &mut Room,
) {
    let mut left = 0u32;
    for (i, footprint) in footprints[..polygons.len()].iter().enumerate() {
        left |= u32::from(!footprint.lines[0].is_empty()) << i;
    }
    if left == 0 {
        return;
    }
    lanes.measure(at, polygons);
    left = visible_lanes(batch, plan, at, (polygons, left), lanes);
    if left == 0 {
        return;
    }
    lanes.set_up_planes(at);
    lanes.set_up_edges(at, polygons);
    if let PixelGrid::Lines(_) = plan.sensor.grid() {
        lanes.bound();
    }
    while left != 0 {
        let i = left.trailing_zeros() as usize;
        left &= left - 1;
        push(batch, plan, at, (polygons[i], i), lanes, &footprints[i], room);
    }
}

/// The lanes with a footprint whose polygon may be visible, a bit each.
#[inline(always)]
fn visible_lanes(
    batch: &mut Batch,
    plan: &FramePlan,
    at: &RayInstance<'_>,
    (polygons, with_footprint): (&[u32], u32),
    lanes: &PolygonLanes<LANES>,
) -> u32 {
    let (mut left, mut visible) = (with_footprint, 0);
    while left != 0 {
        let i = left.trailing_zeros() as usize;
        left &= left - 1;
        let facing = if at.plain { None } else { Some(plan.facings[usize::from(at.mesh.material(polygons[i]))]) };
        if facing.is_some_and(|f| !f.opaque) {
            continue;
        }
        if lanes.edge_on[i] {
            batch.edge_on += 1;
            continue;
        }
        if facing.is_some_and(|f| f.one_sided) && lanes.distance[i] > 0.0 {
            continue;
        }
        visible |= 1 << i;
    }
    visible
}

/// Room for one polygon's lower and upper bounds.
pub(super) struct Room([[[f64; 2]; limits::MAX_CORNERS]; 2]);

impl Default for Room {
    fn default() -> Self {
        Self([[[0.0; 2]; limits::MAX_CORNERS]; 2])
    }
}

/// Adds the polygon of a lane to the batch, unless it covers no sample.
#[inline(always)]
fn push(
    batch: &mut Batch,
    plan: &FramePlan,
    at: &RayInstance<'_>,
    (polygon, i): (u32, usize),
    lanes: &PolygonLanes<LANES>,
    footprint: &Footprint,
    room: &mut Room,
) {
    let (first_edge, [lower, upper, steep]) = match plan.sensor.grid() {
        PixelGrid::Lines(grid) => {
            let first = batch.bounds.len();
            let counts = push_bounds(&mut batch.bounds, lanes, i, room);
            if lanes.clear[i] && covers_nothing(grid, footprint, &batch.bounds[first..], counts) {
                batch.bounds.truncate(first);
                batch.between += 1;
                return;
            }
            (first as u32, counts)
        }
        PixelGrid::Rays(_) => {
            let (first, count) = (batch.edges.len() as u32, lanes.corner_counts[i]);
            let edges = lanes.edges[..count as usize].iter();
            batch.edges.extend(edges.map(|e| DVec3::new(e[0][i], e[1][i], e[2][i])));
            (first, [0, 0, count as u8])
        }
    };
    let shade = at.shade(plan, polygon, lanes.distance[i]);
    let m = DVec3::new(lanes.m[0][i], lanes.m[1][i], lanes.m[2][i]);
    // Otherwise rounding may draw the polygon nearer than it is.
    let nearest_inverse = if lanes.clear[i] { cull::nearest_inverse(footprint) } else { f64::INFINITY };
    let slot = at.first_slot + polygon;
    let Range { start: first_sample, end: end_sample } = footprint.samples;
    for lines in footprint.lines.iter().filter(|lines| !lines.is_empty()) {
        let Range { start: first_line, end: end_line } = *lines;
        batch.polygons.push(PolygonSetup {
            m,
            nearest_inverse,
            first_line,
            end_line,
            first_sample,
            end_sample,
            first_edge,
            lower,
            upper,
            steep,
        });
        batch.shades.push(shade);
        batch.slots.push(slot);
    }
}

/// Appends the edges as bounds of t on a line: lower bounds, upper bounds, then sign tests.
#[inline(always)]
pub(super) fn push_bounds<const N: usize>(
    bounds: &mut Vec<[f64; 2]>,
    lanes: &PolygonLanes<N>,
    i: usize,
    room: &mut Room,
) -> [u8; 3] {
    let n = lanes.corner_counts[i] as usize;
    let edges = || lanes.edges[..n].iter().map(|e| DVec3::new(e[0][i], e[1][i], e[2][i]));
    // Avoids a branch on the unpredictable sign: writes each bound to both lists and counts it in one.
    let (mut lower, mut upper, mut steep) = (0, 0, 0);
    let is_steep = |e: DVec3| e.z.abs() <= 1e-30 * (e.x.abs() + e.y.abs());
    let [lowers, uppers] = &mut room.0;
    for (e, bound) in edges().zip(&lanes.bounds) {
        let bound = [bound[0][i], bound[1][i]];
        (lowers[lower], uppers[upper]) = (bound, bound);
        let flat = is_steep(e);
        lower += usize::from(!flat & (e.z > 0.0));
        upper += usize::from(!flat & (e.z < 0.0));
        steep += usize::from(flat);
    }
    append(bounds, lowers, lower);
    append(bounds, uppers, upper);
    if steep > 0 {
        bounds.extend(edges().filter(|e| is_steep(*e)).map(|e| [e.x, e.y]));
    }
    [lower as u8, upper as u8, steep as u8]
}

/// Appends the first of some bounds. Up to four are copied as four, a number that the compiler knows: other copies are
/// calls.
#[inline(always)]
fn append(bounds: &mut Vec<[f64; 2]>, room: &[[f64; 2]; limits::MAX_CORNERS], count: usize) {
    let end = bounds.len() + count;
    match room.first_chunk::<4>() {
        Some(four) if count <= 4 => bounds.extend_from_slice(four),
        _ => bounds.extend_from_slice(&room[..count]),
    }
    bounds.truncate(end);
}

/// Maximum number of samples of a footprint for a test of each sample.
const FEW: usize = 6;

/// True if a small polygon lies between the samples. The samples of its footprint, with one more at either end of each
/// line for rounding, are tested as spans are drawn.
#[inline(always)]
fn covers_nothing(grid: &LineGrid, footprint: &Footprint, bounds: &[[f64; 2]], [lower, upper, steep]: [u8; 3]) -> bool {
    let (samples, [lines, more]) = (&footprint.samples, &footprint.lines);
    if lines.len() * samples.len() > FEW || !more.is_empty() {
        return false;
    }
    let all = grid.positions();
    let positions = &all[samples.start.saturating_sub(1) as usize..all.len().min(samples.end as usize + 1)];
    let (lower, rest) = bounds.split_at(usize::from(lower));
    let (upper, rest) = rest.split_at(usize::from(upper));
    for &[a, b] in &grid.lines()[lines.start as usize..lines.end as usize] {
        let (mut least, mut greatest) = (f64::NEG_INFINITY, f64::INFINITY);
        for e in lower {
            let t = e[0] * a + e[1] * b;
            least = if t > least { t } else { least };
        }
        for e in upper {
            let t = e[0] * a + e[1] * b;
            greatest = if t < greatest { t } else { greatest };
        }
        for e in &rest[..usize::from(steep)] {
            greatest = if e[0] * a + e[1] * b < 0.0 { f64::NEG_INFINITY } else { greatest };
        }
        if positions.iter().any(|&t| t >= least && t <= greatest) {
            return false;
        }
    }
    true
}
