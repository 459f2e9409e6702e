//! Surfels: oriented samples of surfaces, as small as the measurements allow.

mod detail;
mod gather;
mod graph;
mod layers;
mod surfel;

pub(crate) use detail::{Detail, MIN_SIZE, Noise};
pub(crate) use gather::{permanent, surfels};
pub(crate) use graph::Surface;
pub(crate) use layers::merged;
pub(crate) use surfel::{NEAR, SIMILAR, Surfel};
