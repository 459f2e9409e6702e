//! Two poses 20 cm apart that explain the same readings, worked out by hand.

use super::*;
use presight_localize::localize::Phase;
use presight_model::geometry::RobotPose;
use presight_model::measured::{Motion, OdometryNoise};

/// A corridor along x, 4 m wide, that two plates close: the left one at 5 m, the right one at `right`. A slanted plate closes its
/// other end, and a block stands 8.6 m behind the robot.
fn corridor(right: f32) -> World {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    for (name, least, most) in [
        ("corridor", [-30.0, -2.0, 0.0], [6.0, 2.0, 3.0]),
        ("block", [-9.0, -0.5, 0.0], [-8.6, 2.0, 3.0]),
        ("left", [5.0, 0.0, 0.0], [5.1, 2.0, 3.0]),
        ("right", [right, -2.0, 0.0], [right + 0.1, 0.0, 3.0]),
    ] {
        add_box(&mut environment, name, Vec3::from_array(least), Vec3::from_array(most));
    }
    let plate = Mesh::cuboid("end", Vec3::new(-0.1, -4.0, 0.0), Vec3::new(0.1, 4.0, 3.0), 0).unwrap();
    let slanted = Pose::from_xyz_rpy(DVec3::X * -25.0, 0.0, 0.0, 0.8);
    environment.insert(NewObject::new("end", slanted, Arc::new(plate))).unwrap();
    World::new(environment)
}

/// Both plates are 5 m ahead, but the map has the right one at 5.2 m. Left and right of straight ahead 22 beams meet them (the
/// arc tangent of 2 / 5): the left ones put the robot at 0, the right ones 20 cm farther on, and the side walls say nothing
/// about it. The robot backs off by 20 cm a frame: from frame 4 on it sees the block 8 m behind it (8.6 - 0.8 = 7.8 m), and from frame 16 on
/// no plate (5 + 3.2 = 8.2 m).
///
/// From a start at one of the two, 40 frames: the phase, the error along and off the corridor, the stated deviation, and the reason.
fn backed_off(start: f64) -> Vec<(Phase, f64, f64, String)> {
    let (map, real) = (corridor(5.2), corridor(5.0));
    let mut spec = scanner(0.01).spec().clone();
    (spec.range_max, spec.mount.translation.z) = (8.0, 0.5);
    let (sensor, mut random) = (Sensor::new(spec).unwrap(), Random(31));
    let along = |x: f64| Pose::from_xyz_rpy(DVec3::X * x, 0.0, 0.0, 0.0);
    let prior = PoseEstimate::of_sigmas(RobotPose::new(along(start)), 0.1, 0.02);
    let mut robot = Localizer::new(estimator(EstimateOptions::planar()), prior, LocalizeOptions::default());
    let one = |k: u32| {
        let truth = along(-0.2 * f64::from(k));
        let seen = sense(&real, &sensor, &(truth * sensor.spec().mount), &mut random);
        let mut frame = Frame::new(f64::from(k), sensor.clone(), seen.measurement().clone()).unwrap();
        frame.motion = (k > 0).then(|| Motion::of_odometry(along(-0.2), &OdometryNoise::default()));
        let step = robot.step(&map, &frame).unwrap();
        let (metres, _) = apart(&step.pose.world_from_robot, &truth);
        (step.phase, metres, step.pose.covariance[0][0].sqrt(), step.reason)
    };
    (0..40).map(one).collect()
}

/// While the plates alone decide, neither minimum is certain: the robot is not tracked, and its covariance has room for its error.
/// One minimum alone is known to 2 cm.
#[test]
fn two_minima_that_explain_as_much_are_two_hypotheses() {
    for start in [0.0, 0.2] {
        for (k, (phase, metres, sigma, reason)) in backed_off(start).into_iter().take(5).enumerate() {
            assert!(phase != Phase::Tracking, "{start} {k}: {metres} m, {reason}");
            assert!(k > 0 || sigma > 0.05, "{start} {k}: {sigma} m stated, {reason}");
            assert!(metres < 4.0 * sigma, "{start} {k}: {metres} m off, {sigma} m stated, {reason}");
        }
    }
}

/// The block decides for the right minimum, also where the other one was given: with the plates out of reach the robot is
/// tracked in all frames, and no frame is tracked at the wrong minimum.
#[test]
fn of_two_minima_the_right_one_wins() {
    for start in [0.0, 0.2] {
        for (k, (phase, metres, sigma, reason)) in backed_off(start).into_iter().enumerate() {
            let is_tracked = phase == Phase::Tracking;
            assert!(is_tracked || k <= 16, "{start} {k}: {phase:?}, {reason}");
            assert!(!is_tracked || (metres < 0.05 && sigma < 0.03), "{start} {k}: {metres} m, {sigma}, {reason}");
        }
    }
}
