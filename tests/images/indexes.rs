//! A prediction with any index equals the one without an index, pixel for pixel.
//!
//! `PRESIGHT_SEED` and `PRESIGHT_POSES` (per scene) vary the runs.

#![expect(clippy::print_stderr, reason = "the tests print their comparisons")]

use presight_testkit as common;

use common::{data, engines, env_number, plan, scenes};
use glam::DVec3;
use presight_model::change::Change;
use presight_model::geometry::Pose;
use presight_model::index::{IndexKind, Params};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::plan::{FramePlan, Images, Output};
use presight_studies::index::Scheme;

/// The first channel and pixel in which two predictions differ in any bit.
fn difference(a: &Images, b: &Images) -> Option<String> {
    Output::ALL.into_iter().find_map(|output| {
        let (a, b) = (common::bits(a, output), common::bits(b, output));
        assert_eq!(a.len(), b.len(), "{}", output.name());
        let i = (0..a.len()).find(|i| a[*i] != b[*i])?;
        Some(format!("{} {i}: bits {:x} and {:x}", output.name(), a[i], b[i]))
    })
}

/// The schemes with tuned parameters: the defaults, and very small cells.
fn variants() -> Vec<(Scheme, Params)> {
    let small = Params { cell_polygons: 1, ..Params::default() };
    let mut all: Vec<_> = Scheme::ALL.into_iter().skip(1).map(|s| (s, s.params())).collect();
    all.extend([Scheme::S3d, Scheme::Plop].map(|s| (s, small)));
    all
}

fn check(world: &World, sensor: &Sensor, pose: &Pose, render: &mut dyn FnMut(&FramePlan) -> Images) {
    let without = world.reindexed(&IndexKind::None);
    let expected = render(&plan(&without, sensor, pose));
    for (scheme, params) in variants() {
        let got = render(&plan(&world.reindexed(&scheme.kind(params)), sensor, pose));
        if let Some(what) = difference(&expected, &got) {
            panic!("{} at {pose:?} with {}: {what}", sensor.spec().name, scheme.name());
        }
    }
}

fn check_scenes(render: &mut dyn FnMut(&FramePlan) -> Images, names: &[&str], poses: usize) {
    for name in names {
        let Some(world) = data::scene(name, true) else { return };
        let (seed, mut images) = (env_number("PRESIGHT_SEED", 1), 0);
        for pose in data::poses(&world, poses, seed) {
            for sensor in data::presets() {
                check(&world, &sensor, &pose, render);
                images += variants().len();
            }
        }
        eprintln!("{name}: {images} images equal those without an index");
    }
}

#[test]
fn cpu_images_are_equal() {
    let mut cpu = engines::cpu(2);
    let poses = env_number("PRESIGHT_POSES", 3) as usize;
    check_scenes(&mut cpu, &["factory_hall", "hospital", "warehouse_small"], poses);
}

/// Compares the world's own index after changes with a newly built one.
#[test]
fn cpu_images_are_equal_after_changes() {
    let (mut cpu, mut tiles) = (engines::cpu(2), engines::cpu_by_tiles(2));
    let sensor = scenes::scanner(360, 91);
    for scheme in Scheme::ALL {
        let mut world = scenes::room_world(3, 30).reindexed(&scheme.kind(Params::default()));
        let names: Vec<String> = world.environment().objects().iter().map(|o| o.name.clone()).collect();
        for (i, name) in names.into_iter().enumerate().skip(1) {
            let turn = i as f64;
            let to = Pose::from_xyz_rpy(DVec3::new(turn.sin(), turn.cos(), 0.2), 0.1, 0.0, turn);
            let change = match i % 3 {
                0 => Change::DeleteObject { name },
                _ => Change::MoveObject { name, world_from_object: to },
            };
            world.apply(change).unwrap();
        }
        world.index().assert_well_formed(world.environment());
        let anew = world.reindexed(&IndexKind::None);
        let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.3), 0.1, 0.05, 0.7);
        let expected = cpu(&plan(&anew, &sensor, &pose));
        for got in [cpu(&plan(&world, &sensor, &pose)), tiles(&plan(&world, &sensor, &pose))] {
            assert_eq!(difference(&expected, &got), None, "{}", scheme.name());
        }
    }
}

#[test]
fn gpu_images_are_equal() {
    if let Some(mut gpu) = engines::gpu() {
        check_scenes(&mut gpu, &["factory_hall"], 1);
    }
}

/// The planted fault: an object that the index lacks.
#[test]
fn a_lost_object_is_noticed() {
    let world = scenes::room_world(3, 30);
    let mut lost = world.clone();
    let name = world.environment().objects()[0].name.clone();
    lost.apply(Change::DeleteObject { name }).unwrap();
    let (sensor, mut cpu) = (scenes::scanner(360, 91), engines::cpu(1));
    let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.3), 0.0, 0.0, 0.0);
    let (a, b) = (cpu(&plan(&world, &sensor, &pose)), cpu(&plan(&lost, &sensor, &pose)));
    assert!(difference(&a, &b).is_some());
}
