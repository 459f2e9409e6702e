//! Features in a world: their polygons, their visible parts, and their positions in a sensor's image.

mod boxes;
mod choose;
mod columns;
mod contour;
pub mod generate;
pub mod normal;
mod options;
mod place;
mod prediction;
pub mod roi;
mod sample;
mod sides;
mod tree;
mod view;
mod visible;

#[cfg(feature = "gpu")]
pub use boxes::{BoxFrame, BoxScratch, Kind as ImageKind};
pub use boxes::{BoxMethod, BoxOptions, sensor_covariance};
#[doc(hidden)]
pub use boxes::{BoxQuery, add_boxes};
pub use choose::{choose, informations};
pub use columns::turn;
pub use contour::ContourSet;
#[cfg(all(feature = "gpu", test))]
pub use normal::{TAIL_CELLS, TAIL_COLUMNS, TAIL_ROWS};
#[cfg(feature = "gpu")]
pub use normal::{TAIL_STEPS, Tails};
pub use options::{FeatureOptions, FeatureSource, Hidden, PlacedFeatures};
pub use place::lies_on;
pub use place::place;
pub use place::place_lying;
pub use prediction::along;
pub use prediction::{FeaturePrediction, FeatureStats, HiddenInterval, Occluder, Reason, SeenFeature, VisibleInterval};
pub use sample::{MAX_PATCH_SAMPLES, MAX_SEGMENT_SAMPLES, Piece, STEP, Sample, Sampler};
pub use sides::sides_seen_in_part;
pub use tree::{FeatureTree, check_placed};
pub use visible::PreparedFeatures;
pub use visible::{FeatureSamples, OcclusionHint, Visibility};
#[doc(hidden)]
pub use visible::{FeatureSettings, predict_features};

use crate::environment::Feature;
use std::sync::Arc;

/// A feature with its object and polygons in one version of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedFeature {
    /// The feature from the layer, in the frame of its object.
    pub feature: Arc<Feature>,
    /// Index of its object; `None` means the world.
    pub object: Option<u32>,
    /// Slots of the polygons on which it lies. They never hide the feature. For a contour these are the polygons of its
    /// surface; a polygon does not hide the parts of a curve that touch it.
    pub slots: Vec<u32>,
}
