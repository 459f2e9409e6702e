//! Docking: the reported covariance equals that of least squares on simulated measurements.

use super::*;
use common::Random;
use presight_model::statistics::normal_pair;
use presight_predict::virtual_sensors::Docking;

/// A planar scanner on a robot, slightly rotated.
fn planar() -> SensorSpec {
    let mut spec = scanner("laser", uniform(-90.0, 0.5, 361), uniform(0.0, 0.0, 1));
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.3, 0.1, 0.4), 0.0, 0.0, 0.2);
    (spec.noise.range_sigma, spec.noise.angle_sigma) = (0.01, 0.002);
    spec
}

/// A depth camera.
fn spatial() -> SensorSpec {
    let mut spec = camera("laser", 640, 480, 500.0);
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.2, 0.0, 0.8), 0.02, 0.1, -0.1);
    (spec.noise.range_sigma, spec.noise.pixel_sigma) = (0.01, 0.4);
    spec
}

fn docking(spec: &SensorSpec, features: Vec<Feature>) -> (Docking, Prediction) {
    let world = World::new(scenes::empty());
    let pose = Pose::from_xyz_rpy(DVec3::new(1.0, 2.0, 0.4), 0.0, 0.0, 0.5) * spec.mount;
    let prediction = predict(&world, &Sensor::new(spec.clone()).unwrap(), &pose);
    let seen = seen(&world, &prediction, features);
    match of(VirtualSensor::Docking, world.environment(), &prediction, Some(&seen), &Settings::default()) {
        Answer::Docking(docking) => (docking, prediction),
        other => panic!("{other:?}"),
    }
}

/// Places in the robot's frame as features of the world.
fn marks(at: &[[f64; 3]]) -> Vec<Feature> {
    let world_from_robot = Pose::from_xyz_rpy(DVec3::new(1.0, 2.0, 0.4), 0.0, 0.0, 0.5);
    let place = |p: &[f64; 3]| world_from_robot.transform_point(DVec3::from(*p));
    (1..).zip(at).map(|(id, p)| reflector(id, place(p))).collect()
}

/// A sensor's measurements of points in the robot's frame after the robot has moved along and about its own axes by
/// `motion`, and the noise of each number. Shares only the camera projection with the code under test.
fn measure(sensor: &Sensor, points: &[DVec3], motion: &[f64]) -> Vec<(f64, f64)> {
    let spec = sensor.spec();
    let [tx, ty, tz, rx, ry, rz] = match *motion {
        [x, y, yaw] => [x, y, 0.0, 0.0, 0.0, yaw],
        [a, b, c, d, e, f] => [a, b, c, d, e, f],
        _ => panic!("{} degrees of freedom", motion.len()),
    };
    let turned = glam::DQuat::from_scaled_axis(DVec3::new(rx, ry, rz)).conjugate();
    let mut all = Vec::new();
    for p in points {
        let s = spec.mount.inverse().transform_point(turned * (*p - DVec3::new(tx, ty, tz)));
        all.push((s.length(), spec.noise.range_sigma));
        if sensor.is_camera() {
            let (u, v) = sensor.project(sensor.body_from_image().transpose() * s).unwrap();
            all.extend([(u, spec.noise.pixel_sigma), (v, spec.noise.pixel_sigma)]);
        } else {
            all.push((s.y.atan2(s.x), spec.noise.angle_sigma));
        }
    }
    all
}

fn normal(random: &mut Random) -> f64 {
    let (x, y) = (random.unit().max(1e-300), random.unit());
    normal_pair(x, y, 1.0)[0]
}

/// Solves a linear system by Gaussian elimination.
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for k in 0..n {
        let pivot = (k..n).max_by(|i, j| a[*i][k].abs().total_cmp(&a[*j][k].abs())).unwrap();
        a.swap(k, pivot);
        b.swap(k, pivot);
        for i in k + 1..n {
            let factor = a[i][k] / a[k][k];
            (k..n).for_each(|j| a[i][j] -= factor * a[k][j]);
            b[i] -= factor * b[k];
        }
    }
    for k in (0..n).rev() {
        b[k] = (b[k] - (k + 1..n).map(|j| a[k][j] * b[j]).sum::<f64>()) / a[k][k];
    }
    b
}

/// The covariance of least squares over many simulated measurements of a stationary robot.
fn sampled(sensor: &Sensor, points: &[DVec3], freedom: usize, draws: usize) -> Vec<Vec<f64>> {
    let mut random = Random(7);
    let exact = measure(sensor, points, &vec![0.0; freedom]);
    let mut sums = vec![vec![0.0; freedom]; freedom];
    for _ in 0..draws {
        let got: Vec<f64> = exact.iter().map(|(value, sigma)| value + sigma * normal(&mut random)).collect();
        let mut motion = vec![0.0; freedom];
        for _ in 0..3 {
            let at = measure(sensor, points, &motion);
            let columns: Vec<Vec<f64>> = (0..freedom)
                .map(|k| {
                    let mut moved = motion.clone();
                    moved[k] += 1e-6;
                    let ahead = measure(sensor, points, &moved);
                    ahead.iter().zip(&at).map(|(a, b)| (a.0 - b.0) / (1e-6 * b.1)).collect()
                })
                .collect();
            let off: Vec<f64> = got.iter().zip(&at).map(|(g, a)| (g - a.0) / a.1).collect();
            let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
            let matrix = columns.iter().map(|a| columns.iter().map(|b| dot(a, b)).collect()).collect();
            let step = solve(matrix, columns.iter().map(|c| dot(c, &off)).collect());
            motion.iter_mut().zip(step).for_each(|(m, s)| *m += s);
        }
        for i in 0..freedom {
            for j in 0..freedom {
                sums[i][j] += motion[i] * motion[j] / draws as f64;
            }
        }
    }
    sums
}

/// Decides whether each entry is within five of its standard errors.
fn agree(told: &[Vec<f64>], sampled: &[Vec<f64>], draws: usize) -> bool {
    let n = told.len();
    (0..n).all(|i| {
        (0..n).all(|j| {
            let error = ((told[i][i] * told[j][j] + told[i][j] * told[i][j]) / draws as f64).sqrt();
            (told[i][j] - sampled[i][j]).abs() <= 5.0 * error
        })
    })
}

#[test]
fn the_reported_covariance_equals_that_of_least_squares() {
    let flat = [[2.0, 0.6, 0.4], [2.2, -0.5, 0.4], [1.6, -1.4, 0.4]];
    let deep = [[2.0, 0.4, 0.5], [2.2, -0.5, 0.9], [1.8, -0.2, 0.3], [2.6, 0.1, 1.1]];
    for (spec, places, draws) in [(planar(), &flat[..], 20_000), (spatial(), &deep[..], 6_000)] {
        let (found, prediction) = docking(&spec, marks(places));
        let told = found.covariance.unwrap();
        let n = told.len();
        assert_eq!(found.landmarks.len(), places.len());
        assert_eq!(found.freedom.len(), n);
        assert_eq!(found.measurements, places.len() * if n == 3 { 2 } else { 3 });
        let points: Vec<DVec3> = places.iter().map(|p| DVec3::from(*p)).collect();
        let sampled = sampled(&prediction.sensor, &points, n, draws);
        assert!(agree(&told, &sampled, draws), "{told:?}\n{sampled:?}");
        let sigmas = found.sigmas.unwrap();
        assert!((0..n).all(|i| (sigmas[i] * sigmas[i] / told[i][i] - 1.0).abs() < 1e-12));
        // A different noise than stated, and two swapped axes.
        let mut noisier = spec.clone();
        for sigma in [&mut noisier.noise.range_sigma, &mut noisier.noise.angle_sigma, &mut noisier.noise.pixel_sigma] {
            *sigma *= 1.15;
        }
        let planted = docking(&noisier, marks(places)).0.covariance.unwrap();
        assert!(!agree(&planted, &sampled, draws));
        let mut swapped = told.clone();
        swapped.swap(0, 1);
        swapped.iter_mut().for_each(|row| row.swap(0, 1));
        assert!(!agree(&swapped, &sampled, draws));
    }
}

/// Moves the robot in a direction reported as open: no measurement changes to first order.
fn is_open(prediction: &Prediction, places: &[[f64; 3]], motion: &[f64]) -> bool {
    let points: Vec<DVec3> = places.iter().map(|p| DVec3::from(*p)).collect();
    let at = |h: f64| measure(&prediction.sensor, &points, &motion.iter().map(|m| h * m).collect::<Vec<_>>());
    at(1e-5).iter().zip(at(-1e-5)).all(|(a, b)| ((a.0 - b.0) / (2e-5 * a.1)).abs() < 1e-3)
}

#[test]
fn directions_left_open_by_landmarks_are_named() {
    // Without landmarks no direction is determined.
    let (found, _) = docking(&planar(), Vec::new());
    let names = |found: &Docking| found.unobservable.iter().map(|u| u.name.clone()).collect::<Vec<_>>();
    assert!(found.covariance.is_none() && found.sigmas.is_none() && found.measurements == 0);
    let mut all = names(&found);
    all.sort();
    assert_eq!(
        (found.freedom.as_slice(), all),
        (["x", "y", "yaw"].as_slice(), vec!["x".into(), "y".into(), "yaw".into()])
    );
    // Around one landmark the robot can move on a circle; for a landmark straight ahead that is sideways plus rotation.
    for (place, name) in [([2.3, 0.1, 0.4], None), ([2.0, 0.0, 0.4], Some("y+yaw")), ([2.0, 0.6, 0.4], Some("x+y+yaw"))]
    {
        let (found, prediction) = docking(&planar(), marks(&[place]));
        assert_eq!(found.unobservable.len(), 1);
        assert!(name.is_none_or(|name| names(&found) == [name]), "{:?}", names(&found));
        let motion = found.unobservable[0].motion.clone();
        assert!(is_open(&prediction, &[place], &motion), "{motion:?}");
        assert!(!is_open(&prediction, &[place], &[motion[0] + 0.2, motion[1], motion[2]]));
    }
    // Two landmarks fix the plane; in space the rotation about the line through them stays open.
    let two = [[2.0, 0.4, 0.5], [2.2, -0.3, 0.9]];
    assert!(docking(&planar(), marks(&[[2.0, 0.4, 0.4], [2.2, -0.3, 0.4]])).0.covariance.is_some());
    let (found, prediction) = docking(&spatial(), marks(&two));
    assert_eq!((found.freedom.len(), found.unobservable.len()), (6, 1));
    assert!(is_open(&prediction, &two, &found.unobservable[0].motion));
    let (found, prediction) = docking(&spatial(), marks(&two[..1]));
    assert_eq!(found.unobservable.len(), 3);
    for u in &found.unobservable {
        assert!(is_open(&prediction, &two[..1], &u.motion), "{u:?}");
    }
}

#[test]
fn a_marker_alone_fixes_a_pose_in_space() {
    let world_from_robot = Pose::from_xyz_rpy(DVec3::new(1.0, 2.0, 0.4), 0.0, 0.0, 0.5);
    // Clockwise from the top left as seen from the robot.
    let corners = [[2.0, 0.1, 0.9], [2.0, -0.1, 0.9], [2.0, -0.1, 0.7], [2.0, 0.1, 0.7]]
        .map(|p| world_from_robot.transform_point(DVec3::from(p)));
    let shape =
        FeatureShape::Fiducial { corners, covariance: DMat3::ZERO, family: "DICT_APRILTAG_36h11".into(), code: 4 };
    let (found, _) = docking(&spatial(), vec![feature(1, shape)]);
    assert_eq!((found.landmarks.len(), found.measurements), (1, 12), "{found:?}");
    assert_eq!((found.landmarks[0].code, found.landmarks[0].corners_robot.len()), (Some(4), 4));
    let sigmas = found.sigmas.unwrap();
    assert!(sigmas.iter().all(|s| *s > 0.0 && *s < 0.2), "{sigmas:?}");
    // 1 cm over 0.1 m at four corners determines the tilt; the position of the robot, 2 m before the marker and 0.8 m
    // below, varies with it.
    assert!((sigmas[5] / 0.05 - 1.0).abs() < 0.1 && (sigmas[4] / 0.05 - 1.0).abs() < 0.1, "{sigmas:?}");
    assert!((sigmas[1] / (2.0 * sigmas[5]) - 1.0).abs() < 0.02, "{sigmas:?}");
    assert!((sigmas[0] / (0.8 * sigmas[4]) - 1.0).abs() < 0.05, "{sigmas:?}");
}
