//! Grey images in an estimate: features are predicted at a pose, looked for in their regions, and become residuals.

use super::image::{ImageSource, SeenPoint, SeenSegment};
use crate::error::{Error, Result};
use crate::extract::{FindOptions, Findings, find_features};
use crate::features::{BoxOptions, FeatureOptions, FeatureSource, sensor_covariance};
use crate::frame::Frame;
use crate::geometry::Pose;
use crate::matching::Shape;
use crate::matrix::Matrix;
use crate::plan::Outputs;
use crate::predict::Predictor;
use crate::request::Request;
use crate::sensor::Sensor;
use crate::world::World;
use glam::{DMat2, DVec2};

/// How well a camera is calibrated, one standard deviation, pixels: what is found is known no better.
const CALIBRATION: f64 = 0.1;

/// What a grey image shows of the features that are predicted at a pose of the robot, which is known as well as the covariance says.
pub(super) fn find_at(
    predictor: &mut Predictor,
    world: &World,
    features: &FeatureOptions,
    frame: &Frame,
    world_from_robot: &Pose,
    covariance: &Matrix,
) -> Result<Findings> {
    let sensor = frame.sensor();
    let class = &sensor.spec().class;
    if matches!(features.source, FeatureSource::World) && world.environment().layer(class).is_none() {
        let what = format!("a grey image, and no features of class {class:?} to look for in it");
        return Err(Error::usage(what, "give a layer of features (presight features generates one)"));
    }
    let mount = sensor.spec().mount;
    let of_sensor = sensor_covariance(covariance, world_from_robot.rotation * mount.translation);
    let request = Request::of(Outputs::of(&[]))
        .with_features(features.clone())
        .with_regions(BoxOptions::default().with_sensor(of_sensor));
    let predicted = predictor.predict(world, sensor, &(*world_from_robot * mount), &request)?;
    predicted.features.map_or_else(|| Ok(Findings::default()), |f| find_features(frame, &f, &FindOptions::default()))
}

impl<'a> ImageSource<'a> {
    /// A source of the features that were matched in the image of a sensor.
    pub fn of_findings(sensor: &'a Sensor, findings: &Findings) -> Self {
        let (mut points, mut segments) = (Vec::new(), Vec::new());
        let calibration = CALIBRATION * CALIBRATION;
        for (feature, detection) in findings.matched() {
            match (&detection.shape, &feature.points_world[..]) {
                (Shape::Segment { ends: found, .. }, [a, b]) => {
                    let across = (found[1] - found[0]).perp().normalize_or_zero();
                    let sigma = (across.dot(detection.covariance * across) + calibration).sqrt();
                    segments.push(SeenSegment { ends: [*a, *b], found: *found, sigma, feature: feature.id });
                }
                (Shape::Point(found), [point]) => {
                    let covariance = detection.covariance + DMat2::from_diagonal(DVec2::splat(calibration));
                    points.push(SeenPoint { point: *point, found: *found, covariance, range: None });
                }
                _ => {}
            }
        }
        Self::new(sensor, points, segments)
    }
}
