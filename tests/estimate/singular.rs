//! Quantities that a measurement does not determine must not be reported as determined.

use super::*;
use presight_localize::estimate::{Estimate, Freedom};
use presight_model::geometry::{PoseEstimate, RobotPose};

/// The standard deviation of the estimate along an axis.
fn sigma(answer: &Estimate, axis: usize) -> f64 {
    answer.pose.covariance[axis][axis].sqrt()
}

fn names(answer: &Estimate) -> Vec<&str> {
    let mut names: Vec<&str> = answer.weak.iter().map(|w| w.name.as_str()).collect();
    names.sort_unstable();
    names
}

/// A camera that sees only the floor determines height, roll and pitch; the other axes keep their prior.
#[test]
fn floor_only() {
    let mut environment = Environment::new();
    environment.add_material(Material::named("m")).unwrap();
    add_box(&mut environment, "floor", Vec3::new(-20.0, -20.0, -0.2), Vec3::new(20.0, 20.0, 0.0));
    let world = World::new(environment);
    let truth = Pose::from_xyz_rpy(DVec3::new(0.0, 0.0, 1.5), 0.0, 1.2, 0.3);
    let frame = sense(&world, &camera(0.01), &truth, &mut Random(1));
    let off = moved(&truth, &[0.15, -0.1, 0.05, 0.02, 0.03, 0.1]);
    let answer = estimator(EstimateOptions::default())
        .estimate(&world, &[&frame], &PoseEstimate::of_sigmas(RobotPose::new(off), 0.2, 0.1))
        .unwrap();
    assert_eq!(names(&answer).len(), 3, "{:?}", answer.weak);
    assert!(names(&answer).iter().all(|n| n.split('+').all(|a| ["x", "y", "yaw"].contains(&a))), "{:?}", answer.weak);
    for (axis, before) in [(0, 0.2), (1, 0.2), (5, 0.1)] {
        assert!(sigma(&answer, axis) > 0.9 * before, "axis {axis}: {} claimed", sigma(&answer, axis));
    }
    assert!(sigma(&answer, 2) < 0.01);
    assert!((answer.pose.world_from_robot.translation.z - 1.5).abs() < 4.0 * sigma(&answer, 2));
}

/// The estimator gives up on a frame that no pose explains: the sensor is ten times as noisy as stated.
#[test]
fn a_frame_that_no_pose_explains_is_given_up() {
    let world = room(Vec3::ZERO);
    let truth = Pose::from_xyz_rpy(DVec3::new(0.7, 2.2, 1.4), 0.0, 0.25, 0.05);
    let noisy = sense(&world, &camera(0.05), &truth, &mut Random(8));
    let frame = Frame::new(0.0, camera(0.005), noisy.measurement().clone()).unwrap();
    let answer = estimator(EstimateOptions::default())
        .estimate(&world, &[&frame], &PoseEstimate::of_sigmas(RobotPose::new(truth), 0.03, 0.01))
        .unwrap();
    assert!(!answer.is_determined() && answer.predictions <= 12, "{:?}", answer.state);
}

/// In an endless corridor a scanner determines everything but the position along it.
#[test]
fn corridor() {
    let mut environment = Environment::new();
    environment.add_material(Material::named("m")).unwrap();
    add_box(&mut environment, "corridor", Vec3::new(-300.0, -1.0, 0.0), Vec3::new(300.0, 1.0, 2.5));
    let world = World::new(environment);
    let mut sensor = scanner(0.01).spec().clone();
    sensor.range_max = 30.0;
    let sensor = Sensor::new(sensor).unwrap();
    let truth = Pose::from_xyz_rpy(DVec3::new(0.0, 0.2, 1.0), 0.0, 0.0, 0.1);
    let frame = sense(&world, &sensor, &truth, &mut Random(2));
    let options = EstimateOptions::default().with_freedom(Freedom::Planar);
    let off = moved(&truth, &[0.25, 0.05, 0.0, 0.0, 0.0, 0.03]);
    let answer = estimator(options)
        .estimate(&world, &[&frame], &PoseEstimate::of_sigmas(RobotPose::new(off), 0.3, 0.05))
        .unwrap();
    assert_eq!(names(&answer), ["x"], "{:?}", answer.weak);
    assert!(sigma(&answer, 0) > 0.27 && sigma(&answer, 1) < 0.01);
    assert!((answer.pose.world_from_robot.translation.y - 0.2).abs() < 0.01);
    // A wall at its end also fixes the position, which would expose an estimator that reports everything as weak.
    let mut environment = Environment::new();
    environment.add_material(Material::named("m")).unwrap();
    add_box(&mut environment, "corridor", Vec3::new(-300.0, -1.0, 0.0), Vec3::new(6.0, 1.0, 2.5));
    let world = World::new(environment);
    let frame = sense(&world, &sensor, &truth, &mut Random(2));
    let answer = estimator(options)
        .estimate(&world, &[&frame], &PoseEstimate::of_sigmas(RobotPose::new(off), 0.3, 0.05))
        .unwrap();
    assert!(answer.weak.is_empty() && answer.pose.world_from_robot.translation.x.abs() < 0.02, "{answer:?}");
}

/// Another room does not explain the frame, and the result reports that.
#[test]
fn wrong_map() {
    let truth = Pose::from_xyz_rpy(DVec3::new(1.0, 2.4, 1.4), 0.0, 0.25, -0.2);
    let frame = sense(&room(Vec3::ZERO), &camera(0.01), &truth, &mut Random(3));
    let mut environment = Environment::new();
    environment.add_material(Material::named("m")).unwrap();
    add_box(&mut environment, "hall", Vec3::new(-2.0, -1.0, 0.0), Vec3::new(8.5, 6.3, 4.0));
    add_box(&mut environment, "press", Vec3::new(3.0, 3.0, 0.0), Vec3::new(4.5, 4.0, 2.0));
    let prior = PoseEstimate::of_sigmas(RobotPose::new(truth), 0.12, 0.1);
    let mut found = estimator(EstimateOptions::default());
    let wrong = found.estimate(&World::new(environment), &[&frame], &prior).unwrap();
    assert!(!wrong.is_determined(), "{:.2} explained", wrong.explained);
    assert!(found.estimate(&room(Vec3::ZERO), &[&frame], &prior).unwrap().is_determined());
}

/// Without a measurement the prior is unchanged.
#[test]
fn a_blind_sensor_keeps_the_prior() {
    let sensor = camera(0.01);
    let world = room(Vec3::ZERO);
    let pose = Pose::from_xyz_rpy(DVec3::new(1.0, 2.4, 1.4), 0.0, 0.25, -0.2);
    let prior = PoseEstimate::of_sigmas(RobotPose::new(pose), 0.1, 0.05);
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0] {
        let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(vec![value; 80 * 60])).unwrap();
        let answer = estimator(EstimateOptions::default()).estimate(&world, &[&frame], &prior).unwrap();
        assert!(!answer.is_determined());
        assert_eq!(answer.pose, prior);
        assert_eq!(answer.weak.len(), 6);
    }
}

/// Pillars at intervals of a metre look the same after a metre. Both places are reported, and neither as determined;
/// one unique crate decides.
#[test]
fn a_repeating_corridor_has_two_places() {
    let corridor = |crate_too: bool| {
        let mut environment = Environment::new();
        environment.add_material(Material::named("m")).unwrap();
        add_box(&mut environment, "corridor", Vec3::new(-40.0, -1.0, 0.0), Vec3::new(40.0, 1.0, 2.5));
        for k in -30..=30 {
            let x = k as f32;
            add_box(&mut environment, &format!("left {k}"), Vec3::new(x, 0.75, 0.0), Vec3::new(x + 0.25, 1.0, 2.5));
            add_box(&mut environment, &format!("right {k}"), Vec3::new(x, -1.0, 0.0), Vec3::new(x + 0.25, -0.75, 2.5));
        }
        if crate_too {
            add_box(&mut environment, "crate", Vec3::new(2.4, -0.5, 0.0), Vec3::new(2.8, 0.75, 1.5));
        }
        World::new(environment)
    };
    let mut spec = scanner(0.01).spec().clone();
    spec.range_max = 8.0;
    let sensor = Sensor::new(spec).unwrap();
    let truth = Pose::from_xyz_rpy(DVec3::new(0.6, 0.1, 1.0), 0.0, 0.0, 0.05);
    let options = EstimateOptions::default().with_freedom(Freedom::Planar);
    let mut prior =
        PoseEstimate::of_sigmas(RobotPose::new(moved(&truth, &[0.1, 0.02, 0.0, 0.0, 0.0, 0.01])), 0.5, 0.02);
    prior.covariance[1][1] = 0.01;
    let answer = |crate_too: bool| {
        let world = corridor(crate_too);
        let frame = sense(&world, &sensor, &truth, &mut Random(5));
        estimator(options).estimate(&world, &[&frame], &prior).unwrap()
    };
    let open = answer(false);
    assert!(!open.is_determined() && open.hypotheses.len() > 1, "{:?} {:?}", open.state, open.hypotheses);
    assert!(sigma(&open, 0) > 0.4, "{} m claimed", sigma(&open, 0));
    let decided = answer(true);
    assert!(decided.is_determined(), "{:?}", decided.state);
    assert!(apart(&decided.pose.world_from_robot, &truth).0 < 0.02 && sigma(&decided, 0) < 0.05);
}
