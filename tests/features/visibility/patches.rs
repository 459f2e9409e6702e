//! Compares points and patches with rays in space, patches of many pixels pixel by pixel.

use super::common::oracle::Oracle;
use super::common::{Random, env_number, scenes};
use super::{SHORT, predict, sensors};
use glam::{DMat3, DVec3, Vec3};
use presight_features::{BoxOptions, BoxQuery, Piece, PlacedFeature, Sampler, add_boxes};
use presight_model::environment::Environment;
use presight_model::environment::{Existence, Feature, FeatureShape, NewObject, Properties};
use presight_model::geometry::Pose;
use presight_model::sensor::{Angles, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::world::World;

/// The same places as patches (the polygons) and as points (their corners).
pub(super) fn patches_and_points(environment: &Environment, random: &mut Random) -> Vec<PlacedFeature> {
    let mut all = Vec::new();
    for _ in 0..40 {
        let slot = random.below(environment.slot_count() as usize) as u32;
        let Some(corners) = environment.polygon_in_world(slot) else { continue };
        let patch = FeatureShape::Patch { corners: corners.clone(), covariance: DMat3::ZERO };
        let (a, b) = (random.uniform(0.1, 0.4), random.uniform(0.1, 0.4));
        let at = corners[0] + a * (corners[1] - corners[0]) + b * (corners[2] - corners[0]);
        for shape in [patch, FeatureShape::Point { at, covariance: DMat3::ZERO }] {
            let id = all.len() as u32 + 1;
            let (existence, properties) = (Existence::default(), Properties::default());
            let feature = Feature { id, name: None, object: None, shape, existence, properties };
            all.push(PlacedFeature { feature: feature.into(), object: None, slots: vec![slot] });
        }
    }
    all
}

/// The rays to samples of a point or of a patch with few pixels: how many there are, and how many are clear.
fn clear_samples(corners: &[DVec3], sampler: &Sampler<'_>, hidden: &dyn Fn(DVec3) -> bool) -> (usize, usize) {
    let (mut inside, mut clear) = (0usize, 0usize);
    let mut one = |piece: Piece| {
        if let Piece::Inside(s) = piece {
            inside += 1;
            clear += usize::from(!hidden(s.at));
        }
    };
    match corners.len() {
        1 => one(sampler.point(corners[0])),
        _ => sampler.patch(corners, &mut one),
    }
    (inside, clear)
}

/// The pixels whose rays hit a convex patch, with the hit points; corners and hit points are in the image frame.
fn pixels_of(sensor: &Sensor, corners: &[DVec3]) -> Vec<(u32, u32, DVec3)> {
    let n = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    let mut all = Vec::new();
    for (column, row) in (0..sensor.height()).flat_map(|r| (0..sensor.width()).map(move |c| (c, r))) {
        let Some(ray) = sensor.ray(column, row) else { continue };
        let at = ray * (n.dot(corners[0]) / n.dot(ray));
        let side = |k: usize| (corners[(k + 1) % corners.len()] - corners[k]).cross(at - corners[k]).dot(n);
        if at.dot(ray) > 0.0 && (0..corners.len()).all(|k| side(k) >= 0.0) {
            all.push((column, row, at));
        }
    }
    all
}

/// From this number of pixels on, patches are sampled pixel by pixel.
const MANY: usize = 1024;

#[test]
fn points_and_patches_agree_with_rays_in_space() {
    let mut random = Random(env_number("PRESIGHT_SEED", 1));
    let (mut points, mut patches, mut partly, mut large, mut seams, mut shown) = (0, 0, 0, 0, 0, 0);
    for _ in 0..4 {
        let world = scenes::room_world(random.bits(), 30);
        let placed = patches_and_points(world.environment(), &mut random);
        let pose = Pose::from_xyz_rpy(DVec3::new(0.3, -0.2, 1.4), 0.0, 0.1, random.uniform(-3.0, 3.0));
        let oracle = Oracle::new(world.environment(), pose.translation).unwrap();
        let [_, lens, fisheye, ..] = &sensors()[..] else { unreachable!() };
        for sensor in [&scenes::camera(200, 150), &scenes::scanner(360, 91), lens, fisheye] {
            let (prediction, images) = predict(&world, sensor, &pose, &placed);
            let sampler = Sampler::new(sensor);
            let world_from_image = pose.rotation_matrix() * sensor.body_from_image();
            let mut marks = vec![u32::MAX; images.pixels()];
            for (placed, seen) in placed.iter().zip(&prediction.features) {
                let corners: Vec<DVec3> =
                    seen.points_world.iter().map(|p| world_from_image.transpose() * (*p - pose.translation)).collect();
                let hidden = |at: DVec3| {
                    let ray = world_from_image * at.normalize();
                    oracle.hides(pose.translation, ray, at.length() * (1.0 - SHORT), &placed.slots)
                };
                let pixels = if corners.len() > 1 { pixels_of(sensor, &corners) } else { Vec::new() };
                let (inside, clear, most) = if pixels.len() > MANY {
                    let clear: Vec<_> = pixels.iter().filter(|(.., at)| !hidden(*at)).collect();
                    for (column, row, _) in &clear {
                        let mark = &mut marks[(row * sensor.width() + column) as usize];
                        *mark = (*mark).min(placed.feature.id);
                    }
                    large += 1;
                    // Every pixel must be right, except where an edge runs through it.
                    seams += usize::from(
                        pixels.iter().any(|p| p.0 == 0) && pixels.iter().any(|p| p.0 + 1 == sensor.width()),
                    );
                    (pixels.len(), clear.len(), 1.5 / pixels.len() as f64)
                } else {
                    let (inside, clear) = clear_samples(&corners, &sampler, &hidden);
                    (inside, clear, 0.005 + 2.0 / inside.max(1) as f64)
                };
                let share = if inside > 0 { clear as f64 / inside as f64 } else { 0.0 };
                assert!(
                    (share - seen.visible_fraction).abs() <= most,
                    "{} {}: {share} of {inside}, {}",
                    sensor.spec().name,
                    seen.feature.id,
                    seen.visible_fraction
                );
                let ends: f64 = seen.visible.iter().map(|v| v.t[1] - v.t[0]).sum::<f64>()
                    + seen.hidden.iter().map(|h| h.t[1] - h.t[0]).sum::<f64>();
                assert!((ends - 1.0).abs() < 1e-9, "{ends}");
                points += usize::from(corners.len() == 1 && inside > 0);
                patches += usize::from(corners.len() > 1 && inside > 0);
                partly += usize::from((0.01..0.99).contains(&seen.visible_fraction));
            }
            // The visible part of a large patch shows its number, a lower patch's number, or a feature kind with
            // precedence.
            let right = |(id, mark): (&u32, &u32)| *mark == u32::MAX || *id != 0 && (id <= mark || *id % 2 == 0);
            let wrong = prediction.feature_id.iter().zip(&marks).filter(|pair| !right(*pair)).count();
            assert_eq!(prediction.feature_id.len(), images.pixels());
            let marked = marks.iter().filter(|mark| **mark != u32::MAX).count();
            assert!(wrong * 1000 <= marked, "{}: {wrong} of {marked}", sensor.spec().name);
            shown += marked;
        }
    }
    eprintln!(
        "{points} points and {patches} patches in view, {large} of them large, {seams} on the seam, {partly} seen in part"
    );
    assert!(points > 50 && patches > 50 && partly > 20 && large > 10 && seams > 0 && shown > 10_000);
}

/// A scanner whose image may have a seam, with these ranges of elevation.
fn scanner_over([from, step]: [f64; 2], columns: u32, [low, high]: [f64; 2], rows: u32) -> Sensor {
    let azimuth = Angles::Uniform { start_deg: from, step_deg: step, count: columns };
    let step_deg = if rows > 1 { (high - low) / f64::from(rows - 1) } else { 0.0 };
    let elevation = Angles::Uniform { start_deg: low, step_deg, count: rows };
    let beam_height_deg = if rows > 1 { None } else { Some(0.0) };
    let scanner = Scanner { azimuth, elevation, beam_height_deg };
    Sensor::new(SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner))).unwrap()
}

/// For any visible part, occluder and position relative to border, seam and axis: without errors the box contains the
/// visible part, and the range is that of the nearest pixel.
#[test]
fn boxes_without_errors_contain_the_visible_part() {
    let mut random = Random(env_number("PRESIGHT_SEED", 1));
    let [_, lens, fisheye, ..] = &sensors()[..] else { unreachable!() };
    let around = [-180.0, 1.0];
    let all = [
        scenes::camera(200, 150),
        scanner_over(around, 360, [-45.0, 45.0], 91),
        scanner_over(around, 360, [-90.0, 90.0], 91),
        scanner_over(around, 360, [-15.0, 15.0], 31),
        scanner_over([170.0, -1.0], 360, [-60.0, 20.0], 81),
        scanner_over([100.0, 0.5], 400, [-30.0, 30.0], 61),
        scanner_over([-100.0, 0.5], 400, [-30.0, 30.0], 61),
        scanner_over(around, 360, [0.0, 0.0], 1),
        scanner_over([100.0, 0.5], 400, [-8.0, -8.0], 1),
        lens.clone(),
        fisheye.clone(),
    ];
    let (mut large, mut around_axis, mut held, mut caught) = (0, 0, 0, 0);
    for _ in 0..6 {
        let world = scenes::room_world(random.bits(), 30);
        let placed = patches_and_points(world.environment(), &mut random);
        let [roll, pitch] = [0, 1].map(|_| 0.2 * random.uniform(-1.0, 1.0));
        let pose = Pose::from_xyz_rpy(DVec3::new(0.3, -0.2, 1.4), roll, pitch, random.uniform(-3.0, 3.0));
        let oracle = Oracle::new(world.environment(), pose.translation).unwrap();
        for sensor in &all {
            let (mut prediction, _) = predict(&world, sensor, &pose, &placed);
            add_boxes(
                &mut prediction,
                &BoxQuery {
                    placed: &placed,
                    world: &world,
                    sensor,
                    world_from_sensor: &pose,
                    options: &BoxOptions::default(),
                },
            )
            .unwrap();
            let world_from_image = pose.rotation_matrix() * sensor.body_from_image();
            for (placed, seen) in placed.iter().zip(&prediction.features).filter(|(_, f)| f.points_world.len() > 2) {
                let corners: Vec<DVec3> =
                    seen.points_world.iter().map(|p| world_from_image.transpose() * (*p - pose.translation)).collect();
                let hidden = |at: DVec3| {
                    let ray = world_from_image * at.normalize();
                    oracle.hides(pose.translation, ray, at.length() * (1.0 - SHORT), &placed.slots)
                };
                let pixels = pixels_of(sensor, &corners);
                let clear: Vec<_> = pixels.iter().filter(|(.., at)| !hidden(*at)).collect();
                let Some(bounds) = seen.roi else { continue };
                // Samples of small patches lie between pixels.
                let off = if pixels.len() > MANY { 1e-6 } else { 0.5 };
                let width = f64::from(sensor.width());
                let outside = |[x0, y0, x1, y1]: [f64; 4]| {
                    let holds = |x: f64, y: f64| {
                        let column = [0.0, width].iter().any(|turn| (x0 - off..=x1 + off).contains(&(x + turn)));
                        column && (y0 - off..=y1 + off).contains(&y)
                    };
                    clear.iter().filter(|(c, r, _)| !holds(f64::from(*c), f64::from(*r))).count()
                };
                let out = outside(bounds);
                let mut drawn_in = bounds;
                drawn_in[held % 4] += if held % 4 < 2 { 3.0 } else { -3.0 };
                caught += usize::from(outside(drawn_in) > 1);
                // One pixel may lie on an edge.
                assert!(
                    out <= 1,
                    "{:?} {}: {out} of {} not in {:?}, {:?} {pose:?} {:?}",
                    sensor.spec().geometry,
                    seen.feature.id,
                    clear.len(),
                    seen.roi,
                    seen.visible,
                    seen.points_world
                );
                held += clear.len();
                around_axis +=
                    usize::from(bounds[2] - bounds[0] == width && pixels.iter().any(|p| p.0 == sensor.width() / 2));
                if pixels.len() > MANY && clear.len() > 1 {
                    large += 1;
                    let nearest = clear.iter().map(|p| p.2.length()).fold(f64::INFINITY, f64::min);
                    let range = seen.range.unwrap();
                    let nearer: Vec<_> = clear.iter().filter(|p| p.2.length() < range * (1.0 - 1e-9)).collect();
                    let differ = nearer.len() > 1 || range < nearest * (1.0 - 1e-9);
                    assert!(!differ, "{:?}: {range} for {nearest}", sensor.spec().geometry);
                }
            }
        }
    }
    eprintln!(
        "{held} pixels of patches, {large} of them large, {around_axis} around an axis, {caught} boxes drawn in caught"
    );
    assert!(large > 10 && around_axis > 0 && held > 50_000 && caught > 20);
}

/// Slats of four pixels at gaps of four pixels, in front of a wall: half of it is visible, wherever the slats begin.
#[test]
fn a_wall_behind_a_fence_is_half_visible() {
    let sensor = scenes::camera(512, 384);
    for shift in [0.0, 0.3, 0.5, 0.71] {
        let mut environment = scenes::empty();
        let insert = |environment: &mut Environment, name: &str, low: [f32; 3], high: [f32; 3]| {
            let mesh = std::sync::Arc::new(scenes::cuboid(low.into(), high.into()));
            environment.insert(NewObject::new(name, Pose::IDENTITY, mesh)).unwrap()
        };
        let wall = insert(&mut environment, "wall", [4.0, -3.0, -3.0], [4.1, 3.0, 3.0]);
        let pixel = {
            let [a, b] = [0.0, 1.0].map(|u| sensor.ray_at(u, 190.0).unwrap());
            a.x / a.z - b.x / b.z
        };
        for i in -64..64 {
            let y = (8.0 * f64::from(i) + 8.0 * shift) * pixel.abs() * 2.0;
            let width = 4.0 * pixel.abs() * 2.0;
            insert(&mut environment, "slat", [2.0, y as f32, -3.0], [2.001, (y + width) as f32, 3.0]);
        }
        let world = World::new(environment);
        let object = &world.environment().objects()[wall as usize];
        let front = (0..object.mesh.polygon_count() as u32)
            .find(|p| object.mesh.plane(*p).normal.x.abs() > 0.9 && object.mesh.corners_of(*p).all(|c| c.x < 4.05))
            .unwrap();
        let corners: Vec<DVec3> = object.mesh.corners_of(front).collect();
        let shape = FeatureShape::Patch { corners, covariance: DMat3::ZERO };
        let (existence, properties) = (Existence::default(), Properties::default());
        let feature = Feature { id: 1, name: None, object: None, shape, existence, properties };
        let placed = [PlacedFeature { feature: feature.into(), object: None, slots: vec![object.first_slot + front] }];
        let (prediction, _) = predict(&world, &sensor, &Pose::IDENTITY, &placed);
        let fraction = prediction.features[0].visible_fraction;
        assert!((fraction - 0.5).abs() < 0.02, "{shift}: {fraction}");
    }
}

/// A patch lies behind its own polygon, which hides nothing of it, and a board between the two hides its left half. The
/// image shows only the own polygon, so the index finds the board.
#[test]
fn what_the_index_finds_counts_as_hidden_in_space() {
    let mut environment = scenes::empty();
    let board = |x: f32, y: [f32; 2]| scenes::cuboid(Vec3::new(x, y[0], -2.0), Vec3::new(x + 0.01, y[1], 2.0));
    for (name, mesh) in [("wall", board(2.0, [-2.0, 2.0])), ("board", board(2.5, [0.0, 2.0]))] {
        environment.insert(NewObject::new(name, Pose::IDENTITY, mesh.into())).unwrap();
    }
    let corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)].map(|(y, z)| DVec3::new(3.0, y, z)).to_vec();
    let shape = FeatureShape::Patch { corners, covariance: DMat3::ZERO };
    let (existence, properties) = (Existence::default(), Properties::default());
    let feature = Feature { id: 1, name: None, object: None, shape, existence, properties }.into();
    let wall = environment.objects()[0].mesh.polygon_count() as u32;
    let placed = PlacedFeature { feature, object: None, slots: (0..wall).collect() };
    let stats = predict(&World::new(environment), &scenes::camera(512, 384), &Pose::IDENTITY, &[placed]).0.stats;
    assert!(stats.samples > 2 * MANY && stats.undecided == 0, "{stats:?}");
    assert_eq!((stats.hidden_by_neighbours, stats.visible + stats.hidden_in_space), (0, stats.samples), "{stats:?}");
    assert!(stats.visible.abs_diff(stats.hidden_in_space) < stats.samples / 20, "{stats:?}");
}
