//! Localizers over time: scans that turn while the robot drives, given starts, and what a lost camera does.

use super::changed::hall;
use super::*;
use presight_localize::estimate::nees;
use presight_localize::localize::Phase;
use presight_model::geometry::RobotPose;
use presight_model::sensor::{RayTimes, StampAt};
use presight_testkit::caster::Caster;
use presight_testkit::oracle::Oracle;
use presight_testkit::route::{Driving, Route};

/// A scanner takes 0.1 s for a turn on a robot of up to 1.5 m/s and 1 rad/s. The rest of its motion is in the covariance: the
/// squared errors are as large as it says, by a factor of three at most. Without the unknown acceleration they are twenty times as large.
#[test]
fn a_scan_that_turns_is_as_unsure_as_its_motion() {
    let world = hall();
    let oracle = Oracle::new(world.environment(), DVec3::ZERO).unwrap();
    let driving = Driving { seconds: 7.0, speed: 1.5, turn: 1.0 };
    let route = Route::wander(&oracle, &world.environment().bounds(), &driving, 3);
    let mut spec = scanner(0.01).spec().clone().with_times(RayTimes::turning(0.1, StampAt::First));
    spec.mount.translation.z = 0.5;
    let sensor = Sensor::new(spec).unwrap();
    let mut caster = Caster::new(world.environment(), sensor.clone(), 1);
    caster.times = RayTimes::turning(0.1, StampAt::First);
    let options = EstimateOptions::of(&sensor).with_learns_sigma(true);
    let prior = PoseEstimate::of_sigmas(RobotPose::new(route.at(0.0)), 0.02, 0.01);
    let mut robot = Localizer::new(estimator(options), prior, LocalizeOptions::default());
    let (mut sum, mut squares) = (0.0, [0.0; 2]);
    for k in 0..60 {
        let time = 0.1 * f64::from(k);
        let frame = caster.frame(&|t| route.at(t), time, (k > 0).then_some(time - 0.1));
        let step = robot.step(&world, &frame).unwrap();
        assert_eq!(step.phase, Phase::Tracking, "{k}: {}", step.reason);
        let (squared, axes) = nees(&step.pose, &RobotPose::new(route.at(time)));
        let off = apart(&step.pose.world_from_robot, &route.at(time));
        if k >= 10 {
            sum += squared / axes as f64 / 50.0;
            squares = [squares[0] + off.0 * off.0 / 50.0, squares[1] + off.1 * off.1 / 50.0];
        }
    }
    assert!((0.2..3.0).contains(&sum), "NEES a number {sum}");
    assert!(squares[0].sqrt() < 0.01 && squares[1].sqrt() < 0.1, "{squares:?}");
}

/// A given start is tracked from the first frame that speaks for it: no frame selected it. One that is given 2 m away from the robot is not.
#[test]
fn a_given_start_is_tracked_from_its_first_frame() {
    let (world, sensor) = (room(Vec3::ZERO), camera(0.01));
    let at = |x: f64| Pose::from_xyz_rpy(DVec3::new(x, 2.0, 1.2), 0.0, 0.1, 0.3);
    let frame = sense(&world, &sensor, &at(1.0), &mut Random(3));
    for (given, phase) in [(1.0, Phase::Tracking), (3.0, Phase::Kept)] {
        let prior = PoseEstimate::of_sigmas(RobotPose::new(at(given)), 0.02, 0.01);
        let mut robot = Localizer::new(estimator(EstimateOptions::default()), prior, LocalizeOptions::default());
        let step = robot.step(&world, &frame).unwrap();
        let is_as_expected = if phase == Phase::Tracking { step.phase == phase } else { step.phase != Phase::Tracking };
        assert!(is_as_expected, "given at {given}: {}: {}", step.phase.name(), step.reason);
    }
}

/// A camera that is carried from its room to another one: each frame draws the number of starts that the options state, says it, and makes
/// few predictions.
#[test]
fn a_lost_camera_spreads_its_search_over_frames() {
    let (map, hall, sensor) = (room(Vec3::ZERO), hall(), camera(0.01));
    let options = LocalizeOptions::default().with_search_starts(8);
    let at = |k: u32| Pose::from_xyz_rpy(DVec3::new(1.0 + 0.03 * f64::from(k), 2.0, 1.2), 0.0, 0.1, 0.3);
    let prior = PoseEstimate::of_sigmas(RobotPose::new(at(0)), 0.02, 0.01);
    let mut robot = Localizer::new(estimator(EstimateOptions::default()), prior, options);
    let mut said = Vec::new();
    for k in 0..12u32 {
        let mut frame = sense(if k < 4 { &map } else { &hall }, &sensor, &at(k), &mut Random(k.into()));
        frame.stamp = f64::from(k);
        let was_lost = robot.phase() == Phase::Lost;
        let step = robot.step(&map, &frame).unwrap();
        assert_eq!(step.phase == Phase::Tracking, k < 4, "{k}: {}", step.reason);
        if was_lost && step.phase == Phase::Lost && step.candidates.is_empty() {
            said.push(step.reason.clone());
            assert!(step.estimate.predictions <= 2, "{k}: {} predictions", step.estimate.predictions);
        }
    }
    assert!(said.len() >= 2, "{said:?}");
    let starts = |text: &String| text.split(" by ").nth(1).and_then(|rest| rest.split(' ').next()?.parse::<u64>().ok());
    let counts: Vec<u64> = said.iter().map(|text| starts(text).unwrap_or_else(|| panic!("{text}"))).collect();
    assert!(counts.iter().all(|n| n % 8 == 0) && counts.windows(2).all(|n| n[1] > n[0]), "{said:?}");
    assert!(said[0].contains("no place fits within 1.0 m and 34 deg of the last pose"), "{}", said[0]);
}
