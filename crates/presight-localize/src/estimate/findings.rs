//! Grey images and reflectors of scans in an estimate: features are predicted at a pose, looked for in their regions, and become residuals.

use super::image::{ImageSource, SeenPoint, SeenSegment};
use crate::extract::{FeatureFindings, FindOptions, find_features};
use crate::matching::{Shape, UncertainValue};
use glam::{DMat2, DMat3, DVec2, DVec3};
use presight_features::{BoxOptions, FeatureOptions, FeatureSource};
use presight_model::environment::{Feature, FeatureShape};
use presight_model::error::{Error, Result};
use presight_model::geometry::PoseEstimate;
use presight_model::matrix::Matrix;
use presight_model::measured::Frame;
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_predict::predict::Predictor;
use presight_predict::request::Request;
use presight_render::plan::Outputs;
use std::collections::BTreeMap;

/// How well a camera is calibrated, one standard deviation, pixels: what is found is known no better.
const CALIBRATION: f64 = 0.1;

/// No feature counts less than if it existed with this probability.
const LEAST_EXISTENCE: f64 = 1e-3;

/// True if a frame has intensities, and there are reflectors to look for in them.
pub(super) fn has_reflectors(world: &World, features: &FeatureOptions, frame: &Frame) -> bool {
    frame.intensities().is_some() && reflectors(world, features, frame).next().is_some()
}

/// Where the reflectors are that are looked for in the scans of a frame's sensor, world, metres.
pub(super) fn reflectors<'a>(
    world: &'a World,
    features: &'a FeatureOptions,
    frame: &Frame,
) -> impl Iterator<Item = DVec3> + 'a {
    let environment = world.environment();
    let (placed, own) = match &features.source {
        FeatureSource::Placed(placed) => (Some(placed), None),
        FeatureSource::World => (None, environment.layer(&frame.sensor().spec().class)),
    };
    let placed = placed.into_iter().flat_map(|placed| placed.features.iter()).map(|p| &p.feature);
    let all = placed.chain(own.into_iter().flat_map(|layer| &layer.features));
    all.filter_map(|feature| match &feature.shape {
        FeatureShape::Reflector { at, .. } => {
            let object = feature.object.as_deref().and_then(|path| environment.object(path));
            Some(object.map_or(*at, |o| o.world_from_object.transform_point(*at)))
        }
        _ => None,
    })
}

/// What a grey image, or a scan with intensities, shows of the features that are predicted at a pose of the robot. `unstated` is how far a reflector may be off whose layer does not say it, one standard deviation, metres.
pub(super) fn find_at(
    predictor: &mut Predictor,
    (world, features): (&World, &FeatureOptions),
    frame: &Frame,
    robot: &PoseEstimate,
    unstated: f64,
) -> Result<FeatureFindings> {
    let sensor = frame.sensor();
    let is_scan = frame.grey().is_none();
    let class = &sensor.spec().class;
    if matches!(features.source, FeatureSource::World) && world.environment().layer(class).is_none() {
        let what = format!("a grey image, and no features of class {class:?} to look for in it");
        return Err(Error::usage(what, "give a layer of features (presight features generates one)"));
    }
    let mut of_sensor = robot.sensor_covariance(&sensor.spec().mount);
    let mut options = FindOptions::default();
    if is_scan {
        (0..3).for_each(|i| of_sensor[i][i] += unstated * unstated);
        options.place =
            Some(DMat3::from_cols_array_2d(&std::array::from_fn(|i| std::array::from_fn(|j| of_sensor[i][j]))));
    }
    let request = Request::of(Outputs::of(&[]))
        .with_features(features.clone())
        .with_regions(BoxOptions::default().with_sensor(of_sensor));
    let pose = robot.robot().sensor(sensor);
    let mut predicted = predictor.predict(world, sensor, &pose, &request)?.features.unwrap_or_default();
    if is_scan {
        predicted.features.retain(|seen| matches!(seen.feature.shape, FeatureShape::Reflector { .. }));
    }
    let mut findings = find_features(frame, &pose, &predicted, &options)?;
    let by_id: BTreeMap<u32, &Feature> = predicted.features.iter().map(|s| (s.feature.id, &*s.feature)).collect();
    for found in &mut findings.features {
        let known = by_id.get(&found.id).map_or(DMat3::ZERO, |feature| place_of(world, feature));
        let is_unstated = is_scan && known == DMat3::ZERO;
        found.place = if is_unstated { DMat3::from_diagonal(DVec3::splat(unstated * unstated)) } else { known };
    }
    Ok(findings)
}

/// What the layer says of how well the place of a feature is known, world axes.
fn place_of(world: &World, feature: &Feature) -> DMat3 {
    let covariance = match &feature.shape {
        FeatureShape::Point { covariance, .. }
        | FeatureShape::Fiducial { covariance, .. }
        | FeatureShape::Reflector { covariance, .. } => *covariance,
        _ => return DMat3::ZERO,
    };
    let object = feature.object.as_deref().and_then(|path| world.environment().object(path));
    let turned = object.map_or(DMat3::IDENTITY, |o| DMat3::from_quat(o.world_from_object.rotation));
    turned * covariance * turned.transpose()
}

/// How far a point or a fiducial may be from where the model has it: by what the layer says, and as surfaces may.
pub(super) fn place_error(findings: &[FeatureFindings], id: u32, offset: f64) -> Matrix {
    let known = findings.iter().flat_map(|f| &f.features).find(|f| f.id == id).map(|f| f.place).unwrap_or(DMat3::ZERO);
    let own =
        |i: usize, j: usize| if i < 3 && j < 3 { known.col(j)[i] + if i == j { offset } else { 0.0 } } else { 0.0 };
    std::array::from_fn(|i| std::array::from_fn(|j| own(i, j)))
}

impl<'a> ImageSource<'a> {
    /// A source of the features that were matched in the image of a sensor.
    pub fn of_findings(sensor: &'a Sensor, findings: &FeatureFindings) -> Self {
        let (mut points, mut segments) = (Vec::new(), Vec::new());
        let calibration = CALIBRATION * CALIBRATION;
        for (feature, detection) in findings.matched() {
            // A feature that may not exist may have been matched to something else: its information is weighted by its existence.
            let doubt = 1.0 / feature.existence.clamp(LEAST_EXISTENCE, 1.0);
            match (&detection.shape, &feature.points_world[..]) {
                (Shape::Segment { ends: found, .. }, [a, b]) => {
                    let across = (found[1] - found[0]).perp().normalize_or_zero();
                    let sigma = (doubt * (across.dot(detection.covariance * across) + calibration)).sqrt();
                    segments.push(SeenSegment { ends: [*a, *b], found: *found, sigma, feature: feature.id });
                }
                (Shape::Point(_) | Shape::Fiducial(_), corners) => {
                    let covariance = doubt * (detection.covariance + DMat2::from_diagonal(DVec2::splat(calibration)));
                    let point = |(point, found): (&DVec3, &DVec2)| SeenPoint {
                        point: *point,
                        found: *found,
                        covariance,
                        range: None,
                        place: DMat3::ZERO,
                        feature: feature.id,
                    };
                    points.extend(corners.iter().zip(detection.shape.points()).map(point));
                }
                (Shape::Reflector(found), [at]) => points.push(SeenPoint {
                    point: *at,
                    found: *found,
                    covariance: doubt * (detection.covariance + DMat2::from_diagonal(DVec2::splat(calibration))),
                    range: detection.properties.range.map(|r| UncertainValue { variance: doubt * r.variance, ..r }),
                    place: doubt * feature.place,
                    feature: feature.id,
                }),
                _ => {}
            }
        }
        Self::new(sensor, points, segments)
    }
}
