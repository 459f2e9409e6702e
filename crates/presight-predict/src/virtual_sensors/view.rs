//! Input of virtual sensors: a predicted or measured image.

use presight_features::FeaturePrediction;
use presight_model::environment::Environment;
use presight_model::geometry::SensorPose;
use presight_model::sensor::Sensor;
use presight_render::deadline::Degradation;
use presight_render::plan::IdScheme;

/// A predicted or measured view of a sensor at a pose.
///
/// ```
/// use presight::virtual_sensors::{Settings, View, VirtualSensor};
/// use presight_predict::virtual_sensors::Answer;
/// use presight::SensorPose;
/// // A measured scan: everything is 3 m away except at one beam.
/// let radar = presight::preset("microwave-radar-scan")?;
/// let mut range = vec![3.0; radar.width() as usize];
/// range[100] = 1.25;
/// let view = View::new(&radar, &SensorPose::IDENTITY).with_range(&range);
/// let reading = VirtualSensor::RadarNearest.reduce(&view, &Settings::default())?;
/// let Answer::RadarNearest(found) = &reading.answer else { unreachable!() };
/// let nearest = found.nearest.as_ref().expect("something is there");
/// assert!((nearest.range - 1.25).abs() < 1e-9);
/// assert_eq!((nearest.pixel, nearest.object.as_str()), ([100, 0], ""));
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub struct View<'a> {
    /// The sensor.
    pub sensor: &'a Sensor,
    /// Its pose, body axes.
    pub pose: SensorPose,
    /// Metres along each pixel's ray, row-major; see [`presight_render::Images`]. Empty for tasks that need features
    /// only.
    pub range: &'a [f32],
    /// Ids of what the pixels show, if known.
    pub ids: Option<ViewIds<'a>>,
    /// The visible features, for tasks that need them ([`super::VirtualSensor::needs_features`]).
    pub features: Option<&'a FeaturePrediction>,
    /// Results given up for a deadline. A pixel that has a ray but a NaN range is then unknown.
    pub given_up: Option<&'a Degradation>,
    /// True if the sensor moved while it measured the ranges, so that no single pose holds for them.
    pub moves: bool,
}

/// Ids of the polygons and objects that the pixels show.
#[derive(Clone, Copy, Debug)]
pub struct ViewIds<'a> {
    /// The environment to which the ids refer.
    pub environment: &'a Environment,
    /// Which number `polygon_id` holds.
    pub scheme: IdScheme,
    /// See [`presight_render::Images::polygon_id`].
    pub polygon_id: &'a [u32],
    /// See [`presight_render::Images::object_id`].
    pub object_id: &'a [u32],
}

impl<'a> View<'a> {
    /// A view of a sensor at a pose without images or features.
    pub fn new(sensor: &'a Sensor, pose: &SensorPose) -> Self {
        Self { sensor, pose: *pose, range: &[], ids: None, features: None, given_up: None, moves: false }
    }

    /// Sets the ranges, metres along each pixel's ray, row-major.
    #[must_use]
    pub fn with_range(self, range: &'a [f32]) -> Self {
        Self { range, ..self }
    }

    /// Sets the ids of what the pixels show.
    #[must_use]
    pub fn with_ids(self, ids: ViewIds<'a>) -> Self {
        Self { ids: Some(ids), ..self }
    }

    /// Sets the visible features.
    #[must_use]
    pub fn with_features(self, features: &'a FeaturePrediction) -> Self {
        Self { features: Some(features), ..self }
    }
}
