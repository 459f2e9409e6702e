//! Poses, boxes, planes and angles.

mod aabb;
mod covariance;
mod frames;
mod plane;
mod pose;
mod trig;
mod twist;

pub use aabb::Aabb;
pub use covariance::{InObject, InRobot, InWorld, PoseCovariance, PoseEstimate};
pub use frames::{RobotPose, SensorPose};
pub(crate) use plane::PLANARITY;
pub use plane::{Plane, plane_of_loop, plane_of_polygon};
pub use pose::Pose;
pub use trig::{quat_deg, rotation_deg, sin_cos_deg, sin_cos_of_turn};
pub use twist::Twist;
