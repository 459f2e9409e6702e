//! `geometry_msgs/msg/PoseWithCovarianceStamped` and `diagnostic_msgs/msg/DiagnosticArray`.

use super::{Header, Message};
use crate::cdr::{Cursor, Field, Sink, fields};
use presight_model::error::Result;
use presight_model::geometry::Pose;

/// An estimated pose of the robot, or a start pose that a person gives in RViz.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseWithCovarianceStamped {
    /// Stamp, and the frame in which the pose is given.
    pub header: Header,
    /// world_from_robot, metres; `None` as in [`super::TransformStamped::parent_from_child`].
    pub pose: Option<Pose>,
    /// Row by row: x y z, then rotation about fixed x y z of the world; metres and radians.
    pub covariance: [f64; 36],
}

impl Message<'_> for PoseWithCovarianceStamped {
    const TYPE: &'static str = "geometry_msgs/msg/PoseWithCovarianceStamped";
}

fields!(PoseWithCovarianceStamped { header, pose, covariance });

/// The state of parts of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct DiagnosticArray {
    /// Stamp; the frame is empty.
    pub header: Header,
    /// The parts.
    pub status: Vec<DiagnosticStatus>,
}

/// The state of one part.
#[derive(Clone, Debug, PartialEq)]
pub struct DiagnosticStatus {
    /// 0 for well, 1 for a warning, 2 for an error, 3 for a part that is silent.
    pub level: u8,
    /// The part.
    pub name: String,
    /// Its state in words.
    pub message: String,
    /// The device.
    pub hardware_id: String,
    /// Names and values.
    pub values: Vec<(String, String)>,
}

impl Message<'_> for DiagnosticArray {
    const TYPE: &'static str = "diagnostic_msgs/msg/DiagnosticArray";
}

fields!(DiagnosticStatus { level, name, message, hardware_id, values });
fields!(DiagnosticArray { header, status });

/// `diagnostic_msgs/msg/KeyValue`.
impl<'a> Field<'a> for (String, String) {
    fn read(cursor: &mut Cursor<'a>) -> Result<Self> {
        Ok((String::read(cursor)?, String::read(cursor)?))
    }

    fn write(&self, sink: &mut Sink) {
        self.0.write(sink);
        self.1.write(sink);
    }
}
