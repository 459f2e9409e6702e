//! Parts of a real environment that a drive saw, and surfaces of a model where there is none.

use glam::DVec3;
use presight_model::environment::Environment;
use presight_model::geometry::Aabb;
use presight_model::union_find::UnionFind;
use presight_testkit::judge::Placed;
use presight_testkit::oracle::Oracle;
use std::collections::{BTreeMap, HashMap};

/// For each slot the part of its polygon: polygons that share a corner, to a millimetre, are one part.
fn parts(real: &Environment) -> HashMap<u32, usize> {
    let count = real.objects().iter().map(|object| object.mesh.polygon_count()).sum();
    let (mut corners, mut parts, mut of_slot) = (HashMap::<[i64; 3], u32>::new(), UnionFind::new(count), Vec::new());
    for object in real.objects().iter().filter(|o| !o.is_deleted()) {
        for polygon in 0..object.mesh.polygon_count() as u32 {
            let own = of_slot.len() as u32;
            of_slot.push(object.first_slot + polygon);
            for p in object.polygon_in_world(polygon) {
                let first = *corners.entry((1e3 * p).round().to_array().map(|c| c as i64)).or_insert(own);
                parts.join_to(first, own);
            }
        }
    }
    of_slot.into_iter().enumerate().map(|(k, slot)| (slot, parts.root(k as u32) as usize)).collect()
}

/// A ray of the drive: where it starts, its direction, where it ends and the cosine of incidence.
struct Ray {
    from: DVec3,
    direction: DVec3,
    range: f64,
    cosine: f64,
}

/// Rows of the drive's lidar are 2 degrees apart. Up to this range, metres, two of them fall on a part of 0.3 m.
const RESOLVED: f64 = 4.3;

/// For each part of over 0.3 m that the rays of a drive show, as casts without noise show it, the share of these rays
/// that a model predicts within `near` of the part, along its normal, metres. Every eighth column counts.
pub(crate) fn shares(real: &Environment, model: &Environment, frames: &[Placed], near: f64) -> Vec<f64> {
    let (truth, found, of) =
        (Oracle::new(real, DVec3::ZERO).unwrap(), Oracle::new(model, DVec3::ZERO).unwrap(), parts(real));
    let mut seen = BTreeMap::<usize, Vec<Ray>>::new();
    for (frame, pose) in frames {
        let sensor = frame.sensor();
        for pixel in (0..frame.ranges().len() as u32).step_by(8) {
            let Some(ray) = sensor.ray(pixel % sensor.width(), pixel / sensor.width()) else { continue };
            let (from, direction) = (pose.translation, pose.rotation * (sensor.body_from_image() * ray));
            if let Some((range, cosine, slot)) = truth.met(from, direction).filter(|(range, ..)| *range < RESOLVED) {
                seen.entry(of[&slot]).or_default().push(Ray { from, direction, range, cosine });
            }
        }
    }
    let size =
        |rays: &[Ray]| 2.0 * Aabb::of(rays.iter().map(|r| r.from + r.direction * r.range)).half_extent().max_element();
    let is_right = |r: &&Ray| (found.distance(r.from, r.direction) - r.range).abs() * r.cosine < near;
    let share = |rays: &Vec<Ray>| rays.iter().filter(is_right).count() as f64 / rays.len() as f64;
    seen.values().filter(|rays| size(rays) > 0.3).map(share).collect()
}

/// By polygon of a model: the number of places on it, 5 cm apart, and the number of these places that are farther than
/// `near` metres from all real surfaces.
pub(crate) fn in_free_space<'a>(
    real: &Environment,
    polygons: impl Iterator<Item = Vec<DVec3>> + 'a,
    near: f64,
) -> Vec<[usize; 2]> {
    let truth = Oracle::new(real, DVec3::ZERO).unwrap();
    let places = |corners: &[DVec3]| {
        let n = corners.len();
        let mut places = vec![corners.iter().sum::<DVec3>() / n as f64];
        for k in 1..n - 1 {
            let [u, v] = [corners[k] - corners[0], corners[k + 1] - corners[0]];
            let steps = (u.length().max(v.length()) / 0.05).ceil() as usize;
            let share = |i: usize| i as f64 / steps as f64;
            let grid = (0..=steps).flat_map(|i| (0..=steps - i).map(move |j| (i, j)));
            places.extend(grid.map(|(i, j)| corners[0] + u * share(i) + v * share(j)));
        }
        places
    };
    let count = |corners: Vec<DVec3>| {
        let all = places(&corners);
        [all.len(), all.iter().filter(|p| truth.nearest(**p) > near).count()]
    };
    polygons.map(count).collect()
}
