//! Grey images and ranges together: poses by edges in simulated grey images (light at the camera, blur, noise), by a
//! range camera with 1 cm of noise, and by both.

use super::*;
use presight_features::PlacedFeatures;
use presight_features::generate::{GenerateOptions, generate};
use presight_localize::estimate::{Estimate, EstimateState, nees};
use presight_localize::extract::FeatureClass;
use presight_localize::localize::Phase;
use presight_model::error::ErrorKind;
use presight_model::geometry::{PoseEstimate, RobotPose};
use presight_model::measured::GreyImage;
use presight_model::placement::place_layer;

/// 240 x 180 pixels, 65 degrees wide, 10 cm from the range camera.
fn video() -> Sensor {
    let camera = Camera::pinhole(240, 180, 188.0, 188.0, 119.5, 89.5);
    let mut spec = SensorSpec::new("camera", "video", Geometry::Camera(camera));
    spec.mount = Pose::from_xyz_rpy(DVec3::new(0.0, 0.1, 0.05), 0.0, 0.05, 0.0);
    Sensor::new(spec).unwrap()
}

fn place() -> Pose {
    Pose::from_xyz_rpy(DVec3::new(0.7, 2.2, 1.4), 0.0, 0.25, 0.05)
}

fn edges(world: &World) -> PlacedFeatures {
    let layer = generate(world.environment(), "video", &GenerateOptions::default()).unwrap().layer;
    place_layer(world, &layer).unwrap()
}

fn estimate(world: &World, features: &PlacedFeatures, frames: &[&Frame], prior: &PoseEstimate) -> Estimate {
    estimator(EstimateOptions::default()).with_features(features.clone()).estimate(world, frames, prior).unwrap()
}

/// For each sensor alone and for both: the RMS errors in metres and degrees, and the largest NEES per dimension.
fn errors(map: &World, real: &World) -> [(f64, f64, f64); 3] {
    let features = edges(map);
    let mut random = Random(7);
    let mut all = [(0.0, 0.0, 0.0f64); 3];
    let draws = presight_testkit::env_number("PRESIGHT_FUSED_DRAWS", 4);
    for seed in 0..draws {
        let truth = off_by(&place(), 0.2, 4.0, &mut random);
        let believed = off_by(&truth, 0.03, 0.6, &mut random);
        let prior = PoseEstimate::of_sigmas(RobotPose::new(believed), 0.03, 0.01);
        let (grey, ranges) = (grey(&video(), real, &truth, 0.0, seed), sense(real, &camera(0.01), &truth, &mut random));
        for (frames, sums) in [vec![&ranges], vec![&grey], vec![&ranges, &grey]].into_iter().zip(&mut all) {
            let found = estimate(map, &features, &frames, &prior);
            assert!(found.is_determined(), "{:?}", found.state);
            let (m, d) = apart(&found.pose.world_from_robot, &truth);
            let (squared, numbers) = nees(&found.pose, &RobotPose::new(truth));
            *sums = (sums.0 + m * m, sums.1 + d * d, sums.2.max(squared / numbers as f64));
        }
    }
    let mean = |sum: f64| (sum / draws as f64).sqrt();
    all.map(|(m, d, worst)| (mean(m), mean(d), worst))
}

/// Edges alone are accurate to a centimetre. With ranges the pose is no worse than with the better sensor alone, and
/// the covariances are consistent.
#[test]
fn together_no_worse_than_the_best() {
    let world = room(Vec3::ZERO);
    let [ranges, grey, both] = errors(&world, &world);
    eprintln!("(m, deg, worst NEES/6): ranges {ranges:?}, grey {grey:?}, both {both:?}");
    assert!(grey.0 < 0.012 && grey.1 < 0.25, "{grey:?}");
    assert!(both.0 <= 1.1 * ranges.0.min(grey.0) && both.1 <= 1.1 * ranges.1.min(grey.1), "{both:?}");
    assert!(ranges.2 < 6.0 && grey.2 < 6.0 && both.2 < 6.0);
}

/// Unchanged objects of the room are matched. Rays show that the table is missing, and that an unknown object hides the
/// shelf's edges, which a screen covers.
#[test]
fn features_are_classed_by_ranges() {
    let map = room(Vec3::ZERO);
    let features = edges(&map);
    let mut environment = Environment::clone(map.environment());
    environment.delete("table").unwrap();
    add_box(&mut environment, "screen", Vec3::new(4.0, 3.0, 0.0), Vec3::new(4.05, 4.0, 2.2));
    let real = World::new(environment);
    let frames = [sense(&real, &camera(0.01), &place(), &mut Random(3)), grey(&video(), &real, &place(), 0.0, 3)];
    let prior = PoseEstimate::of_sigmas(RobotPose::new(place()), 0.01, 0.005);
    let options = EstimateOptions::default().with_least_explained(0.4);
    let mut estimator = estimator(options).with_features(features);
    let found = estimator.estimate(&map, &[&frames[0], &frames[1]], &prior).unwrap();
    let findings = &found.findings[0];
    // Grouped by the model's positions: on the table, or on the shelf behind the screen.
    let of = |inside: fn(DVec3) -> bool| -> Vec<FeatureClass> {
        let on = findings.features.iter().filter(|f| f.points_world.iter().all(|p| inside(*p)));
        on.map(|f| f.class).collect()
    };
    let table = of(|p| (1.99..3.21).contains(&p.x) && (0.79..1.61).contains(&p.y) && p.z > 0.1);
    let count = |all: &[FeatureClass], class: FeatureClass| all.iter().filter(|c| **c == class).count();
    assert!(table.len() >= 3 && 2 * count(&table, FeatureClass::Missing) > table.len(), "{table:?}");
    assert_eq!(count(&table, FeatureClass::Occluded), 0, "{table:?}");
    let shelf = of(|p| p.x > 4.55 && p.y > 3.35 && p.z < 1.95);
    assert!(!shelf.is_empty() && 2 * count(&shelf, FeatureClass::Occluded) > shelf.len(), "{shelf:?}");
    assert_eq!(count(&shelf, FeatureClass::Missing), 0, "{shelf:?}");
    assert!(findings.count("matched") >= 8, "{:?}", findings.features);
    // No prediction covers the screen's own edges.
    assert!(!findings.only_found.is_empty());
    // Without ranges the reason is unknown.
    let alone = estimator.estimate(&map, &[&frames[1]], &prior).unwrap();
    assert_eq!(alone.findings[0].count("missing") + alone.findings[0].count("occluded"), 0);
    assert!(alone.findings[0].count("undecidable") > 0);
}

/// A drive by grey images alone, then with ranges.
#[test]
fn drives_are_tracked_by_grey_images() {
    let world = room(Vec3::ZERO);
    let features = edges(&world);
    for with_ranges in [false, true] {
        for (k, (truth, step)) in drive(&video(), &world, &features, &place(), with_ranges).iter().enumerate() {
            let (m, d) = apart(&step.pose.world_from_robot, truth);
            assert!(m < 0.02 && d < 0.4, "{k}: {m} m, {d} deg; {}", step.reason);
            assert_eq!(step.phase, Phase::Tracking, "{k}: {}", step.reason);
        }
    }
}

#[test]
fn images_without_content_determine_nothing() {
    let world = room(Vec3::ZERO);
    let features = edges(&world);
    let prior = PoseEstimate::of_sigmas(RobotPose::new(place()), 0.03, 0.01);
    let frame = |value: f32| {
        let image = GreyImage::new(240, 180, vec![value; 240 * 180]).unwrap();
        Frame::new(0.0, video(), Measurement::Grey(image)).unwrap()
    };
    for value in [0.0, 0.5, 1.0, f32::NAN] {
        let found = estimate(&world, &features, &[&frame(value)], &prior);
        assert!(matches!(&found.state, EstimateState::Undetermined(why) if why.contains("0 features")), "{found:?}");
        // The prior knowledge is kept, and nothing is added.
        assert!((found.pose.covariance[0][0].sqrt() - 0.03).abs() < 1e-6);
        assert!(apart(&found.pose.world_from_robot, &place()).0 < 1e-9);
    }
    let other = GreyImage::new(24, 18, vec![0.5; 24 * 18]).unwrap();
    let error = Frame::new(0.0, video(), Measurement::Grey(other)).unwrap_err();
    assert!(error.kind() == ErrorKind::Invalid && error.to_string().contains("24 x 18"), "{error}");
    let without = estimator(EstimateOptions::default()).estimate(&world, &[&frame(0.5)], &prior).unwrap_err();
    assert!(without.kind() == ErrorKind::Usage && without.to_string().contains("layer"), "{without}");
}
