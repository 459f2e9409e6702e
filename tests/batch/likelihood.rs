//! Compares log-likelihoods of single poses with the oracle.

use super::{common, frame_of, noisy, oracle, predictor, single};
use common::{Random, data, scenes};
use presight_model::error::ErrorKind;
use presight_model::geometry::{Pose, SensorPose};
use presight_model::measured::{Frame, Measurement};
use presight_model::sensor::{Mixture, Noise, Sensor, SensorSpec};
use presight_model::world::World;
use presight_predict::batch::{BatchRequest, PoseCell, RangeLikelihood};

fn noises() -> [Noise; 3] {
    let mixture = Mixture { hit: 0.5, short: 0.2, none: 0.1, any: 0.2, beam_dependence: 3.0 };
    [
        Noise { range_sigma: 0.02, ..Noise::default() },
        Noise { range_sigma: 0.01, angle_sigma: 3e-3, range_sigma_quadratic: 2e-3, mixture, ..Noise::default() },
        Noise { range_sigma: 1e-5, ..Noise::default() },
    ]
}

/// Simulates a measurement for this prediction.
pub fn disturbed(random: &mut Random, spec: &SensorSpec, range: &[f32]) -> Vec<f32> {
    let inside = |r: f64| match r {
        r if r > spec.range_max => f32::INFINITY,
        r if r < spec.range_min => f32::NEG_INFINITY,
        r => r as f32,
    };
    let disturb = |range: &f32| match random.below(10) {
        0 => f32::NAN,
        1 => f32::INFINITY,
        2 if spec.range_min > 0.0 => f32::NEG_INFINITY,
        3 => inside(random.uniform(spec.range_min, spec.range_max)),
        _ if range.is_nan() => f32::NAN,
        4..6 => inside(f64::from(*range)),
        _ => inside(f64::from(*range) + random.uniform(-0.05, 0.05)),
    };
    range.iter().map(disturb).collect()
}

/// A fault that the comparison must find: a wider Gaussian.
fn wide(spec: &SensorSpec) -> SensorSpec {
    let noise = Noise { range_sigma: spec.noise.range_sigma + 0.03, ..spec.noise };
    spec.clone().with_noise(noise)
}

fn check(world: &World, poses: &[Pose], sensors: &[Sensor], tolerance: f64) {
    let mut random = Random(5);
    for (s, sensor) in sensors.iter().enumerate() {
        let sensor = noisy(sensor, noises()[s % 3]);
        let cell = if s % 2 == 0 { PoseCell::default() } else { PoseCell { side: 0.1, turn: 0.01 } };
        let mut engine = predictor(2);
        let sensed = disturbed(&mut random, sensor.spec(), &single(&mut engine, world, &sensor, &poses[0]).0);
        let likelihood = Some(RangeLikelihood::new(&frame_of(&sensor, sensed.clone()), cell).unwrap());
        let request = BatchRequest { likelihood, ..BatchRequest::default() };
        let items: Vec<_> =
            predictor(2).batch(world, &sensor, poses.iter().copied().map(SensorPose::new), &request).unwrap().collect();
        assert_eq!(items.len(), poses.len());
        for (i, (item, pose)) in items.into_iter().zip(poses).enumerate() {
            let ours = item.unwrap().log_likelihood.unwrap();
            let (range, cos) = single(&mut engine, world, &sensor, pose);
            let truth = oracle::log_likelihood(sensor.spec(), cell, &sensed, &range, &cos);
            let name = &sensor.spec().name;
            assert!((ours / truth - 1.0).abs() < tolerance, "{name} at {pose:?}: {ours}, truly {truth}");
            let planted = oracle::log_likelihood(&wide(sensor.spec()), cell, &sensed, &range, &cos);
            // The pose at which the image was measured.
            assert!(i > 0 || (planted / truth - 1.0).abs() > 1e-6, "{name}: the fault must show, {planted} {truth}");
        }
    }
}

#[test]
fn every_preset_is_weighed_by_the_formula() {
    let world = World::new(scenes::room(3, 40));
    let mut random = Random(1);
    // Tilted poses, so that one-row scanners do not use a cut of the world.
    let mut pose = || {
        let at = glam::DVec3::new(random.uniform(-1.0, 1.0), random.uniform(-1.0, 1.0), 1.4);
        Pose::from_xyz_rpy(at, random.uniform(-0.2, 0.2), random.uniform(-0.2, 0.2), random.uniform(-3.0, 3.0))
    };
    let poses: Vec<Pose> = (0..6).map(|_| pose()).collect();
    let mut sensors = data::presets();
    let near = sensors[0].spec().clone().with_limits(1.5, 3.0);
    sensors.push(Sensor::new(near).unwrap());
    check(&world, &poses, &sensors, 1e-9);
}

#[test]
fn real_scenes_are_weighed_by_the_formula() {
    let Some(world) = data::scene("factory_hall", true) else { return };
    let poses: Vec<Pose> = data::poses(&world, 8, 4).iter().map(lean).collect();
    let sensors = ["laser-range-camera", "laser-scanner"].map(|name| presight_read::preset(name).unwrap());
    check(&world, &poses, &sensors, 1e-9);
}

fn lean(pose: &Pose) -> Pose {
    *pose * Pose::from_xyz_rpy(glam::DVec3::ZERO, 0.1, 0.05, 0.0)
}

/// Calculated by hand. A wall 2 m ahead at normal incidence, range sigma 0.1 m, limits 0.5 .. 10 m, and the default
/// mixture weights.
#[test]
fn one_beam_by_hand() {
    let mut spec = presight_read::preset("laser-scanner").unwrap().spec().clone();
    let one = |start_deg| presight_model::sensor::Angles::Uniform { start_deg, step_deg: 0.0, count: 1 };
    let scanner = presight_model::sensor::Scanner { azimuth: one(0.0), elevation: one(0.0), beam_height_deg: None };
    spec.geometry = presight_model::sensor::Geometry::Scanner(scanner);
    (spec.range_min, spec.range_max) = (0.5, 10.0);
    spec.noise = Noise { range_sigma: 0.1, ..Noise::default() };
    let sensor = Sensor::new(spec).unwrap();
    let weigh = |sensed: f32, range: f32| {
        let sensed = RangeLikelihood::new(&frame_of(&sensor, vec![sensed]), PoseCell::default()).unwrap();
        sensed.log_likelihood(&[range], &[1.0]).exp()
    };
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-6, "{a}, by hand {b}");
    // 0.75 / (0.1 sqrt(2 pi)) = 2.9920671, plus 0.1 / 10 m for the uniform term; the reading is not nearer than
    // predicted.
    near(weigh(2.0, 2.0), 2.992_067_1 + 0.01);
    // 1.25 sigma too far: the factor exp(-0.78125) = 0.45783336 gives 1.3698681.
    near(weigh(2.125, 2.0), 1.369_868_1 + 0.01);
    // 1.25 sigma too near: an unmapped object could cause it, which adds 0.1 / 2 m.
    near(weigh(1.875, 2.0), 1.369_868_1 + 0.05 + 0.01);
    near(weigh(1.0, 2.0), 0.05 + 0.01);
    near(weigh(9.0, 2.0), 0.01);
    // No reading: p_none, plus p_hit if no surface is predicted. Nearer than 0.5 m: 0.1 of the uniform term in 10 m,
    // 0.1 in 2 m.
    near(weigh(f32::INFINITY, 2.0), 0.05);
    near(weigh(f32::INFINITY, f32::INFINITY), 0.8);
    near(weigh(f32::NEG_INFINITY, 2.0), 0.005 + 0.025);
    near(weigh(f32::NEG_INFINITY, f32::NEG_INFINITY), 0.005 + 0.1 + 0.75);
    near(weigh(3.0, f32::INFINITY), 0.01 + 0.01);
    near(weigh(3.0, f32::NEG_INFINITY), 0.01);
    // A missing prediction carries no information.
    near(weigh(3.0, f32::NAN), 1.0);
}

#[test]
fn images_that_cannot_be_weighed_are_refused() {
    let plain = presight_read::preset("laser-scanner").unwrap();
    let sensor = noisy(&plain, noises()[0]);
    let refused = |sensor: &Sensor, range: Vec<f32>, cell: PoseCell| {
        let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(range));
        let e = frame.and_then(|frame| RangeLikelihood::new(&frame, cell)).unwrap_err();
        assert!(e.kind() == ErrorKind::Invalid && !e.remedy().is_empty(), "{e}");
        e.to_string()
    };
    let cell = PoseCell::default();
    assert!(refused(&sensor, vec![1.0; 360], cell).contains("360 measured values"));
    assert!(refused(&sensor, vec![f32::NAN; 361], cell).contains("no range readings"));
    assert!(refused(&sensor, vec![31.0; 361], cell).contains("no range readings"));
    assert!(refused(&sensor, vec![-1.0; 361], cell).contains("no range readings"));
    assert!(refused(&sensor, vec![f32::NEG_INFINITY; 361], cell).contains("range 0"));
    let silent = Sensor::new(plain.spec().clone().with_noise(Noise::default())).unwrap();
    assert!(refused(&silent, vec![1.0; 361], cell).contains("noise of ranges"));
    assert!(refused(&sensor, vec![1.0; 361], PoseCell { side: f64::NAN, turn: 0.0 }).contains("pose cell"));
    let endless = Sensor::new(sensor.spec().clone().with_limits(sensor.spec().range_min, f64::INFINITY)).unwrap();
    assert!(refused(&endless, vec![1.0; 361], cell).contains("finite range_max"));

    let sensed = RangeLikelihood::new(&frame_of(&sensor, vec![1.0; 361]), cell).unwrap();
    let world = World::new(presight_model::environment::Environment::new());
    let request = BatchRequest { likelihood: Some(sensed), ..BatchRequest::default() };
    let e = predictor(1).batch(&world, &plain, [SensorPose::IDENTITY], &request).err().unwrap();
    assert_eq!(e.kind(), ErrorKind::Usage, "{e}");
    for mixture in [
        Mixture { hit: 0.9, ..Mixture::default() },
        Mixture { none: 0.0, hit: 0.8, ..Mixture::default() },
        Mixture { any: f64::NAN, ..Mixture::default() },
        Mixture { beam_dependence: 0.5, ..Mixture::default() },
    ] {
        let noise = Noise { mixture, ..Noise::default() };
        let e = Sensor::new(sensor.spec().clone().with_noise(noise)).unwrap_err();
        assert_eq!(e.kind(), ErrorKind::Invalid, "{e}");
    }
}

/// The last beam of a scanner that goes fully round has the direction of the first: its reading does not count again.
#[test]
fn a_beam_that_comes_twice_counts_once() {
    let noise = noises()[0];
    let (once, twice) = (noisy(&scenes::scanner(72, 3), noise), noisy(&scenes::closed(73, 3), noise));
    let mut random = Random(9);
    let readings: Vec<Vec<f32>> = (0..3).map(|_| (0..72).map(|_| random.uniform(1.0, 9.0) as f32).collect()).collect();
    let closed: Vec<f32> = readings.iter().flat_map(|row| row.iter().copied().chain([row[0] + 0.5])).collect();
    let of = |sensor: &Sensor, sensed| RangeLikelihood::new(&frame_of(sensor, sensed), PoseCell::default()).unwrap();
    let at = |likelihood: &RangeLikelihood| {
        let n = likelihood.range().len();
        likelihood.log_likelihood(&vec![3.0; n], &vec![1.0; n])
    };
    let (a, b) = (at(&of(&once, readings.concat())), at(&of(&twice, closed)));
    assert!((a - b).abs() < 1e-9, "{a} {b}");
}
