//! What a page shows of a finding: its place, and how its evidence grew.

use crate::decide::{Doubt, Finding, What};
use crate::view::View;
use crate::voxels::Spot;
use glam::DVec3;
use presight_model::environment::{Environment, Object};
use presight_model::geometry::{Aabb, Pose};

impl Finding {
    /// The corners of boxes around the places that it changes, world frame, metres; of a moved object both places. Empty if
    /// the environment has no such object.
    pub fn corners(&self, environment: &Environment) -> Vec<DVec3> {
        let object = environment.object(&self.object);
        let own = |pose: fn(&Pose, &Finding) -> Pose| {
            object.map_or(Vec::new(), |o| {
                let bounds = o.mesh.bounds().transformed(&o.object_from_mesh);
                corners(&bounds, &pose(&o.world_from_object, self))
            })
        };
        match &self.what {
            What::Gone | What::SeenThrough(_) | What::ComesAndGoes => own(|pose, _| *pose),
            What::Moved { .. } => [own(|pose, _| *pose), own(moved)].concat(),
            What::Part(bounds) => object.map_or(Vec::new(), |o| corners(bounds, &o.world_from_object)),
            What::New(found) => corners(&Aabb { min: -0.5 * found.size, max: 0.5 * found.size }, &found.pose),
            What::Recognized(known) => corners(&known.shape.bounds(), &known.world_from_object),
        }
    }
}

impl Doubt {
    /// The corners of the box around its object, world frame, metres; empty if the environment has no such object.
    pub fn corners(&self, environment: &Environment) -> Vec<DVec3> {
        let bounds = |o: &Object| o.mesh.bounds().transformed(&o.object_from_mesh);
        environment.object(&self.object).map_or_else(Vec::new, |o| corners(&bounds(o), &o.world_from_object))
    }
}

fn moved(before: &Pose, finding: &Finding) -> Pose {
    match &finding.what {
        What::Moved { world_from_object, .. } => *world_from_object,
        _ => *before,
    }
}

fn corners(bounds: &Aabb, pose: &Pose) -> Vec<DVec3> {
    let at = |k: u32, axis: usize| if k >> axis & 1 == 0 { bounds.min[axis] } else { bounds.max[axis] };
    (0..8).map(|k| pose.transform_point(DVec3::new(at(k, 0), at(k, 1), at(k, 2)))).collect()
}

/// How the odds of something new grew, view by view: each view counts the points in a ball around it, or that it passed through its
/// middle, up to `most`.
pub(crate) fn growth_of_new<'a>(
    views: impl Iterator<Item = &'a View>,
    (middle, radius): (DVec3, f64),
    most: f64,
) -> Vec<f32> {
    let says = |view: &View| {
        let hits = view.news.iter().filter(|p| p.distance(middle) <= radius).count() as f64;
        if hits == 0.0 && view.passed(&Spot::cube(middle, radius), radius) { -most } else { hits.min(most) }
    };
    let sums = views.map(says).filter(|said| *said != 0.0).scan(0.0, |sum, said| {
        *sum += said;
        Some(*sum as f32)
    });
    sums.collect()
}
