//! Makes track seeds from full predictions.

use crate::matching::{Detection, ExpectedProperties, Marker, Rejection, Shape};
use glam::{DMat2, DVec2, DVec3};
use presight_features::{FeaturePrediction, SeenFeature, VisibleInterval};
use presight_model::environment::FeatureShape;
use presight_model::geometry::SensorPose;
use presight_model::sensor::Sensor;

/// A feature to follow, from a full prediction or from the caller.
#[derive(Clone, Debug, PartialEq)]
pub struct Seed {
    /// The feature's number.
    pub id: u32,
    /// Position in the image. The ends of a segment that are not corners of the model may be detected anywhere along
    /// it.
    pub shape: Shape,
    /// Covariance of each defining point, pixels squared.
    pub covariances: Vec<DMat2>,
    /// Expected properties.
    pub properties: ExpectedProperties,
}

impl Seed {
    /// Makes seeds from a full prediction: points, reflectors, the longest visible part of each segment, and patches
    /// and fiducials that are fully visible. The end of a segment is a corner if the model ends there; otherwise it
    /// may be detected anywhere along the segment. Only features with a predicted covariance in the image become seeds
    /// ([`presight_predict::Request::with_regions`]), and of their properties only the marker is expected: strength and
    /// contrast of a layer may come from another instrument.
    pub fn of_prediction(prediction: &FeaturePrediction, sensor: &Sensor, pose: &SensorPose) -> Vec<Self> {
        let view = view(sensor, pose);
        prediction.features.iter().filter_map(|seen| Self::of_seen(seen, &view)).collect()
    }

    fn of_seen(seen: &SeenFeature, view: &impl Fn(DVec3) -> Option<DVec2>) -> Option<Self> {
        let extent = |v: &VisibleInterval| v.pixels[0].distance_squared(v.pixels[1]);
        let visible = seen.visible.iter().reduce(|a, b| if extent(b) > extent(a) { b } else { a })?;
        let covariances: Vec<DMat2> = seen.image_covariance.as_ref()?.iter().map(DMat2::from_cols_array_2d).collect();
        let corners = || seen.points_world.iter().map(|p| view(*p)).collect::<Option<Vec<DVec2>>>();
        let is_whole = seen.hidden.is_empty();
        let (shape, covariances) = match (&seen.feature.shape, &covariances[..]) {
            (FeatureShape::Point { .. }, [_]) => (Shape::Point(visible.pixels[0]), covariances),
            (FeatureShape::Reflector { .. }, [_]) => (Shape::Reflector(visible.pixels[0]), covariances),
            (FeatureShape::Segment { .. }, [first, last]) => {
                let corners = [visible.t[0] <= 0.0, visible.t[1] >= 1.0];
                let at = visible.t.map(|t| *first * (1.0 - t) + *last * t);
                (Shape::Segment { ends: visible.pixels, corners }, at.to_vec())
            }
            (FeatureShape::Patch { .. }, _) if is_whole => (Shape::Patch(corners()?), covariances),
            (FeatureShape::Fiducial { .. }, _) if is_whole => {
                (Shape::Fiducial(corners()?.try_into().ok()?), covariances)
            }
            _ => return None,
        };
        let marker = match &seen.feature.shape {
            FeatureShape::Fiducial { family, code, .. } => Some(Marker { family: family.clone(), code: *code }),
            _ => None,
        };
        let properties = ExpectedProperties { marker, ..ExpectedProperties::default() };
        Some(Self { id: seen.feature.id, shape, covariances, properties })
    }

    /// Checks that shape and covariances are usable and fit together.
    pub(super) fn check(&self) -> Result<(), Rejection> {
        self.shape.check()?;
        if self.covariances.len() != self.shape.points().len() {
            return Err(Rejection::Degenerate);
        }
        let point = |covariance: &DMat2| Detection { covariance: *covariance, ..Detection::point(DVec2::ZERO, 1.0) };
        self.covariances.iter().try_for_each(|covariance| point(covariance).check())
    }
}

/// Returns the projection from world points to pixels (column, row) for a sensor at a pose.
fn view<'a>(sensor: &'a Sensor, pose: &SensorPose) -> impl Fn(DVec3) -> Option<DVec2> + use<'a> {
    let sensor_from_world = pose.world_from_sensor().inverse();
    let image_from_body = sensor.body_from_image().transpose();
    move |p_in_world| {
        let p_in_image = image_from_body * sensor_from_world.transform_point(p_in_world);
        sensor.project(p_in_image).map(|(column, row)| DVec2::new(column, row))
    }
}
