//! Features in a world: their polygons, their visible parts, and their positions in a sensor's image.

mod boxes;
mod choose;
mod columns;
pub mod generate;
mod image_path;
mod options;
mod prediction;
pub mod roi;
mod sample;
mod sides;
mod tree;
mod vantage;
mod view;
mod visible;

pub use boxes::{BoxFrame, BoxScratch, Kind as ImageKind};
pub use boxes::{BoxMethod, BoxOptions};
pub use boxes::{BoxQuery, add_boxes};
pub use choose::{choose, informations};
pub use columns::turn;
pub use image_path::image_path;
pub use options::{FeatureOptions, FeatureSource, Hidden};
pub use prediction::along;
pub use prediction::{FeaturePrediction, FeatureStats, HiddenInterval, Occluder, Reason, SeenFeature, VisibleInterval};
pub use presight_model::place::{lies_on, place, place_lying};
pub use presight_model::placement::{PlacedFeature, PlacedFeatures};
pub use sample::{MAX_PATCH_SAMPLES, MAX_SEGMENT_SAMPLES, Piece, STEP, Sample, Sampler};
pub use sides::sides_seen_in_part;
pub use tree::{FeatureTree, check_placed};
pub use vantage::Vantage;
pub use visible::PreparedFeatures;
pub use visible::{FeatureSamples, OcclusionHint, Visibility};
pub use visible::{FeatureSettings, predict_features};
