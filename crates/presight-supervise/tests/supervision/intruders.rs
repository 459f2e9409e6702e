//! Random intruders, against the rays of the test kit's own caster.

use super::corridor::{corridor, known, predictor, robot, room};
use glam::DVec3;
use presight_localize::simulate::{Disturbances, Simulator};
use presight_model::geometry::{Pose, RobotPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_supervise::{CellState, SuperviseOptions, Supervisor};
use presight_testkit::Random;
use presight_testkit::intruders::{believed, random_place, sensors, truth, with_intruder};
use presight_testkit::oracle::Oracle;

fn simulator(sensor: &Sensor, seed: u64) -> Simulator {
    Simulator::new(predictor(), sensor.clone(), Disturbances::default(), seed).unwrap()
}

/// Intruders that three pixels see are found, and no free cell hides a part as wide as the smallest.
#[test]
fn intruders_are_found_and_no_free_cell_hides_one() {
    let model = World::new(room());
    let mut random = Random(11);
    let (mut seen, mut missed, mut off) = (0, 0, Vec::new());
    for (name, sensor) in sensors() {
        let mut supervisor = Supervisor::new(corridor(), SuperviseOptions::default()).unwrap();
        let mut predictor = predictor();
        for k in 0..40 {
            let place = random_place(&mut random);
            let environment = with_intruder(&room(), robot() * place, k % 4);
            let alone = truth::alone(&environment, &(robot() * sensor.spec().mount));
            let world = World::new(environment);
            let frame = simulator(&sensor, random.0).frame(&world, 0.0, &RobotPose::new(robot())).unwrap();
            let belief = believed(&robot(), [0.003, 0.001], &mut random);
            let report = supervisor.supervise(&mut predictor, &model, &[&frame], Some(&belief)).unwrap();
            let pixels = truth::pixels(&world, &alone, &frame, &robot(), &corridor());
            if pixels.len() >= 3 {
                seen += 1;
                missed += usize::from(report.intrusions.is_empty());
                if let [intrusion] = &report.intrusions[..] {
                    off.push((intrusion.range - pixels.iter().copied().fold(f64::INFINITY, f64::min)).abs());
                }
            }
            let cells = supervisor.cells();
            for cell in (0..cells.count()).filter(|cell| report.cells[*cell] == CellState::Free) {
                let (middle, half) = (cells.middle(cell), 0.5 * DVec3::new(cells.side, cells.side, cells.layer_height));
                let is_held = alone.holds_part(&robot(), middle - half, middle + half, 0.07);
                assert!(!is_held, "{name} {k}: free cell {cell} at {middle} holds a part");
            }
        }
    }
    assert!(seen > 60 && missed == 0, "{missed} of {seen}");
    let beyond = off.iter().filter(|off| **off > 3.3 * 0.01).count();
    let median = presight_model::statistics::median(&mut off).unwrap();
    assert!(median <= 0.01 && 10 * beyond <= off.len(), "{median} m off, {beyond} of {} beyond 3.3 sigma", off.len());
}

/// The check above finds a cell that is reported free behind the front of a box.
#[test]
fn a_planted_free_cell_is_caught() {
    let [(_, sensor), ..] = sensors();
    let place = Pose::from_xyz_rpy(DVec3::new(1.7, 0.1, 0.0), 0.0, 0.0, 0.0);
    let alone = truth::alone(&with_intruder(&room(), robot() * place, 1), &(robot() * sensor.spec().mount));
    let held = |min: [f64; 3]| alone.holds_part(&robot(), min.into(), DVec3::from(min) + 0.1, 0.07);
    assert!(held([1.58, 0.05, 0.12]), "its upper front edge");
    assert!(!held([1.3, 0.05, 0.08]) && !held([1.6, 0.19, 0.08]), "before it, and a part of 1 cm");
}

/// 3,000 frames of an empty corridor without an alarm.
#[test]
fn an_empty_corridor_raises_no_alarm() {
    let model = World::new(room());
    let mut random = Random(12);
    for (name, sensor) in sensors() {
        let mut supervisor = Supervisor::new(corridor(), SuperviseOptions::default()).unwrap();
        let (mut predictor, mut simulator) = (predictor(), simulator(&sensor, 5));
        let count = if sensor.height() == 1 { 2000 } else { 500 };
        for k in 0..count {
            let frame = simulator.frame(&model, f64::from(k), &RobotPose::new(robot())).unwrap();
            let belief = believed(&robot(), [0.003, 0.001], &mut random);
            let report = supervisor.supervise(&mut predictor, &model, &[&frame], Some(&belief)).unwrap();
            assert!(report.intrusions.is_empty(), "{name}, frame {k}: {:?}", report.intrusions);
        }
    }
}

/// The hidden share of the volume agrees with rays of the caster to random points, within 1 %.
#[test]
fn hidden_shares_agree_with_dense_rays() {
    let [(_, camera), (_, lidar), _] = sensors();
    let mut random = Random(13);
    for sensor in [camera, lidar] {
        let place = Pose::from_xyz_rpy(DVec3::new(1.7, 0.1, 0.0), 0.0, 0.0, 0.4);
        let environment = with_intruder(&room(), robot() * place, 1);
        let world_from_sensor = robot() * sensor.spec().mount;
        let oracle = Oracle::new(&environment, world_from_sensor.translation).unwrap();
        let mut supervisor = Supervisor::new(corridor(), SuperviseOptions::default()).unwrap();
        let frame = super::corridor::exact(&World::new(environment), &sensor);
        let report = supervisor.supervise(&mut predictor(), &World::new(room()), &[&frame], Some(&known())).unwrap();
        let (mut out, mut behind) = (0, 0);
        let count = 20_000;
        for _ in 0..count {
            let p = DVec3::new(random.uniform(0.0, 4.0), random.uniform(-0.4, 0.4), random.uniform(0.06, 1.8));
            let in_sensor = sensor.spec().mount.inverse().transform_point(p);
            if !truth::is_in_view(&sensor, in_sensor) {
                out += 1;
                continue;
            }
            let off = robot().transform_point(p) - world_from_sensor.translation;
            behind += usize::from(oracle.hides(world_from_sensor.translation, off.normalize(), off.length(), &[]));
        }
        let share = |n: usize| n as f64 / f64::from(count);
        assert!((report.hidden[0] - share(out)).abs() < 0.01, "{} and {}", report.hidden[0], share(out));
        let found = report.hidden[1] + report.hidden[2];
        assert!((found - share(behind)).abs() < 0.01, "{found} and {}", share(behind));
    }
}

/// A corridor that brushes a wall of the model and a crate, the model's objects 1 cm off: nothing intrudes.
#[test]
fn known_objects_a_centimetre_off_are_no_intrusions() {
    use presight_localize::simulate::displace;
    let mut random = Random(14);
    let beside = Pose::from_xyz_rpy(DVec3::new(-4.0, 3.7, 0.0), 0.0, 0.0, 0.0);
    let options = SuperviseOptions::default().with_model_sigma(0.01);
    for (name, sensor) in sensors() {
        for (k, pose) in (0..30).flat_map(|k| [(k, robot()), (k, beside)]) {
            let mut environment = room();
            let crate_ahead = beside * Pose::from_xyz_rpy(DVec3::new(2.0, -0.3, 0.0), 0.0, 0.0, 0.3);
            environment = with_intruder(&environment, crate_ahead, 1);
            let model = World::new(environment);
            let mut world = model.clone();
            displace(&mut world, 0.01, k).unwrap();
            let frame = simulator(&sensor, k).frame(&world, 0.0, &RobotPose::new(pose)).unwrap();
            let belief = believed(&pose, [0.003, 0.001], &mut random);
            let mut supervisor = Supervisor::new(corridor(), options).unwrap();
            let report = supervisor.supervise(&mut predictor(), &model, &[&frame], Some(&belief)).unwrap();
            assert!(report.intrusions.is_empty(), "{name}, {k}: {:?}", report.intrusions);
            let is_seen = sensor.height() > 1 && pose == beside;
            assert!(!is_seen || report.counts().known > 20, "{name}, {k}: {:?}", report.counts());
        }
    }
}
