//! Compares the reference with parry3d-f64, and parry with the reference and with tiles of rays, for every preset at free poses.
//!
//! `PRESIGHT_SEED`, `PRESIGHT_ORACLE_POSES` (per scene), `PRESIGHT_PRESETS` (per pose) and `PRESIGHT_ORACLE_PIXELS`
//! (per image) vary the runs, `PRESIGHT_SCENES` names scenes. By default half of the 8 presets alternate over 20 poses,
//! so a run checks every preset in every scene at 10 poses. `PRESIGHT_PRESETS=8` takes all at every pose.

#![allow(clippy::print_stderr)] // Prints skips and results.

use presight_testkit as common;

use common::engines::{self, Renderer};
use common::oracle::Oracle;
use common::{Random, data, env_number, plan};
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_render::plan::{FramePlan, Images};
use presight_render::verify::{PixelValues, Precision, Report, compare_values};

/// Compares random pixels of one image in both directions, and of one by tiles.
fn check_image(
    world: &World,
    oracle: &Oracle,
    (sensor, pose): (&Sensor, &Pose),
    random: &mut Random,
    tiles: &mut Renderer,
) -> [Report; 3] {
    let plan: FramePlan = plan(world, sensor, pose);
    let number = env_number("PRESIGHT_ORACLE_PIXELS", 400) as usize;
    let mut pixels: Vec<(u32, u32)> = (0..number)
        .map(|_| (random.below(sensor.width() as usize) as u32, random.below(sensor.height() as usize) as u32))
        .collect();
    pixels.sort_unstable();
    pixels.dedup();
    let mut images = Images::default();
    presight_render::reference::render_pixels(&plan, &mut images, pixels.iter().copied())
        .expect("the reference renders");
    let of_reference = |(c, r): (u32, u32)| PixelValues::of(&images, (r * images.width + c) as usize);
    let pairs: Vec<_> =
        pixels.iter().filter_map(|p| Some((*p, of_reference(*p), oracle.cast(sensor, pose, *p)?))).collect();
    let there = compare_values(pairs.iter().copied(), &plan, Precision::F64);
    let back = compare_values(pairs.iter().map(|(p, r, o)| (*p, *o, *r)), &plan, Precision::F64);
    let of_tiles = tiles(&plan);
    let pairs = pairs.iter().map(|(p, _, o)| (*p, *o, PixelValues::of(&of_tiles, (p.1 * images.width + p.0) as usize)));
    [there, back, compare_values(pairs, &plan, Precision::F64)]
}

#[test]
fn reference_and_parry_agree_in_real_scenes() {
    let (seed, poses) = (env_number("PRESIGHT_SEED", 1), env_number("PRESIGHT_ORACLE_POSES", 20) as usize);
    let share = env_number("PRESIGHT_PRESETS", 4) as usize;
    let wanted = std::env::var("PRESIGHT_SCENES").unwrap_or_else(|_| data::SCENES.join(","));
    for (s, scene) in wanted.split(',').enumerate() {
        let Some(world) = data::scene(scene, true) else {
            return;
        };
        let oracle = Oracle::new(world.environment(), glam::DVec3::ZERO).expect("triangles");
        let (mut random, mut tiles) = (Random(seed), engines::cpu_by_tiles(2));
        let mut total = Report::default();
        for (i, pose) in data::poses(&world, poses, seed).iter().enumerate() {
            for sensor in data::presets_at(seed as usize + s, i, share) {
                let reports = check_image(&world, &oracle, (&sensor, pose), &mut random, &mut tiles);
                for (way, report) in ["reference, parry", "parry, reference", "parry, tiles"].iter().zip(reports) {
                    if report.fault > 0 {
                        let name = &sensor.spec().name;
                        eprintln!("{scene}, seed {seed}, pose {i} {pose:?}, {name}, {way}: {:#?}", report.faults);
                    }
                    total.add(report);
                }
            }
        }
        eprintln!("{scene}: {}", common::summary(&total));
        total.check(1e-4).unwrap();
    }
}

#[test]
fn a_displaced_polygon_is_noticed_by_the_oracle() {
    let world = common::scenes::room_world(5, 20);
    let pose = Pose::from_xyz_rpy(glam::DVec3::new(0.1, 0.2, 1.3), 0.0, 0.0, 0.3);
    let moved = Oracle::new(world.environment(), glam::DVec3::new(0.0, 0.0, 1e-5)).expect("triangles");
    let right = Oracle::new(world.environment(), pose.translation).expect("triangles");
    let sensor = common::scenes::scanner(90, 31);
    let reports = check_image(&world, &right, (&sensor, &pose), &mut Random(1), &mut engines::cpu_by_tiles(1));
    assert!(reports.iter().all(|r| r.fault == 0 && r.same > 100));
    // The oracle's sensor is 10 micrometres higher than the reference's.
    let higher = Pose::from_xyz_rpy(glam::DVec3::new(0.1, 0.2, 1.300_01), 0.0, 0.0, 0.3);
    let plan = plan(&world, &sensor, &pose);
    let mut images = Images::default();
    presight_render::reference::render(&plan, &mut images).unwrap();
    let pairs = (0..sensor.height()).flat_map(|r| (0..sensor.width()).map(move |c| (c, r))).filter_map(|p| {
        let reference = PixelValues::of(&images, (p.1 * images.width + p.0) as usize);
        Some((p, reference, moved.cast(&sensor, &higher, p)?))
    });
    assert!(compare_values(pairs, &plan, Precision::F64).fault > 100);
}
