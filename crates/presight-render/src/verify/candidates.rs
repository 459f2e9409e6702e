//! Which polygons a right engine may show at a pixel.

use super::bound::{FaceBound, Precision};
use crate::plan::{FramePlan, Instance};
use crate::reference::{Beam, Face, beams, cones, descend, instances};
use glam::DVec3;
use presight_model::threads::parallel_or_here;
use std::collections::HashMap;

/// A polygon that a right engine may show at a pixel, and what it may say of it there.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// What `polygon_id` shows.
    pub polygon_id: u32,
    /// What `object_id` shows.
    pub object_id: u32,
    /// Every right engine finds the ray inside this polygon; else only some do.
    pub sure: bool,
    /// Range on the polygon's own plane, metres; infinite or negative only beyond the outline of grazing polygons.
    pub range: f64,
    /// Least range within the error bound.
    pub nearest: f64,
    /// Greatest range within the error bound; may be infinite.
    pub farthest: f64,
    /// |cos| of the angle between ray and normal.
    pub cos_incidence: f64,
    /// Error bound of `cos_incidence`.
    pub cos_error: f64,
    /// Reflection factor of its material.
    pub reflection: f64,
    /// depth_z over range.
    pub depth_per_range: f64,
    /// Unit normal in the image frame, on the side that the ray comes from.
    pub(super) normal: DVec3,
}

/// What a right engine may show at a pixel.
#[derive(Clone, Debug, Default)]
pub struct CandidateSet {
    /// Nearest first.
    pub candidates: Vec<Candidate>,
    /// A right engine may find nothing at all.
    pub may_miss: bool,
    /// The sensor has no ray here.
    pub no_ray: bool,
    span: f64,
}

/// The candidate sets of some pixels (column, row): of the polygons whose outline, grown by the edge bound, holds the
/// ray those that are not farther than the nearest one which every right engine must see, within the range bound.
pub fn candidates(plan: &FramePlan, pixels: &[(u32, u32)], precision: Precision) -> Vec<CandidateSet> {
    if pixels.is_empty() {
        return Vec::new();
    }
    let mut beams = beams::<CandidateSet>(&plan.sensor, pixels.iter().copied());
    let mut widest = 0.0f64;
    for beam in &mut beams {
        beam.found.may_miss = true;
        beam.found.span = span(plan, beam.column, beam.row, precision);
        widest = widest.max(beam.found.span);
    }
    parallel_or_here(|| find(plan, &mut beams, precision, widest));
    // Beams come back in another order than they went.
    let found: HashMap<(u32, u32), CandidateSet> = beams.into_iter().map(|b| ((b.column, b.row), b.found)).collect();
    let no_ray = CandidateSet { no_ray: true, ..CandidateSet::default() };
    pixels.iter().map(|pixel| found.get(pixel).unwrap_or(&no_ray).clone()).collect()
}

/// Fills the candidate sets of rays, of which the greatest span is `widest`.
fn find(plan: &FramePlan, beams: &mut [Beam<CandidateSet>], precision: Precision, widest: f64) {
    let instances = instances(plan);
    let bound = |face: &Face, object: u32| FaceBound::new(face, instances[object as usize].center_in_mesh, precision);
    let (cones, _) = cones(plan, &instances, |face, object| Some(bound(face, object).widest() + widest));
    descend(beams, &cones, &|beams, cones| {
        for cone in cones {
            let face = face_of(plan, &instances, cone.object, cone.polygon);
            let bound = bound(&face, cone.object);
            for beam in beams.iter_mut() {
                let inside = bound.inside(&face, beam.ray, beam.found.span);
                if inside >= -1.0 {
                    let sure = inside >= 1.0 && !bound.may_be_edge_on;
                    let id = (plan.polygon_id(cone.object, cone.polygon), cone.object + 1);
                    let reflection = plan.reflection(cone.object, cone.polygon);
                    beam.found.candidates.push(Candidate::new(&face, &bound, beam.ray, (id, reflection), sure));
                }
            }
        }
        beams.iter_mut().for_each(|beam| beam.found.keep_nearest(precision, plan.sensor.spec().range_max));
    });
}

/// A polygon on whose plane pixels are compared.
pub(super) struct PlaneCandidate {
    face: Face,
    bound: FaceBound,
    ids: (u32, u32),
    reflection: f64,
}

impl PlaneCandidate {
    pub fn new(plan: &FramePlan, instance: &Instance, polygon: u32, precision: Precision) -> Self {
        let mesh = &plan.environment().objects()[instance.object as usize].mesh;
        let face = Face::new(instance, mesh, polygon);
        let bound = FaceBound::new(&face, instance.center_in_mesh, precision);
        let ids = (plan.polygon_id(instance.object, polygon), instance.object + 1);
        Self { face, bound, ids, reflection: plan.reflection(instance.object, polygon) }
    }

    /// What it would show along a ray that met it.
    pub fn at(&self, ray: DVec3) -> Candidate {
        Candidate::new(&self.face, &self.bound, ray, (self.ids, self.reflection), false)
    }
}

fn face_of(plan: &FramePlan, instances: &[Instance], object: u32, polygon: u32) -> Face {
    Face::new(&instances[object as usize], &plan.environment().objects()[object as usize].mesh, polygon)
}

/// The part of the angle to the nearest neighbouring ray that a span's end may be off by, radians.
pub fn span(plan: &FramePlan, column: u32, row: u32, precision: Precision) -> f64 {
    let sensor = &plan.sensor;
    let Some(ray) = sensor.ray(column, row) else {
        return 0.0;
    };
    let beside = [(column.wrapping_sub(1), row), (column + 1, row), (column, row.wrapping_sub(1)), (column, row + 1)];
    let least = beside
        .into_iter()
        .filter(|(c, r)| *c < sensor.width() && *r < sensor.height())
        .filter_map(|(c, r)| sensor.ray(c, r))
        .map(|other| ray.distance(other))
        .filter(|angle| *angle > 0.0)
        .fold(f64::INFINITY, f64::min);
    if least.is_finite() { least * precision.pixel_fraction() } else { 0.0 }
}

impl Candidate {
    /// `told` is what the plan knows of the polygon: its ids and its reflection factor.
    fn new(face: &Face, bound: &FaceBound, ray: DVec3, told: ((u32, u32), f64), sure: bool) -> Self {
        let ((polygon_id, object_id), reflection) = told;
        let inverse = face.inverse_range(ray);
        let error = bound.inverse_range(face, ray);
        let positive = |k: f64| if k > 0.0 { k.recip() } else { f64::INFINITY };
        Self {
            polygon_id,
            object_id,
            sure,
            range: inverse.recip(),
            nearest: positive(inverse + error),
            farthest: positive(inverse - error),
            cos_incidence: face.normal.dot(ray).abs(),
            cos_error: bound.shown_cosine,
            reflection,
            depth_per_range: ray.z,
            normal: if face.normal.dot(ray) > 0.0 { -face.normal } else { face.normal },
        }
    }

    /// True if both are sure to be met and lie in one plane as far as anyone can tell: a face stored twice.
    pub(super) fn coincides_with(&self, other: &Self) -> bool {
        let parallel = self.normal.cross(other.normal).length() < 1e-5;
        self.sure && other.sure && parallel && self.nearest <= other.farthest && other.nearest <= self.farthest
    }
}

impl CandidateSet {
    /// Drops what lies behind a polygon that every right engine sees.
    fn keep_nearest(&mut self, precision: Precision, range_max: f64) {
        let wall = self.candidates.iter().filter(|c| c.sure).map(|c| c.farthest).fold(f64::INFINITY, f64::min);
        let wall = wall * precision.limit_slack();
        self.candidates.retain(|c| c.nearest <= wall);
        self.candidates.sort_by(|a, b| a.nearest.total_cmp(&b.nearest).then(a.polygon_id.cmp(&b.polygon_id)));
        self.may_miss = wall >= range_max;
    }
}
