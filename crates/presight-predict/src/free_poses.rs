//! Poses at which a sensor could stand, for tests, benches and the index's statistics.

use glam::DVec3;
use presight_model::environment::Object;
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::index::{QueryResult, Region};
use presight_model::random::SplitMix64;
use presight_model::world::World;
use presight_render::plan::{Facing, facings};

/// Minimum distance of a free pose from any polygon, metres.
pub const FREE_DISTANCE: f64 = 0.3;
/// Minimum fraction of rays, spread evenly over all directions, that hit a surface.
pub const FREE_HITS: f64 = 0.6;
/// Rays of the hit test.
const RAYS: u32 = 192;
/// Tries for each requested pose.
const TRIES: usize = 2000;

/// `n` poses (body axes in the world) inside the bounds of the world, at least [`FREE_DISTANCE`] from every polygon,
/// from which at least [`FREE_HITS`] of all directions hit something. Every other pose is level, the others lean by up
/// to 10 degrees; yaw is free. The same seed gives the same poses.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if the world has too little free space among its polygons.
pub fn free_poses(world: &World, n: usize, seed: u64) -> Result<Vec<Pose>> {
    let bounds = world.environment().bounds();
    let rays = all_round();
    let mut random = SplitMix64(seed);
    let mut found = QueryResult::default();
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
        if is_clear(world, at, &mut found) && is_surrounded(world, &rays, &pose, &mut found) {
            poses.push(pose);
        }
    }
    if poses.len() < n {
        return Err(Error::invalid(
            format!("only {} of {n} free poses found in {} tries", poses.len(), TRIES * n),
            "give `poses`, or a scene that surrounds the sensor",
        ));
    }
    Ok(poses)
}

/// Rays spread evenly over the sphere along a spiral (Fibonacci lattice).
fn all_round() -> Vec<DVec3> {
    let turn = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let ray = |i: u32| {
        let z = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(RAYS);
        let (sin, cos) = (turn * f64::from(i)).sin_cos();
        DVec3::new(cos, sin, 0.0) * (1.0 - z * z).sqrt() + DVec3::Z * z
    };
    (0..RAYS).map(ray).collect()
}

/// True if at least [`FREE_HITS`] of the rays hit something that is opaque to sensors of an unnamed class.
fn is_surrounded(world: &World, rays: &[DVec3], pose: &Pose, found: &mut QueryResult) -> bool {
    let (environment, bounds) = (world.environment(), world.environment().bounds());
    let facings: Vec<Facing> = facings(environment, "").collect();
    let (at, reach) = (pose.translation, (bounds.max - bounds.min).length());
    let mut hits = |ray: &DVec3| {
        let direction = pose.rotation * *ray;
        world.polygons_in(&Region::ray(at, direction, reach), None, found).any(|(object, polygon)| {
            let object = &environment.objects()[object as usize];
            let facing = facings[usize::from(object.mesh.material(polygon))];
            facing.opaque && is_hit(object, polygon, at, direction, facing.one_sided)
        })
    };
    // Stops as soon as the answer is certain.
    let wanted = (FREE_HITS * rays.len() as f64).ceil() as usize;
    let (mut hit, mut missed) = (0, 0);
    for ray in rays {
        if hits(ray) {
            hit += 1;
        } else {
            missed += 1;
        }
        if hit >= wanted || missed > rays.len() - wanted {
            break;
        }
    }
    hit >= wanted
}

/// Corners of a polygon relative to a point, world axes, counter-clockwise as seen from its front.
fn corners_from(object: &Object, polygon: u32, at: DVec3) -> Vec<DVec3> {
    let mut corners = object.polygon_in_world(polygon);
    corners.iter_mut().for_each(|p| *p -= at);
    corners
}

/// Not normalized.
fn normal_of(corners: &[DVec3]) -> DVec3 {
    (1..corners.len() - 1).map(|k| (corners[k] - corners[0]).cross(corners[k + 1] - corners[0])).sum()
}

/// True if a ray meets the polygon, for a one-sided polygon only on its front.
fn is_hit(object: &Object, polygon: u32, at: DVec3, direction: DVec3, one_sided: bool) -> bool {
    let corners = corners_from(object, polygon, at);
    let n = corners.len();
    let normal = normal_of(&corners);
    let distance = normal.dot(corners[0]);
    let inside = (0..n).all(|k| distance * corners[k].cross(corners[(k + 1) % n]).dot(direction) >= 0.0);
    inside && normal.dot(direction) * distance > 0.0 && (!one_sided || distance < 0.0)
}

/// True if no present polygon is nearer than [`FREE_DISTANCE`].
pub fn is_clear(world: &World, at: DVec3, found: &mut QueryResult) -> bool {
    let environment = world.environment();
    world
        .polygons_in(&Region::ball(at, FREE_DISTANCE), None, found)
        .all(|(object, polygon)| distance(&environment.objects()[object as usize], polygon, at) >= FREE_DISTANCE)
}

/// Distance of a point in the world from a polygon of an object, metres.
pub fn distance(object: &Object, polygon: u32, at: DVec3) -> f64 {
    let corners = corners_from(object, polygon, at);
    let (n, normal) = (corners.len(), normal_of(&corners));
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
    use glam::Vec3;
    use presight_model::sensor::{Geometry, RayTable, Sensor, SensorSpec};
    use presight_model::{Environment, Material, Mesh, NewObject};
    use presight_render::plan::{FramePlan, ImageRequest, Images};
    use presight_render::reference;
    use std::sync::Arc;

    fn hall() -> World {
        let mesh = Mesh::cuboid("hall", Vec3::ZERO, Vec3::new(4.0, 3.0, 2.5), 0).unwrap();
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
    fn a_polygon_is_hit_inside_its_outline_and_before_the_ray() {
        let world = hall();
        let floor = |direction: DVec3, one_sided: bool, height: f64| {
            let object = &world.environment().objects()[0];
            is_hit(object, 0, DVec3::new(1.0, 1.0, height), direction.normalize(), one_sided)
        };
        let (down, aslant) = (-DVec3::Z, DVec3::new(2.9, 1.9, -1.0));
        assert!(floor(down, false, 1.0) && floor(aslant, false, 1.0));
        assert!(!floor(DVec3::Z, false, 1.0) && !floor(aslant, false, 1.1));
        // Its front is below.
        assert!(!floor(down, true, 1.0) && floor(DVec3::Z, true, -1.0));
    }

    /// A mirror keeps the front of a face.
    #[test]
    fn the_front_of_a_mirrored_polygon_is_its_front() {
        // The floor's front is below; mirrored in z it is a ceiling below the origin, with its front above.
        for (scale, height, direction) in [
            (DVec3::new(-1.0, 1.0, 1.0), -1.0, DVec3::Z),
            (DVec3::new(1.0, -1.0, 1.0), -1.0, DVec3::Z),
            (DVec3::new(1.0, 1.0, -1.0), 1.0, -DVec3::Z),
            (DVec3::new(-1.0, -1.0, 1.0), -1.0, DVec3::Z),
        ] {
            let mut object = hall().environment().objects()[0].clone();
            object.object_from_mesh = glam::DAffine3::from_scale(scale);
            let at = DVec3::new(scale.x, scale.y, height);
            let behind = DVec3::new(scale.x, scale.y, -height);
            assert!(is_hit(&object, 0, at, direction, true), "{scale}");
            assert!(!is_hit(&object, 0, behind, -direction, true), "{scale}");
            assert!(is_hit(&object, 0, behind, -direction, false), "{scale}");
        }
    }

    /// The ray test agrees with an image of the same rays.
    #[test]
    fn as_many_rays_hit_as_an_image_of_them_shows() {
        let (world, rays, mut found) = (hall(), all_round(), QueryResult::default());
        let table = RayTable::new(RAYS, 1, rays.clone()).unwrap();
        let sensor = Sensor::new(SensorSpec::new("all round", "", Geometry::Rays(table))).unwrap();
        let mut verdicts = [0; 2];
        for k in 0..40 {
            // From inside to far outside.
            let at = DVec3::new(2.0 + 0.08 * f64::from(k), 1.5, 1.2);
            let pose = Pose::from_xyz_rpy(at, 0.1, 0.2, 0.3 * f64::from(k));
            let mut images = Images::default();
            let plan = FramePlan::new(&world, &sensor, &pose, ImageRequest::default()).unwrap();
            reference::render(&plan, &mut images).unwrap();
            let share = images.range.iter().filter(|r| r.is_finite()).count() as f64 / f64::from(RAYS);
            let surrounded = is_surrounded(&world, &rays, &pose, &mut found);
            assert_eq!(surrounded, share >= FREE_HITS, "{share} at {at}");
            verdicts[usize::from(surrounded)] += 1;
        }
        assert!(verdicts.iter().all(|n| *n > 5), "{verdicts:?}");
    }

    #[test]
    fn an_empty_world_has_none() {
        assert!(free_poses(&World::new(Environment::new()), 1, 1).is_err());
    }
}
