//! `tf2_msgs/msg/TFMessage` and `nav_msgs/msg/Odometry`.

use super::{Header, Message};
use crate::cdr::{Cursor, Field, Sink, fields};
use glam::{DQuat, DVec3};
use presight_model::error::Result;
use presight_model::geometry::Pose;

/// `geometry_msgs/msg/TransformStamped`: the pose of a frame in its parent.
#[derive(Clone, Debug, PartialEq)]
pub struct TransformStamped {
    /// Stamp, and the parent's frame.
    pub header: Header,
    /// The frame that has this pose in its parent.
    pub child_frame_id: String,
    /// parent_from_child, metres. The rotation is normalized; `None` if it is not finite or its length differs from 1
    /// by over 0.1.
    pub parent_from_child: Option<Pose>,
}

/// `tf2_msgs/msg/TFMessage`: transforms of one publication.
#[derive(Clone, Debug, PartialEq)]
pub struct TFMessage {
    /// The transforms.
    pub transforms: Vec<TransformStamped>,
}

impl Message<'_> for TFMessage {
    const TYPE: &'static str = "tf2_msgs/msg/TFMessage";
}

fields!(TransformStamped { header, child_frame_id, parent_from_child });
fields!(TFMessage { transforms });

/// `nav_msgs/msg/Odometry`.
#[derive(Clone, Debug, PartialEq)]
pub struct Odometry {
    /// Stamp, and the frame in which the pose is given.
    pub header: Header,
    /// The frame of the robot.
    pub child_frame_id: String,
    /// odom_from_child, metres; `None` as in [`TransformStamped::parent_from_child`].
    pub odom_from_child: Option<Pose>,
    /// Covariance of the pose, row by row: x y z, then rotation about x y z; metres and radians.
    pub pose_covariance: [f64; 36],
    /// Velocity of the child in its own axes: metres a second, then radians a second.
    pub twist: [f64; 6],
    /// Covariance of the velocity.
    pub twist_covariance: [f64; 36],
}

impl Message<'_> for Odometry {
    const TYPE: &'static str = "nav_msgs/msg/Odometry";
}

fields!(Odometry { header, child_frame_id, odom_from_child, pose_covariance, twist, twist_covariance });

/// Maximum deviation of a quaternion's length from 1 that rounding or drift of a publisher explains; tf2 warns from 0.1
/// on.
const MAX_QUATERNION_DEVIATION: f64 = 0.1;

/// Deviation of a normalized quaternion's length from 1: four rounded squares, their sum, a root and a division, each
/// off by half an epsilon at most.
const UNIT: f64 = 4.0 * f64::EPSILON;

/// Position, then quaternion x y z w; `None` for a pose that is not one, which is written as NaN.
impl<'a> Field<'a> for Option<Pose> {
    const MIN_SIZE: usize = 56;

    fn read(cursor: &mut Cursor<'a>) -> Result<Self> {
        let [x, y, z, qx, qy, qz, qw] = <[f64; 7]>::read(cursor)?;
        let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
        let deviation = (rotation.length() - 1.0).abs();
        let translation = DVec3::new(x, y, z);
        if !(deviation <= MAX_QUATERNION_DEVIATION && translation.is_finite()) {
            return Ok(None);
        }
        // A rotation that was normalized keeps its bits, so that a written pose reads back equal.
        let rotation = if deviation <= UNIT { rotation } else { rotation.normalize() };
        Ok(Some(Pose { translation, rotation }))
    }

    fn write(&self, sink: &mut Sink) {
        self.map_or([f64::NAN; 7], |pose| pose.to_array()).write(sink);
    }
}
