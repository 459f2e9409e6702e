//! Generated hard scenes: compares the reference with parry, and the engines with the reference. 0 faults, always.
//!
//! `PROPTEST_CASES` sets the number of cases and `PRESIGHT_SEED` the seed, which is fixed by default.

#![allow(clippy::print_stderr)] // Prints skips and results.

use presight_testkit as common;

use common::hard::{Case, case, grazing};
use common::oracle::Oracle;
use common::{engines, plan, reference};
use presight_render::plan::{FramePlan, Images};
use presight_render::verify::{PixelValues, Precision, compare_values};
use proptest::prelude::*;
use proptest::test_runner::{RngSeed, TestRunner};
use std::cell::RefCell;

fn config() -> ProptestConfig {
    let cases = common::env_number("PROPTEST_CASES", 1500) as u32;
    let rng_seed = RngSeed::Fixed(common::env_number("PRESIGHT_SEED", 1));
    ProptestConfig { cases, rng_seed, max_shrink_iters: 3000, failure_persistence: None, ..ProptestConfig::default() }
}

/// Compares an engine with the reference on one case, with every sensor.
fn check_engine(
    case: &Case,
    render: &mut impl FnMut(&FramePlan) -> Images,
    precision: Precision,
) -> Result<(), TestCaseError> {
    let (world, pose, sensors) = case.build();
    for sensor in sensors {
        let plan = plan(&world, &sensor, &pose);
        let report = common::compare_or_show(&reference(&plan), &render(&plan), &plan, precision);
        let first = report.faults.first();
        prop_assert!(report.fault == 0, "{}: {} faults, first {first:#?}", sensor.spec().name, report.fault);
    }
    Ok(())
}

/// Compares the reference with parry. A pixel at which parry hits a polygon whose plane passes through the sensor is
/// ignored: there the polygon covers no ray by definition.
fn check_oracle(case: &Case) -> Result<(), TestCaseError> {
    let (world, pose, sensors) = case.build_triangles();
    let Some(oracle) = Oracle::off_plane(world.environment(), pose.translation) else {
        return Ok(());
    };
    for sensor in sensors {
        let plan = plan(&world, &sensor, &pose);
        let images = reference(&plan);
        let pixels = (0..sensor.height()).flat_map(|r| (0..sensor.width()).map(move |c| (c, r)));
        let pairs: Vec<_> = pixels
            .filter_map(|p| {
                let shown = oracle.cast(&sensor, &pose, p)?;
                Some((p, PixelValues::of(&images, (p.1 * images.width + p.0) as usize), shown))
            })
            .collect();
        let report = compare_values(pairs.into_iter(), &plan, Precision::F64);
        let first = report.faults.first();
        prop_assert!(report.fault == 0, "{}: {} faults, first {first:#?}", sensor.spec().name, report.fault);
    }
    Ok(())
}

fn check_all(cases: impl Strategy<Value = Case>, check: impl Fn(&Case) -> Result<(), TestCaseError>) {
    TestRunner::new(config()).run(&cases, |case| check(&case)).unwrap_or_else(|e| panic!("{e}"));
}

fn check_cases(check: impl Fn(&Case) -> Result<(), TestCaseError>) {
    check_all(case(), check);
}

#[test]
fn reference_and_parry_agree() {
    check_cases(check_oracle);
}

#[test]
fn cpu_is_right() {
    let render = RefCell::new(engines::cpu(1));
    check_cases(|case| check_engine(case, &mut *render.borrow_mut(), Precision::F64));
}

#[test]
fn cpu_is_right_at_grazing_angles() {
    let render = RefCell::new(engines::cpu(1));
    check_all(grazing(), |case| check_engine(case, &mut *render.borrow_mut(), Precision::F64));
}

#[test]
fn cpu_is_right_by_tiles() {
    let render = RefCell::new(engines::cpu_by_tiles(1));
    check_cases(|case| check_engine(case, &mut *render.borrow_mut(), Precision::F64));
}

#[test]
fn cpu_is_right_by_tiles_at_grazing_angles() {
    let render = RefCell::new(engines::cpu_by_tiles(1));
    check_all(grazing(), |case| check_engine(case, &mut *render.borrow_mut(), Precision::F64));
}

#[test]
fn gpu_is_right_at_grazing_angles() {
    if let Some(gpu) = engines::gpu() {
        let render = RefCell::new(gpu);
        check_all(grazing(), |case| check_engine(case, &mut *render.borrow_mut(), Precision::F32));
    }
}

/// One sliver in front of the GPU engine: its place, direction, length and aspect; the rotation, scale and shear of its
/// mesh.
fn check_sliver(unit: f64, at: [f64; 3], (along, long, aspect): ([f64; 3], f64, f64), mesh: ([f64; 3], [f64; 3], f64)) {
    use common::hard::{Shape, ShapePlacement};
    let placing = ShapePlacement { turn: mesh.0, scale: mesh.1, shear: mesh.2 };
    let shapes = vec![(Shape::Sliver { at, along, long, aspect }, placing)];
    let case = Case { shapes, unit, at: [0.0; 3], turn: [0.0; 3], limits: None, fine: false };
    if let Some(mut gpu) = engines::gpu() {
        check_engine(&case, &mut gpu, Precision::F32).unwrap();
    }
}

/// The long sides of this sliver run towards a ray of the table; edge planes cannot distinguish it from a ray inside.
#[test]
fn a_sliver_is_not_seen_at_its_vanishing_point() {
    let mesh = (
        [1.2823919490829898, 0.0, 1.165545904707838],
        [3.4516506236495275, -9.504869800754584, -7.818688879321611],
        1.6981120438347148,
    );
    let along = ([0.0, 0.0, 1.0], 7.620723058033309, 61401.428461086725);
    check_sliver(1e-3, [0.0, 7.313833593351606, 7.313833593351606], along, mesh);
}

#[test]
fn a_sliver_is_not_seen_beyond_its_end_on_lines() {
    let mesh = (
        [0.0, 0.9812797453782295, 2.5407180247434344],
        [2.4178157433878704, -2.2541826586488876, 9.314303646842474],
        1.7002642750806187,
    );
    check_sliver(1.0, [0.0, 0.0, 3.047230977134758], ([0.0, 1.0, 1.0], 3.1200004157051215, 21887.168291616068), mesh);
}

#[test]
fn a_far_sliver_flat_to_the_sensor_ends_at_its_corner() {
    let mesh = (
        [-1.1168009491646285, -2.4374656620128055, -2.692226095330621],
        [-5.490462491510642, 6.7663527042851275, 7.183942443517694],
        0.0,
    );
    check_sliver(100.0, [0.0, 42.4176835766584, 0.0], ([0.0, 1.0, 1.0], 0.20455509175793538, 10.0), mesh);
}

/// Cells of 0.2 mrad at rays of 0.1 mrad: only the cap distinguishes a cell from the next but one.
#[test]
fn a_cell_of_a_carpet_ends_at_its_corners_on_a_ray_table() {
    use common::hard::{Shape, ShapePlacement};
    let carpet = Shape::Carpet {
        at: [1.4056834039394541, 1.4058727194305156, 0.00022951257164875459],
        normal: [-0.6108024886160263, 0.6108031215650412, -0.5038252341704121],
        cell: 0.0003529135217177236,
        cells: 7,
    };
    let placing = ShapePlacement { turn: [0.0; 3], scale: [1.0; 3], shear: 0.0 };
    let case =
        Case { shapes: vec![(carpet, placing)], unit: 1.0, at: [0.0; 3], turn: [0.0; 3], limits: None, fine: false };
    if let Some(mut gpu) = engines::gpu() {
        check_engine(&case, &mut gpu, Precision::F32).unwrap();
    }
}

#[test]
fn gpu_is_right() {
    if let Some(gpu) = engines::gpu() {
        let render = RefCell::new(gpu);
        check_cases(|case| check_engine(case, &mut *render.borrow_mut(), Precision::F32));
    }
}
