//! A robot that drives while its lidar turns gets the results of a standing robot, wherever frames are used.
//! `cargo bench --bench motion` has the whole figures.
#![allow(clippy::print_stdout, reason = "tests print their figures on request")]

#[path = "../../benches/motion/drive.rs"]
mod drive;
#[path = "../../benches/motion/figures.rs"]
mod figures;

use drive::{Scan, Told, lidar};
use figures::{confirmed, differing, errors, explored, frames, supervised};
use glam::DVec3;
use presight_model::geometry::{Pose, PoseEstimate, RobotPose, Twist};
use presight_model::measured::{Frame, Measurement, ScanMotion};
use presight_model::sensor::{Geometry, RayTable, RayTimes, Sensor, SensorSpec, StampAt};
use presight_model::world::World;
use presight_predict::batch::{PoseCell, RangeLikelihood};
use presight_testkit::data;

/// The hospital, or the factory of this repository where it is missing.
fn scene() -> World {
    data::scene("hospital", true).unwrap_or_else(|| {
        let path = data::root().join("scenes/factory.rhai");
        World::new(presight_read::script::load(path, &Default::default(), &mut |_| {}).unwrap().environment)
    })
}

fn driven(count: usize, seed: u64) -> (World, Sensor, Vec<Scan>, Vec<Pose>) {
    of_drive(count, (seed, false))
}

fn of_drive(count: usize, kind: (u64, bool)) -> (World, Sensor, Vec<Scan>, Vec<Pose>) {
    let (world, sensor) = (scene(), lidar(360, 16));
    let (scans, between) = drive::drive(world.environment(), &sensor, count, kind);
    (world, sensor, scans, between)
}

/// Scans with drop-outs and mixed pixels, moved by odometry that slips by 2 %. Two scans of one place then differ by their
/// disturbances alone; the motion adds no more than it does without them.
#[test]
fn disturbed_scans_and_slipping_odometry_do_as_well() {
    let (world, sensor, scans, between) = of_drive(14, (5, true));
    let slipping = frames(&scans, |scan| scan.told(Told::Slipping));
    let standing = frames(&scans, |scan| scan.standing.clone());
    let shares = (confirmed(&world, &standing), confirmed(&world, &slipping));
    println!("confirmed: {shares:?}");
    assert!(shares.1 > shares.0 - 0.01, "{shares:?}");
    let of_middle = |pick: fn(&Scan) -> figures::At| supervised(&world, &scans.iter().map(pick).collect::<Vec<_>>());
    let middle = of_middle(|scan| scan.in_the_middle.clone());
    let noise = differing(&middle, &of_middle(|scan| scan.in_the_middle_again.clone()));
    let off = differing(&middle, &supervised(&world, &slipping));
    println!("cells that differ: {off:.4}, by the disturbances alone {noise:.4}");
    // The motion may add 1 %; both shares are of draws of the disturbances, whose sampling error is that of counts.
    let cells = middle.iter().map(|frame| frame.chars().count()).sum::<usize>() as f64;
    let sampling = ((off + noise) / cells).sqrt();
    assert!(off <= noise + 0.01 + 3.0 * sampling, "{off} and {noise}, sampling {sampling}");
    let judged = |frames: &[figures::At]| errors(world.environment(), &explored(frames), &sensor, &between);
    let (still, driving) = (judged(&standing), judged(&slipping));
    println!("standing {still:?}\ndriving {driving:?}");
    assert!(driving.over_2_cm <= 1.4 * still.over_2_cm, "{driving:?} and {still:?}");
    #[cfg(feature = "store")]
    {
        let found = [&standing, &slipping].map(|frames| figures::found(&world, frames));
        println!("findings and beams: {found:?}");
        assert!(found[1].0 == 0 && found[1].1 > found[0].1 - 0.005, "{found:?}");
    }
}

/// Planted faults lower the share: no motion, a velocity in the world's axes, the other direction of turning, times
/// before the stamp.
#[test]
fn verdicts_of_a_driving_robot_are_those_of_a_standing_one() {
    let (world, _, scans, _) = driven(6, 1);
    let standing = confirmed(&world, &frames(&scans, |scan| scan.standing.clone()));
    let share = |told: Told| confirmed(&world, &frames(&scans, |scan| scan.told(told)));
    let driving = share(Told::Truth);
    println!("confirmed: {standing:.4} standing, {driving:.4} driving");
    assert!(standing > 0.97, "{standing}");
    assert!(driving > standing - 0.01, "{driving} of {standing}");
    for told in Told::PLANTED {
        let planted = share(told);
        println!("{told:?}: {planted:.4}");
        assert!(planted < standing - 0.05, "planted {told:?}: {planted} of {standing}");
    }
}

#[test]
fn cells_ahead_of_a_driving_robot_are_those_of_a_standing_one() {
    let (world, _, scans, _) = driven(8, 2);
    let standing = supervised(&world, &scans.iter().map(|scan| scan.in_the_middle.clone()).collect::<Vec<_>>());
    let off = |told: Told| differing(&standing, &supervised(&world, &frames(&scans, |scan| scan.told(told))));
    let (driving, unknown) = (off(Told::Truth), off(Told::Nothing));
    println!("cells that differ: {driving:.4}, without the motion {unknown:.4}");
    assert!(driving <= 0.01, "{driving}");
    assert!(unknown > 0.02, "planted: {unknown}");
}

#[test]
fn what_is_explored_while_driving_predicts_as_well() {
    let (world, sensor, scans, between) = driven(14, 3);
    let judged = |frames: &[figures::At]| errors(world.environment(), &explored(frames), &sensor, &between);
    let standing = judged(&frames(&scans, |scan| scan.standing.clone()));
    let driving = judged(&frames(&scans, |scan| scan.told(Told::Truth)));
    let unknown = judged(&frames(&scans, |scan| scan.told(Told::Nothing)));
    println!("standing {standing:?}\ndriving {driving:?}\nwithout the motion {unknown:?}");
    assert!(driving.median <= 1.2 * standing.median, "{driving:?}");
    assert!(driving.over_2_cm <= 1.4 * standing.over_2_cm, "{driving:?}");
    assert!(driving.over_10_cm <= 1.4 * standing.over_10_cm, "{driving:?}");
    assert!(unknown.over_2_cm > 1.4 * standing.over_2_cm, "planted: {unknown:?}");
}

#[cfg(feature = "store")]
#[test]
fn a_driving_robot_finds_nothing_on_an_unchanged_map() {
    let (world, _, scans, _) = driven(20, 4);
    let (findings, beams) = figures::found(&world, &frames(&scans, |scan| scan.told(Told::Truth)));
    let (planted, before) = figures::found(&world, &frames(&scans, |scan| scan.told(Told::Nothing)));
    println!("{findings} findings and {beams:.4} of the beams, without the motion {planted} and {before:.4}");
    assert_eq!(findings, 0);
    assert!(beams > 0.99, "{beams}");
    assert!(planted > 0 || before < 0.9, "planted: {planted}, {before}");
}

/// By hand: a wall 4 m ahead of a robot at 2 m/s, and a ray that is measured half a second after the stamp. It has 3 m.
#[test]
fn the_pose_belongs_to_the_stamp() {
    let table = RayTable::new(2, 1, vec![DVec3::NEG_X, DVec3::X]).unwrap();
    let spec = SensorSpec::new("two rays", "laser", Geometry::Rays(table));
    let sensor = Sensor::new(spec.with_times(RayTimes::turning(1.0, StampAt::First))).unwrap();
    let frame = Frame::new(0.0, sensor, Measurement::Range(vec![f32::NAN, 3.0])).unwrap();
    let frame = frame.with_scan_motion(ScanMotion::Twist(Twist::new(DVec3::X * 2.0, DVec3::ZERO)));
    // The rays are measured at 0 s and at 0.5 s, so that the middle is at 0.25 s and 3.5 m from the wall.
    let moment = frame.at_one_moment().unwrap();
    assert_eq!(moment.frame.stamp, 0.25);
    assert!((moment.stamp_from_moment.translation - DVec3::X * 0.5).length() < 1e-12);
    assert!((moment.frame.ranges()[1] - 3.5).abs() < 1e-6, "{:?}", moment.frame.ranges());
    let robot = PoseEstimate::of_sigmas(RobotPose::new(Pose::from_xyz_rpy(DVec3::Y, 0.0, 0.0, 0.0)), 0.01, 0.02);
    let then = moment.robot(&robot);
    assert!((then.world_from_robot.translation - DVec3::new(0.5, 1.0, 0.0)).length() < 1e-12);
    // 0.02 rad move a robot half a metre on by 1 cm across.
    assert!((then.covariance[1][1] - (0.01f64.powi(2) + 0.01f64.powi(2))).abs() < 1e-12);
    let e = RangeLikelihood::new(&frame, PoseCell::default()).unwrap_err();
    assert!(e.to_string().contains("the robot moves while the frame is measured"), "{e}");
    let still = frame.clone().with_scan_motion(ScanMotion::Twist(Twist::default()));
    assert!(still.has_one_pose() && still.at_one_moment().unwrap().frame.stamp == 0.0);
}
