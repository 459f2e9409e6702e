//! Exploration without poses.

mod follow;
mod group;

pub use follow::{Follower, FoundPose};
