//! Requests: all that one prediction is asked for.

use presight_features::{BoxOptions, FeatureOptions};
use presight_model::error::{Error, Result};
use presight_model::sensor::Sensor;
use presight_render::deadline::Priority;
use presight_render::plan::{IdScheme, ImageRequest, Output, Outputs};
use std::time::Duration;

/// All that one prediction is asked for. What is not asked for costs nothing.
///
/// ```
/// use presight::features::{BoxOptions, FeatureOptions};
/// use presight::{Output, Outputs, Request};
/// let request = Request::of(Outputs::of(&[Output::Range]))
///     .with_features(FeatureOptions::default())
///     .with_regions(BoxOptions::default().with_confidence(0.95));
/// assert!(request.features.is_some() && !request.outputs.has(Output::ObjectId));
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Request {
    /// The images.
    pub outputs: Outputs,
    /// Which number `polygon_id` holds.
    pub ids: IdScheme,
    /// The features, if any are to be predicted.
    pub features: Option<FeatureOptions>,
    /// Regions of interest of these features, if they are asked for.
    pub regions: Option<BoxOptions>,
    /// The time that all of it may take, from the call on; what cannot be made in it is given up (see [`crate::deadline`]).
    /// `None` means as long as it takes, and reads no clock to decide anything.
    pub deadline: Option<Duration>,
    /// What matters most where not all can be made in time.
    pub priority: Priority,
}

impl Request {
    /// Asks for images only.
    pub fn of(outputs: Outputs) -> Self {
        Self { outputs, ..Self::default() }
    }

    /// With other images.
    #[must_use]
    pub fn with_outputs(self, outputs: Outputs) -> Self {
        Self { outputs, ..self }
    }

    /// With another number in `polygon_id`.
    #[must_use]
    pub fn with_ids(self, ids: IdScheme) -> Self {
        Self { ids, ..self }
    }

    /// With predicted features.
    #[must_use]
    pub fn with_features(self, features: FeatureOptions) -> Self {
        Self { features: Some(features), ..self }
    }

    /// With regions of interest of the features.
    #[must_use]
    pub fn with_regions(self, regions: BoxOptions) -> Self {
        Self { regions: Some(regions), ..self }
    }

    /// With a deadline.
    #[must_use]
    pub fn with_deadline(self, deadline: Duration) -> Self {
        Self { deadline: Some(deadline), ..self }
    }

    /// With what matters most where not all can be made in time.
    #[must_use]
    pub fn with_priority(self, priority: Priority) -> Self {
        Self { priority, ..self }
    }

    /// Checks that a sensor can answer it.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] for `depth_z` of a sensor that is not a camera, for `feature_id` or regions without
    /// features, for a confidence outside 0.5..1, and for a priority without sense; [`crate::ErrorKind::Invalid`] for a matrix that is no covariance.
    pub fn check(&self, sensor: &Sensor) -> Result<()> {
        if self.outputs.has(Output::DepthZ) && !sensor.is_camera() {
            let what = format!("sensor {:?} is no camera and has no depth_z", sensor.spec().name);
            return Err(Error::usage(what, "ask for range"));
        }
        if self.features.is_none() && (self.outputs.has(Output::FeatureId) || self.regions.is_some()) {
            let what = if self.regions.is_some() { "regions of interest are" } else { "feature_id is" };
            let remedy = "ask for features, too (Request::with_features)";
            return Err(Error::usage(format!("{what} asked for without features"), remedy));
        }
        self.priority.check()?;
        self.regions.as_ref().map_or(Ok(()), BoxOptions::check)
    }

    /// The images that are drawn: those asked for, and what features are predicted from.
    pub fn drawn(&self) -> ImageRequest {
        let outputs = if self.features.is_some() { self.outputs.with(Output::PolygonId) } else { self.outputs };
        ImageRequest { outputs, ids: self.ids }
    }
}

impl From<&Request> for ImageRequest {
    fn from(request: &Request) -> Self {
        Self { outputs: request.outputs, ids: request.ids }
    }
}
