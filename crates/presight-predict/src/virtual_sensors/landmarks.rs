//! Artificial landmarks: reflectors and fiducial markers that are seen, and where they are.

use super::View;
use glam::DVec3;
use presight_features::{FeaturePrediction, SeenFeature};
use presight_model::environment::FeatureShape;
use serde::Serialize;

/// The artificial landmarks that are seen.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Landmarks {
    /// In the order of the layer.
    pub landmarks: Vec<Landmark>,
    /// Landmarks that the prediction has an entry for, seen or not ([`crate::features::Hidden`]).
    pub known: usize,
}

/// An artificial landmark that is seen.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Landmark {
    /// Its number in the layer.
    pub id: u32,
    /// Its name there.
    pub name: Option<String>,
    /// `reflector` or `fiducial`.
    pub kind: &'static str,
    /// OpenCV's name of a fiducial's dictionary.
    pub family: Option<String>,
    /// A fiducial's number in it.
    pub code: Option<u32>,
    /// Where it is, metres; of a fiducial the middle.
    pub position_robot: [f64; 3],
    /// The same in the world.
    pub position_world: [f64; 3],
    /// A fiducial's corners, clockwise from the top left seen from the front; empty for a reflector.
    pub corners_robot: Vec<[f64; 3]>,
    /// Metres from the sensor to the position.
    pub range: f64,
    /// About the sensor's z axis from its x axis, radians.
    pub azimuth: f64,
    /// Above the sensor's x-y plane, radians.
    pub elevation: f64,
    /// |cos| of the angle between ray and surface, where that is known.
    pub cos_incidence: Option<f64>,
    /// How much of it is seen, 0..=1.
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

/// `None` for one that has no points.
fn landmark(view: &View<'_>, seen: &SeenFeature) -> Option<Landmark> {
    let (sensor_from_world, mount) = (view.world_from_sensor.inverse(), view.sensor.spec().mount);
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
