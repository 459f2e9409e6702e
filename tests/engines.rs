//! Every engine against the reference, in full images, at free poses of real scenes.
//!
//! `PRESIGHT_SEED` and `PRESIGHT_POSES` (per scene) spread runs, `PRESIGHT_SCENES` names scenes, comma-separated.

#![expect(clippy::print_stderr, reason = "what was compared and where it failed is worth reading")]

mod common;

use common::{data, env_number, plan, reference, scenes, summary};
use glam::DVec3;
use presight::compare::{Precision, Report, compare};
use presight::{FramePlan, Images, Pose, Stats, cpu};
use std::time::Instant;

/// Edge pixels beyond this share fail, in scenes where rays and edges meet by chance only.
fn most_edge_share(precision: Precision) -> f64 {
    match precision {
        Precision::F64 => 1e-4,
        Precision::F32 => 2e-3,
        Precision::Snapped => 2e-2,
    }
}

/// Fills images that held something else before: an engine must write every pixel.
fn cpu_engine() -> impl FnMut(&FramePlan) -> Images {
    let mut engine = cpu::Engine::new(2).expect("two threads");
    move |plan| {
        let mut images = Images::default();
        images.prepare(plan.sensor.width(), plan.sensor.height(), plan.request.outputs);
        images.range.fill(-7.0);
        images.depth_z.fill(-7.0);
        images.cos_incidence.fill(-7.0);
        images.polygon_id.fill(0x7777_7777);
        images.object_id.fill(0x7777_7777);
        engine.render(plan, &mut images, &mut Stats::default()).expect("the engine renders");
        images
    }
}

fn check_room(mut render: impl FnMut(&FramePlan) -> Images, precision: Precision) {
    let mut report = Report::default();
    for seed in 0..10 {
        let world = scenes::room_world(seed, 30);
        let turn = seed as f64;
        let pose = Pose::from_xyz_rpy(DVec3::new(0.1, 0.2, 1.3), 0.1 * turn, 0.05, 0.7 * turn);
        for sensor in [scenes::camera(197, 161), scenes::scanner(360, 91), scenes::scanner(3600, 1)] {
            let plan = plan(&world, &sensor, &pose);
            report.add(compare(&reference(&plan), &render(&plan), &plan, precision).unwrap());
        }
    }
    eprintln!("rooms: {}", summary(&report));
    report.check(most_edge_share(precision)).unwrap();
}

fn check_scenes(mut render: impl FnMut(&FramePlan) -> Images, precision: Precision) {
    let wanted = std::env::var("PRESIGHT_SCENES").unwrap_or_else(|_| data::SCENES.join(","));
    let (seed, poses) = (env_number("PRESIGHT_SEED", 1), env_number("PRESIGHT_POSES", 2) as usize);
    for scene in wanted.split(',') {
        let Some(world) = data::scene(scene, true) else {
            return;
        };
        let start = Instant::now();
        let mut report = Report::default();
        for (i, pose) in data::poses(&world, poses, seed).iter().enumerate() {
            for sensor in data::presets() {
                let plan = plan(&world, &sensor, pose);
                let one = compare(&reference(&plan), &render(&plan), &plan, precision).unwrap();
                if one.fault > 0 {
                    let shown: Vec<_> = one.faults.iter().take(3).collect();
                    let name = &sensor.spec().name;
                    eprintln!("{scene}, seed {seed}, pose {i} {pose:?}, {name}: {} faults {shown:#?}", one.fault);
                }
                report.add(one);
            }
        }
        eprintln!("{scene}: {} in {:.1} s", summary(&report), start.elapsed().as_secs_f64());
        report.check(most_edge_share(precision)).unwrap();
    }
}

#[test]
fn cpu_in_rooms() {
    check_room(cpu_engine(), Precision::F64);
}

#[test]
fn cpu_in_real_scenes() {
    check_scenes(cpu_engine(), Precision::F64);
}
