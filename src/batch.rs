//! Batches: predictions for one sensor at many poses, such as the particles of a filter.
#![doc = include_str!("../docs/batches.md")]

#[doc(inline)]
pub use presight_predict::batch::{BatchItem, BatchRequest, Headings, PoseCell, RangeLikelihood};
