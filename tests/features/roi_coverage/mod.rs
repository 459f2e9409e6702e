//! Checks regions of interest against random errors: boxes have their stated coverage, and are hardly larger than the
//! best box.
//!
//! The draws are independent of the code under test: errors from a separate Cholesky decomposition move poses and
//! points in space, and `Sensor::project` images them. `PRESIGHT_DRAWS` sets their number.
#![expect(clippy::print_stdout, reason = "the tests print draws and coverage")]

use presight_testkit as common;
mod draws;
mod study;

use common::{Random, env_number, scenes};
use draws::{Best, Case};
use glam::{DMat3, DVec3, Vec3};
use presight_features::roi::RoiFlag;
use presight_features::{BoxOptions, BoxQuery, FeatureSettings, PlacedFeature, add_boxes, predict_features};
use presight_model::environment::NewObject;
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::geometry::{Pose, PoseCovariance};
use presight_model::sensor::{Angles, Camera, Distortion, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use std::sync::Arc;

type Covariance = [[f64; 6]; 6];
const CONFIDENCES: [f64; 3] = [0.9, 0.99, 0.999];

fn draws() -> usize {
    env_number("PRESIGHT_DRAWS", 200_000) as usize
}

/// 640 x 480 pixels.
fn camera() -> Sensor {
    let camera = Camera::pinhole(640, 480, 500.0, 500.0, 319.5, 239.5);
    Sensor::new(SensorSpec::new("camera", "video", Geometry::Camera(camera))).unwrap()
}

/// All round, from pole to pole.
fn scanner() -> Sensor {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 0.5, count: 720 };
    let elevation = Angles::Uniform { start_deg: -90.0, step_deg: 1.0, count: 181 };
    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
    Sensor::new(SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner))).unwrap()
}

/// The camera with a lens: 180 degrees of a fisheye, or barrel distortion.
fn lenses() -> [Sensor; 2] {
    let fisheye = Distortion::Equidistant([0.01, -0.002, 0.0, 0.0]);
    let barrel = Distortion::PlumbBob([-0.28, 0.07, 1e-4, -2e-4, 0.0]);
    [("fisheye", fisheye, 200.0), ("barrel", barrel, 500.0)].map(|(name, distortion, f)| {
        let camera = Camera { distortion, ..Camera::pinhole(640, 480, f, f, 319.5, 239.5) };
        Sensor::new(SensorSpec::new(name, "video", Geometry::Camera(camera))).unwrap()
    })
}

fn diagonal(sigmas: [f64; 6]) -> Covariance {
    let mut m = [[0.0; 6]; 6];
    for (i, s) in sigmas.into_iter().enumerate() {
        m[i][i] = s * s;
    }
    m
}

fn isotropic(sigma: f64) -> DMat3 {
    DMat3::from_diagonal(DVec3::splat(sigma * sigma))
}

fn segment(a: DVec3, b: DVec3, sigma: f64) -> FeatureShape {
    FeatureShape::Segment { ends: [a, b], covariances: [isotropic(sigma); 2], cross: DMat3::ZERO }
}

fn assert_all(cases: &[Case]) {
    let wrong: Vec<String> = cases.iter().flat_map(Case::check).collect();
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// The case with both sensors at the origin.
fn both(name: &str, covariance: Covariance, shape: FeatureShape, tight: Option<f64>) -> [Case; 2] {
    [camera(), scanner()].map(|sensor| {
        let shape = shape.clone();
        Case { name: name.to_owned(), sensor, pose: Pose::IDENTITY, covariance, shape, tight }
    })
}

fn robot(xy: f64, heading_deg: f64) -> Covariance {
    diagonal([xy, xy, 0.0, 0.0, 0.0, heading_deg.to_radians()])
}

fn post(x: f64, y: f64, sigma: f64) -> FeatureShape {
    segment(DVec3::new(x, y, -0.8), DVec3::new(x, y, 0.7), sigma)
}

fn point(x: f64, y: f64, z: f64, covariance: DMat3) -> FeatureShape {
    FeatureShape::Point { at: DVec3::new(x, y, z), covariance }
}

#[test]
fn comfortable_boxes_have_their_coverage_and_are_tight() {
    let mut correlated = diagonal([0.05, 0.05, 0.05, 0.01, 0.01, 0.01]);
    (correlated[0][5], correlated[5][0]) = (3e-4, 3e-4);
    (correlated[1][5], correlated[5][1]) = (-3.5e-4, -3.5e-4);
    let slanting = segment(DVec3::new(4.0, -1.0, -0.6), DVec3::new(6.0, 1.0, 0.8), 0.03);
    let square = [(-0.3, -0.3), (0.3, -0.3), (0.3, 0.3), (-0.3, 0.3)].map(|(y, z)| DVec3::new(5.0 + 0.5 * y, y, z));
    let patch = FeatureShape::Patch { corners: square.to_vec(), covariance: isotropic(0.01) };
    assert_all(
        &[
            both("a post, robot uncertain in x, y and heading", robot(0.03, 1.0), post(5.0, 0.4, 0.01), Some(1.15)),
            both("a point", robot(0.05, 1.0), point(6.0, -1.0, 0.5, isotropic(0.05)), Some(1.15)),
            both("a point, all pose errors", correlated, point(6.0, -1.0, 0.5, isotropic(0.05)), Some(1.15)),
            both("a slanting edge", robot(0.02, 0.5), slanting, Some(1.15)),
            both("a patch", robot(0.03, 1.0), patch, Some(1.15)),
            both("only the feature", diagonal([0.0; 6]), point(4.0, 0.3, 0.2, isotropic(0.04)), Some(1.15)),
        ]
        .concat(),
    );
}

#[test]
fn extreme_boxes_have_their_coverage() {
    let line = DVec3::new(0.3, 0.2, 0.5);
    let singular = DMat3::from_cols(line * line.x, line * line.y, line * line.z) * 0.01;
    let near = segment(DVec3::new(0.3, 0.0, -0.05), DVec3::new(0.3, 0.0, 0.05), 0.002);
    let kilometre = diagonal([1e3, 1e3, 1e3, 0.0, 0.0, 0.1]);
    assert_all(
        &[
            both("nothing is uncertain", diagonal([0.0; 6]), point(4.0, 0.3, 0.2, DMat3::ZERO), None),
            both("a singular covariance", diagonal([0.0; 6]), point(4.0, 0.3, 0.2, singular), Some(2.0)),
            both("a post 3 m ahead", robot(0.15, 4.0), post(3.0, 0.1, 0.01), Some(2.0)),
            both("a post 1.5 m ahead", robot(0.1, 5.0), post(1.5, 0.1, 0.01), Some(2.0)),
            both("0.3 m ahead, heading 20 degrees", robot(0.02, 20.0), near, Some(2.0)),
            both("sigma 1e-9 m", diagonal([1e-9; 6]), point(4.0, 0.3, 0.2, isotropic(1e-9)), None),
            both("sigma 1e3 m", kilometre, point(4.0, 0.3, 0.2, isotropic(1e-9)), None),
        ]
        .concat(),
    );
}

/// Edges 2, 8 and 20 degrees off the pole, horizontal and slanting. Errors may move them across the pole; then the box
/// covers all columns up to the pole.
#[test]
fn edges_near_a_pole_are_covered() {
    let mut cases = Vec::new();
    for degrees in [2.0f64, 8.0, 20.0] {
        let off = 3.0 * degrees.to_radians().tan();
        let level = segment(DVec3::new(off, -0.4, 3.0), DVec3::new(off, 0.5, 3.0), 0.01);
        let slanting = segment(DVec3::new(off, 0.3, 2.4), DVec3::new(off, -0.4, 3.3), 0.01);
        for (name, shape, sign) in
            [("level", level, 1.0), ("slanting", slanting.clone(), 1.0), ("below", slanting, -1.0)]
        {
            let shape = match shape {
                FeatureShape::Segment { ends, covariances, cross } => {
                    let ends = ends.map(|p| DVec3::new(p.x, p.y, sign * p.z));
                    FeatureShape::Segment { ends, covariances, cross }
                }
                other => other,
            };
            let covariance = diagonal([0.05, 0.05, 0.02, 0.02, 0.02, 5f64.to_radians()]);
            let [_, case] = both(&format!("{name}, {degrees} degrees off the pole"), covariance, shape, None);
            cases.push(case);
        }
    }
    assert_all(&cases);
}

/// Near the pole columns carry little or no information, but rows do: the box takes only the rows that the point may
/// reach.
#[test]
fn at_a_pole_few_rows_are_taken() {
    let pose = Pose::from_xyz_rpy(DVec3::ZERO, 5f64.to_radians(), 15f64.to_radians(), 0.0);
    for (x, all_columns) in [(1.2, false), (0.8, true)] {
        let [_, case] = both("a point at the pole", robot(0.05, 10.0), point(x, -0.2, 3.0, isotropic(0.01)), None);
        let case = Case { pose, ..case };
        assert_all(std::slice::from_ref(&case));
        let ([x0, y0, x1, y1], flag) = case.found(0.99);
        assert_eq!((flag, x1 - x0 > 715.0), (RoiFlag::Set, all_columns), "{x}: {x0} {x1}");
        assert!(y1 - y0 < 20.0, "{x}: {y0} {y1}");
    }
}

/// A covariance with random directions, sometimes singular.
fn any_covariance(random: &mut Random, position: f64, angle: f64) -> Covariance {
    let root: [[f64; 6]; 6] = std::array::from_fn(|i| {
        let sigma = if i < 3 { position } else { angle };
        std::array::from_fn(|_| sigma / 6f64.sqrt() * random.uniform(-1.0, 1.0) * 3f64.sqrt())
    });
    let rank = 3 + random.below(4);
    std::array::from_fn(|i| std::array::from_fn(|j| (0..rank).map(|k| root[i][k] * root[j][k]).sum()))
}

/// Points, edges and patches around `distance` ahead.
fn any_shape(random: &mut Random, distance: f64, sigma: f64) -> FeatureShape {
    let at = distance * DVec3::new(1.0, random.uniform(-0.2, 0.2), random.uniform(-0.15, 0.15));
    let mut by = || DVec3::from_array([0; 3].map(|_| random.uniform(-0.1, 0.1))) * distance;
    let (along, across) = (by(), by());
    match random.below(4) {
        0 => FeatureShape::Point { at, covariance: isotropic(sigma) },
        1 => {
            let corners = [at - along, at - across, at + along, at + across].to_vec();
            FeatureShape::Patch { corners, covariance: isotropic(sigma) }
        }
        _ => segment(at - along, at + along, sigma),
    }
}

fn family(seed: u64, count: usize, distances: [f64; 2], relative: f64, heading_deg: f64, tight: f64) -> Vec<Case> {
    let mut random = Random(seed);
    let one = |i: usize| {
        let distance = distances[0] * (distances[1] / distances[0]).powf(random.uniform(0.0, 1.0));
        let position = relative * distance * random.uniform(0.2, 1.0);
        let angle = heading_deg.to_radians() * random.uniform(0.2, 1.0);
        let covariance = any_covariance(&mut random, position, angle);
        let sigma = 0.3 * position * random.uniform(0.0, 1.0);
        let shape = any_shape(&mut random, distance, sigma);
        let sensor = if i.is_multiple_of(2) { camera() } else { scanner() };
        Case {
            name: format!("family {seed}, {i}"),
            sensor,
            pose: Pose::IDENTITY,
            covariance,
            shape,
            tight: Some(tight),
        }
    };
    (0..count).map(one).collect()
}

/// Tilted sensors of every kind on a robot uncertain in x, y and heading, or in everything: as the heading changes,
/// horizontal features move up and down in the image, and back again.
fn leaning(seed: u64, count: usize) -> Vec<Case> {
    let mut random = Random(seed);
    let [fisheye, barrel] = lenses();
    let sensors = [camera(), scanner(), fisheye, barrel];
    let one = |i: usize| {
        let angle = |random: &mut Random, degrees: f64| random.uniform(-degrees, degrees).to_radians();
        let (roll, pitch) = (angle(&mut random, 15.0), angle(&mut random, 35.0));
        let place = DVec3::new(random.uniform(-5.0, 5.0), 2.0, 1.0);
        let pose = Pose::from_xyz_rpy(place, roll, pitch, angle(&mut random, 180.0));
        let distance = 0.7 * 12f64.powf(random.uniform(0.0, 1.0));
        let sigma = 0.02 * random.uniform(0.0, 1.0);
        let shape = match any_shape(&mut random, distance, sigma) {
            FeatureShape::Segment { ends, .. } => {
                let [a, b] = ends.map(|p| pose.transform_point(p));
                segment(a, b, sigma)
            }
            FeatureShape::Point { at, covariance } => FeatureShape::Point { at: pose.transform_point(at), covariance },
            FeatureShape::Patch { corners, covariance } => {
                FeatureShape::Patch { corners: corners.iter().map(|p| pose.transform_point(*p)).collect(), covariance }
            }
            other => other,
        };
        let heading = [2.0, 5.0, 10.0, 20.0][random.below(4)];
        let covariance = if random.below(3) > 0 {
            robot(random.uniform(0.0, 0.1), heading)
        } else {
            any_covariance(&mut random, 0.1, 0.6 * f64::to_radians(heading))
        };
        Case {
            name: format!("leaning {seed}, {i}, heading {heading}"),
            sensor: sensors[i % sensors.len()].clone(),
            pose,
            covariance,
            shape,
            tight: Some(2.0),
        }
    };
    (0..count).map(one).collect()
}

#[test]
fn tilted_sensors_have_their_coverage() {
    let seed = env_number("PRESIGHT_SEED", 3);
    assert_all(&leaning(seed, env_number("PRESIGHT_CASES", 24) as usize));
}

/// An edge that is highest in the image at zero error: a search outwards from there misses its largest extent.
#[test]
fn extents_that_turn_back_are_covered() {
    let pose = Pose::from_xyz_rpy(DVec3::ZERO, 0.0, 20f64.to_radians(), 0.0);
    let shape = segment(DVec3::new(4.0, 0.8, -1.5), DVec3::new(4.0, -0.8, -1.5), 0.01);
    let case = |heading: f64| Case {
        name: format!("level edge from a leaning camera, heading {heading}"),
        sensor: camera(),
        pose,
        covariance: robot(0.02, heading),
        shape: shape.clone(),
        tight: Some(2.0),
    };
    assert_all(&[case(5.0), case(10.0), case(20.0)]);
}

/// Range sigma up to 5 %, angles up to 2 degrees, away from border and seam.
#[test]
fn a_comfortable_family_is_tight() {
    assert_all(&family(1, 16, [2.0, 20.0], 0.05 / 3f64.sqrt(), 2.0, 1.15));
}

#[test]
fn a_harder_family_is_at_most_twice_the_best() {
    assert_all(&family(2, 12, [0.5, 5.0], 0.12, 6.0, 2.0));
}

/// Files may hold slightly indefinite covariances: the box is that of the nearest valid covariance.
#[test]
fn covariances_at_the_limit_of_acceptance_are_valid() {
    let (shape, mut wrong) = (point(6.0, -1.0, 0.5, isotropic(0.01)), diagonal([0.1, 0.05, 0.02, 0.0, 0.0, 0.02]));
    let put = |m: &mut Covariance, i: usize, j: usize, rho: f64| {
        m[i][j] = rho * (m[i][i] * m[j][j]).sqrt();
        m[j][i] = m[i][j];
    };
    for (i, j) in [(0, 1), (0, 2), (1, 2)] {
        put(&mut wrong, i, j, 1.0);
    }
    let sound = wrong;
    for off in [1e-5, -1e-5] {
        put(&mut wrong, 1, 2, 1.0 + off);
        // A remainder far smaller than the error next to it: a pivot that would blow up.
        wrong[2][2] = sound[2][2] * (1.0 + 1e-13);
        let cases = both("at the limit", wrong, shape.clone(), None);
        for (case, clean) in cases.iter().zip(&both("sound", sound, shape.clone(), None)) {
            assert_all(std::slice::from_ref(case));
            let size = |b: [f64; 4]| [b[2] - b[0], b[3] - b[1]];
            let (got, expected) = (size(case.found(0.99).0), size(clean.found(0.99).0));
            let same = (0..2).all(|k| (got[k] / expected[k] - 1.0).abs() < 0.01);
            assert!(same, "{}: {got:?} and {expected:?}", case.sensor.spec().name);
        }
    }
}

fn patch(corners: [DVec3; 4], sigma: f64) -> FeatureShape {
    FeatureShape::Patch { corners: corners.to_vec(), covariance: isotropic(sigma) }
}

/// The box of a feature in a world, from its visible part.
fn box_in(world: &World, case: &Case, confidence: f64) -> [f64; 4] {
    let (existence, properties) = (Existence::default(), Properties::default());
    let feature = Feature { id: 1, name: None, object: None, shape: case.shape.clone(), existence, properties };
    let placed = [PlacedFeature { feature: feature.into(), object: None, slots: Vec::new() }];
    let images = common::reference(&common::plan(world, &case.sensor, &case.pose));
    let options = FeatureSettings { regions: true, ..FeatureSettings::default() };
    let mut prediction = predict_features(world, &case.sensor, &case.pose, &images, &placed, &options).unwrap();
    let options =
        BoxOptions::default().with_sensor(PoseCovariance::from_rows(case.covariance)).with_confidence(confidence);
    add_boxes(
        &mut prediction,
        &BoxQuery { placed: &placed, world, sensor: &case.sensor, world_from_sensor: &case.pose, options: &options },
    )
    .unwrap();
    prediction.features[0].roi.expect("it is seen")
}

/// The pillar hides half of the wall, so the box is that of the other half.
#[test]
fn partly_hidden_patches_have_boxes_of_the_visible_part() {
    let mut environment = scenes::empty();
    let pillar = scenes::cuboid(Vec3::new(3.0, 0.5, -4.0), Vec3::new(3.2, 6.0, 4.0));
    environment.insert(NewObject::new("pillar", Pose::IDENTITY, Arc::new(pillar))).unwrap();
    let world = World::new(environment);
    let wall = |left: f64| [(-3.0, -1.0), (left, -1.0), (left, 1.0), (-3.0, 1.0)].map(|(y, z)| DVec3::new(5.0, y, z));
    for case in both("half a wall", robot(0.03, 1.0), patch(wall(3.0), 0.01), None) {
        let shape = patch(wall(5.0 * 0.5 / 3.0), 0.01);
        let half = Case { shape, ..case.clone() };
        let reaches = half.reaches(3, draws().min(200_000), true);
        for confidence in CONFIDENCES {
            let bounds = box_in(&world, &case, confidence);
            let fail = 1.0 - confidence;
            let missed = half.missed(&bounds, RoiFlag::Linear, &reaches);
            let most = 1.1 * fail + 3.0 * (fail * confidence / reaches.len() as f64).sqrt();
            assert!(missed <= most, "{}: missed {missed}", case.sensor.spec().name);
            let best = Best::new(&half.reaches(4, 100_000, false)).area(confidence);
            let ratio = (bounds[2] - bounds[0]) * (bounds[3] - bounds[1]) / best;
            assert!(ratio <= 1.15, "{}: {ratio} times the best", case.sensor.spec().name);
        }
    }
}

/// A strip of floor that begins behind the camera: those corners have no image, but the box reaches the lower border.
#[test]
fn patches_that_begin_behind_the_camera_reach_the_border() {
    let strip = [(-10.0, -1.0), (10.0, -1.0), (10.0, 1.0), (-10.0, 1.0)].map(|(x, y)| DVec3::new(x, y, -1.2));
    let [case, _] = both("a strip of floor", diagonal([1e-6; 6]), patch(strip, 0.0), None);
    let [x0, y0, x1, y1] = box_in(&World::new(scenes::empty()), &case, 0.99);
    // At the lower border, 240 pixels below the centre, it is 2.5 m away and 400 pixels wide; its end is 10 m away.
    assert!((y1 - 479.5).abs() < 1.0 && (y0 - 299.5).abs() < 2.0, "{y0} {y1}");
    assert!((x0 - 119.5).abs() < 3.0 && (x1 - 519.5).abs() < 3.0, "{x0} {x1}");
}

/// Planted faults: each side moved inwards by a fifth, and two axes of the covariance swapped.
#[test]
fn boxes_that_are_too_small_are_noticed() {
    let [case, _] = both("a post", robot(0.03, 1.0), post(5.0, 0.4, 0.01), None);
    let reaches = case.reaches(5, draws().min(200_000), true);
    let (good, flag) = case.found(0.99);
    assert!(case.missed(&good, flag, &reaches) < 0.0115);
    for side in 0..4 {
        let mut bad = good;
        bad[side] += (good[2 + side % 2] - good[side % 2]) * if side < 2 { 0.2 } else { -0.2 };
        let missed = case.missed(&bad, flag, &reaches);
        assert!(missed > 0.02, "side {side}: {missed}");
    }
    let mut swapped = case.clone();
    swapped.covariance.swap(4, 5);
    swapped.covariance.iter_mut().for_each(|row| row.swap(4, 5));
    let (bad, flag) = swapped.found(0.99);
    assert!(case.missed(&bad, flag, &reaches) > 0.02);
}
