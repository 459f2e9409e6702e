//! Artificial landmarks: visible reflectors and fiducial markers with their positions.

use super::View;
use glam::DVec3;
use presight_features::{FeaturePrediction, SeenFeature};
use presight_model::environment::FeatureShape;
use serde::Serialize;

/// The visible artificial landmarks.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Landmarks {
    /// Visible landmarks in the order of the layer.
    pub landmarks: Vec<Landmark>,
    /// Number of landmarks in the prediction, visible or not ([`presight_features::Hidden`]).
    pub known: usize,
}

/// A visible artificial landmark.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Landmark {
    /// Number in the layer.
    pub id: u32,
    /// Name in the layer.
    pub name: Option<String>,
    /// `reflector` or `fiducial`.
    pub kind: &'static str,
    /// A fiducial's dictionary by its OpenCV name.
    pub family: Option<String>,
    /// A fiducial's number in the dictionary.
    pub code: Option<u32>,
    /// Position, metres; the centre of a fiducial.
    pub position_robot: [f64; 3],
    /// Position in the world, metres.
    pub position_world: [f64; 3],
    /// A fiducial's corners, clockwise from the top left as seen from the front; empty for a reflector.
    pub corners_robot: Vec<[f64; 3]>,
    /// Metres from the sensor to the position.
    pub range: f64,
    /// Azimuth about the sensor's z axis, from its x axis, radians.
    pub azimuth: f64,
    /// Elevation above the sensor's x-y plane, radians.
    pub elevation: f64,
    /// |cos| of the angle between ray and surface normal, if known.
    pub cos_incidence: Option<f64>,
    /// Visible share, 0..=1.
    pub visible_fraction: f64,
    /// Probability that it exists at the time of the prediction.
    pub existence: f64,
}

impl Landmarks {
    pub(super) fn summary(&self) -> String {
        format!("{} of {} artificial landmarks are seen", self.landmarks.len(), self.known)
    }
}

pub(super) fn reduce(view: &View<'_>, features: &FeaturePrediction) -> Landmarks {
    let is_landmark =
        |f: &&SeenFeature| matches!(f.feature.shape, FeatureShape::Reflector { .. } | FeatureShape::Fiducial { .. });
    let known = features.features.iter().filter(is_landmark).count();
    let seen = features.features.iter().filter(is_landmark).filter(|f| f.visible_fraction > 0.0);
    Landmarks { landmarks: seen.filter_map(|f| landmark(view, f)).collect(), known }
}

/// Returns `None` for a feature without points.
fn landmark(view: &View<'_>, seen: &SeenFeature) -> Option<Landmark> {
    let (sensor_from_world, mount) = (view.pose.world_from_sensor().inverse(), view.sensor.spec().mount);
    let points = &seen.points_world;
    let position_world = *points.first()? + points.iter().map(|p| *p - points[0]).sum::<DVec3>() / points.len() as f64;
    let p_in_sensor = sensor_from_world.transform_point(position_world);
    let in_robot = |p_in_world: DVec3| mount.transform_point(sensor_from_world.transform_point(p_in_world)).to_array();
    let (family, code) = match &seen.feature.shape {
        FeatureShape::Fiducial { family, code, .. } => (Some(family.clone()), Some(*code)),
        _ => (None, None),
    };
    Some(Landmark {
        id: seen.feature.id,
        name: seen.feature.name.clone(),
        kind: seen.feature.shape.kind(),
        family,
        code,
        position_robot: in_robot(position_world),
        position_world: position_world.to_array(),
        corners_robot: if points.len() > 1 { points.iter().map(|p| in_robot(*p)).collect() } else { Vec::new() },
        range: p_in_sensor.length(),
        azimuth: p_in_sensor.y.atan2(p_in_sensor.x),
        elevation: p_in_sensor.z.atan2(p_in_sensor.x.hypot(p_in_sensor.y)),
        cos_incidence: seen.cos_incidence,
        visible_fraction: seen.visible_fraction,
        existence: seen.existence,
    })
}
