//! Tests derivatives and special boxes. tests/features/roi_coverage compares boxes with samples of the errors.

use super::*;
use glam::{DMat3, DVec3};
use presight_model::environment::FeatureShape;
use presight_model::geometry::{InWorld, Pose, PoseCovariance};
use std::f64::consts::{PI, TAU};

/// A pinhole camera of 640 x 480 pixels, body axes.
struct Camera;

impl Projection for Camera {
    fn project(&self, p: DVec3) -> Option<[f64; 2]> {
        (p.x > 0.0).then(|| [319.5 - 500.0 * p.y / p.x, 239.5 - 500.0 * p.z / p.x])
    }

    fn lever(&self, p: DVec3) -> f64 {
        p.x
    }

    fn size(&self) -> (u32, u32) {
        (640, 480)
    }

    fn turn(&self) -> Option<f64> {
        None
    }
}

/// A scanner of 720 x 181 pixels in steps of 0.5 and 1 degree: full circle, from pole to pole.
struct Scanner;

impl Projection for Scanner {
    fn project(&self, p: DVec3) -> Option<[f64; 2]> {
        let azimuth = p.y.atan2(p.x);
        let elevation = p.z.atan2(p.x.hypot(p.y));
        (p.length() > 0.0).then(|| [(azimuth + PI) / TAU * 720.0, 90.0 - elevation.to_degrees()])
    }

    fn lever(&self, p: DVec3) -> f64 {
        p.x.hypot(p.y)
    }

    fn size(&self) -> (u32, u32) {
        (720, 181)
    }

    fn turn(&self) -> Option<f64> {
        Some(720.0)
    }
}

fn diagonal(sigmas: [f64; 6]) -> PoseCovariance<InWorld> {
    PoseCovariance::from_sigmas(sigmas)
}

fn isotropic(sigma: f64) -> DMat3 {
    DMat3::from_diagonal(DVec3::splat(sigma * sigma))
}

fn segment(a: DVec3, b: DVec3, sigma: f64) -> FeatureShape {
    FeatureShape::Segment { ends: [a, b], covariances: [isotropic(sigma); 2], cross: DMat3::ZERO }
}

fn samples(shape: &FeatureShape) -> Vec<BodyPoint> {
    match shape {
        FeatureShape::Segment { ends, .. } => {
            (0..=8).map(|i| BodyPoint::on_segment(ends, f64::from(i) / 8.0)).collect()
        }
        other => other.points().iter().map(|p| BodyPoint::rigid(*p)).collect(),
    }
}

#[test]
fn slopes_are_those_of_place() {
    let pose = Pose::from_xyz_rpy(DVec3::new(5e6, -3.0, 1.0), 0.2, -0.3, 1.1);
    let frame = Pose::from_xyz_rpy(DVec3::new(5e6 + 4.0, -2.0, 1.5), -0.5, 0.1, 0.7);
    let mut covariance = diagonal([0.1, 0.2, 0.3, 0.01, 0.02, 0.03]);
    (covariance[0][4], covariance[4][0]) = (1e-3, 1e-3);
    let shape = segment(DVec3::new(0.1, 0.2, 0.3), DVec3::new(1.0, -0.4, 0.6), 0.05);
    let object = PoseCovariance::from_rows(*covariance.as_rows());
    let uncertain = FeatureErrorModel::new(&pose, &covariance, &frame, Some(&object), &shape).unwrap();
    assert_eq!(uncertain.dimensions(), 18);
    let point = samples(&shape)[5];
    let placed = uncertain.nominal(&point);
    let slopes = DVec3::AXES.map(|axis| uncertain.slopes(&placed, axis));
    for i in 0..18 {
        let at = |step: f64| {
            let mut xi = vec![0.0; 18];
            xi[i] = step;
            uncertain.place(&point, &xi)
        };
        let difference = (at(1e-4) - at(-1e-4)) / 2e-4;
        let slope = DVec3::from_array(slopes.map(|s| s.as_flattened()[i]));
        assert!((difference - slope).length() < 1e-7, "{i}: {difference} and {slope}");
    }
    // A turn of the sensor to the left moves the image to the right.
    let turn = FeatureErrorModel::new(
        &Pose::IDENTITY,
        &diagonal([0.0, 0.0, 0.0, 0.0, 0.0, 0.1]),
        &Pose::IDENTITY,
        None,
        &FeatureShape::Point { at: DVec3::X, covariance: DMat3::ZERO },
    )
    .unwrap();
    assert!(turn.place(&BodyPoint::rigid(DVec3::X), &[1.0]).y < -0.09);
}

#[test]
fn boxes_over_the_seam_go_on_beyond_the_width() {
    let shape = FeatureShape::Point { at: DVec3::new(-5.0, 0.01, 0.0), covariance: isotropic(0.1) };
    let uncertain =
        FeatureErrorModel::new(&Pose::IDENTITY, &diagonal([0.0; 6]), &Pose::IDENTITY, None, &shape).unwrap();
    let b = roi(&Scanner, &uncertain, &samples(&shape), 0.99).unwrap();
    assert!(b.bounds[0] > 700.0 && b.bounds[2] > 719.5 && b.bounds[2] < 740.0, "{b:?}");
}

#[test]
fn nothing_uncertain_is_a_pixel() {
    let shape = FeatureShape::Point { at: DVec3::new(4.0, 0.0, 0.0), covariance: DMat3::ZERO };
    let uncertain =
        FeatureErrorModel::new(&Pose::IDENTITY, &diagonal([0.0; 6]), &Pose::IDENTITY, None, &shape).unwrap();
    let b = roi(&Camera, &uncertain, &samples(&shape), 0.99).unwrap();
    assert_eq!((b.bounds, b.flag), ([319.0, 239.0, 320.0, 240.0], RoiFlag::Linear));
}
