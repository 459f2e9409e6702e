//! From surfels to planes with convex polygons.

mod dense;
mod found;
mod mirror;
mod moments;
mod options;
mod outline;
mod region;
mod sheet;
mod solid;

pub(crate) use dense::detail;
pub(crate) use found::Surfaces;
pub use options::ExploreOptions;
pub use outline::Areas;
pub(crate) use outline::Piece;
pub(crate) use solid::{mesh, visit_world};
