//! Features in grey images, looked for only where they are predicted.
//!
//! [`edges_near`] searches across a predicted edge and tells lines to a fraction of a pixel, with covariance and sense of contrast.
//! [`classify`] says of each feature whether it was matched, and if not, what the ranges beside it say of why.

mod classes;
mod edges;
mod image;
#[cfg(test)]
mod tests;

pub use classes::{Classes, FeatureClass, classify, verdicts_along};
pub use edges::{EdgeOptions, ExpectedEdge, FoundEdge, edges_near};
pub use image::GreyImage;
