//! Features: placed on the model, predicted in images, and generated from the model.
#![doc = include_str!("../docs/features.md")]

#[doc(inline)]
pub use presight_features::generate::{
    FeatureCounts, FeatureKind, GenerateOptions, GeneratedLayer, Progress, generate, generate_with_progress,
};
#[doc(inline)]
pub use presight_features::roi::RoiFlag;
#[doc(inline)]
pub use presight_features::{
    BoxMethod, BoxOptions, FeatureOptions, FeaturePrediction, FeatureSource, Hidden, HiddenInterval, Occluder, Reason,
    SeenFeature, Visibility, VisibleInterval, sides_seen_in_part,
};
#[doc(inline)]
pub use presight_model::environment::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
#[doc(inline)]
pub use presight_model::place::place;
#[doc(inline)]
pub use presight_model::placement::{PlacedFeature, PlacedFeatures, lost as lost_features, place_layer, why_off};
