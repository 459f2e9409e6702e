//! The ROS 2 messages that presight reads and writes, after `common_interfaces` and `geometry2` of ROS 2 Jazzy.

mod answer;
mod definition;
mod image;
mod laser_scan;
mod marker;
mod point_cloud;
mod transform;

pub use answer::{DiagnosticArray, DiagnosticStatus, PoseWithCovarianceStamped};
pub use definition::definition;
pub use image::{CameraInfo, CompressedImage, Image};
pub use laser_scan::LaserScan;
pub use marker::{MarkerArray, MarkerKind, SceneMarker};
pub use point_cloud::{PointCloud2, PointField, Scalar};
pub use transform::{Odometry, TFMessage, TransformStamped};

use crate::cdr::{Cursor, Field, Sink};
use presight_model::error::Result;

/// A message type: its name in ROS, and its serialization.
pub trait Message<'a>: Field<'a> {
    /// Its name, `package/msg/Type`.
    const TYPE: &'static str;

    /// Decodes a serialized message with its header.
    ///
    /// # Errors
    /// As [`Cursor::new`] and [`Field::read`].
    fn decode(message: &'a [u8]) -> Result<Self> {
        Self::read(&mut Cursor::new(message)?)
    }

    /// Serializes the message, with its header, in little endian.
    fn encode(&self) -> Vec<u8> {
        let mut sink = Sink::new();
        self.write(&mut sink);
        sink.into_bytes()
    }
}

/// `std_msgs/msg/Header`: the time and the frame of a measurement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Header {
    /// Nanoseconds since the epoch of the recording's clock.
    pub stamp_ns: i64,
    /// The coordinate frame, as recorded: a leading slash is kept.
    pub frame_id: String,
}

impl Header {
    /// Decodes only the header, with which every stamped message starts.
    ///
    /// # Errors
    /// As [`Message::decode`].
    pub fn decode(message: &[u8]) -> Result<Self> {
        Self::read(&mut Cursor::new(message)?)
    }
}

/// Nanoseconds in a second.
const NANO: i64 = 1_000_000_000;

impl<'a> Field<'a> for Header {
    fn read(cursor: &mut Cursor<'a>) -> Result<Self> {
        let (seconds, nanoseconds) = (i32::read(cursor)?, u32::read(cursor)?);
        Ok(Self { stamp_ns: i64::from(seconds) * NANO + i64::from(nanoseconds), frame_id: String::read(cursor)? })
    }

    /// A stamp beyond the seconds that the message can hold has the rest in its nanoseconds.
    fn write(&self, sink: &mut Sink) {
        let seconds = self.stamp_ns.div_euclid(NANO).clamp(i32::MIN.into(), i32::MAX.into());
        let rest = (self.stamp_ns - seconds * NANO).clamp(0, u32::MAX.into());
        (seconds as i32).write(sink);
        (rest as u32).write(sink);
        self.frame_id.write(sink);
    }
}
