//! Simulated rooms, and a corner calculated by hand.

use super::*;
use presight_localize::estimate::{Freedom, Gate, Kernel, RangeSource, Residuals, measured_points, motion_between};
use presight_localize::verdict::{ExpectedImage, Surfaces};
use presight_model::error::ErrorKind;
use presight_model::geometry::{PoseEstimate, RobotPose};
use presight_model::measured::RangeNoise;
use presight_model::sensor::RayTable;

fn exact() -> EstimateOptions {
    EstimateOptions::default().with_offset_sigma(0.0)
}

/// Three rays meet three walls at normal incidence. Each determines the robot's position along its own axis with the
/// variance of one range, and nothing of the rotation: J is [n, 0]. With prior variances of 0.04 the position variance
/// is 1 / (1 / 0.0001 + 1 / 0.04) in each axis.
#[test]
fn a_corner_of_three_planes() {
    let mut environment = Environment::new();
    environment.add_material(Material::named("m")).unwrap();
    add_box(&mut environment, "room", Vec3::ZERO, Vec3::new(6.0, 4.0, 2.6));
    let world = World::new(environment);
    // A second ray, without a measurement, gives each table its spacing.
    let ray = |along: DVec3, range: f32| {
        let aside = along + 0.01 * along.any_orthonormal_vector();
        let mut spec =
            SensorSpec::new("ray", "laser", Geometry::Rays(RayTable::new(2, 1, vec![along, aside]).unwrap()));
        spec.noise.range_sigma = 0.01;
        Frame::new(0.0, Sensor::new(spec).unwrap(), Measurement::Range(vec![range, f32::NAN])).unwrap()
    };
    // The robot is at (2.02, 1.97, 1.01): 3.98 m before the wall x = 6, 2.03 m before y = 4, 1.01 m above the floor.
    let frames = [ray(DVec3::X, 3.98), ray(DVec3::Y, 2.03), ray(DVec3::NEG_Z, 1.01)];
    let prior = PoseEstimate::of_sigmas(RobotPose::from_xyz_rpy(DVec3::new(2.0, 2.0, 1.0), 0.0, 0.0, 0.0), 0.2, 1e-6);
    let found = estimator(exact()).estimate(&world, &frames.each_ref(), &prior).unwrap();
    // The prior pulls each axis back by 0.0001 / 0.0401 of the distance.
    let kept = 1.0 - 0.0001 / 0.0401;
    let expected = DVec3::new(2.0 + 0.02 * kept, 2.0 - 0.03 * kept, 1.0 + 0.01 * kept);
    assert!(
        found.pose.world_from_robot.translation.distance(expected) < 1e-6,
        "{}",
        found.pose.world_from_robot.translation
    );
    let variance = 1.0 / (1.0 / 1e-4 + 1.0 / 0.04);
    for i in 0..3 {
        assert!((found.pose.covariance[i][i] / variance - 1.0).abs() < 1e-6, "{i}: {}", found.pose.covariance[i][i]);
        assert!((found.pose.covariance[i + 3][i + 3] / 1e-12 - 1.0).abs() < 1e-6);
    }
    let mut weak: Vec<&str> = found.weak.iter().map(|w| w.name.as_str()).collect();
    weak.sort_unstable();
    assert_eq!(weak, ["pitch", "roll", "yaw"]);
}

/// Compares the Jacobian of a residual with finite differences of the distance from the plane, which the test computes
/// itself.
#[test]
fn jacobians_equal_finite_differences() {
    let world = room(Vec3::ZERO);
    let mut random = Random(5);
    let mount = Pose::from_xyz_rpy(DVec3::new(0.3, -0.1, 0.2), 0.05, 0.1, -0.2);
    let ray = DVec3::new(1.0, 0.2, -0.1).normalize();
    let table = RayTable::new(2, 1, vec![ray, DVec3::new(1.0, 0.21, -0.1)]).unwrap();
    let mut spec = SensorSpec::new("one ray", "laser", Geometry::Rays(table));
    (spec.mount, spec.noise.range_sigma) = (mount, 0.01);
    let sensor = Sensor::new(spec).unwrap();
    let mut checked = 0;
    for _ in 0..40 {
        let at = DVec3::new(random.uniform(0.5, 1.8), random.uniform(1.8, 3.5), random.uniform(0.9, 2.0));
        let robot = Pose::from_xyz_rpy(at, 0.1, -0.1, random.uniform(-3.0, 3.0));
        let expected =
            ExpectedImage::predict(&mut predictor(), &world, &mut Surfaces::default(), &sensor, &RobotPose::new(robot))
                .unwrap();
        let pixel = expected.pixels()[0];
        if !pixel.range.is_finite() || expected.pixels()[1].group != pixel.group {
            continue;
        }
        let range = pixel.range + 0.004;
        let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(vec![range, f32::NAN])).unwrap();
        let points = measured_points(&frame);
        let source = RangeSource::new(&expected, &points, RangeNoise::of(&sensor));
        let gate = Gate { translation: 0.01, rotation: 0.0, kernel: Kernel::Wide, points: usize::MAX, finally: true };
        let said = source.linearize(&robot, &gate);
        // The plane in the world, and the moved point's distance from it.
        let normal = (robot * mount).rotation * pixel.normal.as_dvec3();
        let hit = (robot * mount).transform_point(f64::from(pixel.range) * ray);
        let distance = |motion: &[f64; 6]| {
            let p = (moved(&robot, motion) * mount).transform_point(f64::from(range) * ray);
            normal.dot(p - hit)
        };
        let e = distance(&[0.0; 6]);
        let group = said.groups.values().next().expect("one residual");
        for k in 0..6 {
            let step = |x: f64| std::array::from_fn(|i| if i == k { x } else { 0.0 });
            let slope = (distance(&step(1e-5)) - distance(&step(-1e-5))) / 2e-5;
            let told = said.gradient[k] / (group.weight * e);
            assert!((slope - told).abs() < 2e-3 * (1.0 + slope.abs()), "{k}: {slope} {told}");
            let square = said.information[k][k] / group.weight;
            assert!((slope * slope - square).abs() < 1e-4 * (1.0 + slope.abs()), "{k}: {slope} {square}");
            // A fault that must be noticed: the lever arm from the world's origin instead of the robot's.
            if k >= 3 {
                let lever = hit.cross(normal)[k - 3];
                checked += usize::from((lever - slope).abs() > 0.05);
            }
        }
    }
    assert!(checked > 30, "{checked}");
}

#[test]
fn a_room_is_found_from_far_off() {
    let world = room(Vec3::ZERO);
    let sensor = camera(0.01);
    let mut random = Random(1);
    let mut found = estimator(EstimateOptions::default());
    let mut right = 0;
    for k in 0..20 {
        let at = DVec3::new(1.0 + 0.03 * f64::from(k), 2.4, 1.4);
        let truth = Pose::from_xyz_rpy(at, 0.0, 0.25, -0.4 + 0.05 * f64::from(k));
        let frame = sense(&world, &sensor, &truth, &mut random);
        let prior = PoseEstimate::of_sigmas(RobotPose::new(off_by(&truth, 0.2, 10.0, &mut random)), 0.12, 0.1);
        let answer = found.estimate(&world, &[&frame], &prior).unwrap();
        let (metres, degrees) = apart(&answer.pose.world_from_robot, &truth);
        let ok = metres < 0.01 && degrees < 0.5;
        right += usize::from(ok);
        assert!(ok || !answer.is_determined(), "wrong and certain: {metres} m, {degrees} deg, {answer:?}");
    }
    assert!(right >= 19, "{right} of 20");
}

#[test]
fn a_planar_robot_is_found_by_its_scanner() {
    let world = room(Vec3::ZERO);
    let sensor = scanner(0.01);
    let mut random = Random(2);
    let mut found = estimator(EstimateOptions::default().with_freedom(Freedom::Planar));
    for k in 0..20 {
        let truth = Pose::from_xyz_rpy(DVec3::new(1.2, 2.0 + 0.05 * f64::from(k), 0.4), 0.0, 0.0, 0.3 * f64::from(k));
        let frame = sense(&world, &sensor, &truth, &mut random);
        let off = moved(&truth, &[0.1, -0.12, 0.0, 0.0, 0.0, 0.12]);
        let answer =
            found.estimate(&world, &[&frame], &PoseEstimate::of_sigmas(RobotPose::new(off), 0.1, 0.1)).unwrap();
        let (metres, degrees) = apart(&answer.pose.world_from_robot, &truth);
        assert!(
            answer.is_determined() && metres < 0.01 && degrees < 0.3,
            "{metres} m {degrees} deg {:?}",
            answer.state
        );
        assert_eq!(answer.pose.world_from_robot.translation.z, 0.4, "a planar robot keeps its height");
    }
}

/// The mean of the normalized squared error of six dimensions, over many frames; every box is off by `off` in its own
/// direction.
fn nees(off: f64, offset_sigma: f64) -> f64 {
    let (sensor, mut random) = (camera(0.01), Random(3));
    let options = EstimateOptions::default().with_offset_sigma(offset_sigma);
    let mut found = estimator(options);
    let (mut sum, frames) = (0.0, 40);
    for k in 0..frames {
        let mut shift = || (off * direction(&mut random)).as_vec3();
        let mut real = Environment::new();
        real.add_material(Material::named("paint")).unwrap();
        // In the real room each box, and each wall, is displaced.
        let s = shift();
        add_box(&mut real, "room", s, Vec3::new(6.0, 4.0, 2.6) + s);
        for (name, least, most) in [
            ("table", [2.0, 0.8, 0.0], [3.2, 1.6, 0.75]),
            ("shelf", [4.6, 3.4, 0.0], [5.9, 4.0, 1.9]),
            ("pillar", [3.6, 2.5, 0.0], [3.9, 2.8, 2.6]),
            ("crate", [5.2, 0.0, 0.0], [6.0, 0.7, 0.6]),
        ] {
            let s = shift();
            add_box(&mut real, name, Vec3::from(least) + s, Vec3::from(most) + s);
        }
        let truth = Pose::from_xyz_rpy(DVec3::new(0.9, 2.2, 1.4), 0.0, 0.3, -0.5 + 0.02 * f64::from(k));
        let frame = sense(&World::new(real), &sensor, &truth, &mut random);
        let prior = PoseEstimate::of_sigmas(RobotPose::new(off_by(&truth, 0.05, 2.0, &mut random)), 0.1, 0.1);
        let answer = found.estimate(&room(Vec3::ZERO), &[&frame], &prior).unwrap();
        let e = motion_between(&truth, &answer.pose.world_from_robot);
        sum += normalized(answer.pose.covariance.as_rows(), &e);
    }
    sum / f64::from(frames) / 6.0
}

/// e' C^-1 e by Gaussian elimination.
fn normalized(c: &[[f64; 6]; 6], e: &[f64; 6]) -> f64 {
    let (mut a, mut x) = (*c, *e);
    for k in 0..6 {
        for i in k + 1..6 {
            let f = a[i][k] / a[k][k];
            (k..6).for_each(|j| a[i][j] -= f * a[k][j]);
            x[i] -= f * x[k];
        }
    }
    for k in (0..6).rev() {
        x[k] = (x[k] - (k + 1..6).map(|j| a[k][j] * x[j]).sum::<f64>()) / a[k][k];
    }
    e.iter().zip(x).map(|(e, x)| e * x).sum()
}

#[test]
fn covariances_are_consistent() {
    let alone = nees(0.0, 0.0);
    assert!((0.6..1.6).contains(&alone), "independent noise: {alone}");
    let shared = nees(0.01, 0.006);
    assert!((0.3..1.7).contains(&shared), "objects off by 1 cm: {shared}");
}

/// If correlated errors are treated as independent, the covariance is far too small; the test above would notice that.
#[test]
fn independent_beams_would_be_overconfident() {
    let frames = nees(0.01, 1e-5);
    // The offsets are learnt, so only the first frames are overconfident.
    assert!(frames > 1.7, "{frames}");
}

#[test]
fn bad_priors_are_usage_errors() {
    let world = room(Vec3::ZERO);
    let truth = Pose::from_xyz_rpy(DVec3::new(1.0, 2.0, 1.4), 0.0, 0.3, 0.0);
    let frame = sense(&world, &camera(0.01), &truth, &mut Random(4));
    let good = PoseEstimate::of_sigmas(RobotPose::new(truth), 0.1, 0.1);
    let with = |i: usize, j: usize, x: f64| {
        let mut prior = good;
        prior.covariance[i][j] = x;
        prior
    };
    let nowhere = PoseEstimate { world_from_robot: Pose { translation: DVec3::NAN, ..truth }, ..good };
    let both = |x: f64| {
        let mut prior = with(0, 1, x);
        prior.covariance[1][0] = x;
        prior
    };
    let mut found = estimator(EstimateOptions::default());
    for prior in [with(0, 0, f64::NAN), with(0, 0, -1.0), with(3, 3, 0.0), with(0, 1, 0.005), both(0.02), nowhere] {
        assert_eq!(found.estimate(&world, &[&frame], &prior).unwrap_err().kind(), ErrorKind::Usage, "{prior:?}");
    }
    assert_eq!(found.estimate(&world, &[], &good).unwrap_err().kind(), ErrorKind::Usage);
    assert!(found.estimate(&world, &[&frame], &both(0.009)).unwrap().is_determined());
}
