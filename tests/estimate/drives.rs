//! Robots localized from frame to frame.

use super::*;
use presight_localize::localize::{LocalizeOptions, Localizer, Phase};
use presight_model::error::ErrorKind;
use presight_model::geometry::{PoseCovariance, PoseEstimate, RobotPose};

/// A pose on a round trip through the room, looking ahead and slightly down.
fn on_the_way(k: usize) -> Pose {
    let t = 0.02 * k as f64;
    let at = DVec3::new(1.3 + 0.5 * t.sin(), 2.3 + 0.4 * t.cos(), 1.4);
    Pose::from_xyz_rpy(at, 0.0, 0.25, -0.25 + 0.3 * (0.7 * t).sin())
}

fn at(stamp: f64, frame: Frame) -> Frame {
    Frame::new(stamp, frame.sensor().clone(), frame.measurement().clone()).unwrap()
}

fn localizer(start: &Pose) -> Localizer {
    let prior = PoseEstimate::of_sigmas(RobotPose::new(*start), 0.05, 0.03);
    Localizer::new(estimator(EstimateOptions::default()), prior, LocalizeOptions::default())
}

#[test]
fn a_drive_is_tracked_without_odometry() {
    let (world, sensor, mut random) = (room(Vec3::ZERO), camera(0.01), Random(11));
    let mut robot = localizer(&off_by(&on_the_way(0), 0.04, 1.5, &mut random));
    for k in 0..60 {
        let truth = on_the_way(k);
        let step = robot.step(&world, &at(k as f64, sense(&world, &sensor, &truth, &mut random))).unwrap();
        let (metres, degrees) = apart(&step.pose.world_from_robot, &truth);
        assert!(metres < 0.01 && degrees < 0.3, "{k}: {metres} m {degrees} deg, {}", step.reason);
        assert!(k < 3 || step.phase == Phase::Tracking, "{k}: {}", step.reason);
    }
}

/// The robot moves 0.3 m and 11 degrees at a time, at the second frame and again after a stop, without odometry. Its
/// pose is known at every frame.
#[test]
fn a_robot_that_stops_and_goes_is_followed() {
    let (world, sensor, mut random) = (room(Vec3::ZERO), camera(0.01), Random(15));
    let mut robot = localizer(&on_the_way(0));
    for k in 0..16 {
        let moves = if k == 0 { 0 } else { 1 + (k - 1) / 5 };
        let turn =
            Pose::from_xyz_rpy(DVec3::new(0.25 * f64::from(moves), 0.15 * f64::from(moves % 2), 0.0), 0.0, 0.0, 0.0);
        let ahead = Pose::from_xyz_rpy(DVec3::ZERO, 0.0, 0.0, 0.2 * f64::from(moves % 2));
        let truth = turn * on_the_way(0) * ahead;
        let step = robot.step(&world, &at(f64::from(k), sense(&world, &sensor, &truth, &mut random))).unwrap();
        let (metres, degrees) = apart(&step.pose.world_from_robot, &truth);
        assert!(step.is_known() && metres < 0.01 && degrees < 0.3, "{k}: {metres} m {degrees} deg, {}", step.reason);
        assert!(k < 3 || step.phase == Phase::Tracking, "{k}: {}", step.reason);
    }
}

/// The estimator reports a carried-away robot as lost within five frames, and finds it again after it is put back.
#[test]
fn a_kidnapped_robot_is_lost() {
    let (world, sensor) = (room(Vec3::ZERO), camera(0.01));
    let elsewhere = Pose::from_xyz_rpy(DVec3::new(4.6, 1.2, 1.2), 0.0, 0.1, 2.9);
    // Carries it away at the first frame at which that can be noticed, and after the usual level is well known.
    for taken in [3, 20] {
        let (mut robot, mut random) = (localizer(&on_the_way(0)), Random(12));
        let (mut lost, mut back) = (None, None);
        for k in 0..taken + 30 {
            let away = (taken..taken + 8).contains(&k);
            let truth = if away { elsewhere } else { on_the_way(k) };
            let step = robot.step(&world, &at(k as f64, sense(&world, &sensor, &truth, &mut random))).unwrap();
            if k < taken {
                assert_ne!(step.phase, Phase::Lost, "a false alarm at {k}: {}", step.reason);
            }
            if step.phase == Phase::Lost {
                lost.get_or_insert(k);
            }
            if k >= taken + 8 && step.phase == Phase::Tracking {
                back.get_or_insert(k);
            }
            let (metres, _) = apart(&step.pose.world_from_robot, &truth);
            assert!(
                step.phase != Phase::Tracking || metres < 0.05 || k < taken + 5,
                "{k}: tracking and {metres} m off"
            );
        }
        assert!(lost.is_some_and(|k| (taken..taken + 5).contains(&k)), "{lost:?}");
        assert!(back.is_some_and(|k| k < taken + 18), "{back:?}");
    }
}

#[test]
fn a_wrong_map_is_never_tracked() {
    let (real, sensor, mut random) = (room(Vec3::ZERO), camera(0.01), Random(13));
    let mut other = Environment::new();
    other.add_material(Material::named("m")).unwrap();
    add_box(&mut other, "hall", Vec3::new(-2.0, -1.0, 0.0), Vec3::new(8.5, 6.3, 4.0));
    add_box(&mut other, "press", Vec3::new(3.0, 3.0, 0.0), Vec3::new(4.5, 4.0, 2.0));
    let other = World::new(other);
    let mut robot = localizer(&on_the_way(0));
    for k in 0..10 {
        let step = robot.step(&other, &at(k as f64, sense(&real, &sensor, &on_the_way(k), &mut random))).unwrap();
        assert_ne!(step.phase, Phase::Tracking, "{}", step.reason);
    }
}

#[test]
fn frames_out_of_order_and_bad_odometry_are_refused() {
    let (world, sensor) = (room(Vec3::ZERO), camera(0.01));
    let frame = |stamp| at(stamp, sense(&world, &sensor, &on_the_way(0), &mut Random(14)));
    let mut robot = localizer(&on_the_way(0));
    robot.step(&world, &frame(1.0)).unwrap();
    for stamp in [1.0, 0.5] {
        assert_eq!(robot.step(&world, &frame(stamp)).unwrap_err().kind(), ErrorKind::Invalid);
    }
    let mut broken = frame(2.0);
    let nowhere = Pose { translation: DVec3::NAN, ..Pose::IDENTITY };
    broken.motion =
        Some(presight_model::measured::Motion { previous_from_current: nowhere, covariance: PoseCovariance::ZERO });
    assert!(robot.step(&world, &broken).unwrap_err().to_string().contains("odometry"));
    let mut broken = frame(2.0);
    let covariance = PoseCovariance::from_sigmas([f64::NAN; 6]);
    broken.motion = Some(presight_model::measured::Motion { previous_from_current: Pose::IDENTITY, covariance });
    assert_eq!(robot.step(&world, &broken).unwrap_err().kind(), ErrorKind::Invalid);
    assert_eq!(robot.step(&world, &frame(2.0)).unwrap().stamp, 2.0);
}
