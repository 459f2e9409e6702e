//! Single frames with answers worked out by hand, and bad input.

use super::corridor::{corridor, exact, known, predictor, robot, room, supervised};
use glam::DVec3;
use presight_model::error::ErrorKind;
use presight_model::geometry::Pose;
use presight_model::measured::{Frame, Measurement};
use presight_model::world::World;
use presight_predict::virtual_sensors::Corridor;
use presight_supervise::{CellState, Cells, Report, SuperviseOptions, Supervisor, UnseenReason};
use presight_testkit::intruders::{sensors, with_intruder};
use std::time::Duration;

const BOX: usize = 1;

/// A box of 0.2 m, its middle 2.3 m before the robot, 0.1 m to the left.
fn with_box() -> World {
    World::new(with_intruder(&room(), robot() * Pose::from_xyz_rpy(DVec3::new(2.3, 0.1, 0.0), 0.0, 0.0, 0.0), BOX))
}

fn at(cells: &Cells, report: &Report, p: [f64; 3]) -> CellState {
    report.cells[cells.cell_at(p.into()).expect("in the corridor")]
}

#[test]
fn a_box_is_found_and_hides_what_is_behind_it() {
    let world = with_box();
    for (name, sensor) in sensors() {
        let is_planar = sensor.height() == 1;
        let frame = exact(&world, &sensor);
        let options = SuperviseOptions::default().with_speed(0.5).with_upright(is_planar);
        let (supervisor, report) = supervised(options, &[&frame], Some(&known()));
        let cells = supervisor.cells();
        if is_planar {
            // Its plane is 0.2 m high, where the box ends.
            assert!(report.intrusions.len() <= 1, "{name}");
            continue;
        }
        let [intrusion] = &report.intrusions[..] else { panic!("{name}: {:?}", report.intrusions) };
        // Its front is 2.2 m ahead, from y = 0 to 0.2.
        assert!((intrusion.nearest.x - 2.2).abs() < 0.03, "{name}: {:?}", intrusion.nearest);
        assert!((intrusion.along - 2.2).abs() < 0.03 && (report.time_to_reach.unwrap() - 4.4).abs() < 0.1, "{name}");
        let size = intrusion.extent.max - intrusion.extent.min;
        assert!(size.cmple(DVec3::splat(0.21)).all() && size.y > 0.1, "{name}: {size}");
        assert!(intrusion.false_alarms <= 1e-4, "{name}");
        assert_eq!(at(cells, &report, [2.22, 0.12, 0.11]), CellState::Intruded, "{name}");
        assert_eq!(at(cells, &report, [1.05, 0.1, 0.6]), CellState::Free, "{name}");
        let hidden = CellState::Unseen(UnseenReason::BehindUnknown);
        assert_eq!(at(cells, &report, [2.5, 0.1, 0.09]), hidden, "{name}: in its shadow");
        assert!(report.is_compared && !report.is_given_up && !report.is_upright_assumed);
        let counts = report.counts();
        let all = counts.free + counts.known + counts.intruded + counts.unseen.iter().sum::<usize>();
        assert_eq!(all, cells.count());
        assert_eq!(report.letters().chars().filter(|c| *c == 'f').count(), counts.free);
    }
}

/// Nothing stands in the corridor: nothing intrudes, and cells near the sensor are free.
#[test]
fn an_empty_corridor_is_free_where_rays_are_dense() {
    let world = World::new(room());
    for (name, sensor) in sensors() {
        let options = SuperviseOptions::default().with_upright(sensor.height() == 1);
        let (supervisor, report) = supervised(options, &[&exact(&world, &sensor)], Some(&known()));
        assert!(report.intrusions.is_empty() && report.counts().known == 0, "{name}: {:?}", report.intrusions);
        let near = |state: &CellState| *state == CellState::Free;
        let rows: Vec<CellState> = (0..8)
            .map(|k| {
                at(
                    supervisor.cells(),
                    &report,
                    [2.45, -0.35 + 0.1 * f64::from(k), if sensor.height() == 1 { 0.2 } else { 0.45 }],
                )
            })
            .collect();
        assert!(rows.iter().all(near), "{name}: {rows:?}");
        assert!(report.hidden.iter().sum::<f64>() < 1.0, "{name}");
    }
}

/// A planar scanner sees one layer of 18; only with the assumption of upright things is the rest free.
#[test]
fn a_planar_scanner_sees_one_height() {
    let [.., (_, planar)] = sensors();
    let frame = exact(&World::new(room()), &planar);
    let (_, plain) = supervised(SuperviseOptions::default(), &[&frame], Some(&known()));
    let unseen: f64 = plain.hidden.iter().sum();
    assert!((unseen - 17.0 / 18.0).abs() < 0.01, "{unseen}");
    assert!(plain.counts().free <= 320);
    let (_, upright) = supervised(SuperviseOptions::default().with_upright(true), &[&frame], Some(&known()));
    assert!(upright.is_upright_assumed && upright.counts().free > 4000, "{:?}", upright.counts());
}

/// Without a measurement nothing is free.
#[test]
fn frames_without_readings_leave_all_unseen() {
    for (name, sensor) in sensors() {
        let count = sensor.width() as usize * sensor.height() as usize;
        for (value, robot) in
            [(f32::NAN, Some(known())), (f32::NAN, None), (f32::INFINITY, None), (f32::INFINITY, Some(known()))]
        {
            let frame = Frame::new(0.0, sensor.clone(), Measurement::Range(vec![value; count])).unwrap();
            let options = SuperviseOptions::default().with_upright(true);
            let (_, report) = supervised(options, &[&frame], robot.as_ref());
            let counts = report.counts();
            assert_eq!((counts.free, counts.known, counts.intruded), (0, 0, 0), "{name}: {value}");
            assert!(counts.unseen[UnseenReason::NoReturn as usize] > 0, "{name}: {value}");
        }
    }
}

/// Without a pose all surfaces in the corridor intrude, and a corridor in the world cannot be placed.
#[test]
fn without_a_pose_the_measurement_alone_counts() {
    let [(_, camera), ..] = sensors();
    let frame = exact(&with_box(), &camera);
    let (_, report) = supervised(SuperviseOptions::default(), &[&frame], None);
    assert!(!report.is_compared && report.intrusions.len() == 1 && report.counts().known == 0);
    let line = vec![[-4.0, 0.3], [0.0, 0.3]];
    let in_world = Corridor::in_world(line, 0.4, 0.06, 1.8).unwrap();
    let mut supervisor = Supervisor::new(in_world, SuperviseOptions::default()).unwrap();
    let world = World::new(room());
    let mut supervise = |robot| supervisor.supervise(&mut predictor(), &world, &[&frame], robot).unwrap();
    let blind = supervise(None);
    assert_eq!(blind.counts().unseen[UnseenReason::NoPose as usize], blind.cells.len());
    let known = known();
    let seen = supervise(Some(&known));
    assert!(seen.intrusions.len() == 1 && seen.counts().free > 100);
    assert!((seen.intrusions[0].nearest.x - 2.2).abs() < 0.03, "in the robot's frame");
    assert!(seen.intrusions[0].covariance.x_axis.x > 1e-4, "with the pose's own");
}

/// A crate of the model that stands in the corridor is known, and one that was moved into it is named.
#[test]
fn objects_of_the_model_are_known_or_moved() {
    let [_, (_, lidar), _] = sensors();
    let place = |x: f64, y: f64| robot() * Pose::from_xyz_rpy(DVec3::new(x, y, 0.0), 0.0, 0.0, 0.0);
    let model = World::new(with_intruder(&room(), place(2.7, 0.1), BOX));
    let supervise = |world: &World| {
        let mut supervisor = Supervisor::new(corridor(), SuperviseOptions::default()).unwrap();
        supervisor.supervise(&mut predictor(), &model, &[&exact(world, &lidar)], Some(&known())).unwrap()
    };
    let intruder = model.environment().index_of("intruder").unwrap();
    let same = supervise(&model);
    assert!(same.intrusions.is_empty(), "{:?}", same.intrusions);
    assert!(same.cells.contains(&CellState::Known(intruder)));
    let moved = supervise(&World::new(with_intruder(&room(), place(2.3, -0.25), BOX)));
    assert_eq!(moved.intrusions.len(), 1);
    assert_eq!(moved.intrusions[0].object, Some(intruder));
}

/// Single wrong readings do not count, three that agree are an intrusion.
#[test]
fn single_noisy_pixels_are_none() {
    let [(_, camera), ..] = sensors();
    let frame = exact(&World::new(room()), &camera);
    let with = |pixels: &[(usize, f32)]| {
        let mut ranges = frame.ranges().to_vec();
        pixels.iter().for_each(|(at, range)| ranges[*at] = *range);
        let frame = Frame::new(0.0, camera.clone(), Measurement::Range(ranges)).unwrap();
        supervised(SuperviseOptions::default(), &[&frame], Some(&known())).1.intrusions.len()
    };
    // Straight ahead and 23 degrees down: row 20 of 41 is -25 degrees, 1.7 m ahead the height is 0.4 m.
    let middle = 20 * 321 + 160;
    assert_eq!(with(&[(middle, 1.7)]), 0);
    assert_eq!(with(&[(middle, 1.7), (middle + 5, 1.5), (middle - 400, 1.6)]), 0, "apart");
    assert_eq!(with(&[(middle, 1.7), (middle + 1, 1.71), (middle + 2, 1.69)]), 1);
}

#[test]
fn two_sensors_see_more_than_one() {
    let world = World::new(room());
    let [(_, camera), (_, lidar), _] = sensors();
    let (one, other) = (exact(&world, &camera), exact(&world, &lidar));
    let free = |frames: &[&Frame]| supervised(SuperviseOptions::default(), frames, Some(&known())).1.counts().free;
    assert!(free(&[&one, &other]) > free(&[&one]).max(free(&[&other])));
}

/// Cells that nothing looked at before the deadline are unseen, never free.
#[test]
fn a_deadline_leaves_cells_unseen() {
    let [(_, camera), ..] = sensors();
    let frame = exact(&with_box(), &camera);
    let options = SuperviseOptions::default().with_deadline(Some(Duration::from_nanos(1)));
    let (_, report) = supervised(options, &[&frame], Some(&known()));
    assert!(report.is_given_up);
    assert!(report.counts().unseen[UnseenReason::Deadline as usize] > 0 && report.counts().free == 0);
    let (_, generous) =
        supervised(SuperviseOptions::default().with_deadline(Some(Duration::from_secs(60))), &[&frame], Some(&known()));
    let (_, without) = supervised(SuperviseOptions::default(), &[&frame], Some(&known()));
    assert_eq!((generous.letters(), generous.is_given_up), (without.letters(), false));
}

/// Behind the robot, beyond the reach and outside of the image a corridor is out of view.
#[test]
fn corridors_that_are_not_seen_are_out_of_view() {
    let [(_, camera), ..] = sensors();
    let frame = exact(&World::new(room()), &camera);
    for line in [vec![[-4.0, 0.0], [-1.0, 0.0]], vec![[30.0, 0.0], [40.0, 0.0]], vec![[0.0, 3.0], [0.0, 7.0]]] {
        let corridor = Corridor::new(line.clone(), 0.3, 0.06, 1.8).unwrap();
        let mut supervisor = Supervisor::new(corridor, SuperviseOptions::default()).unwrap();
        let report = supervisor.supervise(&mut predictor(), &World::new(room()), &[&frame], Some(&known())).unwrap();
        let counts = report.counts();
        assert!(counts.free == 0 && report.intrusions.is_empty(), "{line:?}: {counts:?}");
        if line[0][0] <= 0.0 {
            assert_eq!(counts.unseen[UnseenReason::OutOfView as usize], report.cells.len(), "{line:?}: {counts:?}");
        }
    }
}

#[test]
fn wrong_input_is_refused() {
    let refused = |options: SuperviseOptions| Supervisor::new(corridor(), options).map(|_| ()).unwrap_err();
    let options = SuperviseOptions::default();
    for (options, word) in [
        (options.with_speed(f64::NAN), "speed"),
        (options.with_cell(0.0), "cell"),
        (options.with_smallest(-1.0), "smallest"),
        (options.with_model_sigma(f64::INFINITY), "model_sigma"),
        (options.with_false_alarms(0.0), "false_alarms"),
        (options.with_arbitrary_readings(1.5), "arbitrary_readings"),
        (options.with_deadline(Some(Duration::ZERO)), "deadline"),
        (options.with_cell(1e-4), "cells"),
    ] {
        let e = refused(options);
        assert!(e.kind() == ErrorKind::Usage && e.to_string().contains(word), "{e}");
    }
    let mut supervisor = Supervisor::new(corridor(), options).unwrap();
    let e = supervisor.supervise(&mut predictor(), &World::new(room()), &[], None).unwrap_err();
    assert_eq!(e.kind(), ErrorKind::Usage);
    let mut wrong = known();
    wrong.covariance[0][0] = f64::NAN;
    let [(_, camera), ..] = sensors();
    let frame = exact(&World::new(room()), &camera);
    assert!(supervisor.supervise(&mut predictor(), &World::new(room()), &[&frame], Some(&wrong)).is_err());
}
