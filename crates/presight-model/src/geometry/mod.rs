//! Poses, boxes, planes and angles.

mod aabb;
mod plane;
mod pose;
mod trig;

pub use aabb::Aabb;
pub use plane::plane_of_loop;
pub use plane::{Plane, plane_of_polygon};
pub use pose::Pose;
pub use trig::{quat_deg, rotation_deg, sin_cos_deg, sin_cos_of_turn};

/// Covariance of a pose: x y z, then rotation about fixed x y z; metres and radians.
pub type PoseCovariance = [[f64; 6]; 6];
