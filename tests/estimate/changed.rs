//! The test kit's own drives: what changes, where the robot drives, and what its scanner reads, by hand.

use super::*;
use presight_model::sensor::{RayTimes, Sensor, StampAt};
use presight_testkit::caster::{Caster, Slip};
use presight_testkit::changes::{Shares, changed, is_furniture};
use presight_testkit::oracle::Oracle;
use presight_testkit::route::{Driving, Route};

/// A hall of 12 x 8 m with twenty crates along its walls.
pub fn hall() -> World {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    add_box(&mut environment, "hall", Vec3::ZERO, Vec3::new(12.0, 8.0, 3.0));
    for k in 0..20 {
        let (x, y) = (0.4 + 1.15 * (k / 2) as f32, if k % 2 == 0 { 0.3 } else { 7.2 });
        let tall = 0.6 + 0.05 * k as f32;
        add_box(&mut environment, &format!("crate {k}"), Vec3::new(x, y, 0.0), Vec3::new(x + 0.5, y + 0.5, tall));
    }
    World::new(environment)
}

pub fn wander(world: &World, seconds: f64) -> Route {
    let environment = world.environment();
    let oracle = Oracle::new(environment, DVec3::ZERO).unwrap();
    Route::wander(&oracle, &environment.bounds(), &Driving { seconds, speed: 0.7, turn: 0.7 }, 3)
}

/// Three of twenty crates (15 %) are gone and three moved, by 0.3 to 1.5 m. Walls stay, nothing moves into the way of the robot,
/// and the same seed changes the same crates.
#[test]
fn stated_shares_of_the_furniture_change() {
    let world = hall();
    let (map, route) = (world.environment(), wander(&world, 20.0));
    assert_eq!(map.objects().iter().filter(|o| is_furniture(o)).count(), 20);
    let shares = Shares { gone: 0.15, moved: 0.15 };
    let (real, counts) = changed(map, shares, &route, 1);
    assert_eq!((counts.furniture, counts.gone), (20, 3));
    assert!((1..=3).contains(&counts.moved), "{counts:?}");
    assert_eq!(real.objects().iter().filter(|o| o.is_deleted()).count(), 3);
    let mut moved = 0;
    for (a, b) in map.objects().iter().zip(real.objects()).filter(|(_, b)| !b.is_deleted()) {
        let middle = |o: &presight_model::environment::Object| 0.5 * (o.world_bounds().min + o.world_bounds().max);
        let off = middle(a).distance(middle(b));
        assert!(off == 0.0 || (0.29..1.51).contains(&off) && a.name != "hall", "{} {off}", a.name);
        moved += usize::from(off > 0.0);
        let near = route.places().map(|[x, y]| (middle(b).x - x).hypot(middle(b).y - y)).fold(f64::MAX, f64::min);
        assert!(off == 0.0 || near > 0.5, "{} {near}", b.name);
    }
    assert_eq!(moved, counts.moved);
    let again = changed(map, shares, &route, 1).0;
    let poses = |e: &Environment| e.objects().iter().map(|o| o.world_from_object).collect::<Vec<_>>();
    assert_eq!(poses(&real), poses(&again));
    assert_ne!(poses(&real), poses(&changed(map, shares, &route, 2).0));
}

/// A wandering robot keeps 0.3 m from everything, and neither its speed nor its turning exceeds the limits.
#[test]
fn ways_touch_nothing_and_keep_their_speed() {
    let world = hall();
    let route = wander(&world, 30.0);
    let mut length = 0.0;
    for k in 1..300 {
        let (a, b) = (route.at(0.1 * f64::from(k - 1)), route.at(0.1 * f64::from(k)));
        let step = a.translation.distance(b.translation);
        length += step;
        assert!(step < 0.0701 && a.rotation.angle_between(b.rotation) < 0.0701, "{k}");
        assert!((0.3..11.7).contains(&b.translation.x) && (0.3..7.7).contains(&b.translation.y), "{k}");
    }
    assert!(length > 6.0, "{length}");
}

/// By hand: from (3, 4) with heading 0 the end wall is 9 m ahead, the long walls 4 m to either side. A person 1.8 m ahead reads
/// 1.55 m there, and so do the pixels up to asin(0.25 / 1.8) = 8 degrees to either side, and no others.
#[test]
fn readings_are_those_of_a_ray_caster_and_of_people() {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    add_box(&mut environment, "hall", Vec3::ZERO, Vec3::new(12.0, 8.0, 3.0));
    let mut spec = scanner(1e-9).spec().clone();
    spec.mount.translation.z = 0.5;
    let sensor = Sensor::new(spec).unwrap();
    let at = |_: f64| Pose::from_xyz_rpy(DVec3::new(3.0, 4.0, 0.0), 0.0, 0.0, 0.0);
    let still = |mut caster: Caster| {
        (caster.drop_outs, caster.mixed) = (0.0, 0.0);
        caster.frame(&at, 0.0, None).ranges().to_vec()
    };
    let ranges = still(Caster::new(&environment, sensor.clone(), 1));
    for (i, range) in [(180, 9.0), (270, 4.0), (90, 4.0), (0, 3.0), (225, 32f32.sqrt())] {
        assert!((ranges[i] - range).abs() < 1e-5, "{i}: {}", ranges[i]);
    }
    let with = still(Caster::new(&environment, sensor, 1).with_person_before(1.8));
    assert!((with[180] - 1.55).abs() < 1e-5, "{}", with[180]);
    let near: Vec<usize> = (0..360).filter(|i| (with[*i] - ranges[*i]).abs() > 1e-3).collect();
    assert_eq!(near, (180 - 7..=180 + 7).collect::<Vec<_>>());
}

/// By hand: a scanner that takes 0.1 s for a turn while the robot drives at 1 m/s along x sees the wall ahead, at column 180 of 360,
/// from 5 cm farther on: 8.95 m; without a turn time 9 m. Its odometry is the way times 1.02, and no noise.
#[test]
fn a_turn_takes_its_time_and_odometry_slips() {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    add_box(&mut environment, "hall", Vec3::ZERO, Vec3::new(12.0, 8.0, 3.0));
    let mut spec = scanner(1e-9).spec().clone();
    spec.mount.translation.z = 0.5;
    let route = Route::straight([3.0, 4.0, 0.0], 1.0, 2.0);
    for (turn_s, range) in [(0.0, 9.0), (0.1, 8.95)] {
        let mut caster = Caster::new(&environment, Sensor::new(spec.clone()).unwrap(), 1);
        (caster.drop_outs, caster.mixed, caster.times) = (0.0, 0.0, RayTimes::turning(turn_s, StampAt::First));
        caster.slip = Some(Slip { noise: [0.0; 2], ..Slip::USUAL });
        let first = caster.frame(&|t| route.at(t), 0.0, None);
        assert!((first.ranges()[180] - range).abs() < 1e-5, "{}", first.ranges()[180]);
        let moved = caster.frame(&|t| route.at(t), 0.1, Some(0.0)).motion.unwrap().previous_from_current.translation;
        assert!((moved - DVec3::X * 0.102).length() < 1e-9, "{moved}");
    }
}
