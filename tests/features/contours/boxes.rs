//! Checks the regions of interest of contours against random errors.
//!
//! A ball is convex: for any pose, its visible part and its silhouette extend as far as the images of its corners. The
//! true extent needs nothing else.

use super::{around, contour, lens, pinhole, see, world};
use crate::contours::bodies::ball;
use glam::{DMat3, DQuat, DVec3};
use presight_features::{BoxOptions, BoxQuery, add_boxes, place};
use presight_model::environment::FeatureShape;
use presight_model::geometry::Pose;
use presight_model::random::SplitMix64;
use presight_model::sensor::Sensor;
use presight_model::statistics::normal_pair;

fn normal(random: &mut SplitMix64) -> f64 {
    let (x, y) = (random.unit().max(1e-300), random.unit());
    normal_pair(x, y, 1.0)[0]
}

fn vector(random: &mut SplitMix64) -> DVec3 {
    DVec3::new(normal(random), normal(random), normal(random))
}

/// The share of draws in which the ball's image exceeds a box that is `less` pixels smaller on each side.
fn missed(sensor: &Sensor, at: DVec3, sigma: (f64, f64, f64), confidence: f64, less: f64) -> f64 {
    const DRAWS: usize = 1000;
    let mesh = ball(48, 24, 0.5);
    let anchor = mesh.corners_of(60).sum::<DVec3>() / mesh.corners_of(60).len() as f64;
    let corners: Vec<DVec3> = mesh.vertices().iter().map(|v| at + v.as_dvec3()).collect();
    let world = world(vec![("ball", at, mesh)]);
    let mut feature = contour(1, "ball", anchor);
    let covariance = DMat3::IDENTITY * (sigma.2 * sigma.2);
    feature.shape = FeatureShape::Contour { anchor, crease_deg: 30.0, covariance };
    let mut seen = see(&world, sensor, &Pose::IDENTITY, vec![feature.clone()]);
    let placed = place(&world, &super::layer(vec![feature])).unwrap();
    let options = BoxOptions::default()
        .with_sensor_sigmas([sigma.0, sigma.0, sigma.0, sigma.1, sigma.1, sigma.1])
        .with_confidence(confidence);
    add_boxes(
        &mut seen,
        &BoxQuery { placed: &placed, world: &world, sensor, world_from_sensor: &Pose::IDENTITY, options: &options },
    )
    .unwrap();
    assert!(seen.features[0].image_covariance.is_none());
    let [x0, y0, x1, y1] = seen.features[0].roi.unwrap();
    let turn = sensor.columns_of_a_turn().unwrap_or(0.0);
    let image_from_body = sensor.body_from_image().transpose();
    let mut random = SplitMix64(7);
    let leaves = |random: &mut SplitMix64| {
        let (shift, turned) = (vector(random) * sigma.0, vector(random) * sigma.1);
        let own = vector(random) * sigma.2;
        let back = image_from_body * DMat3::from_quat(DQuat::from_scaled_axis(-turned));
        corners.iter().any(|p| {
            let Some((mut u, v)) = sensor.project(back * (*p + own - shift)) else { return true };
            if turn > 0.0 {
                u += turn * ((0.5 * (x0 + x1) - u) / turn).round();
            }
            u < x0 + less || u > x1 - less || v < y0 + less || v > y1 - less
        })
    };
    (0..DRAWS).filter(|_| leaves(&mut random)).count() as f64 / DRAWS as f64
}

#[test]
fn regions_contain_the_silhouettes_of_other_poses() {
    let ahead = DVec3::new(4.0, 0.3, 0.2);
    let conditions = [
        (pinhole(), ahead, (0.02, 0.005, 0.01)),
        (pinhole(), ahead, (0.0, 0.0, 0.03)),
        (lens(), ahead, (0.03, 0.01, 0.0)),
        (around(), ahead, (0.05, 0.01, 0.01)),
        (around(), DVec3::new(-4.0, 0.05, 0.2), (0.05, 0.01, 0.01)),
    ];
    for (sensor, at, sigma) in conditions {
        for confidence in [0.9, 0.99] {
            let share = missed(&sensor, at, sigma, confidence, 0.0);
            let most = 1.0 - confidence;
            let sd = (most * confidence / 1000.0).sqrt();
            let name = &sensor.spec().name;
            assert!(share <= most + 3.0 * sd, "{name} {sigma:?} {confidence}: {share}");
            // No box is so large that it would suffice with three pixels less on each side.
            let share = missed(&sensor, at, sigma, confidence, 3.0);
            assert!(share > most + 3.0 * sd, "{name} {sigma:?} {confidence}: {share} with 3 pixels less");
        }
    }
}

#[test]
fn a_region_continues_over_the_seam() {
    let one = |at: DVec3| {
        let mesh = ball(48, 24, 0.5);
        let anchor = mesh.corners_of(60).sum::<DVec3>() / mesh.corners_of(60).len() as f64;
        let world = world(vec![("ball", at, mesh)]);
        let features = vec![contour(1, "ball", anchor)];
        let placed = place(&world, &super::layer(features.clone())).unwrap();
        let mut seen = see(&world, &around(), &Pose::IDENTITY, features);
        add_boxes(
            &mut seen,
            &BoxQuery {
                placed: &placed,
                world: &world,
                sensor: &around(),
                world_from_sensor: &Pose::IDENTITY,
                options: &BoxOptions::default(),
            },
        )
        .unwrap();
        seen.features[0].roi.unwrap()
    };
    // By symmetry the box is the same, shifted by half a turn.
    let (ahead, behind) = (one(DVec3::X * 4.0), one(DVec3::X * -4.0));
    let half = 720.0;
    for (k, by) in [half, 0.0, half, 0.0].into_iter().enumerate() {
        assert!((behind[k] - ahead[k] - by).abs() < 1e-6, "{ahead:?} {behind:?}");
    }
    assert!(behind[0] < 1439.5 && behind[2] > 1439.5, "{behind:?}");
    // asin(0.5 / 4) to both sides, in quarters of a degree.
    let width = 2.0 * (0.125f64).asin().to_degrees() / 0.25;
    assert!((behind[2] - behind[0] - width).abs() < 0.3, "{behind:?} {width}");
}
