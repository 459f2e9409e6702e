//! Options of predicted features.

use super::{PlacedFeatures, STEP, Visibility};

/// The source of the features of a prediction.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum FeatureSource {
    /// The world's own layer for the sensor's class. The predictor finds their polygons once per version of the world.
    #[default]
    World,
    /// Features with known polygons, from [`presight_model::placement::place_layer`] or from files.
    Placed(PlacedFeatures),
}

/// The detail in which a prediction reports features without a visible part. Partly visible features always list all
/// hidden parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Hidden {
    /// Reports every feature, with each hidden part and its reason. Features entirely out of view are listed separately
    /// with index and reason ([`super::FeaturePrediction::out_of_view`]). All others are tested in full.
    Full,
    /// Reports every feature. A feature without a visible part has one hidden part. Its reason is the last, in the
    /// order of [`super::Reason`], among the reasons of its parts. Features out of view are listed as with `Full`.
    Reason,
    /// Reports visible features only, and the number of all. The cost depends on the features in view only.
    #[default]
    Count,
}

/// Which features are predicted, and how.
///
/// ```
/// use presight::features::FeatureOptions;
/// let options = FeatureOptions::default().with_time(1_790_000_000.0).with_step(0.25);
/// assert_eq!((options.time, options.step), (Some(1.79e9), 0.25));
/// ```
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct FeatureOptions {
    /// Source of the features.
    pub source: FeatureSource,
    /// Time of the probabilities of existence, UTC seconds. `None` means the newest confirmation of all features.
    pub time: Option<f64>,
    /// The detail in which features without a visible part are reported.
    pub hidden: Hidden,
    /// Maximum number of visible features to keep: those with the most information about the sensor's pose. The others
    /// are only counted. `feature_id` shows all.
    pub max_features: Option<usize>,
    /// How visibility is decided.
    pub visibility: Visibility,
    /// Maximum length of a feature's image per sample, 0.001 pixels to [`STEP`]. Finer steps make visible fractions
    /// more precise and take longer. A patch over more than 1,024 pixels is sampled at its pixels. With
    /// [`Visibility::Rays`] a patch has up to 4,096 samples, and up to 64 times as many for finer steps.
    pub step: f64,
}

impl Default for FeatureOptions {
    fn default() -> Self {
        Self {
            source: FeatureSource::default(),
            time: None,
            hidden: Hidden::default(),
            max_features: None,
            visibility: Visibility::default(),
            step: STEP,
        }
    }
}

impl FeatureOptions {
    /// Uses features with known polygons instead of the world's own layer.
    #[must_use]
    pub fn with_placed(self, placed: impl Into<PlacedFeatures>) -> Self {
        Self { source: FeatureSource::Placed(placed.into()), ..self }
    }

    /// Sets the time, UTC seconds.
    #[must_use]
    pub fn with_time(self, seconds: f64) -> Self {
        Self { time: Some(seconds), ..self }
    }

    /// Sets how features without a visible part are reported.
    #[must_use]
    pub fn with_hidden(self, hidden: Hidden) -> Self {
        Self { hidden, ..self }
    }

    /// Keeps at most this many visible features. They are chosen greedily by the log determinant of the pose
    /// information, weighted by existence and contrast.
    #[must_use]
    pub fn with_max_features(self, most: usize) -> Self {
        Self { max_features: Some(most), ..self }
    }

    /// Sets how visibility is decided.
    #[must_use]
    pub fn with_visibility(self, visibility: Visibility) -> Self {
        Self { visibility, ..self }
    }

    /// Sets the step of sampling, pixels.
    #[must_use]
    pub fn with_step(self, step: f64) -> Self {
        Self { step, ..self }
    }
}
