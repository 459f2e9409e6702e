//! Poses, boxes and planes: the few shapes everything else is made of.

mod aabb;
mod plane;
mod pose;

pub use aabb::Aabb;
pub(crate) use plane::plane_of_loop;
pub use plane::{Plane, plane_of_polygon};
pub use pose::Pose;
