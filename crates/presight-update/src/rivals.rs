//! Two explanations of the same readings, ray by ray: a shape at a pose, or boxes.

use crate::boxes::UprightBox;
use crate::decide::Decision;
use crate::fit::Thing;
use crate::view::{BOUND, View};
use glam::DVec3;
use presight_model::geometry::{Aabb, Pose};

/// A surface is known no better than this, one standard deviation, metres.
const SURFACE: f64 = 0.005;

/// What may stand there, before what the model has.
pub(crate) struct Stand<'a> {
    pub thing: Option<(&'a Thing, &'a Pose)>,
    pub boxes: &'a [UprightBox],
}

/// A surface on a ray: its range, metres, and the cosine of the incidence.
pub(crate) type Surface = (f64, f64);

/// Logarithm of the odds of one explanation against another: half the difference of their squared deviations, each of a reading
/// bounded by that of noise, summed over the readings of a view up to the most that a view counts, and over all views.
pub(crate) fn better(decision: &Decision<'_>, a: &Stand<'_>, b: &Stand<'_>, points: &Aabb) -> f64 {
    let bounds = [a, b].iter().fold(*points, |all, stand| all.union(stand.bounds()));
    let (middle, radius, most) = (bounds.center(), 0.5 * bounds.size(), decision.options.most_per_view);
    decision.views.iter().map(|view| of_view(decision, view, (a, b), (middle, radius)).clamp(-most, most)).sum()
}

fn of_view(
    decision: &Decision<'_>,
    view: &View,
    (a, b): (&Stand<'_>, &Stand<'_>),
    (middle, radius): (DVec3, f64),
) -> f64 {
    let (origin, reach) = (view.world_from_image.translation, view.kept.sensor.spec().range_max.min(1e5));
    let toward = view.world_from_image.inverse().transform_point(middle);
    let distance = toward.length();
    if distance > reach + radius {
        return 0.0;
    }
    let cone = (radius / distance.max(radius)).asin().cos();
    let mut sum = 0.0;
    for (at, ray) in view.kept.rays.iter().enumerate().filter(|(_, ray)| ray.dot(toward) >= cone * distance) {
        let z = f64::from(view.ranges[at]);
        if z.is_nan() || z == f64::NEG_INFINITY {
            continue;
        }
        let ray = view.world_from_image.rotation * *ray;
        let (a, b) = (a.first(decision, origin, ray, reach), b.first(decision, origin, ray, reach));
        if a.is_none() && b.is_none() {
            continue;
        }
        let behind = decision.caster.cast(origin, ray, reach, None).map(|met| (met.range, met.normal.dot(ray).abs()));
        let deviation = |own: Option<Surface>| {
            let nearer = |known: Surface| behind.filter(|behind| behind.0 < known.0).unwrap_or(known);
            squared(view, z, own.map(nearer).or(behind))
        };
        sum += 0.5 * (deviation(b) - deviation(a));
    }
    sum
}

/// The squared deviation of a reading from a surface, in units of its variance, at most that of noise.
pub(crate) fn squared(view: &View, z: f64, surface: Option<Surface>) -> f64 {
    let most = BOUND * BOUND;
    let Some((range, cos)) = surface else { return if z.is_finite() { most } else { 0.0 } };
    let off = view.off.0 + range * (view.off.1 + view.noise.angle * (1.0 - cos * cos).max(0.0).sqrt());
    let sigma = view.noise.range_sigma(range) + (off + SURFACE) / cos.max(0.1);
    ((z - range) / sigma).powi(2).min(most)
}

impl Stand<'_> {
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
        let met =
            self.thing.and_then(|(thing, pose)| decision.caster.cast_at(thing.object, pose, (origin, ray, reach)));
        let thing = met.map(|met| (met.range, met.normal.dot(ray).abs()));
        let boxes = self.boxes.iter().filter_map(|b| b.meet(origin, ray).filter(|met| met.0 <= reach));
        thing.into_iter().chain(boxes).min_by(|x, y| x.0.total_cmp(&y.0))
    }
}
