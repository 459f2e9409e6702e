//! Edges of a model in simulated grey images (light at the camera, blur, noise): matched near their predictions,
//! classified, and used as the only source of a pose.

use super::*;
use presight_features::generate::{GenerateOptions, generate};
use presight_features::{BoxOptions, FeatureOptions, FeaturePrediction};
use presight_localize::estimate::{Freedom, ImageSource, SeenPoint, SeenSegment, fit, nees};
use presight_localize::extract::{
    CornerOptions, EdgeOptions, ExpectedEdge, FoundEdge, PixelBox, corners_in, edges_near,
};
use presight_localize::matching::Detection;
use presight_localize::simulate::GreySimulator;
use presight_model::geometry::{PoseEstimate, RobotPose, SensorPose};
use presight_model::measured::GreyImage;
use presight_model::placement::place_layer;
use std::time::Duration;

const NOISE: f64 = 0.01;
/// The standard deviation of the prior, metres and radians.
const KNOWN: (f64, f64) = (0.03, 0.01);

/// A pose that looks over the table to the shelf.
fn place() -> Pose {
    Pose::from_xyz_rpy(DVec3::new(0.7, 2.2, 1.4), 0.0, 0.25, 0.05)
}

fn predicted(world: &World, pose: &Pose) -> FeaturePrediction {
    let layer = generate(world.environment(), "video", &GenerateOptions::default()).unwrap().layer;
    let placed = place_layer(world, &layer).unwrap();
    let (t, r) = KNOWN;
    let request = Request::default()
        .with_features(FeatureOptions::default().with_placed(placed))
        .with_regions(BoxOptions::default().with_sensor_sigmas([t, t, t, r, r, r]));
    predictor().predict(world, &video(), &SensorPose::new(*pose), &request).unwrap().features.unwrap()
}

fn picture(world: &World, pose: &Pose, seed: u64) -> GreyImage {
    let mut simulator = GreySimulator::new(predictor(), video(), 0.7, NOISE, seed).unwrap();
    simulator.frame(world, 0.0, &RobotPose::new(*pose)).unwrap().grey().unwrap().clone()
}

/// A predicted edge with the best match near it. `t` holds the ends of the visible part.
struct Pair {
    ends: [DVec3; 2],
    found: FoundEdge,
}

fn matched(features: &FeaturePrediction, image: &GreyImage, reach: Option<f64>) -> Vec<Pair> {
    let options = EdgeOptions::default().with_noise(NOISE).with_min_support(0.7).with_max_edges(1);
    let mut pairs = Vec::new();
    for seen in &features.features {
        let [a, b] = seen.points_world[..] else { continue };
        let visible = seen.visible.iter().filter(|part| part.pixels[0].distance(part.pixels[1]) >= 12.0);
        for (part, expected) in visible.zip(ExpectedEdge::of(seen, 3.0)) {
            let expected = ExpectedEdge { reach: reach.unwrap_or(expected.reach), ..expected };
            if let Some(found) = edges_near(image, &expected, &options).pop() {
                pairs.push(Pair { ends: part.t.map(|t| a.lerp(b, t)), found });
            }
        }
    }
    pairs
}

/// The distance of the model edge's ends from the matched line in the image at the true pose, pixels.
fn off(pair: &Pair, truth: &Pose) -> f64 {
    let camera = video();
    let [a, b] = [0, 1].map(|k| pair.found.detection.shape.points()[k]);
    let along = (b - a).normalize();
    let ends = pair.ends.map(|p| {
        let image = camera.body_from_image().transpose() * truth.inverse().transform_point(p);
        let (u, v) = camera.project(image).unwrap();
        along.perp_dot(glam::DVec2::new(u, v) - a).abs()
    });
    ends[0].max(ends[1])
}

/// If the prediction is right, edges are found to a fraction of a pixel and mismatches are rare.
#[test]
fn predicted_edges_are_found() {
    let world = room(Vec3::ZERO);
    let pairs = matched(&predicted(&world, &place()), &picture(&world, &place(), 3), Some(4.0));
    let mut all: Vec<f64> = pairs.iter().map(|p| off(p, &place())).collect();
    all.sort_by(f64::total_cmp);
    assert!(all.len() >= 12, "{} edges", all.len());
    assert!(all[all.len() / 2] < 0.3, "median of {} pixels", all[all.len() / 2]);
    let wrong = all.iter().filter(|d| **d > 1.5).count();
    assert!(10 * wrong <= all.len(), "{wrong} of {} are mismatches", all.len());
}

/// Edges alone determine the pose from 3 cm and 0.6 degrees off, with a consistent covariance.
#[test]
fn edges_alone_determine_the_pose() {
    let (world, mut random) = (room(Vec3::ZERO), Random(4));
    let (mut metres, mut degrees, mut scores) = (0.0f64, 0.0f64, Vec::new());
    for seed in 0..3 {
        let (truth, camera) = (place(), video());
        let believed = off_by(&truth, KNOWN.0, KNOWN.1.to_degrees(), &mut random);
        let pairs = matched(&predicted(&world, &believed), &picture(&world, &truth, seed), None);
        let segment = |p: &Pair| {
            let ends = p.found.detection.shape.points();
            let sigma = p.found.detection.covariance.x_axis.x.sqrt();
            SeenSegment { ends: p.ends, found: [ends[0], ends[1]], sigma: sigma.hypot(0.1), feature: 0 }
        };
        let source = ImageSource::new(&camera, Vec::new(), pairs.iter().map(segment).collect());
        let found =
            fit(&[&source], &PoseEstimate::of_sigmas(RobotPose::new(believed), KNOWN.0, KNOWN.1), Freedom::Full)
                .unwrap();
        let (m, d) = apart(&found.pose.world_from_robot, &truth);
        (metres, degrees) = (metres.max(m), degrees.max(d));
        let (squared, numbers) = nees(&found.pose, &RobotPose::new(truth));
        scores.push(squared / numbers as f64);
        assert!(found.weak.is_empty(), "{:?}", found.weak);
    }
    assert!(metres < 0.012 && degrees < 0.25, "{metres} m {degrees} deg");
    assert!(scores.iter().all(|s| *s < 6.0), "{scores:?}");
}

/// By hand: a camera of focal length 100 pixels sees a point 2 m ahead 1 pixel too far right, so the camera is 2 cm too
/// far left or rotated. With x, z and all rotations known, the whole pixel goes to y. A pixel's deviation is 2 cm.
#[test]
fn a_point_ahead() {
    let camera = Camera::pinhole(100, 100, 100.0, 100.0, 49.5, 49.5);
    let camera = Sensor::new(SensorSpec::new("camera", "video", Geometry::Camera(camera))).unwrap();
    let found = glam::DVec2::new(50.5, 49.5);
    let point = SeenPoint {
        point: DVec3::new(2.0, 0.0, 0.0),
        found,
        covariance: glam::DMat2::IDENTITY,
        place: glam::DMat3::ZERO,
        range: None,
        feature: 0,
    };
    let source = ImageSource::new(&camera, vec![point; 4], Vec::new());
    let mut prior = PoseEstimate::of_sigmas(RobotPose::IDENTITY, 1e-6, 1e-6);
    prior.covariance[1][1] = 100.0;
    let answer = fit(&[&source], &prior, Freedom::Full).unwrap();
    let t = answer.pose.world_from_robot.translation;
    assert!((t - DVec3::new(0.0, 0.02, 0.0)).length() < 1e-5, "{t}");
    // Four points of 2 cm each.
    assert!((answer.pose.covariance[1][1].sqrt() - 0.01).abs() < 1e-5, "{}", answer.pose.covariance[1][1].sqrt());
    // A point that is off by a thousand pixels is an outlier and gets no weight.
    let far = SeenPoint { found: glam::DVec2::new(950.0, 49.5), ..point };
    prior.covariance[1][1] = 1e-3;
    let mut points = vec![point; 4];
    points.push(far);
    let answer = fit(&[&ImageSource::new(&camera, points, Vec::new())], &prior, Freedom::Full).unwrap();
    assert!(
        (answer.pose.world_from_robot.translation.y - 0.02).abs() < 0.003,
        "{}",
        answer.pose.world_from_robot.translation
    );
}

/// Compares with a search of the whole image for every edge and corner, without predictions. CPU times are printed, not
/// checked: `cargo test --release --test estimate regions -- --nocapture`.
#[test]
fn regions_of_interest_save_time_and_false_matches() {
    let world = room(Vec3::ZERO);
    let (image, features) = (picture(&world, &place(), 3), predicted(&world, &place()));
    let edges = |reach: Option<f64>| {
        let pairs = matched(&features, &image, reach);
        let wrong = pairs.iter().filter(|p| off(p, &place()) > 1.5).count();
        (pairs.len(), wrong)
    };
    let corners = |everywhere: bool| nearest_corners(&features, &image, everywhere);
    let (near, wide) = (timed(|| edges(None)), timed(|| edges(Some(1e3))));
    eprintln!("edges in regions: {near:?}; in the whole image: {wide:?} (CPU time, (found, wrong))");
    assert!(near.1.1 * wide.1.0 <= wide.1.1 * near.1.0, "a larger share is wrong: {near:?} {wide:?}");
    let (near, wide) = (timed(|| corners(false)), timed(|| corners(true)));
    eprintln!("corners in regions: {near:?}; in the whole image: {wide:?}");
    assert!(near.1.0 >= 6, "{near:?}");
    assert!(near.1.1 <= wide.1.1, "more are wrong: {near:?} {wide:?}");
}

/// The smallest CPU time of five runs, and their result.
fn timed<T>(run: impl Fn() -> T) -> (Duration, T) {
    let once = || {
        let start = cpu_time::ThreadTime::now();
        let result = run();
        (start.elapsed(), result)
    };
    (1..5).fold(once(), |best, _| {
        let next = once();
        if next.0 < best.0 { next } else { best }
    })
}

/// For each predicted corner, the nearest corner found in its region or in the whole image. Returns how many were
/// found, and how many of them are more than 1.5 pixels off.
fn nearest_corners(features: &FeaturePrediction, image: &GreyImage, everywhere: bool) -> (usize, usize) {
    let options = CornerOptions::default().with_noise(NOISE);
    let all = if everywhere { corners_in(image, PixelBox::whole(image), &options) } else { Vec::new() };
    let (mut count, mut wrong) = (0, 0);
    for seen in features.features.iter().filter(|f| f.points_world.len() == 1) {
        let (Some(roi), Some(part)) = (seen.roi, seen.visible.first()) else { continue };
        let there = part.pixels[0];
        let apart = |d: &Detection| d.shape.centre().distance(there);
        let near = if everywhere { Vec::new() } else { corners_in(image, PixelBox(roi), &options) };
        let found = all.iter().chain(&near).map(apart).min_by(f64::total_cmp);
        let Some(off) = found else { continue };
        count += 1;
        wrong += usize::from(off > 1.5);
    }
    (count, wrong)
}
