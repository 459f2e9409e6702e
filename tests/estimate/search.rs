//! Robots that nothing is known of, in rooms whose look-alikes are known by hand.

use super::*;
use presight::ErrorKind;
use presight::frame::{Motion, OdometryNoise};
use presight::localize::{LocalizeOptions, Localizer, Phase, Search, SearchOptions};

/// A scanner of one row all round, 1.2 m above the floor, that reaches 20 m.
fn row_scanner() -> Sensor {
    let mut spec = scanner(0.02).spec().clone();
    spec.range_max = 20.0;
    spec.mount.translation.z = 1.2;
    Sensor::new(spec).unwrap()
}

/// Coarser than the default, for a small room.
fn options() -> SearchOptions {
    SearchOptions { cell: 0.5, headings: 90, candidates: 12, ..SearchOptions::default() }
}

fn planar() -> Estimator {
    estimator(EstimateOptions::planar())
}

fn unknown(world: &World) -> Localizer {
    let search = Search::new(&mut planar(), world, &row_scanner(), options()).unwrap();
    Localizer::unknown(planar(), search, LocalizeOptions::default())
}

/// The k-th frame of a drive: straight on, 0.1 m each.
fn frame(world: &World, start: &Pose, k: usize, random: &mut Random) -> (Frame, Pose) {
    let step = Pose { translation: DVec3::new(0.1, 0.0, 0.0), ..Pose::IDENTITY };
    let truth = Pose { translation: start.transform_point(DVec3::new(0.1 * k as f64, 0.0, 0.0)), ..*start };
    let sensor = row_scanner();
    let seen = sense(world, &sensor, &(truth * sensor.spec().mount), random);
    let mut frame = Frame::new(k as f64, sensor, seen.sensed().clone()).unwrap();
    frame.motion = Some(Motion::of_odometry(step, &OdometryNoise::default()));
    (frame, truth)
}

fn start() -> Pose {
    Pose::from_xyz_rpy(DVec3::new(1.5, 2.6, 0.0), 0.0, 0.0, 0.3)
}

/// Lost within five frames, found again within ten; and each change with its reason.
#[test]
fn a_robot_is_found_and_found_again_after_it_was_carried_away() {
    let (world, mut random) = (room(Vec3::ZERO), Random(21));
    let mut robot = unknown(&world);
    let elsewhere = Pose::from_xyz_rpy(DVec3::new(4.6, 2.0, 0.0), 0.0, 0.0, -2.4);
    let (mut lost, mut found) = (None, Vec::new());
    for k in 0..26 {
        let from = if k < 10 { start() } else { Pose { translation: elsewhere.translation, ..elsewhere } };
        let (mut frame, truth) = frame(&world, &from, if k < 10 { k } else { k - 10 }, &mut random);
        frame.stamp = k as f64;
        let step = robot.step(&world, &frame).unwrap();
        assert!(!step.reason.is_empty());
        if step.phase == Phase::Lost {
            lost.get_or_insert(k);
        }
        if step.phase == Phase::Tracking && !(10..15).contains(&k) {
            found.push(k);
            let (metres, degrees) = apart(&step.pose, &truth);
            assert!(metres < 0.05 && degrees < 1.0, "{k}: {metres} m {degrees} deg, {}", step.reason);
        }
    }
    assert!(lost.is_some_and(|k| (10..15).contains(&k)), "lost at {lost:?}");
    assert!(found.contains(&4) && found.iter().any(|k| (10..25).contains(k)), "found at {found:?}");
    assert!(found.contains(&25));
}

/// An empty rectangle looks the same from the opposite place: no number of frames may decide, and both places are told.
#[test]
fn a_room_with_a_double_stays_undetermined() {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    add_box(&mut environment, "room", Vec3::ZERO, Vec3::new(6.0, 4.0, 2.6));
    let (world, mut random) = (World::new(environment), Random(22));
    let mut robot = unknown(&world);
    for k in 0..7 {
        let (frame, truth) = frame(&world, &start(), k, &mut random);
        let step = robot.step(&world, &frame).unwrap();
        assert!(
            step.phase == Phase::Candidates && !step.is_known() && !step.estimate.is_determined(),
            "{}",
            step.reason
        );
        // Half a turn about the middle of the room.
        let half = Pose::from_xyz_rpy(DVec3::new(6.0, 4.0, 0.0), 0.0, 0.0, std::f64::consts::PI);
        for place in [truth, half * truth] {
            let near = |pose: &Pose| apart(pose, &place).0 < 0.05 && apart(pose, &place).1 < 1.0;
            assert!(step.candidates.iter().any(|c| near(&c.pose)), "{k}: {place:?} is missing");
        }
    }
}

#[test]
fn what_cannot_be_searched_is_told() {
    let world = room(Vec3::ZERO);
    let refused = |world: &World, sensor: &Sensor, options: SearchOptions| {
        let e = Search::new(&mut planar(), world, sensor, options).expect_err("it is refused");
        assert!(e.kind() == ErrorKind::Usage && !e.remedy().is_empty(), "{e}");
        e.to_string()
    };
    assert!(refused(&world, &camera(0.01), options()).contains("no scanner"));
    assert!(refused(&World::new(Environment::new()), &row_scanner(), options()).contains("without a polygon"));
    assert!(refused(&world, &row_scanner(), SearchOptions { cell: f64::NAN, ..options() }).contains("cell"));
    assert!(refused(&world, &row_scanner(), SearchOptions { cell: 1e-4, ..options() }).contains("places"));
    // Above the ceiling.
    assert!(refused(&world, &row_scanner(), SearchOptions { floor: 5.0, ..options() }).contains("no free place"));
    let mut leaning = row_scanner().spec().clone();
    leaning.mount = Pose::from_xyz_rpy(DVec3::ZERO, 0.2, 0.0, 0.0);
    assert!(refused(&world, &Sensor::new(leaning).unwrap(), options()).contains("leans"));
    let six = Search::new(&mut estimator(EstimateOptions::default()), &world, &row_scanner(), options());
    assert_eq!(six.expect_err("six numbers").kind(), ErrorKind::Usage);
}

/// Blind frames say nothing; the search begins at the first that measures.
#[test]
fn a_blind_start_waits() {
    let (world, mut random) = (room(Vec3::ZERO), Random(23));
    let mut robot = unknown(&world);
    let nothing = Frame::new(-1.0, row_scanner(), Measurement::Range(vec![f32::NAN; 360])).unwrap();
    let step = robot.step(&world, &nothing).unwrap();
    assert!(step.phase == Phase::Unknown && !step.is_known(), "{}", step.reason);
    let step = robot.step(&world, &frame(&world, &start(), 0, &mut random).0).unwrap();
    assert!(step.phase == Phase::Candidates, "{}", step.reason);
}
