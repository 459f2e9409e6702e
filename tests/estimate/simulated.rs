//! The simulator and its logs.

use super::*;
use presight_localize::localize::{LocalizeOptions, Localizer, Phase};
use presight_localize::simulate::{Disturbances, Simulator};
use presight_model::geometry::{PoseEstimate, RobotPose, SensorPose};

fn simulator(disturbances: Disturbances, seed: u64) -> Simulator {
    Simulator::new(predictor(), camera(0.01), disturbances, seed).unwrap()
}

fn undisturbed() -> Disturbances {
    Disturbances::default().with_drop_outs(0.0).with_mixed_pixels(0.0).with_slip(0.0).with_turn_slip(0.0)
}

/// The noise has the stated mean and deviation, and the number of drop-outs is as requested.
#[test]
fn noise_has_its_stated_size() {
    let world = room(Vec3::ZERO);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.9, 2.2, 1.4), 0.0, 0.3, -0.3);
    let truth =
        predictor().predict(&world, &camera(0.01), &SensorPose::new(pose), &Request::default()).unwrap().images.range;
    let frame = simulator(undisturbed().with_drop_outs(0.1), 1).frame(&world, 0.0, &RobotPose::new(pose)).unwrap();
    let errors: Vec<f64> =
        frame.ranges().iter().zip(&truth).map(|(a, b)| f64::from(a - b)).filter(|e| e.is_finite()).collect();
    let n = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / n;
    let sigma = (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt();
    assert!(mean.abs() < 4.0 * 0.01 / n.sqrt() && (sigma / 0.01 - 1.0).abs() < 0.05, "{mean} {sigma}");
    let lost = frame.ranges().iter().filter(|r| r.is_nan()).count() as f64 / 4800.0;
    assert!((lost - 0.1).abs() < 0.02, "{lost}");
    // The same seed gives the same frame, another seed another frame.
    let again =
        |seed| simulator(undisturbed().with_drop_outs(0.1), seed).frame(&world, 0.0, &RobotPose::new(pose)).unwrap();
    let bits = |f: &Frame| f.ranges().iter().map(|r| r.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&frame), bits(&again(1)));
    assert_ne!(bits(&frame), bits(&again(2)));
}

/// Mixed pixels lie only at edges, between their two surfaces.
#[test]
fn mixed_pixels_are_at_edges() {
    let world = room(Vec3::ZERO);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.9, 2.2, 1.4), 0.0, 0.3, -0.3);
    let frame = |mixed_pixels| {
        simulator(undisturbed().with_mixed_pixels(mixed_pixels), 3).frame(&world, 0.0, &RobotPose::new(pose)).unwrap()
    };
    let (plain, mixed) = (frame(0.0), frame(1.0));
    let mut changed = 0;
    for i in 0..4799 {
        let (a, b, next) = (plain.ranges()[i], mixed.ranges()[i], plain.ranges()[i + 1]);
        if (a - b).abs() > 0.06 {
            changed += 1;
            assert!((a.min(next) - 0.1..=a.max(next) + 0.1).contains(&b), "{i}: {a} {b} {next}");
        }
    }
    assert!(changed > 20, "{changed}");
}

/// Intensities are the echo with the requested noise, at most 1, and absent where nothing was measured. The ranges are
/// the same without them.
#[test]
fn intensities_are_echoes_with_noise() {
    let world = room(Vec3::ZERO);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.9, 2.2, 1.4), 0.0, 0.3, -0.3);
    let asked = Request::of(presight_render::plan::Outputs::of(&[presight_render::plan::Output::Echo]));
    let echo = predictor().predict(&world, &camera(0.01), &SensorPose::new(pose), &asked).unwrap().images.echo;
    let lossy = undisturbed().with_drop_outs(0.1);
    let frame = simulator(lossy, 1).with_intensities(0.05).unwrap().frame(&world, 0.0, &RobotPose::new(pose)).unwrap();
    let plain = simulator(lossy, 1).frame(&world, 0.0, &RobotPose::new(pose)).unwrap();
    let bits = |f: &Frame| f.ranges().iter().map(|r| r.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&frame), bits(&plain));
    assert!(plain.intensities().is_none());
    let values = frame.intensities().unwrap().values();
    assert!(values.iter().zip(frame.ranges()).all(|(v, r)| v.is_nan() == r.is_nan() && !(*v > 1.0 || *v < 0.0)));
    // Far from both ends of the scale no value is clamped.
    let told = values.iter().zip(&echo).filter(|(v, e)| v.is_finite() && (0.3..0.7).contains(*e));
    let errors: Vec<f64> = told.map(|(v, e)| f64::from(v - e)).collect();
    let sigma = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    assert!(errors.len() > 300 && (sigma / 0.05 - 1.0).abs() < 0.15, "{} {sigma}", errors.len());
    for noise in [-0.1, 1.1, f64::NAN] {
        assert!(simulator(undisturbed(), 1).with_intensities(noise).is_err());
    }
}

#[test]
fn a_simulated_log_is_tracked_with_odometry() {
    let world = room(Vec3::ZERO);
    let mut simulator = simulator(Disturbances::default(), 5);
    let pose = |k: usize| {
        let t = 0.05 * k as f64;
        Pose::from_xyz_rpy(DVec3::new(1.2 + 0.4 * t.sin(), 2.3 + 0.3 * t.cos(), 1.4), 0.0, 0.25, -0.25 + 0.2 * t.sin())
    };
    let prior = PoseEstimate::of_sigmas(RobotPose::new(pose(0)), 0.03, 0.02);
    let mut robot = Localizer::new(estimator(EstimateOptions::default()), prior, LocalizeOptions::default());
    let mut squares = 0.0;
    for k in 0..60 {
        let frame = simulator.frame(&world, k as f64, &RobotPose::new(pose(k))).unwrap();
        assert_eq!(frame.motion.is_some(), k > 0);
        let step = robot.step(&world, &frame).unwrap();
        assert!(k < 3 || step.phase == Phase::Tracking, "{k}: {}", step.reason);
        squares += apart(&step.pose.world_from_robot, &pose(k)).0.powi(2);
    }
    let rms = (squares / 60.0).sqrt();
    assert!(rms < 0.003, "{rms}");
}

#[test]
fn bad_disturbances_are_refused() {
    for bad in [
        undisturbed().with_drop_outs(1.5),
        undisturbed().with_mixed_pixels(f64::NAN),
        undisturbed().with_slip(-0.1),
        undisturbed().with_turn_slip(f64::INFINITY),
    ] {
        assert!(Simulator::new(predictor(), camera(0.01), bad, 1).is_err(), "{bad:?}");
    }
}
