//! Records the feature that each pixel shows, and the results of neighbouring features.

use super::worker::FeatureResult;
use crate::{FeatureStats, SeenFeature};
use presight_model::environment::{Feature, FeatureShape};

/// By pixel, the feature it shows. Points and landmarks win over segments, then contours, then patches; then lower ids.
pub struct Marks(pub(super) Vec<u64>);

impl Marks {
    pub fn add(&mut self, feature: &Feature, pixels: &[u32]) {
        let key = u64::from(layer_of(&feature.shape)) << 32 | u64::from(feature.id);
        for pixel in pixels {
            let at = &mut self.0[*pixel as usize];
            *at = key.min(*at);
        }
    }

    /// The ids of the features; 0 where no feature is seen.
    pub fn into_image(self) -> Vec<u32> {
        self.0.into_iter().map(|key| if key == u64::MAX { 0 } else { key as u32 }).collect()
    }
}

/// Results for some neighbouring features.
#[derive(Default)]
pub(super) struct Part {
    pub features: Vec<SeenFeature>,
    pub given: Vec<u32>,
    /// The pixels that show each feature, with the index of the feature.
    pub pixels: Vec<(usize, Vec<u32>)>,
    pub stats: FeatureStats,
}

impl Part {
    pub fn take(&mut self, number: usize, FeatureResult { seen, stats, pixels }: FeatureResult) {
        self.stats.add(&stats);
        if let Some(seen) = seen {
            self.features.push(seen);
            self.given.push(number as u32);
        }
        if !pixels.is_empty() {
            self.pixels.push((number, pixels));
        }
    }
}

fn layer_of(shape: &FeatureShape) -> u32 {
    match shape {
        FeatureShape::Point { .. } | FeatureShape::Reflector { .. } | FeatureShape::Fiducial { .. } => 0,
        FeatureShape::Segment { .. } => 1,
        FeatureShape::Contour { .. } => 2,
        FeatureShape::Patch { .. } => 3,
    }
}
