//! Exploration: frames with poses become planes, convex polygons and objects (paper section 4).
//!
//! Use it through the crate `presight`, which gives the same names.

mod change;
mod evidence;
mod geometry;
mod known;
mod observe;
pub mod occupancy;
mod surface;
mod surfels;
mod track;
mod walls;

pub use change::{Exploration, ExploredObject, Known, MAX_MARKS};
pub use observe::{View, Views};
pub use surface::{Areas, ExploreOptions};
pub use track::{Follower, FoundPose};
