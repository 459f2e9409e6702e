//! Which feature each pixel shows, and what is found of neighbouring features.

use super::worker::FeatureResult;
use crate::{FeatureStats, SeenFeature};
use presight_model::environment::{Feature, FeatureShape};

/// Which feature each pixel shows: points and landmarks over segments over contours over patches, then lower numbers.
pub struct Marks(pub(super) Vec<u64>);

impl Marks {
    pub fn add(&mut self, feature: &Feature, pixels: &[u32]) {
        let key = u64::from(layer_of(&feature.shape)) << 32 | u64::from(feature.id);
        for pixel in pixels {
            let at = &mut self.0[*pixel as usize];
            *at = key.min(*at);
        }
    }

    /// The numbers of features, 0 is none.
    pub fn into_image(self) -> Vec<u32> {
        self.0.into_iter().map(|key| if key == u64::MAX { 0 } else { key as u32 }).collect()
    }
}

/// What is found of some neighbouring features.
#[derive(Default)]
pub(super) struct Part {
    pub features: Vec<SeenFeature>,
    pub given: Vec<u32>,
    /// By number of the feature, the pixels in which it shows.
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
