//! Invalid deadlines, clocks that jump, and engines that cannot stop.

use crate::common::scenes::{camera, room_world};
use crate::ticks::{Jumping, Ticks, Untouchable};
use presight_model::error::ErrorKind;
use presight_model::geometry::SensorPose;
use presight_predict::engine::EngineKind;
use presight_predict::predict::{Backend, Options, Predictor};
use presight_predict::request::Request;
use presight_render::deadline::Priority;
use std::sync::Arc;
use std::time::Duration;

fn predictor() -> Predictor {
    Predictor::new(Options::new(Backend::Cpu).with_threads(1)).unwrap()
}

fn within(deadline: Duration) -> Request {
    Request::default().with_deadline(deadline)
}

#[test]
fn zero_time_is_wrong_usage_and_too_little_fails_in_time() {
    let (world, sensor, mut predictor) = (room_world(1, 50), camera(640, 480), predictor());
    let none = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &within(Duration::ZERO)).unwrap_err();
    assert_eq!((none.kind(), none.kind().exit_status()), (ErrorKind::Usage, 2));
    // Refused before any rendering: selection checks the clock when it ends.
    let clock = Arc::new(Ticks::default());
    predictor.set_clock(clock.clone());
    let too_little =
        predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &within(Duration::from_nanos(1))).unwrap_err();
    assert_eq!(clock.looks(), 2);
    assert_eq!((too_little.kind(), too_little.kind().exit_status()), (ErrorKind::Deadline, 4));
    let said = too_little.to_string();
    assert!(said.starts_with("no prediction is possible within 0.000 ms; give ") && !said.contains('\n'), "{said}");
    // The next prediction is not affected.
    let all = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &within(Duration::MAX)).unwrap();
    assert_eq!(all.degradation(), None);
    assert!(all.stats.deadline.is_some());
}

#[test]
fn without_a_deadline_no_clock_is_read() {
    let (world, sensor, mut predictor) = (room_world(1, 50), camera(64, 48), predictor());
    predictor.set_clock(Arc::new(Untouchable));
    let seen = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &Request::default()).unwrap();
    assert_eq!(seen.stats.deadline, None);
    assert!(
        std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &within(Duration::from_secs(1)))
        }))
        .is_err()
    );
}

/// With any clock, images stay right and costs stay finite.
#[test]
fn a_clock_that_jumps_does_no_harm() {
    let (world, sensor, mut predictor) = (room_world(1, 300), camera(64, 48), predictor());
    let full = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &Request::default()).unwrap().images;
    predictor.set_clock(Arc::new(Jumping::default()));
    let mut answers = 0;
    for k in 1..60u64 {
        match predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &within(Duration::from_millis(40 * k))) {
            Ok(partial) => {
                answers += 1;
                for (full, partial) in full.range.iter().zip(&partial.images.range) {
                    assert!(full == partial || partial.is_nan(), "{full} {partial}");
                }
            }
            Err(e) => assert_eq!(e.kind(), ErrorKind::Deadline),
        }
    }
    assert!(answers > 0);
    let costs = predictor.costs();
    for key in costs.keys() {
        assert!(costs.unit_costs(key).unwrap().iter().all(|c| c.is_finite() && *c >= 0.0));
    }
}

#[test]
fn an_engine_that_cannot_stop_reports_it() {
    let (world, sensor) = (room_world(1, 10), camera(32, 24));
    let options = Options::new(Backend::Cpu).with_threads(1);
    let engine = EngineKind::Reference.open(&1.into()).unwrap();
    let mut predictor = Predictor::with_engine(options, engine);
    let refused =
        predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &within(Duration::from_secs(1))).unwrap_err();
    assert_eq!(refused.kind(), ErrorKind::Usage);
    assert!(refused.to_string().contains("`Backend::Cpu`"), "{refused}");
    // Where no engine was named, the CPU engine takes over and reports it.
    let engine = EngineKind::Reference.open(&1.into()).unwrap();
    let mut predictor = Predictor::with_engine(Options::new(Backend::Auto).with_threads(1), engine);
    for _ in 0..2 {
        let seen = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &within(Duration::from_secs(10))).unwrap();
        assert_eq!((seen.stats.engine, seen.degradation()), ("cpu", None));
        assert_eq!(seen.stats.notices, ["the CPU engine kept the deadline: reference cannot stop"]);
    }
    let without = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &Request::default()).unwrap();
    assert_eq!((without.stats.engine, without.stats.notices.len()), ("reference", 0));
}

#[test]
fn priorities_without_sense_are_wrong_usage() {
    let (world, sensor, mut predictor) = (room_world(1, 10), camera(32, 24), predictor());
    let radii = [0.0, -1.0, f64::NAN, f64::INFINITY].map(|metres| Priority::default().with_min_radius(metres));
    let headings = [f64::NAN, f64::NEG_INFINITY].map(|heading| Priority::default().with_heading(heading));
    for priority in radii.into_iter().chain(headings) {
        let request = within(Duration::from_secs(1)).with_priority(priority);
        let refused = predictor.predict(&world, &sensor, &SensorPose::IDENTITY, &request).unwrap_err();
        assert_eq!(refused.kind(), ErrorKind::Usage, "{refused}");
    }
}
