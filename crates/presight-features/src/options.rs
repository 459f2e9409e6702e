//! Which features a prediction is asked for, and how finely.

use super::{PlacedFeatures, STEP, Visibility};

/// Where the features of a prediction come from.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum FeatureSource {
    /// The world's own layer for the sensor's class. The predictor finds their polygons once per version of the world.
    #[default]
    World,
    /// Features whose polygons were found before: by [`crate::placement::place_layer`], or from files.
    Placed(PlacedFeatures),
}

/// What a prediction says of features of which nothing is seen. Of those that are seen in part it always gives the hidden parts,
/// with their reasons.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Hidden {
    /// Every feature is told of, with each hidden part and its reason. Those that are out of view as a whole are listed apart, by number
    /// and reason ([`super::FeaturePrediction::out_of_view`]). All others are looked at.
    Full,
    /// Every feature is told of. One of which nothing is seen has one hidden part and one reason: of those that apply to
    /// parts of it the last in the order of [`super::Reason`]. Those out of view are listed apart as with `Full`.
    Reason,
    /// The prediction holds features that are seen, and the number of all. It costs what is in view, not what there is.
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
    /// Where they come from.
    pub source: FeatureSource,
    /// UTC seconds, for probabilities of existence. `None` means the newest confirmation of all features.
    pub time: Option<f64>,
    /// What is said of features of which nothing is seen.
    pub hidden: Hidden,
    /// Of the features that are seen the most that are kept, those that tell most of the sensor's pose; the rest is counted.
    /// `feature_id` shows all.
    pub max_features: Option<usize>,
    /// How visibility is decided.
    pub visibility: Visibility,
    /// Longest piece of a feature's image that one sample stands for, 0.001 pixels to [`STEP`]. Finer steps make visible
    /// fractions more precise and take longer. A patch that covers more than 1,024 pixels is sampled at its pixels. With
    /// [`Visibility::Rays`] a patch has up to 4,096 samples, and up to 64 times as many where the step is finer.
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
    /// Features whose polygons were found before, instead of the world's own layer.
    #[must_use]
    pub fn with_placed(self, placed: impl Into<PlacedFeatures>) -> Self {
        Self { source: FeatureSource::Placed(placed.into()), ..self }
    }

    /// With another time, UTC seconds.
    #[must_use]
    pub fn with_time(self, seconds: f64) -> Self {
        Self { time: Some(seconds), ..self }
    }

    /// With more or less said of features of which nothing is seen.
    #[must_use]
    pub fn with_hidden(self, hidden: Hidden) -> Self {
        Self { hidden, ..self }
    }

    /// With no more features that are seen than this: one by one those that add most to the logarithm of the determinant of the
    /// pose's information, weighted by existence and contrast.
    #[must_use]
    pub fn with_max_features(self, most: usize) -> Self {
        Self { max_features: Some(most), ..self }
    }

    /// With another way to decide visibility.
    #[must_use]
    pub fn with_visibility(self, visibility: Visibility) -> Self {
        Self { visibility, ..self }
    }

    /// With another step of sampling, pixels.
    #[must_use]
    pub fn with_step(self, step: f64) -> Self {
        Self { step, ..self }
    }
}
