//! Features in a world: which polygons they lie on, how much of each a sensor sees, and where.

mod boxes;
mod normal;
mod place;
mod prediction;
pub mod roi;
mod sample;
mod visible;

pub use boxes::{BoxOptions, add_boxes, sensor_covariance};
pub use place::place;
pub use prediction::{FeaturePrediction, FeatureStats, HiddenInterval, Occluder, Reason, SeenFeature, VisibleInterval};
pub use sample::{MAX_PATCH_SAMPLES, MAX_SEGMENT_SAMPLES, Piece, STEP, Sample, Sampler};
pub(crate) use visible::Prepared;
pub use visible::{FeatureOptions, Visibility, predict_features};

use crate::environment::Feature;

/// A feature with its place in a version of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedFeature {
    /// As the layer has it; geometry in the frame of its object.
    pub feature: Feature,
    /// Index of its object; `None` is the world.
    pub object: Option<u32>,
    /// Slots of the polygons it lies on: they never hide it.
    pub slots: Vec<u32>,
}
