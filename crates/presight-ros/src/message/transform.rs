//! `tf2_msgs/msg/TFMessage` and `nav_msgs/msg/Odometry`.

use super::{Header, Message};
use crate::cdr::Cursor;
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

    fn read(cursor: &mut Cursor<'_>) -> Result<Self> {
        // Stamp, two strings with their zeros, seven doubles.
        let count = cursor.read_length(8 + 5 + 5 + 56)?;
        let transforms = (0..count).map(|_| read_transform(cursor)).collect::<Result<_>>()?;
        Ok(Self { transforms })
    }
}

fn read_transform(cursor: &mut Cursor<'_>) -> Result<TransformStamped> {
    Ok(TransformStamped {
        header: Header::read(cursor)?,
        child_frame_id: cursor.read_string()?,
        parent_from_child: read_pose(cursor)?,
    })
}

/// `nav_msgs/msg/Odometry` without its covariances and twist, which presight does not use.
#[derive(Clone, Debug, PartialEq)]
pub struct Odometry {
    /// Stamp, and the frame in which the pose is given.
    pub header: Header,
    /// The frame of the robot.
    pub child_frame_id: String,
    /// odom_from_child, metres; `None` as in [`TransformStamped::parent_from_child`].
    pub odom_from_child: Option<Pose>,
}

impl Message<'_> for Odometry {
    const TYPE: &'static str = "nav_msgs/msg/Odometry";

    fn read(cursor: &mut Cursor<'_>) -> Result<Self> {
        let odometry = Self {
            header: Header::read(cursor)?,
            child_frame_id: cursor.read_string()?,
            odom_from_child: read_pose(cursor)?,
        };
        cursor.read_array::<f64, 36>()?; // covariance of the pose
        cursor.read_array::<f64, 6>()?; // twist
        cursor.read_array::<f64, 36>()?; // covariance of the twist
        Ok(odometry)
    }
}

/// Maximum deviation of a quaternion's length from 1 that rounding or drift of a publisher explains; tf2 warns from 0.1
/// on.
const MAX_QUATERNION_DEVIATION: f64 = 0.1;

/// Position, then quaternion x y z w.
fn read_pose(cursor: &mut Cursor<'_>) -> Result<Option<Pose>> {
    let [x, y, z, qx, qy, qz, qw] = cursor.read_array::<f64, 7>()?;
    let rotation = DQuat::from_xyzw(qx, qy, qz, qw);
    let is_unit = (rotation.length() - 1.0).abs() <= MAX_QUATERNION_DEVIATION;
    let translation = DVec3::new(x, y, z);
    Ok((is_unit && translation.is_finite()).then(|| Pose { translation, rotation: rotation.normalize() }))
}
