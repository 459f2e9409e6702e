//! Conservative bounds: which polygons may touch which rays, by cones around both.

use super::face::Face;
use crate::plan::{FramePlan, Instance};
use glam::DVec3;
use presight_model::sensor::Sensor;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Margin of cones, radians: far above rounding (2e-8 for the arcsine near 1), but too small to cost time.
const SLACK: f64 = 1e-6;
/// A cone with a larger half angle is treated as unbounded, because it may not be convex.
const WIDEST: f64 = 1.4;
/// Bundles of at most this many rays are not split.
const LEAF: usize = 16;

/// A ray and its result.
#[derive(Clone, Debug)]
pub struct Beam<T> {
    /// Column of its pixel.
    pub column: u32,
    /// Row of its pixel.
    pub row: u32,
    /// Unit direction.
    pub ray: DVec3,
    /// The result.
    pub found: T,
}

/// The beams of some pixels; pixels without a ray are skipped.
pub fn beams<T: Default>(sensor: &Sensor, pixels: impl Iterator<Item = (u32, u32)>) -> Vec<Beam<T>> {
    pixels
        .filter_map(|(column, row)| Some(Beam { column, row, ray: sensor.ray(column, row)?, found: T::default() }))
        .collect()
}

/// A polygon with a cone around it.
#[derive(Clone, Copy, Debug)]
pub struct Cone {
    pub object: u32,
    pub polygon: u32,
    axis: DVec3,
    /// Half angle, radians; above [`WIDEST`] the cone is unbounded.
    half_angle: f64,
}

/// All objects as the sensor sees them, even if they were not selected.
pub fn instances(plan: &FramePlan) -> Vec<Instance> {
    (0..plan.environment().objects().len() as u32).map(|object| plan.instance_of(object)).collect()
}

/// The cones of all polygons that the sensor can see by their material. `grown` returns the angle by which to widen a
/// polygon's cone, or `None` to drop it. Also returns the number of dropped polygons.
pub fn cones(
    plan: &FramePlan,
    instances: &[Instance],
    grown: impl Fn(&Face, u32) -> Option<f64> + Sync,
) -> (Vec<Cone>, usize) {
    let (mut all, mut dropped) = (Vec::new(), 0);
    for instance in instances {
        let mesh = &plan.environment().objects()[instance.object as usize].mesh;
        let found: Vec<Option<Cone>> = (0..mesh.polygon_count() as u32)
            .into_par_iter()
            .with_min_len(1024)
            .filter_map(|polygon| {
                let facing = plan.facings[usize::from(mesh.material(polygon))];
                let face = Face::new(instance, mesh, polygon);
                let seen = facing.opaque && (!facing.one_sided || face.distance < 0.0);
                seen.then(|| {
                    grown(&face, instance.object)
                        .map(|angle| cone_around(instance.object, polygon, &face.corners, angle))
                })
            })
            .collect();
        dropped += found.iter().filter(|c| c.is_none()).count();
        all.extend(found.into_iter().flatten());
    }
    (all, dropped)
}

fn cone_around(object: u32, polygon: u32, corners: &[DVec3], grown: f64) -> Cone {
    let units: Vec<DVec3> = corners.iter().map(|v| v.normalize_or_zero()).collect();
    let (axis, half_angle) = around(units.iter().copied());
    Cone { object, polygon, axis, half_angle: half_angle + grown + SLACK }
}

/// Axis and half angle of a cone around unit vectors. A zero vector (a corner at the sensor) makes the cone unbounded.
fn around(units: impl Iterator<Item = DVec3> + Clone) -> (DVec3, f64) {
    let axis = units.clone().sum::<DVec3>().normalize_or_zero();
    // The largest chord belongs to the largest angle, so only one angle is computed.
    let chord = |u: DVec3| if u == DVec3::ZERO { 2.0 } else { axis.distance(u) };
    let farthest = if axis == DVec3::ZERO { 2.0 } else { units.map(chord).fold(0.0, f64::max) };
    (axis, 2.0 * (farthest / 2.0).min(1.0).asin())
}

/// Halves a bundle of rays recursively, keeps the polygons whose cones touch it, and passes small bundles to `leaf`.
/// Results do not depend on threads or the order of rays.
pub fn descend<T: Send>(beams: &mut [Beam<T>], cones: &[Cone], leaf: &(impl Fn(&mut [Beam<T>], &[Cone]) + Sync)) {
    let (axis, half_angle) = around(beams.iter().map(|b| b.ray));
    let touches = |c: &Cone| {
        let reach = c.half_angle + half_angle;
        c.half_angle > WIDEST || half_angle > WIDEST || c.axis.dot(axis) >= reach.min(PI).cos()
    };
    let kept: Vec<Cone> = cones.iter().filter(|c| touches(c)).copied().collect();
    if kept.is_empty() {
        return;
    }
    if beams.len() <= LEAF {
        return leaf(beams, &kept);
    }
    let span = |of: fn(&Beam<T>) -> u32| {
        let (least, most) = beams.iter().fold((u32::MAX, 0), |(l, m), b| (l.min(of(b)), m.max(of(b))));
        most - least
    };
    let middle = beams.len() / 2;
    if span(|b| b.column) >= span(|b| b.row) {
        beams.select_nth_unstable_by_key(middle, |b| (b.column, b.row));
    } else {
        beams.select_nth_unstable_by_key(middle, |b| (b.row, b.column));
    }
    let (left, right) = beams.split_at_mut(middle);
    rayon::join(|| descend(left, &kept, leaf), || descend(right, &kept, leaf));
}
