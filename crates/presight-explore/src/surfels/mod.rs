//! Surfels: oriented samples of surfaces, as small as the measurements allow.

mod detail;
mod graph;
mod layers;
mod surfel;

pub(crate) use detail::{Detail, NEAR, Noise, SMALLEST};
pub(crate) use graph::Surface;
pub(crate) use layers::joined;
pub(crate) use surfel::{Surfel, lasting, surfels};
