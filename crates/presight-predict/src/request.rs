//! Requests: everything that one prediction should deliver.

use presight_features::{BoxOptions, FeatureOptions};
use presight_model::error::{Error, Result};
use presight_model::measured::ScanMotion;
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
    /// How the robot moves while the sensor measures its rays, relative to its pose at the stamp; the pose of the
    /// prediction is the sensor's at the stamp. `None` if the robot stands.
    pub motion: Option<ScanMotion>,
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

    /// Sets how the robot moves while the sensor measures its rays ([`presight_model::sensor::SensorSpec::times`]). Each
    /// pixel is then predicted from where its ray starts at its own time.
    ///
    /// ```
    /// use presight::measured::ScanMotion;
    /// use presight::{Request, Twist};
    /// let twist = Twist::new(glam::DVec3::X * 1.5, glam::DVec3::Z); // 1.5 m/s ahead, 1 rad/s to the left
    /// assert!(Request::default().with_motion(ScanMotion::Twist(twist)).motion.is_some());
    /// ```
    #[must_use]
    pub fn with_motion(self, motion: ScanMotion) -> Self {
        Self { motion: Some(motion), ..self }
    }

    /// Checks that the request is valid for a sensor.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Usage`] for `depth_z` of a sensor that is not a camera, for `feature_id` or regions
    /// without features, for a confidence outside 0.5..1, for an invalid priority, and for features or a deadline if no
    /// single pose holds for all rays; [`presight_model::ErrorKind::Invalid`] for an invalid covariance matrix.
    pub fn check(&self, sensor: &Sensor) -> Result<()> {
        self.check_bundles(sensor)?;
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

    /// True if the sensor moves while it measures its rays.
    pub(crate) fn moves(&self, sensor: &Sensor) -> bool {
        self.motion.as_ref().is_some_and(|m| !m.is_still()) && !sensor.spec().times.is_at_once()
    }

    /// Refuses what needs one pose for all rays.
    fn check_bundles(&self, sensor: &Sensor) -> Result<()> {
        if let Some(ScanMotion::Twist(twist)) = &self.motion {
            twist.check()?;
        }
        let why = if sensor.has_origins() {
            "the rays of the sensor start at several points"
        } else if self.moves(sensor) {
            "the sensor moves while it measures"
        } else {
            return Ok(());
        };
        let what = match (&self.features, self.deadline) {
            (Some(_), _) => "features",
            (None, Some(_)) => "a deadline",
            (None, None) => return Ok(()),
        };
        let remedy = format!("request images alone, or predict {what} with a sensor of one origin and one time");
        Err(Error::usage(format!("{what} of sensor {:?}, but {why}", sensor.spec().name), remedy))
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
