//! Rays of the second look against the ray caster of another library.

use glam::DVec3;
use presight_model::caster::RayCaster;
use presight_model::change::Change;
use presight_model::geometry::Pose;
use presight_model::world::World;
use presight_testkit::oracle::Oracle;
use presight_testkit::scenes::{all_round, room_world};

/// Every ray of a scanner meets what parry's rays meet; behind the first object it meets what stands there once
/// that object is deleted.
#[test]
fn rays_meet_what_an_independent_caster_meets() {
    let sensor = all_round(90, 21);
    for seed in 0..3 {
        let mut world = room_world(seed, 12);
        let pose = Pose::from_xyz_rpy(DVec3::new(0.3, 0.2, 1.4), 0.05, -0.1, 0.7);
        let caster = RayCaster::new(&world, &sensor.spec().class);
        let reach = sensor.spec().range_max.min(1e6);
        let oracle = Oracle::new(world.environment(), pose.translation).unwrap();
        let mut firsts = Vec::new();
        for (c, r) in (0..21).flat_map(|r| (0..90).map(move |c| (c, r))) {
            let Some(ray) = sensor.ray(c, r) else { continue };
            let ray = pose.rotation * (sensor.body_from_image() * ray);
            let expected = oracle.cast(&sensor, &pose, (c, r)).unwrap();
            let found = caster.cast(pose.translation, ray, reach, None);
            let range = found.map_or(f64::INFINITY, |met| met.range);
            let truth = f64::from(expected.range.unwrap());
            assert!((range - truth).abs() < 1e-5 || range == truth, "seed {seed}, {c}, {r}: {range} and {truth}");
            firsts.extend(found.map(|met| (met.object, ray)));
        }
        assert!(firsts.len() > 500);
        let object = firsts[firsts.len() / 2].0;
        let name = world.environment().objects()[object as usize].name.clone();
        world.apply(Change::DeleteObject { name }).unwrap();
        let without = RayCaster::new(&world, &sensor.spec().class);
        for (_, ray) in firsts.iter().filter(|(first, _)| *first == object) {
            let second = caster.cast(pose.translation, *ray, reach, Some(object));
            assert_eq!(second, without.cast(pose.translation, *ray, reach, None));
        }
    }
}

/// By hand: a cube of 1 m at x = 3 turned by a quarter, and points around it.
#[test]
fn feet_are_on_faces_edges_and_corners() {
    let mut environment = presight_model::environment::Environment::new();
    let at = Pose::from_xyz_rpy(DVec3::new(3.0, 0.0, 0.0), 0.0, 0.0, std::f64::consts::FRAC_PI_2);
    environment.add_cuboid("crate", at, DVec3::ONE).unwrap();
    let caster = RayCaster::new(&World::new(environment), "laser");
    for (p, apart) in [
        (DVec3::new(1.0, 0.2, 0.1), 1.5),
        (DVec3::new(1.5, 1.5, 0.0), 2f64.sqrt()),
        (DVec3::new(1.5, 1.5, 1.5), 3f64.sqrt()),
        (DVec3::new(3.0, 0.0, 0.4), 0.1),
    ] {
        assert_eq!(caster.nearest(p, apart - 1e-9), None, "{p}");
        assert_eq!(caster.nearest(p, apart + 1e-9).map(|(object, _)| object), Some(0), "{p}");
    }
}
