//! Requests: everything that one prediction should deliver.

use presight_features::{BoxOptions, FeatureOptions};
use presight_model::error::{Error, Result};
use presight_model::sensor::Sensor;
use presight_render::deadline::Priority;
use presight_render::plan::{IdScheme, ImageRequest, Output, Outputs};
use std::time::Duration;

/// Everything that one prediction should deliver. Outputs that are not requested cost no time.
///
/// ```
/// use presight::features::FeatureOptions;
/// use presight::features::BoxOptions;
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
    /// Regions of interest of these features, if requested.
    pub regions: Option<BoxOptions>,
    /// Time limit from the call on. Results that cannot be computed in time are given up (see
    /// [`presight_render::deadline`]). `None` means no limit; no clock is then read to decide anything.
    pub deadline: Option<Duration>,
    /// What to compute first if time does not suffice for everything.
    pub priority: Priority,
}

impl Request {
    /// Requests images only.
    pub fn of(outputs: Outputs) -> Self {
        Self { outputs, ..Self::default() }
    }

    /// Replaces the images.
    #[must_use]
    pub fn with_outputs(self, outputs: Outputs) -> Self {
        Self { outputs, ..self }
    }

    /// Sets the number that `polygon_id` holds.
    #[must_use]
    pub fn with_ids(self, ids: IdScheme) -> Self {
        Self { ids, ..self }
    }

    /// Adds predicted features.
    #[must_use]
    pub fn with_features(self, features: FeatureOptions) -> Self {
        Self { features: Some(features), ..self }
    }

    /// Adds regions of interest of the features.
    #[must_use]
    pub fn with_regions(self, regions: BoxOptions) -> Self {
        Self { regions: Some(regions), ..self }
    }

    /// Sets the deadline.
    #[must_use]
    pub fn with_deadline(self, deadline: Duration) -> Self {
        Self { deadline: Some(deadline), ..self }
    }

    /// Sets what to compute first if time does not suffice for everything.
    #[must_use]
    pub fn with_priority(self, priority: Priority) -> Self {
        Self { priority, ..self }
    }

    /// Checks that the request is valid for a sensor.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for `depth_z` of a sensor that is not a camera, for `feature_id` or regions
    /// without features, for a confidence outside 0.5..1, and for an invalid priority;
    /// [`presight_model::ErrorKind::Invalid`] for an invalid covariance matrix.
    pub fn check(&self, sensor: &Sensor) -> Result<()> {
        if self.outputs.has(Output::DepthZ) && !sensor.is_camera() {
            let what = format!("sensor {:?} is not a camera and has no depth_z", sensor.spec().name);
            return Err(Error::usage(what, "request range"));
        }
        if self.features.is_none() && (self.outputs.has(Output::FeatureId) || self.regions.is_some()) {
            let what = if self.regions.is_some() { "regions of interest are" } else { "feature_id is" };
            let remedy = "request features, too (Request::with_features)";
            return Err(Error::usage(format!("{what} requested without features"), remedy));
        }
        self.priority.check()?;
        self.regions.as_ref().map_or(Ok(()), BoxOptions::check)
    }

    /// The images to render: the requested ones, and `polygon_id` if features are predicted.
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
