//! Coverage by condition, counted over the whole visible feature: 200 features for each condition, 20,000 draws each,
//! by `cargo test --release --test features coverage_by_condition_in_full -- --ignored --nocapture`;
//! `coverage_by_condition` takes a tenth of the features.

use super::common::{Random, env_number, scenes};
use super::draws::{Best, Case, Normal, Reach, cholesky, ends_covariance};
use super::{
    CONFIDENCES, Covariance, any_covariance, any_shape, camera, diagonal, isotropic, lenses, robot, scanner, segment,
};
use glam::{DMat3, DQuat, DVec3, Vec3};
use presight_features::roi::RoiFlag;
use presight_features::{BoxOptions, BoxQuery, FeatureSettings, PlacedFeature, add_boxes, predict_features};
use presight_model::environment::NewObject;
use presight_model::environment::{Existence, Feature, FeatureShape, Properties};
use presight_model::geometry::{Pose, PoseCovariance};
use presight_model::sensor::{Angles, Geometry, Scanner, Sensor, SensorSpec};
use presight_model::world::World;
use presight_render::plan::{Images, Output, Outputs};
use rayon::prelude::*;
use std::sync::Arc;

const CONDITIONS: [&str; 21] = [
    "comfortable",
    "near",
    "large heading",
    "seam",
    "pole 2 deg",
    "pole 8 deg",
    "pole 20 deg",
    "fisheye",
    "plumb-bob",
    "one row",
    "one row, 1 deg high",
    "slivers",
    "slivers, one row, 1 deg high",
    "partly outside, camera",
    "partly outside, scanner",
    "singular",
    "zero",
    "stiff",
    "moved object",
    "robot pose",
    "turned sensor",
];

/// The largest area relative to the best box.
const MOST_AREA: f64 = 1.5;

/// A feature on an object in front of a sensor on a robot. The case's pose and covariance are the robot's; its shape is
/// in the object's frame.
struct Trial {
    case: Case,
    mount: Pose,
    object: Pose,
    object_covariance: Covariance,
}

/// A box, and its method.
type Found = ([f64; 4], RoiFlag);

/// One level row, full circle.
fn row(beam_height_deg: Option<f64>) -> Sensor {
    let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 0.5, count: 720 };
    let scanner = Scanner { azimuth, elevation: Angles::Listed(vec![0.0]), beam_height_deg };
    Sensor::new(SensorSpec::new("row", "laser", Geometry::Scanner(scanner))).unwrap()
}

fn turned(angle: f64, p: DVec3) -> DVec3 {
    DQuat::from_rotation_z(angle) * p
}

fn moved(shape: &FeatureShape, to: impl Fn(DVec3) -> DVec3) -> FeatureShape {
    match shape.clone() {
        FeatureShape::Point { at, covariance } => FeatureShape::Point { at: to(at), covariance },
        FeatureShape::Patch { corners, covariance } => {
            FeatureShape::Patch { corners: corners.into_iter().map(to).collect(), covariance }
        }
        FeatureShape::Segment { ends, covariances, cross } => {
            FeatureShape::Segment { ends: ends.map(to), covariances, cross }
        }
        other => other,
    }
}

impl Trial {
    fn of(condition: &str, number: usize) -> Self {
        let of_condition = condition.bytes().fold(7u64, |h, b| h.wrapping_mul(31).wrapping_add(u64::from(b)));
        let mut random = Random(of_condition.wrapping_add((number as u64) << 32));
        let distance = 2.0 * 8f64.powf(random.uniform(0.0, 1.0));
        let sigma = 0.01 * random.uniform(0.1, 2.0);
        let mut trial = Self {
            case: Case {
                name: format!("{condition} {number}"),
                sensor: if number.is_multiple_of(2) { camera() } else { scanner() },
                pose: Pose::IDENTITY,
                covariance: any_covariance(&mut random, 0.01 * distance, 1f64.to_radians()),
                shape: any_shape(&mut random, distance, sigma),
                tight: None,
            },
            mount: Pose::IDENTITY,
            object: Pose::IDENTITY,
            object_covariance: diagonal([0.0; 6]),
        };
        let case = &mut trial.case;
        match condition {
            "near" => {
                let near = random.uniform(0.4, 1.2);
                case.shape = any_shape(&mut random, near, sigma);
                case.covariance = any_covariance(&mut random, 0.04, 2f64.to_radians());
            }
            "large heading" => case.covariance = robot(0.05, [5.0, 10.0, 20.0][number % 3]),
            "seam" => {
                case.sensor = scanner();
                let turn = std::f64::consts::PI + random.uniform(-0.1, 0.1);
                case.shape = moved(&case.shape, |p| turned(turn, p));
            }
            "fisheye" => case.sensor = lenses()[0].clone(),
            "plumb-bob" => case.sensor = lenses()[1].clone(),
            "one row" | "one row, 1 deg high" => {
                case.sensor = row((condition != "one row").then_some(1.0));
                // Across the row: upright or slanting features.
                let by = 0.3 * distance;
                let (y, lean) = (random.uniform(-0.5, 0.5) * distance, random.uniform(-0.2, 0.2) * distance);
                let at = |y: f64, z: f64| DVec3::new(distance, y, z);
                case.shape = match number % 2 {
                    0 => segment(at(y - lean, -by), at(y + lean, by), sigma),
                    _ => {
                        let corners = [at(y - by, -by), at(y + by, -by), at(y + by + lean, by), at(y - by + lean, by)];
                        FeatureShape::Patch { corners: corners.to_vec(), covariance: isotropic(sigma) }
                    }
                };
                case.covariance = robot(0.01 * distance, 2.0);
            }
            "slivers" => case.shape = sliver(&mut random, distance, 0.1 * distance, sigma),
            "slivers, one row, 1 deg high" => {
                case.sensor = row(Some(1.0));
                case.shape = sliver(&mut random, distance, 0.02 * distance, sigma);
                case.covariance = robot(0.01 * distance, 2.0);
            }
            "partly outside, camera" | "partly outside, scanner" => {
                let is_camera = condition.ends_with("camera");
                let angle = if is_camera { random.uniform(0.45, 0.65) } else { random.uniform(0.0, 0.3) };
                case.shape = moved(&case.shape, |p| turned(angle, p));
                if !is_camera {
                    // A sector whose border the feature may pass.
                    let azimuth = Angles::Uniform { start_deg: -90.0, step_deg: 0.5, count: 200 };
                    let elevation = Angles::Uniform { start_deg: -20.0, step_deg: 1.0, count: 41 };
                    let scanner = Scanner { azimuth, elevation, beam_height_deg: None };
                    case.sensor = Sensor::new(SensorSpec::new("sector", "laser", Geometry::Scanner(scanner))).unwrap();
                } else {
                    case.sensor = camera();
                }
            }
            "singular" => case.covariance = robot(0.03, 0.0),
            "zero" => {
                case.covariance = diagonal([0.0; 6]);
                case.shape = without_own(&case.shape);
            }
            "stiff" => case.covariance = diagonal([1e-7, 0.1, 1e-7, 1e-7, 1e-7, 1e-7]),
            "moved object" => {
                let object =
                    Pose::from_xyz_rpy(DVec3::new(0.8 * distance, 0.3, -0.2), 0.2, -0.3, random.uniform(-3.0, 3.0));
                case.shape = moved(&case.shape, |p| object.inverse().transform_point(p));
                trial.object_covariance = any_covariance(&mut random, 0.02, 2f64.to_radians());
                trial.object = object;
            }
            "robot pose" | "turned sensor" => {
                let lean = if condition == "turned sensor" { 0.4 } else { 0.0 };
                trial.mount = Pose::from_xyz_rpy(DVec3::new(0.6, -0.3, 0.9), 0.1 * lean, lean, 0.5);
                case.pose = Pose::from_xyz_rpy(DVec3::new(3.0, -2.0, 0.1), 0.0, 0.0, random.uniform(-3.0, 3.0));
                let sensor = case.pose * trial.mount;
                case.shape = moved(&case.shape, |p| sensor.transform_point(p));
                case.covariance = robot(0.03, 3.0);
            }
            _ => {}
        }
        if let Some(degrees) = condition.strip_prefix("pole ").and_then(|rest| rest.split(' ').next()) {
            let off = 3.0 * degrees.parse::<f64>().unwrap().to_radians().tan();
            let z = |random: &mut Random| 3.0 * random.uniform(0.8, 1.2);
            let ends = [DVec3::new(off, -0.4, z(&mut random)), DVec3::new(off, 0.5, z(&mut random))];
            let turn = random.uniform(-3.0, 3.0);
            case.sensor = scanner();
            case.shape = segment(turned(turn, ends[0]), turned(turn, ends[1]), sigma);
            case.covariance = diagonal([0.05, 0.05, 0.02, 0.02, 0.02, 5f64.to_radians()]);
        }
        trial
    }

    fn world(&self) -> World {
        // The object's surface is far below.
        let mesh = scenes::cuboid(Vec3::new(0.0, 0.0, -1e4), Vec3::new(1.0, 1.0, 1.0 - 1e4));
        let mut environment = scenes::empty();
        environment.insert(NewObject::new("object", self.object, Arc::new(mesh))).unwrap();
        World::new(environment)
    }

    /// Boxes at all confidences; `None` if the feature is not visible.
    fn boxes(&self) -> Option<Vec<Found>> {
        let (existence, properties) = (Existence::default(), Properties::default());
        let feature =
            Feature { id: 1, name: None, object: None, shape: self.case.shape.clone(), existence, properties };
        let placed = [PlacedFeature { feature: feature.into(), object: Some(0), slots: Vec::new() }];
        let (world, sensor, pose) = (self.world(), &self.case.sensor, self.case.pose * self.mount);
        // The object's surface is far behind the feature: an empty image.
        let mut images = Images::default();
        images.prepare(sensor.width(), sensor.height(), Outputs::of(&[Output::PolygonId]));
        images.polygon_id.fill(0);
        let settings = FeatureSettings { regions: true, ..FeatureSettings::default() };
        let prediction = predict_features(&world, sensor, &pose, &images, &placed, &settings).unwrap();
        if prediction.features[0].visible.is_empty() {
            return None;
        }
        let lever = self.case.pose.rotation * self.mount.translation;
        let options = BoxOptions::default()
            .with_sensor(PoseCovariance::from_rows(self.case.covariance).moved_by(lever))
            .with_objects(vec![(0, PoseCovariance::from_rows(self.object_covariance))]);
        let found = CONFIDENCES.map(|confidence| {
            let mut prediction = prediction.clone();
            let options = options.clone().with_confidence(confidence);
            let query =
                BoxQuery { placed: &placed, world: &world, sensor, world_from_sensor: &pose, options: &options };
            add_boxes(&mut prediction, &query).unwrap();
            (prediction.features[0].roi.unwrap(), prediction.features[0].roi_flag.unwrap())
        });
        Some(found.to_vec())
    }

    /// The part visible without errors, as points of the object's frame with the weights of both ends' errors.
    fn seen(&self) -> Vec<(DVec3, [f64; 2])> {
        let image = self.image_from_object(&self.case.pose, &Pose::IDENTITY);
        let sensor = &self.case.sensor;
        let (w, h) = (f64::from(sensor.width()) - 0.5, f64::from(sensor.height()) - 0.5);
        let is_row = sensor.height() == 1;
        let tan = |p: DVec3| p.z.abs() / p.x.hypot(p.y);
        let beam = if self.case.name.contains("deg high") { 0.5f64.to_radians().tan() } else { 1e-9 };
        let inside = |p: &DVec3| {
            let at = image(*p);
            let Some((u, v)) = sensor.project(at) else { return false };
            (sensor.columns_of_a_turn().is_some() || (-0.5..=w).contains(&u))
                && if is_row { tan(at) <= beam } else { (-0.5..=h).contains(&v) }
        };
        let mut all: Vec<(DVec3, [f64; 2])> = Vec::new();
        let line = |a: DVec3, b: DVec3, parts: u32| {
            let share = move |i: u32| f64::from(i) / f64::from(parts);
            (0..=parts).map(move |i| (a.lerp(b, share(i)), share(i)))
        };
        match &self.case.shape {
            FeatureShape::Segment { ends: [a, b], .. } => {
                let shares = |(p, t): (DVec3, f64)| (p, [1.0 - t, t]);
                all.extend(line(*a, *b, 16).map(shares));
                all.extend(borders(*a, *b, &inside).into_iter().map(|t| shares((a.lerp(*b, t), t))));
                if is_row {
                    all.extend(level(&image, *a, *b).map(|t| shares((a.lerp(*b, t), t))));
                }
            }
            other => {
                let corners = other.points();
                let n = corners.len();
                let sides = || (0..n).map(|k| (corners[k], corners[(k + 1) % n]));
                for (a, b) in sides().filter(|_| n > 1) {
                    all.extend(line(a, b, 6).map(|(p, _)| (p, [1.0, 0.0])));
                    all.extend(borders(a, b, &inside).into_iter().map(|t| (a.lerp(b, t), [1.0, 0.0])));
                }
                all.extend((n == 1).then(|| (corners[0], [1.0, 0.0])));
                let middle = corners.iter().sum::<DVec3>() / n as f64;
                for (a, _) in sides() {
                    all.extend(line(middle, a, 4).map(|(p, _)| (p, [1.0, 0.0])));
                }
                let cut: Vec<DVec3> = sides().filter_map(|(a, b)| Some(a.lerp(b, level(&image, a, b)?))).collect();
                if let (true, [a, b]) = (is_row, &cut[..]) {
                    all.extend(line(*a, *b, 8).map(|(p, _)| (p, [1.0, 0.0])));
                }
            }
        }
        all.retain(|(p, _)| inside(p));
        all
    }

    fn image_from_object(&self, robot: &Pose, object: &Pose) -> impl Fn(DVec3) -> DVec3 + use<> {
        let sensor = *robot * self.mount;
        let from = sensor.inverse() * self.object * *object;
        let image_from_body = self.case.sensor.body_from_image().transpose();
        move |p| image_from_body * from.transform_point(p)
    }

    /// The extent in each draw; points outside the image do not count.
    fn reaches(&self, draws: usize) -> Vec<Reach> {
        let (case, points) = (&self.case, self.seen());
        let roots = [&case.covariance, &self.object_covariance, &ends_covariance(&case.shape)].map(cholesky);
        let mut normal = Normal::new(0xd0a1 + case.name.len() as u64);
        let turn = case.sensor.columns_of_a_turn();
        let (w, h) = (f64::from(case.sensor.width()) - 0.5, f64::from(case.sensor.height()) - 0.5);
        let nominal = self.image_from_object(&case.pose, &Pose::IDENTITY);
        let near = points.first().and_then(|(p, _)| case.sensor.project(nominal(*p))).map_or(0.0, |(u, _)| u);
        let pose = |[shift, angle]: [DVec3; 2], of: &Pose| Pose {
            translation: of.translation + shift,
            rotation: DQuat::from_scaled_axis(angle) * of.rotation,
        };
        let one = |normal: &mut Normal| {
            let robot = pose(normal.pair(&roots[0]), &case.pose);
            let image = self.image_from_object(&robot, &pose(normal.pair(&roots[1]), &Pose::IDENTITY));
            let ends = normal.pair(&roots[2]);
            let mut reach = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
            // The whole feature lies within half a turn, wherever that is.
            let mut near = near;
            for (p, shares) in &points {
                let Some((mut u, v)) = case.sensor.project(image(*p + ends[0] * shares[0] + ends[1] * shares[1]))
                else {
                    continue;
                };
                // A row is checked only along itself: above or below it is another part of the feature.
                let within = case.sensor.height() == 1 || (-0.5..=h).contains(&v);
                if !(within && (turn.is_some() || (-0.5..=w).contains(&u))) {
                    continue;
                }
                let v = if case.sensor.height() == 1 { 0.0 } else { v };
                u -= turn.map_or(0.0, |turn| turn * ((u - near) / turn).round());
                near = u;
                reach = [reach[0].min(u), reach[1].min(v), reach[2].max(u), reach[3].max(v)];
            }
            Some(reach)
        };
        (0..draws).map(|_| one(&mut normal)).collect()
    }
}

fn without_own(shape: &FeatureShape) -> FeatureShape {
    match shape.clone() {
        FeatureShape::Point { at, .. } => FeatureShape::Point { at, covariance: DMat3::ZERO },
        FeatureShape::Patch { corners, .. } => FeatureShape::Patch { corners, covariance: DMat3::ZERO },
        FeatureShape::Segment { ends: [a, b], .. } => segment(a, b, 0.0),
        other => other,
    }
}

/// A nearly upright patch that may fall between pixel centres: 0.01 to 0.5 columns of the scanner wide.
fn sliver(random: &mut Random, distance: f64, half: f64, sigma: f64) -> FeatureShape {
    let at = distance * DVec3::new(1.0, random.uniform(-0.2, 0.2), 0.0);
    let along = half * DVec3::new(random.uniform(-0.2, 0.2), random.uniform(-0.3, 0.3), 1.0);
    let across = 0.5f64.to_radians() * distance * 0.01 * 50f64.powf(random.uniform(0.0, 1.0)) * DVec3::Y;
    let corners = [at - along, at - along + across, at + along + across, at + along].to_vec();
    FeatureShape::Patch { corners, covariance: isotropic(sigma) }
}

/// The point where a line crosses the sensor's height.
fn level(image: &impl Fn(DVec3) -> DVec3, a: DVec3, b: DVec3) -> Option<f64> {
    let [z, y] = [image(a).z, image(b).z];
    ((z > 0.0) != (y > 0.0)).then(|| z / (z - y))
}

/// The points where a line crosses the border of the visible region, just inside.
fn borders(a: DVec3, b: DVec3, inside: &impl Fn(&DVec3) -> bool) -> Vec<f64> {
    const PARTS: u32 = 16;
    let at = |t: f64| inside(&a.lerp(b, t));
    let step = |i: u32| (f64::from(i) / f64::from(PARTS), f64::from(i + 1) / f64::from(PARTS));
    let passes = (0..PARTS).map(step).filter(|(from, to)| at(*from) != at(*to));
    passes
        .map(|(from, to)| {
            let (mut seen, mut beyond) = if at(from) { (from, to) } else { (to, from) };
            for _ in 0..30 {
                let middle = 0.5 * (seen + beyond);
                if at(middle) { seen = middle } else { beyond = middle }
            }
            seen
        })
        .collect()
}

/// The result of one condition.
#[derive(Default)]
struct Outcome {
    regions: usize,
    /// The counts below confidence by three and six standard deviations, for each confidence.
    below: [[usize; 2]; 3],
    worst: [f64; 3],
    /// Areas relative to the best box at 0.99.
    areas: Vec<f64>,
    loosest: String,
}

fn outcome(condition: &str, features: usize, draws: usize) -> Outcome {
    let mut outcome = Outcome { worst: [f64::INFINITY; 3], ..Outcome::default() };
    let found: Vec<(Trial, Vec<Found>)> = (0..4 * features)
        .filter_map(|number| {
            let trial = Trial::of(condition, number);
            let boxes = trial.boxes()?;
            (!trial.seen().is_empty()).then_some((trial, boxes))
        })
        .take(features)
        .collect();
    let judged: Vec<_> = found
        .into_par_iter()
        .map(|(trial, boxes)| {
            let reaches = trial.reaches(draws);
            let held: Vec<f64> =
                boxes.iter().map(|(bounds, flag)| 1.0 - trial.case.missed(bounds, *flag, &reaches)).collect();
            let known: Vec<Reach> = reaches.iter().map(|r| r.filter(|r| r[0] <= r[2])).collect();
            let b = boxes[1].0;
            let size = trial.case.sensor.width() as f64 - 0.5;
            let height = trial.case.sensor.height() as f64 - 0.5;
            let all_round = trial.case.sensor.columns_of_a_turn().is_some();
            let cut = height > 1.0 && (b[1] <= -0.5 || b[3] >= height) || !all_round && (b[0] <= -0.5 || b[2] >= size);
            let area = (!cut && boxes[1].1 != RoiFlag::WholeImage && known.iter().any(Option::is_some))
                .then(|| (b[2] - b[0]) * (b[3] - b[1]).max(1.0) / Best::new(&known).area(0.99));
            (trial.case.name.clone(), trial.case.shape.kind(), held, area)
        })
        .collect();
    for (name, kind, held, area) in judged {
        outcome.regions += 1;
        for (k, confidence) in CONFIDENCES.iter().enumerate() {
            let sd = (confidence * (1.0 - confidence) / draws as f64).sqrt();
            let off = (held[k] - confidence) / sd;
            outcome.below[k][0] += usize::from(off < -3.0);
            outcome.below[k][1] += usize::from(off < -6.0);
            if held[k] < outcome.worst[k] {
                outcome.worst[k] = held[k];
                if off < -3.0 {
                    println!("    {name}, {kind}: {:.5} of {confidence}", held[k]);
                }
            }
        }
        if let Some(area) = area {
            if outcome.areas.iter().all(|a| *a < area) {
                outcome.loosest = format!("{name}, {kind}");
            }
            outcome.areas.push(area);
        }
    }
    outcome.areas.sort_by(f64::total_cmp);
    outcome
}

fn check(features: usize, draws: usize) {
    let only = std::env::var("PRESIGHT_CONDITION").ok();
    let mut wrong = Vec::new();
    println!(
        "condition, regions, worst coverage at 0.9, 0.99, 0.999, below by 3 sd, by 6 sd; area relative to the best box at 0.99: median, largest"
    );
    for condition in CONDITIONS.iter().filter(|c| only.as_ref().is_none_or(|only| c.contains(only.as_str()))) {
        let o = outcome(condition, features, draws);
        let [median, largest] =
            [o.areas.len() / 2, o.areas.len().saturating_sub(1)].map(|i| o.areas.get(i).copied().unwrap_or(f64::NAN));
        let sums = [0, 1].map(|k| o.below.iter().map(|b| b[k]).sum::<usize>());
        println!(
            "{condition}, {}, {:.5}, {:.5}, {:.5}, {}, {}; {median:.2}, {largest:.2} ({})",
            o.regions, o.worst[0], o.worst[1], o.worst[2], sums[0], sums[1], o.loosest
        );
        // For exact coverage one region in 740 is below by three standard deviations.
        let is_loose = largest > MOST_AREA;
        if sums[0] as f64 > (0.002 * (3 * o.regions) as f64).max(1.0)
            || sums[1] > 0
            || o.regions < features / 2
            || is_loose
        {
            wrong.push(*condition);
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

#[test]
fn coverage_by_condition() {
    check(20, env_number("PRESIGHT_DRAWS", 20_000) as usize);
}

#[test]
#[ignore = "a study of minutes"]
fn coverage_by_condition_in_full() {
    check(env_number("PRESIGHT_FEATURES", 200) as usize, env_number("PRESIGHT_DRAWS", 20_000) as usize);
}
