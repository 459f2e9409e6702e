//! Surfaces: planes with convex polygons, from surfels or from the triangles between sparse rays.

mod dense;
mod fit;
mod found;
mod mirror;
mod moments;
mod options;
mod outline;
mod region;
mod sheet;
mod solid;

pub(crate) use dense::{detail, explain};
pub(crate) use fit::PlaneFit;
pub(crate) use found::Surfaces;
pub use options::ExploreOptions;
pub use outline::Areas;
pub(crate) use outline::Piece;
pub(crate) use solid::{compare, mesh};
