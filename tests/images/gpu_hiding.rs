//! Geometry that the GPU engine skips because earlier waves hide it: the images equal those with every polygon set up,
//! bit for bit.
#![cfg(feature = "gpu")]

use presight_testkit as common;

use common::hall::{hall_poses, open_hall};
use common::skip::no_adapter;
use common::{data, plan, scenes};
use glam::{DVec3, Vec3};
use presight_model::environment::{Environment, NewObject};
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::gpu::testing;
use presight_predict::gpu::testing::{Hiding, Setup};
use presight_predict::gpu::{DeviceOptions, GpuEngine};
use presight_render::plan::CountName;
use presight_render::plan::{Images, Stats};
use std::sync::Arc;

fn engine(hiding: Hiding, without_int64: bool) -> Option<GpuEngine> {
    let options = DeviceOptions { without_int64, ..Default::default() };
    // One of the two resolves images on the device, as in `gpu`.
    let setup = Setup { hiding, all_on_device: without_int64, ..Setup::default() };
    testing::open(options, setup).map_err(no_adapter).ok()
}

fn render(engine: &mut GpuEngine, world: &World, sensor: &Sensor, pose: &Pose) -> (Images, Stats) {
    let (mut images, mut stats) = (Images::default(), Stats::default());
    engine.render(&plan(world, sensor, pose), &mut images, &mut stats).expect("the engine renders");
    (images, stats)
}

fn count(stats: &Stats, name: CountName) -> u64 {
    stats.count_of(name).unwrap_or_else(|| panic!("no count {name}"))
}

/// None square; the last one's lines do not fill a tile.
fn sensors() -> Vec<Sensor> {
    let [camera, scanner] = [scenes::camera(161, 121), scenes::scanner(360, 61)];
    let rows = [scenes::scanner(1800, 1), scenes::scanner(90, 1)];
    let rays = [scenes::lens(121, 91), scenes::fisheye(91, 91), scenes::all_round(72, 36)];
    [camera, scanner].into_iter().chain(rows).chain(rays).collect()
}

/// Returns the runs and polygons hidden, where images with and without hiding are equal.
fn compare(world: &World, sensors: &[Sensor], poses: &[Pose]) -> [u64; 2] {
    let mut hidden = [0; 2];
    for without_int64 in [false, true] {
        let Some(mut without) = engine(Hiding::Off, without_int64) else { continue };
        let Some(mut with) = engine(Hiding::Always, without_int64) else { continue };
        for (sensor, pose) in sensors.iter().flat_map(|sensor| poses.iter().map(move |pose| (sensor, pose))) {
            let (all, _) = render(&mut without, world, sensor, pose);
            let (some, stats) = render(&mut with, world, sensor, pose);
            for output in all.outputs().iter() {
                assert_eq!(
                    common::bits(&all, output),
                    common::bits(&some, output),
                    "{}: {output:?}",
                    sensor.spec().name
                );
            }
            // Without anything in view there are no counts.
            hidden[0] += stats.count_of(CountName::RunsHidden).unwrap_or(0);
            hidden[1] += stats.count_of(CountName::PolygonsHidden).unwrap_or(0);
        }
    }
    hidden
}

fn has_adapter() -> bool {
    engine(Hiding::Off, false).is_some()
}

#[test]
fn images_of_rooms_and_halls_equal_those_without_hiding() {
    let hall = open_hall(3, 30_000);
    let poses = hall_poses(&hall, 5, 2);
    let [runs, polygons] = compare(&World::new(hall), &sensors(), &poses);
    assert!(!has_adapter() || runs > 100 && polygons > 100, "{runs} runs and {polygons} polygons are hidden");
    let room = scenes::room_world(7, 400);
    let poses = [(0.2, -0.1, 1.4, 0.4), (-1.5, 0.8, 0.6, 2.6)]
        .map(|(x, y, z, yaw)| Pose::from_xyz_rpy(DVec3::new(x, y, z), 0.05, 0.1, yaw));
    let [runs, _] = compare(&room, &sensors(), &poses);
    assert!(!has_adapter() || runs > 100, "{runs} runs are hidden");
}

#[test]
fn images_of_real_models_equal_those_without_hiding() {
    for name in ["hospital", "factory_hall"] {
        let Some(world) = data::scene(name, true) else { continue };
        let poses = data::poses(&world, 1, 22);
        let [runs, polygons] = compare(&world, &[scenes::camera(320, 240), scenes::scanner(640, 100)], &poses);
        assert!(!has_adapter() || runs > 50 && polygons > 50, "{name}: {runs} runs, {polygons} polygons are hidden");
    }
}

/// A large wall 5 m ahead, and small plates with lower ids in its plane, away from its centre. The wall is drawn first,
/// and ties go to the plates. A pillar further away is behind both.
fn tied() -> World {
    let mut environment = scenes::empty();
    let square = |y: f32, z: f32, half: f32, x: f32| {
        [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)]
            .map(|(a, b)| Vec3::new(x, y + a * half, z + b * half))
            .to_vec()
    };
    let insert = |environment: &mut Environment, name: &str, polygons: &[Vec<Vec3>]| {
        let mesh = Arc::new(scenes::mesh(polygons));
        environment.insert(NewObject::new(name, Pose::IDENTITY, mesh)).expect("a valid object");
    };
    for (i, (y, z)) in [(2.0, 1.5), (-2.0, 1.5), (2.0, -1.5), (-2.0, -1.5)].into_iter().enumerate() {
        insert(&mut environment, &format!("plate {i}"), &[square(y, z, 0.4, 5.0)]);
    }
    insert(&mut environment, "wall", &[square(0.0, 0.0, 8.0, 5.0)]);
    insert(&mut environment, "behind", &[square(0.0, 0.0, 0.5, 5.5)]);
    World::new(environment)
}

/// The pixels of the plates, the count of hidden geometry behind the wall, and its visible pixels.
fn plates(hiding: Hiding, without_int64: bool) -> Option<(usize, u64, usize)> {
    let (images, stats) =
        render(&mut engine(hiding, without_int64)?, &tied(), &scenes::camera(160, 120), &Pose::IDENTITY);
    let seen = |ids: std::ops::RangeInclusive<u32>| images.polygon_id.iter().filter(|id| ids.contains(id)).count();
    let hidden = count(&stats, CountName::RunsHidden) + count(&stats, CountName::PolygonsHidden);
    Some((seen(1..=4), hidden, seen(6..=6)))
}

/// The plates are in the wall's plane: a depth that is one step too near hides them.
#[test]
fn equal_depths_are_not_hidden_and_a_depth_one_step_too_near_is_found() {
    for without_int64 in [false, true] {
        let Some((all, hidden, behind)) = plates(Hiding::Off, without_int64) else { return };
        assert!(all > 100 && hidden == 0 && behind == 0, "{all} pixels of plates, {hidden} hidden, {behind} behind");
        assert_eq!(plates(Hiding::Always, without_int64), Some((all, 1, 0)), "only the pillar behind is hidden");
        let (fewer, hidden, _) = plates(Hiding::TooNear, without_int64).expect("an adapter");
        assert!(fewer < all && hidden > 1, "the fault must be found: {fewer} of {all} pixels, {hidden} hidden");
    }
}

/// A wall over all of 160 x 120 samples: 30 pieces of four lines, each in two parts of 80 samples.
#[test]
fn a_large_polygon_is_distributed() {
    let Some(mut engine) = engine(Hiding::Off, false) else { return };
    let mut environment = scenes::empty();
    let wall = [(-8.0, -8.0), (8.0, -8.0), (8.0, 8.0), (-8.0, 8.0)].map(|(y, z)| Vec3::new(5.0, y, z)).to_vec();
    environment
        .insert(NewObject::new("wall", Pose::IDENTITY, Arc::new(scenes::mesh(&[wall]))))
        .expect("a valid object");
    let (images, stats) = render(&mut engine, &World::new(environment), &scenes::camera(160, 120), &Pose::IDENTITY);
    assert!(images.polygon_id.iter().all(|id| *id == 1));
    assert_eq!(count(&stats, CountName::WorkItems), 60);
    assert_eq!(count(&stats, CountName::PolygonsSetUp), 1);
}
