//! Exploration: frames with poses become planes, convex polygons and objects (paper section 4).
//!
//! Use it through the crate `presight`, which gives the same names.

mod convex;
mod evidence;
mod field;
mod flat;
mod outline;
mod region;
mod solid;
mod surfaces;
mod surfel;
mod view;

pub use outline::Areas;
pub use surfaces::{ExploreOptions, Surfaces};
pub use view::{View, Views};
