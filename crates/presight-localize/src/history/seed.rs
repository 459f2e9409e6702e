//! Makes track seeds from full predictions.

use super::track::Seed;
use crate::matching::{Detection, ExpectedProperties, Marker, Rejection, Shape, UncertainValue};
use glam::{DMat2, DVec2, DVec3};
use presight_features::{FeaturePrediction, SeenFeature, VisibleInterval};
use presight_model::environment::{FeatureShape, Properties};
use presight_model::geometry::SensorPose;
use presight_model::sensor::Sensor;

/// Standard deviation of a property in a feature layer, which may come from a different instrument.
const LAYER_SIGMA: f64 = 0.1;

/// Variance of a defining point without a predicted covariance, pixels squared.
const UNKNOWN: f64 = 25.0;

impl Seed {
    /// Makes seeds from a full prediction: points, reflectors, the longest visible part of each segment, and patches
    /// and fiducials that are fully visible. The end of a segment is a corner if the model ends there; otherwise it
    /// slides.
    pub fn of_prediction(prediction: &FeaturePrediction, sensor: &Sensor, pose: &SensorPose) -> Vec<Self> {
        let view = view(sensor, pose);
        prediction.features.iter().filter_map(|seen| Self::of_seen(seen, &view)).collect()
    }

    fn of_seen(seen: &SeenFeature, view: &impl Fn(DVec3) -> Option<DVec2>) -> Option<Self> {
        let extent = |v: &VisibleInterval| v.pixels[0].distance_squared(v.pixels[1]);
        let visible = seen.visible.iter().reduce(|a, b| if extent(b) > extent(a) { b } else { a })?;
        let told = |k: usize| seen.image_covariance.as_ref().and_then(|c| c.get(k)).map(DMat2::from_cols_array_2d);
        let covariance = |k: usize| told(k).unwrap_or(DMat2::from_diagonal(DVec2::splat(UNKNOWN)));
        let world = &seen.points_world;
        let corners = || world.iter().map(|p| view(*p)).collect::<Option<Vec<DVec2>>>();
        let is_whole = seen.hidden.is_empty();
        let (shape, covariances, points_world) = match &seen.feature.shape {
            FeatureShape::Point { .. } => (Shape::Point(visible.pixels[0]), vec![covariance(0)], world.clone()),
            FeatureShape::Reflector { .. } => (Shape::Reflector(visible.pixels[0]), vec![covariance(0)], world.clone()),
            FeatureShape::Segment { .. } => {
                let (a, b) = (*world.first()?, *world.get(1)?);
                let corners = [visible.t[0] <= 0.0, visible.t[1] >= 1.0];
                let ends = visible.t.map(|t| (covariance(0) * (1.0 - t) + covariance(1) * t, a.lerp(b, t)));
                (
                    Shape::Segment { ends: visible.pixels, corners },
                    ends.map(|e| e.0).to_vec(),
                    ends.map(|e| e.1).to_vec(),
                )
            }
            FeatureShape::Patch { .. } if is_whole => {
                (Shape::Patch(corners()?), (0..world.len()).map(covariance).collect(), world.clone())
            }
            FeatureShape::Fiducial { .. } if is_whole => {
                let corners = corners()?.try_into().ok()?;
                (Shape::Fiducial(corners), (0..4).map(covariance).collect(), world.clone())
            }
            FeatureShape::Patch { .. } | FeatureShape::Fiducial { .. } | FeatureShape::Contour { .. } => return None,
        };
        Some(Self { id: seen.feature.id, shape, covariances, properties: properties(seen), points_world })
    }

    /// Checks that shape, covariances and points fit together.
    pub(super) fn check(&self) -> Result<(), Rejection> {
        self.shape.check()?;
        let points = self.shape.points().len();
        if self.covariances.len() != points || !(self.points_world.is_empty() || self.points_world.len() == points) {
            return Err(Rejection::Degenerate);
        }
        for covariance in &self.covariances {
            Detection { covariance: *covariance, ..Detection::new(self.shape.clone(), 1.0) }.check()?;
        }
        if self.points_world.iter().all(|p| p.is_finite()) { Ok(()) } else { Err(Rejection::NotFinite) }
    }
}

fn properties(seen: &SeenFeature) -> ExpectedProperties {
    let estimate = |mean: f64| UncertainValue { mean, variance: LAYER_SIGMA * LAYER_SIGMA };
    let marker = match &seen.feature.shape {
        FeatureShape::Fiducial { family, code, .. } => Some(Marker { family: family.clone(), code: *code }),
        _ => None,
    };
    let Properties { strength, contrast, .. } = &seen.feature.properties;
    ExpectedProperties {
        strength: strength.map(estimate),
        contrast: contrast.map(estimate),
        marker,
        ..ExpectedProperties::default()
    }
}

/// Returns the projection from world points to pixels (column, row) for a sensor at a pose, for
/// [`super::Tracker::set_view`].
pub fn view<'a>(sensor: &'a Sensor, pose: &SensorPose) -> impl Fn(DVec3) -> Option<DVec2> + use<'a> {
    let sensor_from_world = pose.world_from_sensor().inverse();
    let image_from_body = sensor.body_from_image().transpose();
    move |p_in_world| {
        let p_in_image = image_from_body * sensor_from_world.transform_point(p_in_world);
        sensor.project(p_in_image).map(|(column, row)| DVec2::new(column, row))
    }
}
