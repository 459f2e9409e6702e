//! Two poses 20 cm apart that explain the same readings, worked out by hand.

use super::*;
use presight_localize::localize::Phase;
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
/// about it. Neither is certain: the robot is not tracked, and its covariance has room for 20 cm. Then it backs off until the
/// plates are out of reach (8 m), towards a block: a pose that is tracked then is right.
#[test]
fn two_minima_that_explain_as_much_are_two_hypotheses() {
    let (map, real) = (corridor(5.2), corridor(5.0));
    let mut spec = scanner(0.01).spec().clone();
    (spec.range_max, spec.mount.translation.z) = (8.0, 0.5);
    let (sensor, mut random) = (Sensor::new(spec).unwrap(), Random(31));
    let back = Pose::from_xyz_rpy(DVec3::X * -0.2, 0.0, 0.0, 0.0);
    for start in [0.0, 0.2] {
        let prior = PoseEstimate::of_sigmas(Pose::from_xyz_rpy(DVec3::X * start, 0.0, 0.0, 0.0), 0.1, 0.02);
        let mut robot = Localizer::new(estimator(EstimateOptions::planar()), prior, LocalizeOptions::default());
        for k in 0..40 {
            let truth = Pose::from_xyz_rpy(DVec3::X * -0.2 * f64::from(k), 0.0, 0.0, 0.0);
            let seen = sense(&real, &sensor, &(truth * sensor.spec().mount), &mut random);
            let mut frame = Frame::new(f64::from(k), sensor.clone(), seen.sensed().clone()).unwrap();
            frame.motion = (k > 0).then(|| Motion::of_odometry(back, &OdometryNoise::default()));
            let step = robot.step(&map, &frame).unwrap();
            let (metres, _) = apart(&step.pose.world_from_robot, &truth);
            let sigma = step.pose.covariance[0][0].sqrt();
            if k <= 4 {
                assert!(step.phase != Phase::Tracking, "{start} {k}: {metres} m, {}", step.reason);
                // One minimum alone is known to 2 cm.
                assert!(k > 0 || sigma > 0.05, "{start} {k}: {sigma} m stated, {}", step.reason);
                assert!(metres < 4.0 * sigma, "{start} {k}: {metres} m off, {sigma} m stated, {}", step.reason);
            }
            if step.phase == Phase::Tracking {
                assert!(metres < 0.05, "{start} {k}: {metres} m, {}", step.reason);
            }
        }
    }
}
