//! Robots with unknown poses, in rooms whose ambiguities are known by hand.

use super::*;
use presight_localize::estimate::{Freedom, measured_points};
use presight_localize::localize::{LocalizeOptions, Localizer, Phase, Search, SearchOptions};
use presight_model::error::ErrorKind;
use presight_model::geometry::RobotPose;
use presight_model::measured::{Motion, OdometryNoise};
use presight_testkit::scenes;

/// A scanner of one row all round, 1.2 m above the floor, with a range of 20 m.
fn row_scanner() -> Sensor {
    let mut spec = scanner(0.02).spec().clone();
    spec.range_max = 20.0;
    spec.mount.translation.z = 1.2;
    Sensor::new(spec).unwrap()
}

/// A coarser search than the default, for a small room.
fn options() -> SearchOptions {
    SearchOptions::default().with_cell(0.5).with_headings(90).with_candidates(12)
}

fn planar() -> Estimator {
    estimator(EstimateOptions::planar())
}

fn unknown(world: &World) -> Localizer {
    let search = Search::new(&mut planar(), world, &row_scanner(), options()).unwrap();
    Localizer::unknown(planar(), search, LocalizeOptions::default())
}

/// The k-th frame of a drive straight ahead, 0.1 m each.
fn frame(world: &World, start: &Pose, k: usize, random: &mut Random) -> (Frame, Pose) {
    let step = Pose { translation: DVec3::new(0.1, 0.0, 0.0), ..Pose::IDENTITY };
    let truth = Pose { translation: start.transform_point(DVec3::new(0.1 * k as f64, 0.0, 0.0)), ..*start };
    let sensor = row_scanner();
    let seen = sense(world, &sensor, &(truth * sensor.spec().mount), random);
    let mut frame = Frame::new(k as f64, sensor, seen.measurement().clone()).unwrap();
    frame.motion = Some(Motion::of_odometry(step, &OdometryNoise::default()));
    (frame, truth)
}

fn start() -> Pose {
    Pose::from_xyz_rpy(DVec3::new(1.5, 2.6, 0.0), 0.0, 0.0, 0.3)
}

/// The robot is lost within five frames and found again within ten, and each change has its reason. This also holds if
/// it is carried away as soon as it is tracked.
#[test]
fn a_robot_is_found_and_found_again_after_it_was_carried_away() {
    for carried in [5, 10] {
        let (world, mut random) = (room(Vec3::ZERO), Random(21));
        let mut robot = unknown(&world);
        let elsewhere = Pose::from_xyz_rpy(DVec3::new(4.6, 2.0, 0.0), 0.0, 0.0, -2.4);
        let (mut lost, mut found) = (None, Vec::new());
        for k in 0..carried + 16 {
            let (from, steps) = if k < carried { (start(), k) } else { (elsewhere, k - carried) };
            let (mut frame, truth) = frame(&world, &from, steps, &mut random);
            frame.stamp = k as f64;
            let step = robot.step(&world, &frame).unwrap();
            assert!(!step.reason.is_empty());
            if step.phase == Phase::Lost {
                lost.get_or_insert(k);
            }
            if step.phase == Phase::Tracking && !(carried..carried + 5).contains(&k) {
                found.push(k);
                let (metres, degrees) = apart(&step.pose.world_from_robot, &truth);
                assert!(metres < 0.05 && degrees < 1.0, "{k}: {metres} m {degrees} deg, {}", step.reason);
            }
        }
        assert!(lost.is_some_and(|k| (carried..carried + 5).contains(&k)), "lost at {lost:?}");
        let again = found.iter().any(|k| (carried..carried + 15).contains(k));
        assert!(found.contains(&4) && again && found.contains(&(carried + 15)), "found at {found:?}");
    }
}

/// A wall that the map still has is removed while the robot is tracked: half of the beams pass through its place. The rest
/// of the room still singles out the place, so the pose is kept and never wrong. A robot that is carried away at that
/// moment is not tracked at that frame, and never where it was.
#[test]
fn a_robot_is_followed_on_where_the_map_has_changed() {
    let (map, mut random) = (room(Vec3::ZERO), Random(25));
    let changed = room_up_to(7.5, Vec3::ZERO);
    let away = Pose::from_xyz_rpy(DVec3::new(4.6, 2.0, 0.0), 0.0, 0.0, -2.4);
    for carried_away in [false, true] {
        let mut robot = unknown(&map);
        let mut tracked = 0;
        for k in 0..28 {
            let (world, taken) = if k < 14 { (&map, false) } else { (&changed, carried_away) };
            let (from, steps) = if taken { (away, k - 14) } else { (start(), k) };
            let (mut frame, truth) = frame(world, &from, steps, &mut random);
            frame.stamp = k as f64;
            let step = robot.step(&map, &frame).unwrap();
            if step.phase == Phase::Tracking {
                let (metres, degrees) = apart(&step.pose.world_from_robot, &truth);
                assert!(metres < 0.1 && degrees < 1.5, "{k}: {metres} m {degrees} deg, {}", step.reason);
                tracked += usize::from(k >= 14);
            }
            assert!(k != 14 || !carried_away || step.phase != Phase::Tracking, "{}", step.reason);
        }
        assert!(carried_away || tracked >= 10, "tracked in {tracked} of 14 frames");
    }
}

/// An empty rectangle looks the same from the opposite place: no number of frames may decide, and both places are
/// reported.
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
            assert!(step.candidates.iter().any(|c| near(&c.pose.world_from_robot)), "{k}: {place:?} is missing");
        }
    }
}

/// A scanner that states no greatest range reaches as far as the map: it finds the robot, and hypotheses follow it.
#[test]
fn a_sensor_without_a_greatest_range_is_searched_with() {
    let (world, mut random) = (room(Vec3::ZERO), Random(21));
    let mut spec = row_scanner().spec().clone();
    spec.range_max = f64::INFINITY;
    let endless = Sensor::new(spec).unwrap();
    let search = Search::new(&mut planar(), &world, &endless, options()).unwrap();
    let mut robot = Localizer::unknown(planar(), search, LocalizeOptions::default());
    for k in 0..5 {
        let (finite, truth) = frame(&world, &start(), k, &mut random);
        let mut frame = Frame::new(finite.stamp, endless.clone(), finite.measurement().clone()).unwrap();
        frame.motion = finite.motion;
        let step = robot.step(&world, &frame).unwrap();
        let is_tracked = step.phase == Phase::Tracking;
        assert!(if k < 4 { k > 1 || !is_tracked } else { is_tracked }, "{k}: {}", step.reason);
        assert!(!is_tracked || apart(&step.pose.world_from_robot, &truth).0 < 0.05, "{:?}", step.pose);
    }
}

#[test]
fn unsearchable_input_is_refused() {
    let world = room(Vec3::ZERO);
    let refused = |world: &World, sensor: &Sensor, options: SearchOptions| {
        let e = Search::new(&mut planar(), world, sensor, options).expect_err("it is refused");
        assert!(e.kind() == ErrorKind::Usage && !e.remedy().is_empty(), "{e}");
        e.to_string()
    };
    assert!(refused(&World::new(Environment::new()), &row_scanner(), options()).contains("without a polygon"));
    assert!(refused(&world, &row_scanner(), options().with_cell(f64::NAN)).contains("cell"));
    assert!(refused(&world, &row_scanner(), options().with_cell(1e-4)).contains("places"));
    // Above the ceiling.
    assert!(refused(&world, &row_scanner(), options().with_floor(5.0)).contains("no free place"));
    let heights = options().with_floor_to(1e9);
    assert!(refused(&world, &camera(0.01), heights).contains("heights"));
    let six = Search::new(&mut estimator(EstimateOptions::default()), &world, &row_scanner(), options());
    assert_eq!(six.expect_err("six numbers").kind(), ErrorKind::Usage);
}

/// A camera of 40 x 30 pixels, 1.2 m above the robot's frame, tilted slightly down.
fn leaning_camera() -> Sensor {
    let camera = Camera::pinhole(40, 30, 30.0, 30.0, 19.5, 14.5);
    let mut spec = SensorSpec::new("range camera", "laser", Geometry::Camera(camera));
    spec.noise.range_sigma = 0.01;
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.1, 0.0, 1.2), 0.0, 0.2, 0.0);
    Sensor::new(spec).unwrap()
}

/// The mirror image of the room.
fn mirrored_room() -> World {
    let mut environment = Environment::new();
    environment.add_material(Material::named("paint")).unwrap();
    for (name, least, most) in [
        ("room", [0.0, 0.0, 0.0], [6.0, 4.0, 2.6]),
        ("table", [2.0, 2.4, 0.0], [3.2, 3.2, 0.75]),
        ("shelf", [4.6, 0.0, 0.0], [5.9, 0.6, 1.9]),
        ("pillar", [3.6, 1.2, 0.0], [3.9, 1.5, 2.6]),
        ("crate", [5.2, 3.3, 0.0], [6.0, 4.0, 0.6]),
    ] {
        add_box(&mut environment, name, Vec3::from(least), Vec3::from(most));
    }
    World::new(environment)
}

/// A tilted camera is found in its room, and nowhere in the room's mirror image.
#[test]
fn a_camera_is_found_in_its_map_and_not_in_a_mirrored_one() {
    let (real, sensor) = (room(Vec3::ZERO), leaning_camera());
    for (map, is_right) in [(room(Vec3::ZERO), true), (mirrored_room(), false)] {
        let search = Search::new(&mut estimator(EstimateOptions::default()), &map, &sensor, options()).unwrap();
        let mut robot = Localizer::unknown(estimator(EstimateOptions::default()), search, LocalizeOptions::default());
        let (mut random, mut found) = (Random(24), None);
        for k in 0..9 {
            let truth = start() * Pose::from_xyz_rpy(DVec3::new(0.1 * k as f64, 0.0, 0.0), 0.0, 0.0, 0.08 * k as f64);
            let seen = sense(&real, &sensor, &(truth * sensor.spec().mount), &mut random);
            let mut frame = Frame::new(k as f64, sensor.clone(), seen.measurement().clone()).unwrap();
            let step = Pose::from_xyz_rpy(DVec3::new(0.1, 0.0, 0.0), 0.0, 0.0, 0.08);
            frame.motion = Some(Motion::of_odometry(step, &OdometryNoise::default()));
            let step = robot.step(&map, &frame).unwrap();
            if step.phase == Phase::Tracking {
                let (metres, degrees) = apart(&step.pose.world_from_robot, &truth);
                assert!(is_right && metres < 0.03 && degrees < 1.0, "{k}: {metres} m {degrees} deg, {}", step.reason);
                found.get_or_insert(k);
            }
        }
        assert!(found.is_some() == is_right, "right map {is_right}: found at {found:?}");
    }
}

/// The caller gives the tilt: the robot's roll and pitch, and a height known within half a metre.
#[test]
fn a_camera_that_is_held_in_the_hand_is_found() {
    let world = room(Vec3::ZERO);
    let mut spec = leaning_camera().spec().clone();
    spec.mount = Pose::IDENTITY;
    let sensor = Sensor::new(spec).unwrap();
    let truth = Pose::from_xyz_rpy(DVec3::new(1.5, 2.6, 1.35), 0.1, 0.25, 0.4);
    let heights = options().with_floor(1.0).with_floor_to(1.6).with_lean([0.1, 0.25]);
    let mut found = estimator(EstimateOptions::default());
    let search = Search::new(&mut found, &world, &sensor, heights).unwrap();
    let seen = sense(&world, &sensor, &truth, &mut Random(25));
    let best = &search.candidates(&mut found, &world, &seen).unwrap()[0];
    let (metres, degrees) = apart(&best.pose.world_from_robot, &truth);
    assert!(metres < 0.02 && degrees < 0.5, "{metres} m {degrees} deg of {} places", search.places().len());
}

/// Blind frames carry no information; the search begins at the first frame with measurements.
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

/// Beams reported as too near by a sensor without a stated minimum range are ignored.
#[test]
fn beams_that_are_too_near_are_ignored() {
    let (world, mut random) = (room(Vec3::ZERO), Random(26));
    let mut robot = unknown(&world);
    let (seen, truth) = frame(&world, &start(), 0, &mut random);
    let mut ranges = seen.ranges().to_vec();
    ranges[40..60].fill(f32::NEG_INFINITY);
    let near = Frame::new(0.0, row_scanner(), Measurement::Range(ranges)).unwrap();
    let step = robot.step(&world, &near).unwrap();
    assert!(apart(&step.pose.world_from_robot, &truth).0 < 0.05, "{}", step.reason);
}

/// What holds the scanner, and how the robot leans.
struct Held {
    mount: Pose,
    lean: [f64; 2],
    elevation: f64,
}

/// Upright or upside down, turned anyhow, and off level by anything from rounding to three degrees.
fn held(random: &mut Random, case: usize) -> Held {
    let off = |random: &mut Random| random.uniform(-1.0, 1.0).signum() * 10f64.powf(random.uniform(-17.0, -1.3));
    let over = if case.is_multiple_of(2) { std::f64::consts::PI } else { 0.0 };
    let place = DVec3::new(random.uniform(-0.3, 0.3), random.uniform(-0.2, 0.2), 1.2);
    let yaw = random.uniform(-3.0, 3.0);
    let mount = Pose::from_xyz_rpy(place, over + off(random), off(random), yaw);
    let lean = if case.is_multiple_of(3) { [off(random), off(random)] } else { [0.0; 2] };
    Held { mount, lean, elevation: if case % 4 == 3 { 2.0 } else { 0.0 } }
}

/// A robot starts at a known pose or an unknown one, and is then carried away. No frame is an error. If it moves on a
/// floor, the pose at the end of each part is as near to the truth as from an upright scanner.
fn check_held(world: &World, held: &Held, freedom: Freedom, is_known: bool, random: &mut Random) {
    let mut spec = row_scanner().spec().clone();
    spec.mount = held.mount;
    if let Geometry::Scanner(scanner) = &mut spec.geometry {
        scanner.elevation = Angles::Listed(vec![held.elevation]);
    }
    let sensor = Sensor::new(spec).unwrap();
    let make = || estimator(EstimateOptions::planar().with_freedom(freedom));
    let options = options().with_lean(held.lean);
    let lean = Pose::from_xyz_rpy(DVec3::ZERO, held.lean[0], held.lean[1], 0.0);
    let mut robot = if is_known {
        Localizer::new(
            make(),
            PoseEstimate::of_sigmas(RobotPose::new(start() * lean), 0.05, 0.03),
            LocalizeOptions::default(),
        )
    } else {
        let search = Search::new(&mut make(), world, &sensor, options).unwrap();
        Localizer::unknown(make(), search, LocalizeOptions::default())
    };
    let elsewhere = Pose::from_xyz_rpy(DVec3::new(4.6, 2.0, 0.0), 0.0, 0.0, -2.4);
    let (carried, mut may_search) = (7, is_known && freedom == Freedom::Planar);
    for k in 0..carried + 16 {
        let (from, steps) = if k < carried { (start(), k) } else { (elsewhere, k - carried) };
        let at = from.transform_point(DVec3::new(0.1 * steps as f64, 0.0, 0.0));
        let truth = Pose { translation: at, ..from } * lean;
        let seen = sense(world, &sensor, &(truth * held.mount), random);
        let mut frame = Frame::new(k as f64, sensor.clone(), seen.measurement().clone()).unwrap();
        let ahead = Pose { translation: DVec3::new(0.1, 0.0, 0.0), ..Pose::IDENTITY };
        frame.motion = Some(Motion::of_odometry(lean.inverse() * ahead * lean, &OdometryNoise::default()));
        let step = robot.step(world, &frame).unwrap_or_else(|e| panic!("{k}, {:?}: {e}", held.mount));
        if may_search && matches!(step.phase, Phase::Lost | Phase::Unknown) {
            may_search = false;
            robot.search_everywhere(world, &sensor, options).unwrap();
        }
        if freedom == Freedom::Planar && (k == carried - 1 || k == carried + 15) {
            let (metres, degrees) = apart(&step.pose.world_from_robot, &truth);
            assert!(
                step.phase == Phase::Tracking && metres < 0.05 && degrees < 1.0,
                "{k}: {metres} m {degrees} deg, {}, mount {:?}, lean {:?}",
                step.reason,
                held.mount.rpy(),
                held.lean
            );
        }
    }
}

#[test]
fn a_mount_that_is_not_level_to_the_last_bit_is_like_an_upright_one() {
    let (world, mut random) = (room(Vec3::ZERO), Random(31));
    for case in 0..8 {
        let held = held(&mut random, case);
        check_held(&world, &held, Freedom::Planar, false, &mut random);
        check_held(&world, &held, Freedom::Planar, true, &mut random);
        check_held(&world, &held, Freedom::Full, case.is_multiple_of(2), &mut random);
    }
}

/// A scanner that goes fully round measures 73 ranges in 72 directions, which are 72 points.
#[test]
fn a_beam_that_comes_twice_is_one_point() {
    let of = |sensor: Sensor| {
        let ranges = Measurement::Range(vec![2.0; sensor.width() as usize * sensor.height() as usize]);
        measured_points(&Frame::new(0.0, sensor, ranges).unwrap())
    };
    let (once, twice) = (of(scenes::scanner(72, 3)), of(scenes::closed(73, 3)));
    assert_eq!(once.len(), 3 * 72);
    assert!(once.len() == twice.len() && once.iter().zip(&twice).all(|(a, b)| a.point == b.point));
}
