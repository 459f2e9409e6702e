//! Rooms that differ from their map: a seeded share of the furniture is gone, another has been moved.

use super::Random;
use super::route::Route;
use glam::{DQuat, DVec3};
use presight_model::environment::{Environment, Object};
use presight_model::geometry::Pose;
use std::f64::consts::PI;

/// Maximum side of furniture on the floor plan, metres. Longer objects are walls, floors or roofs.
const LONGEST: f64 = 4.5;
/// Furniture reaches into these heights above the floor at z = 0, metres, where robots meet it.
const HEIGHTS: (f64, f64) = (0.1, 1.8);
/// Minimum and maximum distance by which furniture is moved, metres.
const MOVED: (f64, f64) = (0.3, 1.5);
/// Maximum turn of moved furniture, radians.
const TURNED: f64 = 0.25 * PI;
/// Minimum distance of moved furniture from the robot's route, metres.
const CLEAR: f64 = 0.5;
/// Maximum number of random poses for each piece of moved furniture.
const TRIES: usize = 30;

/// The shares of the furniture that change, 0 to 1 together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shares {
    /// Deleted.
    pub gone: f64,
    /// Moved by 0.3 to 1.5 m and turned by up to 45 degrees, on the floor.
    pub moved: f64,
}

/// Numbers of changes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Furniture in the map.
    pub furniture: usize,
    /// Deleted.
    pub gone: usize,
    /// Moved.
    pub moved: usize,
}

/// True if an object is furniture: at most 4.5 m long, and an obstacle to a robot on the floor.
pub fn is_furniture(object: &Object) -> bool {
    if object.is_deleted() {
        return false;
    }
    let bounds = object.world_bounds();
    let size = bounds.max - bounds.min;
    size.x.max(size.y) <= LONGEST && bounds.max.z >= HEIGHTS.0 && bounds.min.z <= HEIGHTS.1
}

/// The environment with a share of its furniture gone and another share moved; none moves onto the robot's route. Equal
/// seeds give equal changes.
pub fn changed(map: &Environment, shares: Shares, route: &Route, seed: u64) -> (Environment, Counts) {
    let mut random = Random(seed);
    let mut names: Vec<String> = map.objects().iter().filter(|o| is_furniture(o)).map(|o| o.name.clone()).collect();
    // Fisher and Yates: every order is as likely as any other.
    (1..names.len()).rev().for_each(|k| names.swap(k, random.below(k + 1)));
    let of = |share: f64| (share * names.len() as f64).round() as usize;
    let (gone, moved) = (of(shares.gone), of(shares.moved));
    let mut real = map.clone();
    let mut counts = Counts { furniture: names.len(), gone, moved: 0 };
    for name in &names[..gone] {
        real.delete(name).expect("the object exists");
    }
    for name in names.iter().skip(gone).take(moved) {
        let object = map.object(name).expect("the object exists");
        if let Some(pose) = (0..TRIES).map(|_| shoved(object, &mut random)).find(|pose| is_clear(object, pose, route)) {
            real.set_pose(name, pose).expect("a sound pose");
            counts.moved += 1;
        }
    }
    (real, counts)
}

/// The environment with this share of its walls moved by 0.1 to 0.3 m. A wall is an object over 1 m high that is larger than
/// furniture and shorter than half of the building.
pub fn with_moved_walls(map: &Environment, share: f64, seed: u64) -> Environment {
    let (mut random, mut real, all) = (Random(seed ^ 0x3a11), map.clone(), map.bounds());
    let size = all.max - all.min;
    for object in map.objects().iter().filter(|o| !o.is_deleted() && !is_furniture(o)) {
        let bounds = object.world_bounds();
        let own = bounds.max - bounds.min;
        let is_wall = own.z > 1.0 && own.x.min(own.y) < 0.5 * size.x.min(size.y);
        let (is_moved, far, azimuth) = (random.unit() < share, random.uniform(0.1, 0.3), random.uniform(-PI, PI));
        if is_wall && is_moved {
            let mut pose = object.world_from_object;
            pose.translation += far * DVec3::new(azimuth.cos(), azimuth.sin(), 0.0);
            real.set_pose(&object.name, pose).expect("a sound pose");
        }
    }
    real
}

/// Another pose on the same floor: turned about the middle of the object, and moved.
fn shoved(object: &Object, random: &mut Random) -> Pose {
    let bounds = object.world_bounds();
    let middle = 0.5 * (bounds.min + bounds.max);
    let (far, azimuth) = (random.uniform(MOVED.0, MOVED.1), random.uniform(-PI, PI));
    let turn = DQuat::from_rotation_z(random.uniform(-TURNED, TURNED));
    let to = middle + far * DVec3::new(azimuth.cos(), azimuth.sin(), 0.0);
    let pose = object.world_from_object;
    Pose { translation: to + turn * (pose.translation - middle), rotation: (turn * pose.rotation).normalize() }
}

/// True if the circle around the moved object stays clear of the route.
fn is_clear(object: &Object, pose: &Pose, route: &Route) -> bool {
    let bounds = object.world_bounds();
    let (half, middle) = (0.5 * (bounds.max - bounds.min), 0.5 * (bounds.min + bounds.max));
    let motion = *pose * object.world_from_object.inverse();
    let to = motion.transform_point(middle);
    let reach = half.x.hypot(half.y) + CLEAR;
    route.places().all(|[x, y]| (to.x - x).hypot(to.y - y) > reach)
}
