//! Exploration: frames with poses become planes, convex polygons and objects (paper section 4).
//!
//! Use it through the crate `presight`, which gives the same names.

mod convex;
mod detail;
mod evidence;
mod exploration;
mod field;
mod flat;
mod follow;
mod group;
mod layers;
mod mirror;
mod objects;
pub mod occupancy;
mod outline;
mod plan;
mod region;
mod rough;
mod segment;
mod sheet;
mod solid;
mod surfaces;
mod surfel;
mod view;

pub use exploration::{Exploration, Known, MOST_MARKS};
pub use follow::{Follower, FoundPose};
pub use objects::ExploredObject;
pub use outline::Areas;
pub use surfaces::ExploreOptions;
pub use view::{View, Views};
