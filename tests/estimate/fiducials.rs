//! Fiducials of a layer in simulated grey images of a room with tags on its walls: predicted, found in their regions,
//! and used as the source of a pose. Planted faults: a tag with a wrong number, and a tag that was moved.

use super::*;
use glam::{DMat3, DQuat, DVec2};
use presight_features::PlacedFeatures;
use presight_localize::estimate::{Estimate, EstimateState, nees};
use presight_localize::extract::FeatureClass;
use presight_localize::localize::Phase;
use presight_localize::matching::Shape;
use presight_model::environment::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
use presight_model::geometry::{PoseEstimate, RobotPose};
use presight_model::placement::place_layer;
use presight_testkit::tags::add_tag;
use std::sync::Arc;

/// The standard deviation of the prior, metres and radians.
const KNOWN: (f64, f64) = (0.03, 0.01);

/// A pose that looks along x at the wall with tags, 3.8 m away; the pillar with another tag is 1.4 m away.
fn place() -> Pose {
    Pose::from_xyz_rpy(DVec3::new(2.2, 2.2, 1.4), 0.0, 0.0, 0.0)
}

/// The pose of a tag at a place, facing the robot.
fn facing(at: DVec3) -> Pose {
    // As seen from the front, right is -y and up is z; the viewer is at smaller x.
    let rotation = DQuat::from_mat3(&DMat3::from_cols(-DVec3::Y, DVec3::Z, -DVec3::X));
    Pose { translation: at, rotation }
}

/// A tag's number, the centre of its black square, and its side in metres.
type Tag = (usize, [f64; 3], f64);

/// Three tags 2 mm in front of the wall, and one on the pillar.
const TAGS: [Tag; 4] = [
    (0, [5.998, 0.9, 1.9], 0.3),
    (1, [5.998, 1.7, 1.1], 0.3),
    (2, [5.998, 2.5, 1.9], 0.3),
    (3, [3.598, 2.65, 1.5], 0.16),
];

/// The room with boards.
fn with_tags(tags: &[Tag]) -> (World, Vec<[DVec3; 4]>) {
    let mut environment = Environment::clone(room(Vec3::ZERO).environment());
    let put = |(k, (tag, at, side)): (usize, &Tag)| {
        add_tag(&mut environment, &format!("board {k}"), *tag, &facing(DVec3::from(*at)), *side)
    };
    let corners = tags.iter().enumerate().map(put).collect();
    (World::new(environment), corners)
}

/// Each tag at its place in the map, with this sigma in metres.
fn layer(world: &World, tags: &[Tag], corners: &[[DVec3; 4]], sigma: f64) -> PlacedFeatures {
    let feature = |(k, (tag, ..)): (usize, &Tag)| Feature {
        id: k as u32 + 1,
        name: None,
        object: None,
        shape: FeatureShape::Fiducial {
            corners: corners[k],
            covariance: DMat3::from_diagonal(DVec3::splat(sigma * sigma)),
            family: "DICT_APRILTAG_36h11".into(),
            code: *tag as u32,
        },
        existence: Existence::default(),
        properties: Properties::default(),
    };
    let features = tags.iter().enumerate().map(feature).map(Arc::new).collect();
    place_layer(world, &FeatureLayer { class: "video".into(), tolerance: 1e-3, features, ..Default::default() })
        .unwrap()
}

/// Estimates the pose when the map has `TAGS` but the image shows another room's tags.
fn seen_in(real: &World, tags: &[Tag], believed: &Pose, truth: &Pose, seed: u64) -> Estimate {
    let (map, corners) = with_tags(tags);
    let features = layer(&map, tags, &corners, 0.0);
    let prior = PoseEstimate::of_sigmas(RobotPose::new(*believed), KNOWN.0, KNOWN.1);
    let mut estimator = estimator(EstimateOptions::default()).with_features(features);
    estimator.estimate(&map, &[&grey(&video(), real, truth, 0.0, seed)], &prior).unwrap()
}

/// By hand: a square of 0.4 m, 2 m ahead of a camera of focal length 250 pixels, is 50 pixels wide around the principal
/// point, with its top left corner in the world at the top left of the image.
#[test]
fn a_tag_square_ahead() {
    let mut environment = Environment::new();
    let corners = add_tag(&mut environment, "board", 3, &facing(2.0 * DVec3::X), 0.4);
    let world = World::new(environment);
    let features = layer(&world, &[(3, [2.0, 0.0, 0.0], 0.4)], &[corners], 0.0);
    let prior = PoseEstimate::of_sigmas(RobotPose::IDENTITY, 0.01, 0.005);
    let mut estimator = estimator(EstimateOptions::default()).with_features(features);
    let found = estimator.estimate(&world, &[&grey(&video(), &world, &Pose::IDENTITY, 0.0, 1)], &prior).unwrap();
    let findings = &found.findings[0];
    let (finding, detection) = findings.matched().next().expect("the tag is matched");
    let Shape::Fiducial(seen) = &detection.shape else { panic!("{detection:?}") };
    let by_hand = [[134.5, 94.5], [184.5, 94.5], [184.5, 144.5], [134.5, 144.5]].map(DVec2::from);
    for (k, by_hand) in by_hand.into_iter().enumerate() {
        // Predicted at the estimated pose.
        assert!(finding.predicted.points()[k].distance(by_hand) < 0.5, "{k}: {:?}", finding.predicted);
        assert!(seen[k].distance(by_hand) < 0.3, "{k}: {seen:?}");
    }
    assert!(findings.only_found.is_empty());
    // A single tag may have been moved, and nothing else supports the pose.
    assert!(
        matches!(&found.state, EstimateState::Undetermined(why) if why.contains("1 features")),
        "{:?}",
        found.state
    );
}

/// Four tags determine the pose from 3 cm and 0.6 degrees off, with a consistent covariance.
#[test]
fn tags_alone_determine_the_pose() {
    let (world, _) = with_tags(&TAGS);
    let mut random = Random(9);
    let mut scores = 0.0;
    for seed in 0..4 {
        let truth = off_by(&place(), 0.1, 2.0, &mut random);
        let believed = off_by(&truth, KNOWN.0, KNOWN.1.to_degrees(), &mut random);
        let found = seen_in(&world, &TAGS, &believed, &truth, seed);
        assert!(found.is_determined(), "{:?}", found.state);
        assert_eq!(found.findings[0].count("matched"), 4);
        let (m, d) = apart(&found.pose.world_from_robot, &truth);
        assert!(m < 0.015 && d < 0.25, "{seed}: {m} m, {d} deg");
        let (squared, numbers) = nees(&found.pose, &RobotPose::new(truth));
        scores += squared / numbers as f64 / 4.0;
    }
    assert!(scores < 2.5, "NEES {scores}");
}

/// Planted fault: a board has the number of another tag, which is also in view. It is not matched, and the other tags
/// determine the pose.
#[test]
fn a_tag_with_another_number_is_not_matched() {
    let mut real = TAGS;
    real[1].0 = 3;
    let (real, _) = with_tags(&real);
    let believed = off_by(&place(), KNOWN.0, KNOWN.1.to_degrees(), &mut Random(2));
    let found = seen_in(&real, &TAGS, &believed, &place(), 5);
    let findings = &found.findings[0];
    let classes: Vec<FeatureClass> = findings.features.iter().map(|f| f.class).collect();
    let is_matched: Vec<bool> = classes.iter().map(|c| matches!(c, FeatureClass::Matched(_))).collect();
    assert_eq!(is_matched, [true, false, true, true], "{classes:?}");
    let only: Vec<u32> = findings
        .only_found
        .iter()
        .map(|at| findings.detections[*at].properties.marker.as_ref().unwrap().code)
        .collect();
    assert_eq!(only, [3]);
    let (m, d) = apart(&found.pose.world_from_robot, &place());
    assert!(found.is_determined() && m < 0.02 && d < 0.3, "{m} m, {d} deg; {:?}", found.state);
}

/// Planted fault: a board hangs 5 cm from its place in the map. Among four tags it is outvoted; among two tags the
/// wrong one cannot be identified. A wrong pose is never reported as determined.
#[test]
fn a_tag_that_was_moved_is_not_believed() {
    let mut outvoted = 0;
    for moved in 0..4 {
        for (dy, dz) in [(0.05, 0.0), (0.0, -0.05)] {
            let mut real = TAGS;
            real[moved].1[1] += dy;
            real[moved].1[2] += dz;
            let believed = off_by(&place(), KNOWN.0, KNOWN.1.to_degrees(), &mut Random(moved as u64));
            let pair = [moved, (moved + 1) % 4];
            for some in [vec![0, 1, 2, 3], vec![0, 1, 2], pair.to_vec()] {
                let [real, map] = [real, TAGS].map(|all| some.iter().map(|k| all[*k]).collect::<Vec<Tag>>());
                let found = seen_in(&with_tags(&real).0, &map, &believed, &place(), 5);
                let (squared, numbers) = nees(&found.pose, &RobotPose::new(place()));
                let (score, off) = (squared / numbers as f64, apart(&found.pose.world_from_robot, &place()));
                eprintln!("{some:?}, {moved} by {dy} {dz}: NEES {score}, {off:?}, {:?}", found.state);
                assert!(!found.is_determined() || score < 4.0, "{some:?}, {moved}: NEES {score}, {off:?}");
                outvoted += usize::from(some.len() == 4 && found.is_determined() && off.0 < 0.03);
            }
        }
    }
    assert!(outvoted >= 6, "{outvoted} of 8");
}

/// By hand: three tags at equal distance with places known to 2 cm give the robot's place to 2 cm / sqrt(3). Exactly
/// known tags give it better.
#[test]
fn a_pose_is_known_no_better_than_its_tags() {
    let (world, corners) = with_tags(&TAGS[..3]);
    // In front of the middle of the three.
    let place = Pose { translation: DVec3::new(2.2, 1.7, 4.9 / 3.0), ..place() };
    let prior = PoseEstimate::of_sigmas(RobotPose::new(place), 0.05, 1e-4);
    let sigma_of = |sigma: f64| {
        let options = EstimateOptions::default().with_offset_sigma(1e-4);
        let mut estimator = estimator(options).with_features(layer(&world, &TAGS[..3], &corners, sigma));
        let found = estimator.estimate(&world, &[&grey(&video(), &world, &place, 0.0, 1)], &prior).unwrap();
        assert!(found.is_determined(), "{:?}", found.state);
        found.pose.covariance[1][1].sqrt()
    };
    let (exact, loose) = (sigma_of(0.0), sigma_of(0.02));
    // The heading is known; the prior of 5 cm reduces the value slightly.
    assert!((loose - 0.02 / 3f64.sqrt()).abs() < 0.001, "{loose}");
    assert!(exact < 0.002, "{exact}");
}

/// A drive by tags alone, and one by tags and ranges, which is at least as accurate as ranges alone.
#[test]
fn drives_are_tracked_by_tags() {
    let (world, corners) = with_tags(&TAGS);
    let features = layer(&world, &TAGS, &corners, 0.0);
    for with_ranges in [false, true] {
        for (k, (truth, step)) in drive(&video(), &world, &features, &place(), with_ranges).iter().enumerate() {
            let (m, d) = apart(&step.pose.world_from_robot, truth);
            assert!(m < if with_ranges { 0.004 } else { 0.02 } && d < 0.3, "{k}: {m} m, {d} deg; {}", step.reason);
            assert_eq!(step.estimate.findings[0].count("matched"), 4);
            assert_eq!(step.phase, Phase::Tracking, "{k}: {}", step.reason);
        }
    }
}
