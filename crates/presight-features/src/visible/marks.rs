//! Records the feature that each pixel shows, and the results of neighbouring features.

use super::worker::FeatureResult;
use crate::{FeatureStats, SeenFeature};
use presight_model::environment::{Feature, FeatureShape};

/// By pixel, the feature it shows. Points and landmarks win over segments, then contours, then patches; then lower ids.
pub struct Marks {
    /// By pixel.
    keys: Vec<u64>,
    /// Columns of the image, and those with directions of their own.
    columns: [usize; 2],
}

impl Marks {
    pub fn new(pixels: usize, columns: [usize; 2]) -> Self {
        Self { keys: vec![u64::MAX; pixels], columns }
    }

    pub fn add(&mut self, feature: &Feature, pixels: &[u32]) {
        let key = u64::from(layer_of(&feature.shape)) << 32 | u64::from(feature.id);
        for pixel in pixels {
            let at = &mut self.keys[*pixel as usize];
            *at = key.min(*at);
        }
    }

    /// The ids of the features; 0 where no feature is seen.
    pub fn into_image(self) -> Vec<u32> {
        let [width, distinct] = self.columns;
        let ids = self.keys.into_iter().map(|key| if key == u64::MAX { 0 } else { key as u32 });
        let mut image: Vec<u32> = ids.collect();
        // A last column with the direction of the first shows what the first does.
        if distinct < width {
            image.chunks_mut(width).for_each(|row| row[distinct] = row[0]);
        }
        image
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
