//! Candidates: the polygons that a correct engine may show at a pixel.

use super::bound::{FaceBound, Precision};
use crate::plan::{FramePlan, Instance};
use crate::reference::{Beam, Face, beams, cones, descend, instances};
use glam::DVec3;
use presight_model::threads::parallel_or_here;
use std::collections::HashMap;

/// A polygon that a correct engine may show at a pixel, with the values that it may have there.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Value of `polygon_id`.
    pub polygon_id: u32,
    /// Value of `object_id`.
    pub object_id: u32,
    /// True if the ray is inside this polygon for every correct engine; otherwise only some find it.
    pub sure: bool,
    /// Range on the polygon's plane, metres; infinite or negative only beyond the outline of grazing polygons.
    pub range: f64,
    /// Minimum range within the error bound.
    pub nearest: f64,
    /// Maximum range within the error bound; may be infinite.
    pub farthest: f64,
    /// |cos| of the angle between ray and normal.
    pub cos_incidence: f64,
    /// Error bound of `cos_incidence`.
    pub cos_error: f64,
    /// Reflection factor of its material.
    pub reflection: f64,
    /// Ratio of depth_z to range.
    pub depth_per_range: f64,
    /// Unit normal in the image frame, on the side of the sensor.
    pub(super) normal: DVec3,
}

/// Everything that a correct engine may show at a pixel.
#[derive(Clone, Debug, Default)]
pub struct CandidateSet {
    /// Nearest first.
    pub candidates: Vec<Candidate>,
    /// True if a correct engine may find no hit.
    pub may_miss: bool,
    /// True if the sensor has no ray here.
    pub no_ray: bool,
    span: f64,
}

/// The candidate sets of some pixels (column, row). A polygon is a candidate if its outline, enlarged by the edge
/// bound, contains the ray, and it is not behind a polygon that every correct engine must see, within the range bound.
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
    // Beams come back in another order.
    let found: HashMap<(u32, u32), CandidateSet> = beams.into_iter().map(|b| ((b.column, b.row), b.found)).collect();
    let no_ray = CandidateSet { no_ray: true, ..CandidateSet::default() };
    pixels.iter().map(|pixel| found.get(pixel).unwrap_or(&no_ray).clone()).collect()
}

/// Fills the candidate sets of rays; `widest` is the largest span.
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
                    let ids = PolygonIds::of(plan, cone.object, cone.polygon);
                    beam.found.candidates.push(Candidate::new(&face, &bound, beam.ray, ids, sure));
                }
            }
        }
        beams.iter_mut().for_each(|beam| beam.found.keep_nearest(precision, plan.sensor.spec().range_max));
    });
}

/// A polygon whose plane pixels are compared with.
pub(super) struct PlaneCandidate {
    face: Face,
    bound: FaceBound,
    ids: PolygonIds,
}

/// How pixels show a polygon.
#[derive(Clone, Copy)]
struct PolygonIds {
    polygon_id: u32,
    object_id: u32,
    /// Factor of the echo.
    reflection: f64,
    /// Metres by which ranges exceed the distance from where rays start.
    lead: f64,
}

impl PolygonIds {
    fn of(plan: &FramePlan, object: u32, polygon: u32) -> Self {
        let reflection = plan.reflection(object, polygon);
        let lead = plan.sensor.range_lead();
        Self { polygon_id: plan.polygon_id(object, polygon), object_id: object + 1, reflection, lead }
    }
}

impl PlaneCandidate {
    pub fn new(plan: &FramePlan, instance: &Instance, polygon: u32, precision: Precision) -> Self {
        let mesh = &plan.environment().objects()[instance.object as usize].mesh;
        let face = Face::new(instance, mesh, polygon);
        let bound = FaceBound::new(&face, instance.center_in_mesh, precision);
        Self { face, bound, ids: PolygonIds::of(plan, instance.object, polygon) }
    }

    /// Its values for a ray, as if the ray met it.
    pub fn at(&self, ray: DVec3) -> Candidate {
        Candidate::new(&self.face, &self.bound, ray, self.ids, false)
    }
}

fn face_of(plan: &FramePlan, instances: &[Instance], object: u32, polygon: u32) -> Face {
    Face::new(&instances[object as usize], &plan.environment().objects()[object as usize].mesh, polygon)
}

/// Allowed error of a span's end at a pixel: a fraction of the angle to the nearest neighbouring ray, radians.
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
    fn new(face: &Face, bound: &FaceBound, ray: DVec3, ids: PolygonIds, sure: bool) -> Self {
        let PolygonIds { polygon_id, object_id, reflection, lead } = ids;
        let inverse = face.inverse_range(ray);
        let error = bound.inverse_range(face, ray);
        let positive = |k: f64| if k > 0.0 { k.recip() } else { f64::INFINITY };
        Self {
            polygon_id,
            object_id,
            sure,
            range: inverse.recip() + lead,
            nearest: positive(inverse + error) + lead,
            farthest: positive(inverse - error) + lead,
            cos_incidence: face.normal.dot(ray).abs(),
            cos_error: bound.shown_cosine,
            reflection,
            depth_per_range: ray.z,
            normal: if face.normal.dot(ray) > 0.0 { -face.normal } else { face.normal },
        }
    }

    /// True if both are certain hits in the same plane, within the bounds: a face that is stored twice.
    pub(super) fn coincides_with(&self, other: &Self) -> bool {
        let parallel = self.normal.cross(other.normal).length() < 1e-5;
        self.sure && other.sure && parallel && self.nearest <= other.farthest && other.nearest <= self.farthest
    }
}

impl CandidateSet {
    /// Drops polygons behind one that every correct engine sees.
    fn keep_nearest(&mut self, precision: Precision, range_max: f64) {
        let wall = self.candidates.iter().filter(|c| c.sure).map(|c| c.farthest).fold(f64::INFINITY, f64::min);
        let wall = wall * precision.limit_slack();
        self.candidates.retain(|c| c.nearest <= wall);
        self.candidates.sort_by(|a, b| a.nearest.total_cmp(&b.nearest).then(a.polygon_id.cmp(&b.polygon_id)));
        self.may_miss = wall >= range_max;
    }
}
