//! Noise as large as the gaps between objects, and noise that grows with the range. Neither may bias which surface a
//! point is compared with, its weight, or its lever arm.

use super::*;
use presight_localize::estimate::{Gate, Kernel, Normal, RangeSource, Residuals, measured_points, nees};
use presight_localize::simulate::{Disturbances, Simulator};
use presight_localize::verdict::{ExpectedImage, Surfaces};
use presight_model::geometry::{PoseEstimate, RobotPose};
use presight_model::measured::RangeNoise;
use presight_model::sensor::{Distortion, Noise};
use presight_predict::free_poses::free_poses;
use presight_read::gltf::import;

fn undisturbed() -> Disturbances {
    Disturbances::default().with_drop_outs(0.0).with_mixed_pixels(0.0).with_slip(0.0).with_turn_slip(0.0)
}

/// A wall `ahead` metres from the origin and wider than the image, with slats a third of a metre wide that protrude by
/// `out` metres.
fn slatted_wall(ahead: f32, out: f32) -> World {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    add_box(&mut environment, "wall", Vec3::new(ahead, -9.0, -9.0), Vec3::new(ahead + 0.2, 9.0, 9.0));
    for k in (-26..26).filter(|_| out > 0.0) {
        let y = k as f32 * 0.66;
        let (least, most) = (Vec3::new(ahead - out, y, -9.0), Vec3::new(ahead - 0.001, y + 0.33, 9.0));
        add_box(&mut environment, &format!("slat {k}"), least, most);
    }
    World::new(environment)
}

/// The camera with this noise and range.
fn noisy_camera(camera: Camera, noise: Noise, range_max: f64) -> Sensor {
    let mut spec = SensorSpec::new("depth camera", "laser", Geometry::Camera(camera));
    (spec.noise, spec.range_max) = (noise, range_max);
    Sensor::new(spec).unwrap()
}

/// 80 x 60 pixels, 60 degrees wide.
fn small() -> Camera {
    Camera::pinhole(80, 60, 70.0, 70.0, 39.5, 29.5)
}

/// The normal equations of a frame at `truth`, for a robot assumed to be `metres` ahead of it, with outliers
/// unweighted.
fn said_of(world: &World, frame: &Frame, truth: &Pose, metres: f64) -> Normal {
    let sensor = frame.sensor();
    let expected =
        ExpectedImage::predict(&mut predictor(), world, &mut Surfaces::default(), sensor, &RobotPose::new(*truth))
            .unwrap();
    let points = measured_points(frame);
    let source = RangeSource::new(&expected, &points, RangeNoise::of(sensor));
    let kernel = Kernel::Redescending { spread: 1.0 };
    let gate = Gate { translation: 0.001, rotation: 0.0, kernel, points: usize::MAX, finally: true };
    source.linearize(&(*truth * Pose::from_xyz_rpy(DVec3::X * metres, 0.0, 0.0, 0.0)), &gate)
}

/// Slats 6 cm before a wall, with 5 cm of noise: the pull on a robot assumed 2 cm too far ahead must correspond to 2
/// cm. For Gaussian errors Tukey's kernel keeps E psi' / E w = 0.758 / 0.915 = 0.83 of it; comparison with the nearest
/// surface would keep half.
#[test]
fn noise_does_not_choose_the_surface() {
    let world = slatted_wall(5.0, 0.06);
    let sensor = noisy_camera(small(), Noise { range_sigma: 0.05, ..Noise::default() }, 10.0);
    let mut simulator = Simulator::new(predictor(), sensor, undisturbed(), 1).unwrap();
    let (mut sum, frames) = (0.0, 6);
    for k in 0..frames {
        let frame = simulator.frame(&world, f64::from(k), &RobotPose::IDENTITY).unwrap();
        let [there, ahead] = [0.0, 0.02].map(|metres| said_of(&world, &frame, &Pose::IDENTITY, metres));
        sum += (ahead.gradient[0] - there.gradient[0]) / there.information[0][0] / 0.02 / f64::from(frames);
    }
    assert!((0.76..0.9).contains(&sum), "{sum} of the pull");
}

/// A wall 6 m away with noise of 7.6 cm there, which grows with the square of the range. Weighted by the measured
/// range, the wall would seem nearer by sigma^2 d(ln sigma^2)/dz = 3.6 mm, because points measured nearer get more
/// weight.
#[test]
fn noise_does_not_choose_the_weight() {
    let world = slatted_wall(6.0, 0.0);
    let noise = Noise { range_sigma: 0.004, range_sigma_quadratic: 0.002, ..Noise::default() };
    let sensor = noisy_camera(small(), noise, 10.0);
    let mut simulator = Simulator::new(predictor(), sensor, undisturbed(), 2).unwrap();
    let (mut mean, mut variance, frames) = (0.0, 0.0, 12);
    for k in 0..frames {
        let frame = simulator.frame(&world, f64::from(k), &RobotPose::IDENTITY).unwrap();
        let said = said_of(&world, &frame, &Pose::IDENTITY, 0.0);
        mean += said.gradient[0] / said.information[0][0] / f64::from(frames);
        variance += said.noise[0][0] / said.information[0][0].powi(2) / f64::from(frames).powi(2);
    }
    // Four standard deviations are less than half of that error.
    let most = 4.0 * variance.sqrt();
    assert!(most < 0.0019 && mean.abs() < most, "{mean} m, at most {most} m");
}

/// A wall at an oblique angle, with 15 cm of noise and more. With lever arms to the measured points, noise would
/// lengthen the lever arms of its own sign: the robot would seem rotated by 1.6 standard deviations in each frame, in
/// the same direction in all frames.
#[test]
fn noise_does_not_choose_the_lever() {
    let world = slatted_wall(6.0, 0.0);
    let noise = Noise { range_sigma: 0.004, range_sigma_quadratic: 0.004, ..Noise::default() };
    let mut simulator = Simulator::new(predictor(), noisy_camera(small(), noise, 30.0), undisturbed(), 3).unwrap();
    let aslant = Pose::from_xyz_rpy(DVec3::ZERO, 0.0, 0.0, 0.5);
    let (mut mean, frames) = (0.0, 12);
    for k in 0..frames {
        let frame = simulator.frame(&world, f64::from(k), &RobotPose::new(aslant)).unwrap();
        let said = said_of(&world, &frame, &aslant, 0.0);
        mean += said.gradient[5] / said.noise[5][5].sqrt() / f64::from(frames);
    }
    assert!(mean.abs() < 3.0 / f64::from(frames).sqrt(), "{mean} deviations in each frame");
}

/// Noise beyond the sensor's range gives no measurement, so the remaining points of a surface there are nearer than the
/// surface. These points must be ignored.
#[test]
fn a_surface_at_the_end_of_the_range_is_ignored() {
    let world = slatted_wall(6.0, 0.0);
    for (range_max, says) in [(6.1, false), (10.0, true)] {
        let sensor = noisy_camera(small(), Noise { range_sigma: 0.05, ..Noise::default() }, range_max);
        let mut simulator = Simulator::new(predictor(), sensor, undisturbed(), 4).unwrap();
        let frame = simulator.frame(&world, 0.0, &RobotPose::IDENTITY).unwrap();
        let said = said_of(&world, &frame, &Pose::IDENTITY, 0.0);
        assert!(said.compared > 100, "{} points", said.compared);
        assert_eq!(said.information[0][0] > 0.0, says, "up to {range_max} m");
    }
}

/// A depth camera in the factory hall among objects closer together than its noise, with an exact sensor model and
/// priors with errors of their stated size: the errors match the covariance. With nearest points the NEES was 2.5 at
/// both places and headings were 0.09 and 0.07 degrees off; with lever arms to measured points it was 1.6 at the first.
#[test]
fn a_noisy_depth_camera_has_consistent_covariances() {
    let Some(path) = presight_testkit::data::file("env/factory_hall.glb") else { return };
    let world = World::new(import(&path, &Default::default()).unwrap().environment);
    let places = free_poses(&world, 6, 11).unwrap();
    let distortion = Distortion::PlumbBob([-0.12, 0.03, 0.0, 0.0, 0.0]);
    let camera = Camera { distortion, ..Camera::pinhole(160, 120, 130.0, 130.0, 79.5, 59.5) };
    let noise = Noise { range_sigma: 0.004, range_sigma_quadratic: 0.002, angle_sigma: 0.002, ..Noise::default() };
    let sensor = noisy_camera(camera, noise, 10.0);
    for place in [places[2], places[5]] {
        let mut simulator = Simulator::new(predictor(), sensor.clone(), Disturbances::default(), 5).unwrap();
        let (mut estimator, mut random) = (estimator(EstimateOptions::default()), Random(7));
        let (mut sum, mut turned, frames) = (0.0, 0.0, 24);
        for k in 0..frames {
            let (a, yaw) = (0.1 * f64::from(k), place.rotation.to_euler(glam::EulerRot::ZYX).0);
            let at = place.translation + DVec3::new(0.125 * a.cos() - 0.125, 0.125 * a.sin(), 0.0);
            let truth = Pose::from_xyz_rpy(at, 0.0, 0.0, yaw + 0.5 * (0.35 * a).sin());
            let frame = simulator.frame(&world, f64::from(k), &RobotPose::new(truth)).unwrap();
            let off = std::array::from_fn(|axis| if axis < 3 { 0.02 } else { 0.01 } * normal(&mut random));
            let prior = PoseEstimate::of_sigmas(RobotPose::new(moved(&truth, &off)), 0.02, 0.01);
            let found = estimator.estimate(&world, &[&frame], &prior).unwrap();
            sum += nees(&found.pose, &RobotPose::new(truth)).0 / 6.0 / f64::from(frames);
            turned += apart(&found.pose.world_from_robot, &truth).1.powi(2) / f64::from(frames);
        }
        let degrees = turned.sqrt();
        println!("NEES {sum}, {degrees} deg");
        // For 144 dimensions the 95 % interval is 0.77 to 1.23. Learning polygon offsets where there are none makes the
        // value smaller.
        assert!((0.4..1.23).contains(&sum) && degrees < 0.05, "NEES {sum}, {degrees} deg");
    }
}
