//! Visibility of features against rays in space: parry3d-f64 sends one to each sample, which ends short of it by the
//! rounding bound.
//!
//! Samples at which the oracle's own answer changes within 1/16 pixel are left out, and their share is reported.
//! `PRESIGHT_SEED` spreads runs, `PRESIGHT_FEATURE_SCENES` names real scenes.

#![allow(clippy::print_stderr)] // What agrees is worth reading.

mod common;

use common::oracle::Oracle;
use common::{Random, data, env_number, scenes};
use glam::{DMat3, DVec2, DVec3};
use presight::environment::{Existence, Feature, FeatureShape, Properties};
use presight::features::{
    FeatureOptions, FeaturePrediction, Piece, PlacedFeature, Reason, Sampler, SeenFeature, Visibility, predict_features,
};
use presight::{Angles, Camera, Distortion, Environment, Geometry, Images, Pose, Scanner, Sensor, SensorSpec, World};

/// Hits nearer than this part of the range hide.
const SHORT: f64 = 1e-9;

/// Every edge of every polygon as a segment in its object's frame, on all polygons of the object that have both corners.
fn edges(environment: &Environment, most: usize, random: &mut Random) -> Vec<PlacedFeature> {
    let mut all = Vec::new();
    for (index, object) in environment.objects().iter().enumerate() {
        let mut of_edge: std::collections::BTreeMap<[[u64; 3]; 2], ([DVec3; 2], Vec<u32>)> = Default::default();
        for polygon in 0..object.mesh.polygon_count() as u32 {
            let corners: Vec<DVec3> =
                object.mesh.corners_of(polygon).map(|p| object.object_from_mesh.transform_point3(p)).collect();
            for k in 0..corners.len() {
                let ends = [corners[k], corners[(k + 1) % corners.len()]];
                let mut key = ends.map(|p| p.to_array().map(f64::to_bits));
                key.sort_unstable();
                of_edge.entry(key).or_insert((ends, Vec::new())).1.push(object.first_slot + polygon);
            }
        }
        all.extend(of_edge.into_values().map(|(ends, slots)| (Some(index as u32), ends, slots)));
    }
    while all.len() > most {
        all.swap_remove(random.below(all.len()));
    }
    let place = |(i, (object, ends, slots)): (usize, (Option<u32>, [DVec3; 2], Vec<u32>))| PlacedFeature {
        feature: Feature {
            id: i as u32 + 1,
            name: None,
            object: object.map(|o| environment.objects()[o as usize].name.clone()),
            shape: FeatureShape::Segment { ends, covariances: [DMat3::ZERO; 2], cross: DMat3::ZERO },
            existence: Existence::default(),
            properties: Properties::default(),
        },
        object,
        slots,
    };
    all.into_iter().enumerate().map(place).collect()
}

/// The same places as patches (the polygons) and points (their corners).
fn patches_and_points(environment: &Environment, random: &mut Random) -> Vec<PlacedFeature> {
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
            all.push(PlacedFeature { feature, object: None, slots: vec![slot] });
        }
    }
    all
}

fn predict(world: &World, sensor: &Sensor, pose: &Pose, placed: &[PlacedFeature]) -> (FeaturePrediction, Images) {
    let images = common::reference(&common::plan(world, sensor, pose));
    let options = FeatureOptions { feature_id: true, ..FeatureOptions::default() };
    (predict_features(world, sensor, pose, &images, placed, &options).unwrap(), images)
}

#[derive(Debug, Default)]
struct Agreement {
    samples: usize,
    excluded: usize,
    wrong: Vec<String>,
    features: usize,
    features_wrong: usize,
}

impl Agreement {
    fn add(&mut self, other: Self) {
        self.samples += other.samples;
        self.excluded += other.excluded;
        self.wrong.extend(other.wrong);
        self.features += other.features;
        self.features_wrong += other.features_wrong;
    }

    fn excluded_share(&self) -> f64 {
        self.excluded as f64 / self.samples.max(1) as f64
    }

    fn wrong_share(&self) -> f64 {
        self.wrong.len() as f64 / self.samples.max(1) as f64
    }
}

/// What the prediction says of a place on a segment: seen, or why not.
fn predicted(seen: &SeenFeature, t: f64) -> Option<Result<(), Reason>> {
    let holds = |[a, b]: [f64; 2]| a <= t && t <= b;
    let visible = seen.visible.iter().any(|v| holds(v.t));
    let hidden = seen.hidden.iter().find(|h| holds(h.t));
    match (visible, hidden) {
        (true, None) => Some(Ok(())),
        (false, Some(h)) => Some(Err(h.reason)),
        _ => None,
    }
}

/// Holds every segment sample to the oracle.
fn check(
    world: &World,
    oracle: &Oracle,
    sensor: &Sensor,
    pose: &Pose,
    placed: &[PlacedFeature],
    prediction: &FeaturePrediction,
) -> Agreement {
    let sampler = Sampler::new(sensor);
    let world_from_image = pose.rotation_matrix() * sensor.body_from_image();
    let image_from_world = world_from_image.transpose();
    let mut sum = Agreement::default();
    assert_eq!(placed.len(), prediction.features.len());
    for (placed, seen) in placed.iter().zip(&prediction.features) {
        let [a, b] = [0, 1].map(|i| image_from_world * (seen.points_world[i] - pose.translation));
        let hides = |direction: DVec3, range: f64| {
            oracle.hides(pose.translation, world_from_image * direction, range * (1.0 - SHORT), &placed.slots)
        };
        let mut wrong = 0;
        let mut one = |piece: Piece| {
            let Piece::Inside(sample) = piece else { return };
            let range = sample.at.length();
            let spec = sensor.spec();
            if range < spec.range_min || range > spec.range_max {
                return;
            }
            sum.samples += 1;
            let truth = hides(sample.at / range, range);
            let around = (0..8).map(|k| DVec2::from_angle(f64::from(k) * std::f64::consts::FRAC_PI_4) / 16.0);
            let changes = around
                .filter_map(|by| sensor.ray_at(sample.pixel.x + by.x, sample.pixel.y + by.y))
                .any(|ray| hides(ray, range) != truth);
            if changes {
                sum.excluded += 1;
                return;
            }
            let t = 0.5 * (sample.t[0] + sample.t[1]);
            let said = predicted(seen, t);
            let right = if truth { said == Some(Err(Reason::Occluded)) } else { said == Some(Ok(())) };
            if !right {
                wrong += 1;
                sum.wrong.push(format!("{} at {t}, {}: {said:?}, hidden {truth}", seen.feature.id, sample.pixel));
            }
        };
        sampler.segment(a, b, &mut one);
        sum.features += 1;
        sum.features_wrong += usize::from(wrong > 0);
    }
    let _ = world;
    sum
}

fn sensors() -> Vec<Sensor> {
    let lens = |distortion| {
        let camera = Camera { distortion, ..Camera::pinhole(160, 120, 110.0, 112.0, 78.0, 61.0) };
        Sensor::new(SensorSpec::new("lens", "video", Geometry::Camera(camera))).unwrap()
    };
    let row = |height: f64, elevation: f64| {
        let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 0.5, count: 720 };
        let elevation = Angles::Uniform { start_deg: elevation, step_deg: 0.0, count: 1 };
        let scanner = Scanner { azimuth, elevation, beam_height_deg: Some(height) };
        Sensor::new(SensorSpec::new("row", "laser", Geometry::Scanner(scanner))).unwrap()
    };
    vec![
        scenes::camera(200, 150),
        lens(Distortion::PlumbBob([-0.28, 0.07, 1e-3, -5e-4, 0.0])),
        lens(Distortion::Equidistant([0.02, -0.01, 0.0, 0.0])),
        scenes::scanner(360, 91),
        scenes::fan(),
        row(0.0, 0.0),
        row(4.0, 0.0),
        row(0.0, 20.0),
    ]
}

#[test]
fn rooms_agree_with_rays_in_space() {
    let mut random = Random(env_number("PRESIGHT_SEED", 1));
    let mut totals: std::collections::BTreeMap<String, Agreement> = Default::default();
    for scene in 0..4 {
        let world = scenes::room_world(random.bits(), [3, 15, 40, 80][scene]);
        let placed = edges(world.environment(), 150, &mut random);
        for _ in 0..2 {
            let at = DVec3::new(random.uniform(-0.6, 0.6), random.uniform(-0.6, 0.6), random.uniform(0.8, 1.8));
            let pose = Pose::from_xyz_rpy(at, 0.1, random.uniform(-0.2, 0.2), random.uniform(-3.0, 3.0));
            let oracle = Oracle::new(world.environment(), at).unwrap();
            for (i, sensor) in sensors().iter().enumerate() {
                let (prediction, _) = predict(&world, sensor, &pose, &placed);
                let found = check(&world, &oracle, sensor, &pose, &placed, &prediction);
                assert_eq!(prediction.stats.undecided, 0);
                totals.entry(format!("{i} {}", sensor.spec().name)).or_default().add(found);
            }
        }
    }
    for (name, sum) in totals {
        eprintln!(
            "{name}: {} samples of {} features, {:.2} % left out, {} wrong ({:.4} %), {} features",
            sum.samples,
            sum.features,
            100.0 * sum.excluded_share(),
            sum.wrong.len(),
            100.0 * sum.wrong_share(),
            sum.features_wrong,
        );
        assert!(sum.samples > 200 && sum.excluded_share() < 0.05, "{name}");
        assert!(sum.wrong.is_empty(), "{name}: {:#?}", &sum.wrong[..sum.wrong.len().min(10)]);
    }
}
