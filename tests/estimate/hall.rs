//! Simulated drives through a factory hall (../shared/data/env), by the laser range camera with 1 cm of noise: with an
//! exact map, and with every object of it 1 cm off. PRESIGHT_HALL_FRAMES sets the number of frames of a drive.

use super::*;
use presight_localize::estimate::nees;
use presight_localize::localize::{LocalizeOptions, Localizer};
use presight_localize::simulate::{Disturbances, Simulator, displace};
use presight_model::geometry::{PoseEstimate, RobotPose};
use presight_predict::free_poses::free_poses;
use presight_read::gltf::import;

fn hall() -> Option<World> {
    let path = presight_testkit::data::file("env/factory_hall.glb")?;
    Some(World::new(import(path, &Default::default()).unwrap().environment))
}

fn laser() -> Sensor {
    let mut spec = presight_read::preset("laser-range-camera").unwrap().spec().clone();
    spec.noise.range_sigma = 0.01;
    Sensor::new(spec).unwrap()
}

/// RMS errors of position in metres and heading in degrees, and the mean and largest NEES per dimension.
struct Errors {
    metres: f64,
    degrees: f64,
    mean_nees: f64,
    worst_nees: f64,
}

/// A circle of 25 cm from each of these places, with a prior of 3 cm and 0.02 rad and odometry that slips.
fn drive(map: &World, real: &World, places: &[Pose]) -> Errors {
    let frames = presight_testkit::env_number("PRESIGHT_HALL_FRAMES", 4) as usize;
    let (mut squares, mut all) = ([0.0; 2], Vec::new());
    for (seed, place) in (0..).zip(places) {
        let yaw = place.rotation.to_euler(glam::EulerRot::ZYX).0;
        let pose = |k: usize| {
            let a = 0.1 * k as f64;
            let aside = DVec3::new(0.25 * a.cos() - 0.25, 0.25 * a.sin(), 0.0);
            Pose::from_xyz_rpy(place.translation + aside, 0.0, 0.0, yaw + 0.5 * (0.7 * a).sin())
        };
        let mut simulator = Simulator::new(predictor(), laser(), Disturbances::default(), seed).unwrap();
        let prior = PoseEstimate::of_sigmas(RobotPose::new(pose(0)), 0.03, 0.02);
        let mut robot = Localizer::new(estimator(EstimateOptions::default()), prior, LocalizeOptions::default());
        for k in 0..frames {
            let frame = simulator.frame(real, k as f64, &RobotPose::new(pose(k))).unwrap();
            let step = robot.step(map, &frame).unwrap();
            assert!(step.estimate.is_determined(), "place {seed}, frame {k}: {}", step.reason);
            let (squared, numbers) = nees(&step.pose, &RobotPose::new(pose(k)));
            all.push(squared / numbers as f64);
            let off = presight_localize::estimate::motion_between(&step.pose.world_from_robot, &pose(k));
            squares[0] += off[..3].iter().map(|x| x * x).sum::<f64>();
            squares[1] += off[5].to_degrees().powi(2);
        }
    }
    let n = all.len() as f64;
    let [metres, degrees] = squares.map(|s| (s / n).sqrt());
    Errors {
        metres,
        degrees,
        mean_nees: all.iter().sum::<f64>() / n,
        worst_nees: all.iter().copied().fold(0.0, f64::max),
    }
}

/// A selection of the free level poses.
fn places(map: &World) -> Vec<Pose> {
    free_poses(map, 6, 11).unwrap().into_iter().step_by(2).collect()
}

#[test]
fn an_exact_map_gives_poses_to_millimetres() {
    let Some(map) = hall() else { return };
    let off = drive(&map, &map, &places(&map));
    assert!(off.metres <= 0.002 && off.degrees <= 0.02, "{} m {} deg", off.metres, off.degrees);
    assert!(off.worst_nees < 6.0, "{}", off.worst_nees);
}

#[test]
fn displaced_objects_show_in_the_covariance() {
    let Some(map) = hall() else { return };
    let mut real = map.clone();
    displace(&mut real, 0.01, 5).unwrap();
    let off = drive(&map, &real, &places(&map));
    assert!(off.metres <= 0.015 && off.degrees <= 0.1, "{} m {} deg", off.metres, off.degrees);
    assert!(off.mean_nees < 3.0 && off.worst_nees < 6.0, "{} {}", off.mean_nees, off.worst_nees);
}

#[cfg(feature = "script")]
fn scripted_hall() -> World {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/factory.rhai");
    World::new(presight_read::script::load(path, &Default::default(), &mut |_| {}).unwrap().environment)
}

/// In a place that repeats every few decimetres: from priors that are off by 2 cm and 0.6 degrees an axis, the search
/// ends 15 cm away in two of these 14 frames, with 97 % explained. That is seven standard deviations of the prior, and
/// a place near the prior explains as much; the estimate must be that place.
#[cfg(feature = "script")]
#[test]
fn a_pose_is_told_where_the_robot_may_be() {
    let (map, mut random) = (scripted_hall(), Random(7));
    let floor = map.environment().bounds().min.z;
    let places = free_poses(&map, 60, 11).unwrap();
    let low = |place: &&Pose| (0.8..2.5).contains(&(place.translation.z - floor));
    let place = places.iter().step_by(2).find(low).unwrap();
    let yaw = place.rotation.to_euler(glam::EulerRot::ZYX).0;
    let mut simulator = Simulator::new(predictor(), laser(), Disturbances::default(), 3).unwrap();
    let mut estimator = estimator(EstimateOptions::default());
    for k in 0..14 {
        let a = 0.1 * f64::from(k);
        let at = place.translation + DVec3::new(0.125 * a.cos() - 0.125, 0.125 * a.sin(), 0.0);
        let truth = Pose::from_xyz_rpy(at, 0.0, 0.0, yaw + 0.5 * (0.35 * a).sin());
        let frame = simulator.frame(&map, f64::from(k), &RobotPose::new(truth)).unwrap();
        let off = std::array::from_fn(|axis| if axis < 3 { 0.02 } else { 0.01 } * normal(&mut random));
        let found = estimator
            .estimate(&map, &[&frame], &PoseEstimate::of_sigmas(RobotPose::new(moved(&truth, &off)), 0.02, 0.01))
            .unwrap();
        let (metres, degrees) = apart(&found.pose.world_from_robot, &truth);
        assert!(found.is_determined() && metres < 0.02 && degrees < 0.1, "{k}: {metres} m {degrees} deg");
    }
}

/// Radar scan and laser range camera in the scripted hall, alone and together: together they are no worse than the
/// better one alone.
#[cfg(feature = "script")]
#[test]
fn two_sensors_in_a_scripted_hall() {
    let map = scripted_hall();
    let mut spec = presight_read::preset("microwave-radar-scan").unwrap().spec().clone();
    spec.noise.range_sigma = 0.03;
    let radar = Sensor::new(spec).unwrap();
    // In the aisle before the machine tools.
    let start = Pose::from_xyz_rpy(DVec3::new(21.0, 25.0, 1.4), 0.0, 0.0, 1.2);
    let frames = presight_testkit::env_number("PRESIGHT_HALL_FRAMES", 4) as usize;
    let [by_radar, by_laser, by_both] = [vec![radar.clone()], vec![laser()], vec![laser(), radar]].map(|sensors| {
        let mut simulators: Vec<Simulator> = (0..)
            .zip(&sensors)
            .map(|(seed, s)| Simulator::new(predictor(), s.clone(), Disturbances::default(), seed).unwrap())
            .collect();
        let planar = EstimateOptions::planar().with_model_sigma(0.0).with_offset_sigma(0.003);
        let options = if sensors.iter().all(|s| s.height() == 1) { planar } else { EstimateOptions::default() };
        let mut robot = Localizer::new(
            estimator(options),
            PoseEstimate::of_sigmas(RobotPose::new(start), 0.03, 0.02),
            LocalizeOptions::default(),
        );
        let mut squares = 0.0;
        for k in 0..frames {
            let truth = start * Pose::from_xyz_rpy(DVec3::new(0.05 * k as f64, 0.0, 0.0), 0.0, 0.0, 0.02 * k as f64);
            let all: Vec<Frame> =
                simulators.iter_mut().map(|s| s.frame(&map, k as f64, &RobotPose::new(truth)).unwrap()).collect();
            let step = robot.step_together(&map, &all[0], &all[1..].iter().collect::<Vec<_>>()).unwrap();
            assert!(step.estimate.is_determined(), "{} sensors, frame {k}: {}", sensors.len(), step.reason);
            let (squared, numbers) = nees(&step.pose, &RobotPose::new(truth));
            assert!(squared / (numbers as f64) < 6.0, "{} sensors, frame {k}: {squared}", sensors.len());
            squares += apart(&step.pose.world_from_robot, &truth).0.powi(2);
        }
        (squares / frames as f64).sqrt()
    });
    eprintln!("radar {by_radar} m, laser {by_laser} m, both {by_both} m");
    assert!(by_radar < 0.01 && by_laser < 0.002, "{by_radar} m by radar, {by_laser} m by laser");
    assert!(by_both < 1.2 * by_laser, "{by_both} m by both, {by_laser} m by laser alone");
}
