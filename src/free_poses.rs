//! Poses at which a sensor could stand: what tests, benches and the index's statistics are taken at.

use crate::cpu::Engine;
use crate::environment::Object;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::index::{Found, Region};
use crate::plan::{FramePlan, Images, Output, Outputs, Request, Stats};
use crate::random::SplitMix64;
use crate::sensor::{Geometry, RayTable, Sensor, SensorSpec};
use crate::world::World;
use glam::DVec3;

/// Least distance of a free pose from any polygon, metres.
pub const FREE_DISTANCE: f64 = 0.3;
/// Least share of rays, spread evenly over all directions, that hit something.
pub const FREE_HITS: f64 = 0.6;
/// Rays of the hit test: 16 x 12.
const RAYS: (u32, u32) = (16, 12);
/// Tries for each wanted pose.
const TRIES: usize = 2000;

/// `n` poses (body axes in the world) inside the bounds of the world, at least [`FREE_DISTANCE`] from every polygon,
/// from which at least [`FREE_HITS`] of all directions hit something. Every other one is level, the others lean by up to
/// 10 degrees; yaw is free. The same seed gives the same poses.
///
/// # Errors
/// [`crate::ErrorKind::Invalid`] if the world has too little free space among its polygons.
pub fn free_poses(world: &World, n: usize, seed: u64) -> Result<Vec<Pose>> {
    let bounds = world.environment().bounds();
    let sensor = all_round()?;
    let mut engine = Engine::new(0)?;
    let mut random = SplitMix64(seed);
    let mut found = Found::default();
    let mut poses = Vec::with_capacity(n);
    for _ in 0..TRIES * n {
        if poses.len() == n || bounds.is_empty() {
            break;
        }
        let fraction = DVec3::new(random.unit(), random.unit(), random.unit());
        let at = bounds.min + (bounds.max - bounds.min) * fraction;
        let yaw = std::f64::consts::TAU * random.unit();
        let lean = if poses.len() % 2 == 0 { 0.0 } else { 20f64.to_radians() };
        let (roll, pitch) = (lean * (random.unit() - 0.5), lean * (random.unit() - 0.5));
        let pose = Pose::from_xyz_rpy(at, roll, pitch, yaw);
        if is_clear(world, at, &mut found) && hits(&mut engine, world, &sensor, &pose)? >= FREE_HITS {
            poses.push(pose);
        }
    }
    if poses.len() < n {
        return Err(Error::invalid(
            format!("only {} of {n} free poses found in {} tries", poses.len(), TRIES * n),
            "give poses, or a scene that surrounds the sensor",
        ));
    }
    Ok(poses)
}

/// Rays spread evenly over the sphere along a spiral (Fibonacci lattice).
fn all_round() -> Result<Sensor> {
    let n = RAYS.0 * RAYS.1;
    let turn = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let ray = |i: u32| {
        let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(n);
        let (sin, cos) = (turn * f64::from(i)).sin_cos();
        DVec3::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + DVec3::Z * z
    };
    let table = RayTable::new(RAYS.0, RAYS.1, (0..n).map(ray).collect())?;
    Sensor::new(SensorSpec::new("all round", "", Geometry::Rays(table)))
}

/// Share of directions that hit something.
fn hits(engine: &mut Engine, world: &World, sensor: &Sensor, pose: &Pose) -> Result<f64> {
    let request = Request { outputs: Outputs::of(&[Output::Range]), ..Request::default() };
    let mut images = Images::default();
    engine.render(&FramePlan::new(world, sensor, pose, &request), &mut images, &mut Stats::default())?;
    let hit = images.range.iter().filter(|r| r.is_finite()).count();
    Ok(hit as f64 / images.pixels() as f64)
}

/// True if no polygon is nearer than [`FREE_DISTANCE`].
fn is_clear(world: &World, at: DVec3, found: &mut Found) -> bool {
    let environment = world.environment();
    found.clear();
    world.index().query(environment, &Region::ball(at, FREE_DISTANCE), found);
    found
        .all()
        .filter_map(|slot| environment.locate(slot))
        .all(|(object, polygon)| distance(&environment.objects()[object as usize], polygon, at) >= FREE_DISTANCE)
}

/// Distance of a point from a polygon, metres.
fn distance(object: &Object, polygon: u32, at: DVec3) -> f64 {
    let world_from_mesh = object.world_from_mesh();
    let corners: Vec<DVec3> =
        object.mesh.corners_of(polygon).map(|p| world_from_mesh.transform_point3(p) - at).collect();
    let n = corners.len();
    let normal: DVec3 = (1..n - 1).map(|k| (corners[k] - corners[0]).cross(corners[k + 1] - corners[0])).sum();
    let side = |k: usize| (corners[k], corners[(k + 1) % n] - corners[k]);
    if (0..n).all(|k| normal.dot(side(k).1.cross(-side(k).0)) >= 0.0) {
        return normal.normalize_or_zero().dot(corners[0]).abs();
    }
    let to_side = |(from, along): (DVec3, DVec3)| {
        let t = -from.dot(along) / along.length_squared();
        (from + along * if t.is_nan() { 0.0 } else { t.clamp(0.0, 1.0) }).length()
    };
    (0..n).map(|k| to_side(side(k))).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Environment, Material, Mesh, NewObject, Polygon, PolygonOrder};
    use glam::Vec3;
    use std::sync::Arc;

    fn hall() -> World {
        let corner = |i: u32| {
            let pick = |bit: u32, most: f32| if i & bit == 0 { 0.0 } else { most };
            Vec3::new(pick(1, 4.0), pick(2, 3.0), pick(4, 2.5))
        };
        let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let polygons = faces.iter().map(|f| Polygon::new(f.to_vec(), 0)).collect();
        let mesh = Mesh::new("hall", (0..8).map(corner).collect(), polygons, PolygonOrder::Given).unwrap();
        let mut environment = Environment::new();
        environment.add_material(Material::named("m")).unwrap();
        environment.insert(NewObject::new("hall", Pose::IDENTITY, Arc::new(mesh))).unwrap();
        World::new(environment)
    }

    #[test]
    fn poses_keep_their_distance_and_repeat() {
        let world = hall();
        let poses = free_poses(&world, 40, 7).unwrap();
        assert_eq!(poses, free_poses(&world, 40, 7).unwrap());
        assert_ne!(poses, free_poses(&world, 40, 8).unwrap());
        for pose in &poses {
            let p = pose.translation;
            let wall = p.min(DVec3::new(4.0, 3.0, 2.5) - p).min_element();
            assert!(wall >= FREE_DISTANCE, "{wall}");
        }
    }

    #[test]
    fn distance_is_to_the_face_the_side_and_the_corner() {
        let world = hall();
        let object = &world.environment().objects()[0];
        assert!((distance(object, 0, DVec3::new(1.0, 1.0, 0.7)) - 0.7).abs() < 1e-12);
        assert!((distance(object, 0, DVec3::new(-3.0, 1.0, 4.0)) - 5.0).abs() < 1e-12);
        assert!((distance(object, 0, DVec3::new(-3.0, -4.0, 12.0)) - 13.0).abs() < 1e-12);
    }

    #[test]
    fn an_empty_world_has_none() {
        assert!(free_poses(&World::new(Environment::new()), 1, 1).is_err());
    }
}
