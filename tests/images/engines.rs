//! Compares every engine with the reference in full images at free poses of real scenes.
//!
//! `PRESIGHT_SEED`, `PRESIGHT_POSES` (per scene; half as many for the GPU engine) and `PRESIGHT_PRESETS` (per pose)
//! vary the runs, `PRESIGHT_SCENES` names scenes, separated by commas. By default 4 of the 8 presets alternate over the
//! poses, with a different order in each scene and for each seed: two poses cover every preset, and two seeds do so for
//! a single pose.

#![expect(clippy::print_stderr, reason = "the tests print their comparisons")]

use presight_testkit as common;

use common::{compare_or_show, data, engines, env_number, plan, reference, scenes, summary};
use glam::DVec3;
use presight_model::geometry::Pose;
use presight_render::plan::{FramePlan, Images};
use presight_render::verify::{Precision, Report};
use std::time::Instant;

/// A larger share of edge pixels fails, in scenes where rays hit edges only by chance.
const MOST_EDGE_SHARE: f64 = 1e-4;

fn check_room(mut render: impl FnMut(&FramePlan) -> Images, precision: Precision) {
    let mut report = Report::default();
    for seed in 0..10 {
        let world = scenes::room_world(seed, 30);
        let turn = seed as f64;
        let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.3), 0.1 * turn, 0.05, 0.7 * turn);
        let scanners = [scenes::scanner(360, 91), scenes::scanner(3600, 1), scenes::closed(181, 31)];
        for sensor in [scenes::camera(197, 161)].into_iter().chain(scanners) {
            let plan = plan(&world, &sensor, &pose);
            let images = render(&plan);
            report.add(compare_or_show(&reference(&plan), &images, &plan, precision));
            let (width, distinct) = (sensor.width() as usize, sensor.distinct_columns() as usize);
            if distinct < width {
                let same = |row: &[f32]| row[0].to_bits() == row[distinct].to_bits();
                assert!(images.range.chunks(width).all(same), "seed {seed}: a column that comes twice");
            }
        }
    }
    eprintln!("rooms: {}", summary(&report));
    report.check(MOST_EDGE_SHARE).unwrap();
}

/// Compares full images at each pose for `share` presets, or for all.
fn check_scenes(mut render: impl FnMut(&FramePlan) -> Images, precision: Precision, poses: usize, share: usize) {
    let wanted = std::env::var("PRESIGHT_SCENES").unwrap_or_else(|_| data::SCENES.join(","));
    let seed = env_number("PRESIGHT_SEED", 1);
    for (s, scene) in wanted.split(',').enumerate() {
        let Some(world) = data::scene(scene, true) else {
            return;
        };
        let start = Instant::now();
        let mut report = Report::default();
        for (i, pose) in data::poses(&world, poses, seed).iter().enumerate() {
            for sensor in data::presets_at(seed as usize + s, i, share) {
                let plan = plan(&world, &sensor, pose);
                let one = compare_or_show(&reference(&plan), &render(&plan), &plan, precision);
                if one.fault > 0 {
                    let shown: Vec<_> = one.faults.iter().take(3).collect();
                    let name = &sensor.spec().name;
                    eprintln!("{scene}, seed {seed}, pose {i} {pose:?}, {name}: {} faults {shown:#?}", one.fault);
                }
                report.add(one);
            }
        }
        eprintln!("{scene}: {} in {:.1} s", summary(&report), start.elapsed().as_secs_f64());
        report.check(MOST_EDGE_SHARE).unwrap();
    }
}

fn poses() -> usize {
    env_number("PRESIGHT_POSES", 2) as usize
}

/// The number of presets at each pose.
fn share() -> usize {
    env_number("PRESIGHT_PRESETS", 4) as usize
}

#[test]
fn cpu_in_rooms() {
    check_room(engines::cpu(2), Precision::F64);
}

#[test]
fn cpu_in_real_scenes() {
    check_scenes(engines::cpu(2), Precision::F64, poses(), share());
}

#[test]
fn cpu_by_tiles_in_rooms() {
    check_room(engines::cpu_by_tiles(2), Precision::F64);
}

/// Half of the poses: `ways` compares the bits of both ways, too.
#[test]
fn cpu_by_tiles_in_real_scenes() {
    check_scenes(engines::cpu_by_tiles(2), Precision::F64, poses().div_ceil(2), share());
}

#[test]
fn gpu_in_rooms() {
    if let Some(gpu) = engines::gpu() {
        check_room(gpu, Precision::F32);
    }
}

#[test]
fn gpu_in_real_scenes() {
    if let Some(gpu) = engines::gpu() {
        check_scenes(gpu, Precision::F32, poses().div_ceil(2), share());
    }
}
