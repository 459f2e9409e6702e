//! Scans that take time: the first scans of a robot that drives already, and times that the log does not state.

use super::changed::hall;
use super::*;
use presight_localize::estimate::nees;
use presight_localize::localize::Phase;
use presight_model::geometry::Twist;
use presight_model::sensor::{RayTimes, StampAt};
use presight_testkit::caster::Caster;
use presight_testkit::oracle::Oracle;
use presight_testkit::route::{Driving, Route};

/// 16 rows of 180 beams, 1 m above the floor.
fn lidar(times: RayTimes) -> Sensor {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 2.0, count: 180 };
    let elevation = Angles::Uniform { start_deg: 20.0, step_deg: -2.5, count: 16 };
    let geometry = Geometry::Scanner(Scanner { azimuth, elevation, beam_height_deg: None });
    let mut spec = SensorSpec::new("lidar", "laser", geometry).with_times(times);
    (spec.range_max, spec.noise.range_sigma) = (30.0, 0.01);
    spec.mount.translation = DVec3::new(0.1, 0.0, 1.0);
    Sensor::new(spec).unwrap()
}

/// A drive of a lidar whose rays are measured at `times`, while the sensor file states others.
struct Drive {
    world: World,
    route: Route,
    caster: Caster,
    sensor: Sensor,
}

impl Drive {
    /// The robot drives for 2.5 s before the first frame.
    const BEFORE: f64 = 2.5;

    fn new(times: RayTimes, stated: RayTimes, seed: u64) -> Self {
        let world = hall();
        let oracle = Oracle::new(world.environment(), DVec3::ZERO).unwrap();
        let driving = Driving { seconds: 8.0, speed: 1.5, turn: 1.5 };
        let route = Route::wander(&oracle, &world.environment().bounds(), &driving, seed);
        let sensor = lidar(stated);
        let mut caster = Caster::new(world.environment(), sensor.clone(), seed);
        caster.times = times;
        Self { world, route, caster, sensor }
    }

    fn localizer(&self) -> Localizer {
        let prior = PoseEstimate::of_sigmas(RobotPose::new(self.route.at(Self::BEFORE)), 0.05, 0.035);
        let options = EstimateOptions::of(&self.sensor).with_learns_sigma(true);
        Localizer::new(estimator(options), prior, LocalizeOptions::default())
    }

    /// The frame `k` of ten a second, and the true pose at its stamp.
    fn frame(&mut self, k: u32) -> (Frame, Pose) {
        let time = Self::BEFORE + 0.1 * f64::from(k);
        let route = &self.route;
        let frame = self.caster.frame(&|t| route.at(t), time, (k > 0).then_some(time - 0.1));
        (frame, route.at(time))
    }

    /// The true twist of the robot from the stamp on, in its axes.
    fn twist(&self, k: u32) -> Twist {
        let time = Self::BEFORE + 0.1 * f64::from(k);
        Twist::to(&(self.route.at(time).inverse() * self.route.at(time + 0.1)), 0.1)
    }

    fn warnings(&mut self, frames: u32) -> Vec<String> {
        let mut robot = self.localizer();
        for k in 0..frames {
            let (frame, _) = self.frame(k);
            robot.step(&self.world.clone(), &frame).unwrap();
        }
        robot.warnings()
    }
}

fn turning(turn_s: f64, stamp: StampAt) -> RayTimes {
    RayTimes::turning(turn_s, stamp)
}

/// The start is exact, and the motion unknown: the first scans themselves show it. A point at the end of a scan of 0.1
/// s is off by 7.5 cm and 4 degrees at 1.5 m/s and 1.5 rad/s. A twist in the axes of the world would point elsewhere by
/// the heading.
#[test]
fn the_first_scan_of_a_driving_robot_tells_its_motion() {
    for seed in [3, 4] {
        let mut drive = Drive::new(turning(0.1, StampAt::First), turning(0.1, StampAt::First), seed);
        drive.caster.slip = None;
        let mut robot = drive.localizer();
        let mut sum = 0.0;
        for k in 0..3 {
            let (frame, truth) = drive.frame(k);
            let step = robot.step(&drive.world, &frame).unwrap();
            let (squared, axes) = nees(&step.pose, &RobotPose::new(truth));
            let off = apart(&step.pose.world_from_robot, &truth);
            assert!(off.0 < 0.01 && off.1 < 0.3, "{seed}, {k}: {off:?}");
            sum += squared / axes as f64 / 3.0;
            let motion = step.scan_motion.unwrap();
            let twist = Twist::to(&(motion.at(0.0).unwrap().inverse() * motion.at(0.099).unwrap()), 0.099);
            let true_twist = drive.twist(k);
            let metres = (twist.linear - true_twist.linear).length();
            println!(
                "{seed}, {k}: {metres:.3} m/s, NEES {:.2}, {off:?}, {:?}",
                squared / axes as f64,
                step.pose.covariance.sigmas()
            );
            assert!(metres < 0.15, "{seed}, {k}: {twist:?} instead of {true_twist:?}");
            let in_world = truth.rotation * true_twist.linear;
            assert!((twist.linear - in_world).length() > 4.0 * metres, "planted: axes of the world");
            assert!((twist.angular - true_twist.angular).length() < 0.05, "{seed}, {k}: {twist:?} {true_twist:?}");
        }
        assert!(sum < 2.0, "{seed}: NEES a number {sum}");
    }
}

/// Nothing is stated, the wrong direction, and the wrong place of the stamp; the note says what to write. Stated
/// rightly there is none, and none for scans that are measured at once.
#[test]
fn the_times_of_a_scan_are_learnt() {
    let cases = [
        (turning(0.1, StampAt::First), RayTimes::AtOnce, Some((Some(0.1), "first"))),
        (turning(-0.1, StampAt::Last), RayTimes::AtOnce, Some((Some(-0.1), "last"))),
        (turning(0.1, StampAt::First), turning(-0.1, StampAt::First), Some((Some(0.1), "first"))),
        (turning(0.1, StampAt::Last), turning(0.1, StampAt::First), Some((None, "last"))),
        (turning(0.1, StampAt::First), turning(0.1, StampAt::First), None),
        (RayTimes::AtOnce, RayTimes::AtOnce, None),
    ];
    for (times, stated, expected) in cases {
        let mut drive = Drive::new(times.clone(), stated.clone(), 5);
        let lines = drive.warnings(50);
        let found = lines.iter().find(|line| line.starts_with("the scans seem to"));
        println!("{times:?} for {stated:?}: {lines:?}");
        match (expected, found) {
            (Some((turn_s, stamp)), Some(line)) => {
                let said = |key: &str| line.split(key).nth(1).and_then(|rest| rest.split([' ', '"']).next());
                // A stamp that the odometry does not show is not named.
                let right_stamp = said("stamp = \"").map_or(turn_s.is_some(), |found| found == stamp);
                let off = |turn_s: f64| said("turn_s = ").and_then(|s| s.parse::<f64>().ok()).map(|s| s / turn_s - 1.0);
                let right_turn = turn_s.is_none_or(|turn_s| off(turn_s).is_some_and(|off| off.abs() < 0.05));
                assert!(right_stamp && right_turn, "{times:?} for {stated:?}: {line}");
            }
            (None, None) => {}
            _ => panic!("{times:?} for {stated:?}: {lines:?}"),
        }
    }
}

/// A log that does not say that its scans take 0.1 s: each pose belongs to the middle of its scan, and the
/// covariances know it.
#[test]
fn a_scan_of_unknown_times_has_a_wide_covariance() {
    let mut drive = Drive::new(turning(0.1, StampAt::First), RayTimes::AtOnce, 6);
    let mut robot = drive.localizer();
    let mut sum = 0.0;
    for k in 0..25 {
        let (frame, truth) = drive.frame(k);
        let step = robot.step(&drive.world, &frame).unwrap();
        let (squared, axes) = nees(&step.pose, &RobotPose::new(truth));
        // A given start is tracked from the third frame on.
        assert!(k < 3 || step.phase == Phase::Tracking, "{k}: {}", step.reason);
        sum += squared / axes as f64 / 25.0;
    }
    assert!(sum < 2.0, "NEES a number {sum}");
}
