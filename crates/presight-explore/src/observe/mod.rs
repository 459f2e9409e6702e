//! Measurements at known poses.

mod normal;
mod spacing;
mod view;

pub(crate) use normal::{MIN_COSINE, oriented};
pub(crate) use spacing::{are_sparse, directions, spacing};
pub use view::{View, Views};
