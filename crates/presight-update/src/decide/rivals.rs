//! Compares two explanations of the same readings, ray by ray: a shape at a pose, and boxes.

use crate::decide::boxes::UprightBox;
use crate::decide::decision::Decision;
use crate::decide::fit::{Thing, pixel_sigma};
use crate::observe::view::View;
use glam::DVec3;
use presight_model::geometry::{Aabb, Pose};
use presight_model::statistics::NOISE_BOUND;

/// A shape and boxes that may stand before the surfaces of the model.
pub(crate) struct Explanation<'a> {
    pub thing: Option<(&'a Thing, &'a Pose)>,
    pub boxes: &'a [UprightBox],
}

/// A surface on a ray: its range, metres, and the cosine of the incidence.
pub(crate) type Surface = (f64, f64);

/// Log-odds of one explanation against another: half the difference of their squared deviations, summed over all
/// readings. The bound of noise limits the deviation of a reading, and the maximum of a view limits its sum.
pub(crate) fn better(decision: &Decision<'_>, a: &Explanation<'_>, b: &Explanation<'_>, points: &Aabb) -> f64 {
    let bounds = [a, b].iter().fold(*points, |all, stand| all.union(stand.bounds()));
    let (middle, radius, max) = (bounds.center(), 0.5 * bounds.size(), decision.known.options.max_per_view);
    decision.known.views.iter().map(|view| of_view(decision, view, (a, b), (middle, radius)).clamp(-max, max)).sum()
}

fn of_view(
    decision: &Decision<'_>,
    view: &View,
    (a, b): (&Explanation<'_>, &Explanation<'_>),
    (middle, radius): (DVec3, f64),
) -> f64 {
    let (origin, reach) = (view.origin(), view.reach());
    if origin.distance(middle) > reach + radius {
        return 0.0;
    }
    let mut sum = 0.0;
    for (at, ray) in view.pixels.rays_at(view.world_from_image, (middle, radius)) {
        let z = f64::from(view.ranges[at]);
        if z.is_nan() || z == f64::NEG_INFINITY {
            continue;
        }
        let (a, b) = (a.first(decision, origin, ray, reach), b.first(decision, origin, ray, reach));
        if a.is_none() && b.is_none() {
            continue;
        }
        let behind = decision.caster.cast(origin, ray, reach, None).map(|hit| (hit.range, hit.normal.dot(ray).abs()));
        let deviation = |own: Option<Surface>| {
            let nearer = |known: Surface| behind.filter(|behind| behind.0 < known.0).unwrap_or(known);
            squared(view, z, own.map(nearer).or(behind))
        };
        sum += 0.5 * (deviation(b) - deviation(a));
    }
    sum
}

/// The squared deviation of a reading from a surface, in variances, at most the bound of noise.
pub(crate) fn squared(view: &View, z: f64, surface: Option<Surface>) -> f64 {
    let max = NOISE_BOUND * NOISE_BOUND;
    let Some((range, cos)) = surface else { return if z.is_finite() { max } else { 0.0 } };
    ((z - range) / pixel_sigma(view, range, cos)).powi(2).min(max)
}

impl Explanation<'_> {
    fn bounds(&self) -> Aabb {
        let thing = self.thing.map(|(thing, pose)| {
            let middle = pose.transform_point(thing.middle);
            Aabb { min: middle - thing.radius, max: middle + thing.radius }
        });
        let boxes = self.boxes.iter().map(|b| {
            let half = 0.5 * b.size.length();
            Aabb { min: b.pose.translation - half, max: b.pose.translation + half }
        });
        thing.into_iter().chain(boxes).fold(Aabb::EMPTY, |all, bounds| all.union(bounds))
    }

    fn first(&self, decision: &Decision<'_>, origin: DVec3, ray: DVec3, reach: f64) -> Option<Surface> {
        let hit =
            self.thing.and_then(|(thing, pose)| decision.caster.cast_at(thing.object, pose, (origin, ray, reach)));
        let thing = hit.map(|hit| (hit.range, hit.normal.dot(ray).abs()));
        let boxes = self.boxes.iter().filter_map(|b| b.meet(origin, ray).filter(|hit| hit.0 <= reach));
        thing.into_iter().chain(boxes).min_by(|x, y| x.0.total_cmp(&y.0))
    }
}
