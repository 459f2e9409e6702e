//! Setup: from runs of mesh polygons to planes and edges in the frame of the rays, dropping early what covers none.

use super::Bands;
use super::batch::{Batch, PolygonSetup, Shade};
use super::bounds::{Bounds, Footprint, LANES, Lanes};
use crate::environment::{Mesh, PolygonRecord};
use crate::limits;
use crate::plan::{FramePlan, Instance, Run};
use crate::sensor::PixelGrid;
use glam::{DMat3, DVec3};
use pulp::Simd;
use std::ops::Range;

/// One instance in the frame of the rays.
pub(super) struct RayInstance<'a> {
    pub mesh: &'a Mesh,
    pub ray_from_mesh: DMat3,
    /// Turns a mesh normal over its plane distance into m.
    m_from_normal: DMat3,
    normal_from_mesh: DMat3,
    /// What [`RayInstance::length_per_distance`] is for every normal, if it is.
    uniform: Option<f64>,
    pub center: DVec3,
    mirrored: bool,
    plain: bool,
    object: u32,
    first_slot: u32,
}

impl<'a> RayInstance<'a> {
    pub fn new(plan: &'a FramePlan, instance: &Instance) -> Self {
        let (ray_from_image, image_from_ray) = match plan.sensor.grid() {
            PixelGrid::Lines(grid) => (grid.line_from_image(), grid.image_from_line()),
            PixelGrid::Rays(_) => (DMat3::IDENTITY, DMat3::IDENTITY),
        };
        let ray_from_mesh = ray_from_image * instance.image_from_mesh;
        let object = &plan.environment().objects()[instance.object as usize];
        Self {
            mesh: &object.mesh,
            ray_from_mesh,
            m_from_normal: image_from_ray.transpose() * instance.normal_from_mesh,
            normal_from_mesh: instance.normal_from_mesh,
            uniform: uniform_scale(&instance.normal_from_mesh).map(f64::recip),
            center: instance.center_in_mesh,
            mirrored: ray_from_mesh.determinant() < 0.0,
            plain: instance.plain,
            object: instance.object,
            first_slot: object.first_slot,
        }
    }

    /// True metres per metre of a plane's distance in the mesh frame.
    #[inline(always)]
    fn length_per_distance(&self, normal: DVec3) -> f64 {
        match self.uniform {
            Some(factor) => factor,
            None => (self.normal_from_mesh * normal).length().recip(),
        }
    }
}

/// The length of every turned unit vector, if it is the same for all to rounding: most instances are at most scaled.
fn uniform_scale(m: &DMat3) -> Option<f64> {
    let squares = [m.x_axis, m.y_axis, m.z_axis].map(|c| c.length_squared());
    let skew = [m.x_axis.dot(m.y_axis), m.y_axis.dot(m.z_axis), m.z_axis.dot(m.x_axis)];
    let rounding = 1e-13 * squares[0];
    let alike = (squares[0] - squares[1]).abs() <= rounding && (squares[0] - squares[2]).abs() <= rounding;
    (alike && skew.iter().all(|s| s.abs() <= rounding)).then(|| squares[0].sqrt())
}

/// Sets up the polygons of some runs.
#[inline(always)]
pub(super) fn fill<S: Simd>(simd: S, batch: &mut Batch, plan: &FramePlan, runs: &[Run], bands: &Bands) {
    batch.clear();
    let bounds = Bounds::new(&plan.sensor);
    let mut corners: CornerLanes = [[[0.0; LANES]; 3]; limits::MAX_CORNERS];
    let mut outline = Outline::new();
    let mut placed: Option<(u32, RayInstance<'_>)> = None;
    for run in runs {
        let known = placed.take().filter(|(i, _)| *i == run.instance);
        let (_, at) = placed.insert(
            known.unwrap_or_else(|| (run.instance, RayInstance::new(plan, &plan.instances[run.instance as usize]))),
        );
        let end = run.first + run.count;
        for first in (run.first..end).step_by(LANES) {
            let records = &at.mesh.polygons()[first as usize..end.min(first + LANES as u32) as usize];
            let footprints = cover_lanes(simd, &bounds, at, records, &mut corners);
            for (i, footprint) in footprints.into_iter().take(records.len()).enumerate() {
                if !footprint.lines[0].is_empty() {
                    let corners = |k: usize| DVec3::from(corners[k].map(|lanes| lanes[i]));
                    set_up(batch, plan, at, first + i as u32, footprint, corners, &mut outline);
                }
            }
        }
    }
    batch.bin(bands);
}

/// Room for one polygon's corners, edge planes and bounds, kept from polygon to polygon: clearing it costs more than
/// filling it.
struct Outline {
    corners: [DVec3; limits::MAX_CORNERS],
    planes: [DVec3; limits::MAX_CORNERS],
    lower: [[f64; 2]; limits::MAX_CORNERS],
    upper: [[f64; 2]; limits::MAX_CORNERS],
}

impl Outline {
    fn new() -> Self {
        let (points, bounds) = ([DVec3::ZERO; limits::MAX_CORNERS], [[0.0; 2]; limits::MAX_CORNERS]);
        Self { corners: points, planes: points, lower: bounds, upper: bounds }
    }
}

/// Corners of [`LANES`] polygons, x, y and z apart.
type CornerLanes = [[Lanes; 3]; limits::MAX_CORNERS];

/// The footprints of up to [`LANES`] polygons; lanes without one repeat the last.
#[inline(always)]
fn cover_lanes<S: Simd>(
    simd: S,
    bounds: &Bounds<'_>,
    at: &RayInstance<'_>,
    records: &[PolygonRecord],
    corners: &mut CornerLanes,
) -> [Footprint; LANES] {
    let (vertices, all_corners) = (at.mesh.vertices(), at.mesh.all_corners());
    let record = |l: usize| &records[l.min(records.len() - 1)];
    let first: [u32; LANES] = std::array::from_fn(|l| record(l).first_corner);
    let last: [u32; LANES] = std::array::from_fn(|l| u32::from(record(l).corner_count) - 1);
    let count = last.iter().max().map_or(0, |&m| m as usize + 1);
    let (m, center) = (at.ray_from_mesh, at.center);
    for (i, corner) in corners[..count].iter_mut().enumerate() {
        let (mut x, mut y, mut z) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for l in 0..LANES {
            let p = vertices[all_corners[(first[l] + last[l].min(i as u32)) as usize] as usize];
            (x[l], y[l], z[l]) = (f64::from(p.x), f64::from(p.y), f64::from(p.z));
        }
        for l in 0..LANES {
            let (x, y, z) = (x[l] - center.x, y[l] - center.y, z[l] - center.z);
            corner[0][l] = m.x_axis.x * x + m.y_axis.x * y + m.z_axis.x * z;
            corner[1][l] = m.x_axis.y * x + m.y_axis.y * y + m.z_axis.y * z;
            corner[2][l] = m.x_axis.z * x + m.y_axis.z * y + m.z_axis.z * z;
        }
    }
    bounds.cover(simd, &corners[..count])
}

#[inline(always)]
fn set_up(
    batch: &mut Batch,
    plan: &FramePlan,
    at: &RayInstance<'_>,
    polygon: u32,
    footprint: Footprint,
    corner_in_ray_frame: impl Fn(usize) -> DVec3,
    outline: &mut Outline,
) {
    let record = &at.mesh.polygons()[polygon as usize];
    let facing = if at.plain { None } else { Some(plan.facings[usize::from(record.material)]) };
    if facing.is_some_and(|f| !f.opaque) {
        return;
    }
    let indices = corner_indices(at, record);
    let vertices = at.mesh.vertices();
    let plane = at.mesh.planes()[polygon as usize];
    // The plane's distance from the sensor, along the mesh normal; its sign is the side, and must be proven. Taken at the
    // nearest corner, and the sensor must be farther off the plane than the corners are: else the edges span no cone.
    let from_center = |i: &u32| vertices[*i as usize].as_dvec3() - at.center;
    let mut nearest = from_center(&indices[0]);
    let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
    for p in indices.iter().map(from_center) {
        let off = plane.normal.dot(p);
        (least, most) = (least.min(off), most.max(off));
        nearest = if p.length_squared() < nearest.length_squared() { p } else { nearest };
    }
    let d = plane.normal.dot(nearest);
    let reach = nearest.abs().element_sum();
    let rounding = 16.0 * f64::EPSILON * reach + if indices.len() > 3 { most - least } else { 0.0 };
    if d.abs() <= rounding {
        batch.edge_on += 1;
        return;
    }
    if facing.is_some_and(|f| f.one_sided) && d > 0.0 {
        return;
    }
    for (k, corner) in outline.corners[..indices.len()].iter_mut().enumerate() {
        *corner = corner_in_ray_frame(k);
    }
    let outward = if (d > 0.0) == at.mirrored { -1.0 } else { 1.0 };
    let (first_edge, [lower, upper, steep]) = match plan.sensor.grid() {
        PixelGrid::Lines(_) => (batch.bounds.len() as u32, line_edges(batch, indices, outline, outward)),
        PixelGrid::Rays(_) => (batch.edges.len() as u32, plane_edges(batch, indices, outline, outward)),
    };
    let shade = Shade {
        distance: d.abs() * at.length_per_distance(plane.normal),
        polygon_id: plan.polygon_id(at.object, polygon),
        object_id: at.object + 1,
    };
    let m = at.m_from_normal * plane.normal / d;
    let slot = at.first_slot + polygon;
    let Range { start: first_sample, end: end_sample } = footprint.samples;
    for lines in footprint.lines.into_iter().filter(|lines| !lines.is_empty()) {
        let Range { start: first_line, end: end_line } = lines;
        batch.polygons.push(PolygonSetup {
            m,
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

#[inline(always)]
fn corner_indices<'a>(at: &RayInstance<'a>, record: &PolygonRecord) -> &'a [u32] {
    let first = record.first_corner as usize;
    &at.mesh.all_corners()[first..first + usize::from(record.corner_count)]
}

/// The plane through the centre and edge k, inside positive. Computed from the lower vertex index to the higher, sign
/// afterwards, so that neighbours get exactly opposite planes and no ray falls between them.
#[inline(always)]
fn edge_plane(indices: &[u32], corners: &[DVec3], k: usize, outward: f64) -> DVec3 {
    let l = if k + 1 == corners.len() { 0 } else { k + 1 };
    let (a, b, sign) = if indices[k] < indices[l] { (k, l, outward) } else { (l, k, -outward) };
    corners[a].cross(corners[b] - corners[a]) * sign
}

/// Appends the edges as bounds of t on a line: lower ones, upper ones, then those that only have a sign.
#[inline(always)]
fn line_edges(batch: &mut Batch, indices: &[u32], outline: &mut Outline, outward: f64) -> [u8; 3] {
    let n = indices.len();
    let (corners, planes) = (&outline.corners, &mut outline.planes);
    for (k, plane) in planes[..n].iter_mut().enumerate() {
        *plane = edge_plane(indices, &corners[..n], k, outward);
    }
    // Without a branch on the sign, which no processor can foresee: each bound is written to both lists, and counted in one.
    let (mut lower, mut upper, mut steep) = (0, 0, 0);
    let is_steep = |e: DVec3| e.z.abs() <= 1e-30 * (e.x.abs() + e.y.abs());
    for e in &planes[..n] {
        let bound = [-e.x / e.z, -e.y / e.z];
        (outline.lower[lower], outline.upper[upper]) = (bound, bound);
        let flat = is_steep(*e);
        lower += usize::from(!flat & (e.z > 0.0));
        upper += usize::from(!flat & (e.z < 0.0));
        steep += usize::from(flat);
    }
    batch.bounds.extend_from_slice(&outline.lower[..lower]);
    batch.bounds.extend_from_slice(&outline.upper[..upper]);
    if steep > 0 {
        batch.bounds.extend(planes[..n].iter().filter(|e| is_steep(**e)).map(|e| [e.x, e.y]));
    }
    [lower as u8, upper as u8, steep as u8]
}

/// Appends the edge planes as they are.
#[inline(always)]
fn plane_edges(batch: &mut Batch, indices: &[u32], outline: &Outline, outward: f64) -> [u8; 3] {
    let n = indices.len();
    batch.edges.extend((0..n).map(|k| edge_plane(indices, &outline.corners[..n], k, outward)));
    [0, 0, n as u8]
}
