//! Generated hard scenes: the reference against parry, the engines against the reference. 0 faults, always.
//!
//! `PROPTEST_CASES` says how many, `PROPTEST_RNG_SEED` spreads runs.

mod common;

use common::hard::{Case, case};
use common::oracle::Oracle;
use common::{plan, reference};
use presight::compare::{Precision, Values, compare, compare_values};
use presight::{FramePlan, Images, Stats, cpu};
use proptest::prelude::*;

fn config() -> ProptestConfig {
    let cases = common::env_number("PROPTEST_CASES", 300) as u32;
    ProptestConfig { cases, max_shrink_iters: 3000, failure_persistence: None, ..ProptestConfig::default() }
}

/// Holds an engine to the reference on one case, with every sensor.
fn check_engine(case: &Case, render: impl Fn(&FramePlan) -> Images, precision: Precision) -> Result<(), TestCaseError> {
    let (world, pose, sensors) = case.build();
    for sensor in sensors {
        let plan = plan(&world, &sensor, &pose);
        let report = compare(&reference(&plan), &render(&plan), &plan, precision).expect("images of one shape");
        let first = report.faults.first();
        prop_assert!(report.fault == 0, "{}: {} faults, first {first:#?}", sensor.spec().name, report.fault);
    }
    Ok(())
}

/// The reference against parry. A pixel at which parry meets a polygon whose plane passes through the sensor says
/// nothing: there the polygon covers no ray by definition.
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
                Some((p, Values::of(&images, (p.1 * images.width + p.0) as usize), shown))
            })
            .collect();
        let report = compare_values(pairs.into_iter(), &plan, Precision::F64);
        let first = report.faults.first();
        prop_assert!(report.fault == 0, "{}: {} faults, first {first:#?}", sensor.spec().name, report.fault);
    }
    Ok(())
}

proptest! {
    #![proptest_config(config())]

    #[test]
    fn reference_and_parry_agree(case in case()) {
        check_oracle(&case)?;
    }

    #[test]
    fn cpu_is_right(case in case()) {
        let render = |plan: &FramePlan| {
            let mut images = Images::default();
            let mut engine = cpu::Engine::new(1).expect("a thread");
            engine.render(plan, &mut images, &mut Stats::default()).expect("the engine renders");
            images
        };
        check_engine(&case, render, Precision::F64)?;
    }
}
