//! A pipe plant.

use super::bodies::{elbow, prism, turned};
use super::scenes;
use glam::{DQuat, DVec3, Vec3};
use presight_model::environment::NewObject;
use presight_model::geometry::Pose;
use presight_model::world::World;
use std::f64::consts::FRAC_PI_2;

/// A hall with pipes along the walls, elbows between them, posts, and tanks.
pub fn plant(seed: u64) -> World {
    let mut random = super::common::Random(seed);
    let mut environment = scenes::empty();
    let mut put = |name: &str, at: DVec3, yaw: f64, mesh: presight_model::environment::Mesh| {
        let pose = Pose::from_xyz_rpy(at, 0.0, 0.0, yaw);
        environment.insert(NewObject::new(name, pose, mesh.into())).unwrap();
    };
    put("hall", DVec3::ZERO, 0.0, scenes::cuboid(Vec3::new(-8.0, -6.0, 0.0), Vec3::new(8.0, 6.0, 4.0)));
    for k in 0..4 {
        let (radius, height) = (0.06 + 0.04 * f64::from(k), 0.6 + 0.7 * f64::from(k));
        let along = turned(&prism(24, radius, 8.0, false), DQuat::from_rotation_y(FRAC_PI_2));
        put("pipe", DVec3::new(-4.0, 4.4 - 0.2 * f64::from(k), height), 0.0, along);
        // A bend of 0.5 m, then down the other wall.
        let across = turned(&prism(24, radius, 5.0, false), DQuat::from_rotation_x(FRAC_PI_2));
        put("elbow", DVec3::new(4.0, 3.9 - 0.2 * f64::from(k), height), 0.0, elbow(24, 6, radius, 0.5));
        put("pipe", DVec3::new(4.5, 3.9 - 0.2 * f64::from(k), height), 0.0, across);
    }
    for _ in 0..6 {
        let at = DVec3::new(random.uniform(-7.0, 3.0), random.uniform(-5.0, 2.5), 0.0);
        put("post", at, random.uniform(0.0, 1.0), prism(24, random.uniform(0.05, 0.2), 4.0, false));
    }
    for _ in 0..3 {
        let at = DVec3::new(random.uniform(-6.0, 2.0), random.uniform(-4.5, 2.0), 0.0);
        put("tank", at, 0.0, prism(36, random.uniform(0.4, 0.8), random.uniform(0.8, 2.0), true));
        put("box", at + DVec3::new(1.5, 0.0, 0.0), 0.4, scenes::cuboid(Vec3::ZERO, Vec3::new(0.7, 0.5, 0.9)));
    }
    World::new(environment)
}
