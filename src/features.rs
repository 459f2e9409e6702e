//! Features: placed on the model, predicted in images, and generated from the model.
#![doc = include_str!("../docs/features.md")]

#[doc(inline)]
pub use presight_features::generate::{FeatureKind, GenerateOptions, generate, generate_with_progress};
#[doc(inline)]
pub use presight_features::{FeatureOptions, FeaturePrediction, Hidden, Reason, SeenFeature, sides_seen_in_part};
#[doc(inline)]
pub use presight_model::environment::{Existence, Feature, FeatureLayer, FeatureShape, Properties};
#[doc(inline)]
pub use presight_model::place::place;
#[doc(inline)]
pub use presight_model::placement::{PlacedFeature, PlacedFeatures};
