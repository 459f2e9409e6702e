//! Radar: lines, nearest obstacles and landmarks.

use super::*;
use glam::DVec2;
use presight_predict::virtual_sensors::{Corridor, Nearest, RadarLines};
use proptest::prelude::*;

/// A full circle of one row, counter-clockwise from behind.
fn radar(beams: u32) -> SensorSpec {
    scanner("radar", uniform(-180.0, 360.0 / f64::from(beams), beams), uniform(0.0, 0.0, 1))
}

fn lines(world: &World, spec: SensorSpec, pose: &Pose) -> (RadarLines, Prediction) {
    let prediction = predict(world, &Sensor::new(spec).unwrap(), pose);
    match of(VirtualSensor::RadarLines, world.environment(), &prediction, None, &Settings::default()) {
        Answer::RadarLines(lines) => (lines, prediction),
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_room_is_four_lines_over_the_seam_too() {
    let room = world(vec![("room", cuboid([-3.0, -2.0, 0.0], [4.0, 2.0, 2.5]))]);
    let (found, _) = lines(&room, radar(3600), &Pose::from_xyz_rpy(DVec3::new(0.0, 0.0, 1.0), 0.0, 0.0, 0.0));
    assert_eq!((found.lines.len(), found.single_beams), (4, 0));
    assert_eq!(found.lines.iter().map(|l| l.beams).sum::<u32>(), 3600);
    // The wall behind crosses the seam: its columns continue from the last to the first.
    let behind = found.lines.last().unwrap();
    assert!(behind.columns[0] > behind.columns[1] && (behind.distance - 3.0).abs() < 1e-12);
    assert!(DVec3::from(behind.normal_robot).distance(DVec3::X) < 1e-12);
    // Each line is as long as its wall, less a beam at each end.
    let beam = 2.0 * 5.0 * (0.1f64).to_radians() / 0.4;
    for (line, length) in found.lines.iter().zip([7.0, 4.0, 7.0, 4.0]) {
        assert!(line.length <= length + 1e-9 && line.length > length - beam, "{line:?}");
        assert_eq!((line.polygons.len(), line.objects.as_slice()), (1, ["room".to_owned()].as_slice()));
    }
}

#[test]
fn aligned_panels_are_one_line_and_a_step_splits_them() {
    let panel = |x: f32, y0: f32, y1: f32| quad([[x, y0, 0.0], [x, y1, 0.0], [x, y1, 2.0], [x, y0, 2.0]]);
    for (step, count) in [(0.0, 1), (5e-4, 1), (5e-3, 2)] {
        let two = world(vec![("left", panel(3.0, 0.0, 1.0)), ("right", panel(3.0 + step, -1.0, 0.0))]);
        let pose = Pose::from_xyz_rpy(DVec3::Z, 0.0, 0.0, 0.0);
        let (found, _) = lines(&two, radar(1440), &pose);
        assert_eq!(found.lines.len(), count, "step of {step} m");
        let names: Vec<&str> = found.lines.iter().flat_map(|l| &l.objects).map(String::as_str).collect();
        assert_eq!(names, ["right", "left"]);
    }
}

#[test]
fn a_pillar_cuts_the_wall_behind_it_and_lines_are_in_the_robots_frame() {
    let room = world(vec![
        ("wall", quad([[4.0, -3.0, 0.0], [4.0, 3.0, 0.0], [4.0, 3.0, 2.0], [4.0, -3.0, 2.0]])),
        ("pillar", cuboid([1.8, -0.2, 0.0], [2.2, 0.2, 2.0])),
    ]);
    let mut spec = radar(3600);
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.4, -0.3, 0.9), 0.0, 0.0, 0.7);
    let world_from_sensor = Pose::from_xyz_rpy(DVec3::new(0.0, 0.0, 0.9), 0.0, 0.0, 0.3);
    let world_from_robot = world_from_sensor * spec.mount.inverse();
    let (found, _) = lines(&room, spec, &world_from_sensor);
    let by_object = |name: &str| found.lines.iter().filter(|l| l.objects == [name.to_owned()]).collect::<Vec<_>>();
    let (walls, pillar) = (by_object("wall"), by_object("pillar"));
    assert_eq!((found.lines.len(), walls.len(), pillar.len()), (3, 2, 1));
    // The pillar's front face hides 0.4 * 4 / 1.8 m of the wall.
    let shown: f64 = walls.iter().map(|l| l.length).sum();
    assert!((shown - (6.0 - 0.4 * 4.0 / 1.8)).abs() < 4.0 * 0.015, "{shown}");
    for line in walls {
        for end in line.ends_robot {
            let p = world_from_robot.transform_point(DVec3::from(end));
            assert!((p.x - 4.0).abs() < 1e-12 && (p.z - 0.9).abs() < 1e-12, "{p}");
        }
        let normal = world_from_robot.rotation * DVec3::from(line.normal_robot);
        assert!(normal.distance(DVec3::NEG_X) < 1e-12 && (line.distance - 4.0).abs() < 1e-12);
    }
}

/// Distance of a point from a convex polygon.
fn off_polygon(p: DVec3, corners: &[DVec3]) -> f64 {
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
    let n = corners.len();
    let outside = (0..n).map(|k| {
        let (a, b) = (corners[k], corners[(k + 1) % n]);
        (p - a).dot((b - a).cross(normal).normalize())
    });
    outside.fold((p - corners[0]).dot(normal).abs(), f64::max)
}

/// Returns true if all lines lie on their polygons.
fn on_polygons(found: &RadarLines, world: &World, world_from_robot: &Pose) -> bool {
    found.lines.iter().all(|line| {
        let ends = line.ends_robot.map(|p| world_from_robot.transform_point(DVec3::from(p)));
        let corners = |id: &u32| world.environment().polygon_in_world(id - 1).unwrap();
        let nearest =
            |p: DVec3| line.polygons.iter().map(|id| off_polygon(p, &corners(id))).fold(f64::INFINITY, f64::min);
        ends.into_iter().all(|p| nearest(p) < 1e-9) && nearest(ends[0].lerp(ends[1], 0.37)) < 1.1e-3
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn ends_lie_on_polygons_and_every_beam_is_reported(
        seed in 0..1000u64, x in -1.0..1.0f64, y in -1.0..1.0f64, z in 0.3..2.4f64, yaw in -3.0..3.0f64,
    ) {
        let room = scenes::room_world(seed, 12);
        let mut spec = radar(720);
        spec.mount = Pose::from_xyz_rpy(DVec3::new(0.2, 0.1, 0.5), 0.1, -0.2, 1.0);
        let pose = Pose::from_xyz_rpy(DVec3::new(x, y, z), 0.03, -0.02, yaw);
        let world_from_robot = pose * spec.mount.inverse();
        let (mut found, prediction) = lines(&room, spec, &pose);
        let hits = prediction.images.range.iter().filter(|r| r.is_finite()).count();
        prop_assert_eq!(found.lines.iter().map(|l| l.beams as usize).sum::<usize>() + found.single_beams, hits);
        prop_assert!(on_polygons(&found, &room, &world_from_robot));
        // One millimetre off.
        found.lines[0].ends_robot[0][2] += 1e-3;
        found.lines[0].ends_robot[0][0] += 1e-3;
        prop_assert!(!on_polygons(&found, &room, &world_from_robot));
    }
}

fn nearest(world: &World, spec: SensorSpec, pose: &Pose, corridor: Option<Corridor>) -> (Nearest, Prediction) {
    let prediction = predict(world, &Sensor::new(spec).unwrap(), pose);
    let settings = Settings { corridor, ..Settings::default() };
    match of(VirtualSensor::RadarNearest, world.environment(), &prediction, None, &settings) {
        Answer::RadarNearest(nearest) => (nearest, prediction),
        other => panic!("{other:?}"),
    }
}

/// A hall with a pillar, and a radar of many rows, 1 m high on a robot.
fn hall() -> (World, SensorSpec, Pose) {
    let hall = world(vec![
        ("hall", cuboid([-5.0, -2.0, 0.0], [8.0, 2.0, 3.0])),
        ("pillar", cuboid([3.0, 0.5, 0.0], [3.5, 1.0, 3.0])),
    ]);
    let mut spec = scanner("radar", uniform(-180.0, 0.5, 720), uniform(-25.0, 1.0, 51));
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.2, 0.0, 1.0), 0.0, 0.0, 0.0);
    let pose = spec.mount;
    (hall, spec, pose)
}

#[test]
fn corridors_end_at_the_first_obstacle_inside() {
    let (world, spec, pose) = hall();
    let along = |line: Vec<[f64; 2]>, half: f64| {
        nearest(&world, spec.clone(), &pose, Some(Corridor::new(line, half, 0.1, 1.8).unwrap())).0
    };
    // A narrow robot reaches the far wall straight ahead; a wider robot meets the pillar's front face, x = 3.
    let narrow = along(vec![[0.0, 0.0], [9.0, 0.0]], 0.4).corridor.unwrap();
    assert!((narrow.arc_length.unwrap() - 8.0).abs() < 1e-9 && narrow.length == 9.0, "{narrow:?}");
    let wide = along(vec![[0.0, 0.0], [9.0, 0.0]], 0.6).corridor.unwrap();
    assert!((wide.arc_length.unwrap() - 3.0).abs() < 1e-9, "{wide:?}");
    assert_eq!(wide.first.unwrap().object, "pillar");
    // Around a corner: 2 m ahead, then to the left up to the wall at y = 2.
    let bent = along(vec![[0.0, 0.0], [2.0, 0.0], [2.0, 5.0]], 0.4).corridor.unwrap();
    assert!((bent.arc_length.unwrap() - 4.0).abs() < 1e-9, "{bent:?}");
    // The corridor ends before the first obstacle.
    let short = along(vec![[0.0, 0.0], [2.5, 0.0]], 0.45).corridor.unwrap();
    assert_eq!((short.arc_length, short.first.is_none(), short.beams), (None, true, 0));
    // The floor is an obstacle only for a corridor that includes its height.
    let low = Corridor::new(vec![[0.0, 0.0], [9.0, 0.0]], 0.4, -0.1, 1.8).unwrap();
    let floor = nearest(&world, spec, &pose, Some(low)).0.corridor.unwrap();
    assert!(floor.arc_length.unwrap() < 3.0 && floor.first.unwrap().point_robot[2].abs() < 1e-9);
}

#[test]
fn each_direction_has_its_nearest_obstacle() {
    let (world, spec, pose) = hall();
    let (found, prediction) = nearest(&world, spec, &pose, None);
    let images = &prediction.images;
    assert!(found.corridor.is_none() && found.directions.range.len() == 720);
    let equal = |ranges: &[f64]| {
        (0..720).all(|column| {
            let rows = (0..51).map(|row| f64::from(images.range[row * 720 + column]));
            let least = rows.fold(f64::INFINITY, f64::min);
            (ranges[column] - least).abs() <= 1e-6 * least
        })
    };
    assert!(equal(&found.directions.range));
    let mut shifted = found.directions.range.clone();
    shifted.rotate_left(1);
    assert!(!equal(&shifted));
    for (column, azimuth) in found.directions.azimuth.iter().enumerate() {
        let want = (-180.0 + 0.5 * column as f64).to_radians();
        assert!((azimuth.sin() - want.sin()).abs() < 1e-12 && (azimuth.cos() - want.cos()).abs() < 1e-12);
    }
    let least = found.directions.range.iter().copied().fold(f64::INFINITY, f64::min);
    let point = found.nearest.unwrap();
    assert_eq!((point.range, point.object.as_str()), (least, "hall"));
    let at = DVec3::from(point.point_robot) - DVec3::new(0.2, 0.0, 1.0);
    assert!((at.length() - least).abs() < 1e-12);
}

#[test]
fn an_empty_world_has_no_nearest() {
    let (found, _) = nearest(&World::new(scenes::empty()), radar(36), &Pose::IDENTITY, None);
    assert!(found.nearest.is_none() && found.directions.range.iter().all(|r| *r == f64::INFINITY));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// The corridor's result equals a walk along its line in steps of 1 mm with the distance to every hit.
    #[test]
    fn corridors_equal_a_walk_along_them(
        seed in 0..1000u64, turns in prop::collection::vec(-1.2..1.2f64, 1..4), half_width in 0.2..0.9f64,
    ) {
        let room = scenes::room_world(seed, 10);
        let mut spec = radar(180);
        spec.mount = Pose::from_xyz_rpy(DVec3::new(0.1, 0.0, 1.1), 0.0, 0.0, 0.0);
        let pose = spec.mount;
        let (mut heading, mut line) = (0.0, vec![[0.0, 0.0]]);
        for turn in &turns {
            heading += turn;
            let [x, y] = line[line.len() - 1];
            line.push([x + 2.0 * f64::cos(heading), y + 2.0 * f64::sin(heading)]);
        }
        let corridor = Corridor::new(line.clone(), half_width, 0.0, 2.0).unwrap();
        let (found, prediction) = nearest(&room, spec, &pose, Some(corridor));
        let mut walked: Option<f64> = None;
        let mut close = false;
        for column in 0..180 {
            let range = f64::from(prediction.images.range[column as usize]);
            let ray = prediction.sensor.ray(column, 0).unwrap();
            let p = DVec2::new(0.1, 0.0) + (ray * range).truncate();
            let mut before = 0.0;
            for piece in line.windows(2) {
                let (a, b) = (DVec2::from(piece[0]), DVec2::from(piece[1]));
                let steps = (a.distance(b) * 1e3).ceil() as u32;
                let at = |i: u32| a.lerp(b, f64::from(i) / f64::from(steps));
                let nearest = (0..=steps).min_by(|i, j| p.distance(at(*i)).total_cmp(&p.distance(at(*j)))).unwrap();
                let d = p.distance(at(nearest));
                close |= (d - half_width).abs() < 1e-5;
                if d <= half_width {
                    let s = before + a.distance(at(nearest));
                    walked = Some(walked.map_or(s, |w: f64| w.min(s)));
                    break;
                }
                before += a.distance(b);
            }
        }
        prop_assume!(!close);
        let inside = found.corridor.unwrap();
        prop_assert_eq!(inside.arc_length.is_some(), walked.is_some());
        if let Some((s, w)) = inside.arc_length.zip(walked) {
            prop_assert!((s - w).abs() < 1.1e-3, "{} and {}", s, w);
        }
    }
}

#[test]
fn visible_landmarks_are_placed() {
    let scene = world(vec![("pillar", cuboid([1.8, -0.2, 0.0], [2.2, 0.2, 2.0]))]);
    let mut spec = radar(3600);
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.3, 0.0, 1.0), 0.0, 0.0, 1.0);
    let pose = Pose::from_xyz_rpy(DVec3::new(0.0, 0.0, 1.0), 0.0, 0.0, 0.2);
    let world_from_robot = pose * spec.mount.inverse();
    let prediction = predict(&scene, &Sensor::new(spec).unwrap(), &pose);
    let open = DVec3::new(4.0, 2.0, 1.0);
    let features = seen(&scene, &prediction, vec![reflector(3, open), reflector(4, DVec3::new(4.0, 0.0, 1.0))]);
    let Answer::RadarLandmarks(found) =
        of(VirtualSensor::RadarLandmarks, scene.environment(), &prediction, Some(&features), &Settings::default())
    else {
        panic!("no landmarks");
    };
    assert_eq!((found.known, found.landmarks.len()), (2, 1));
    let mark = &found.landmarks[0];
    assert_eq!((mark.id, mark.kind, mark.name.as_deref()), (3, "reflector", Some("mark 3")));
    assert!(world_from_robot.transform_point(DVec3::from(mark.position_robot)).distance(open) < 1e-12);
    assert!((mark.range - 20f64.sqrt()).abs() < 1e-12 && mark.elevation.abs() < 1e-12);
    assert!((mark.azimuth - (0.5f64.atan() - 0.2)).abs() < 1e-12);
}
