//! The ROS 2 messages that presight reads, after `common_interfaces` and `geometry2` of ROS 2 Jazzy.

mod image;
mod laser_scan;
mod point_cloud;
mod transform;

pub use image::{CameraInfo, CompressedImage, Image};
pub use laser_scan::LaserScan;
pub use point_cloud::{PointCloud2, PointField, Scalar};
pub use transform::{Odometry, TFMessage, TransformStamped};

use crate::cdr::Cursor;
use presight_model::error::Result;

/// A message type: its name in ROS, and how to decode it.
pub trait Message<'a>: Sized {
    /// Its name, `package/msg/Type`.
    const TYPE: &'static str;

    /// Decodes the fields in the order of the definition.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if the message ends early or a length is greater than the rest of it.
    fn read(cursor: &mut Cursor<'a>) -> Result<Self>;

    /// Decodes a serialized message with its header.
    ///
    /// # Errors
    /// As [`Cursor::new`] and [`Message::read`].
    fn decode(message: &'a [u8]) -> Result<Self> {
        Self::read(&mut Cursor::new(message)?)
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
    /// Decodes a header, with which every stamped message starts.
    ///
    /// # Errors
    /// As [`Message::read`].
    pub fn read(cursor: &mut Cursor<'_>) -> Result<Self> {
        let (seconds, nanoseconds) = (cursor.read::<i32>()?, cursor.read::<u32>()?);
        Ok(Self {
            stamp_ns: i64::from(seconds) * 1_000_000_000 + i64::from(nanoseconds),
            frame_id: cursor.read_string()?,
        })
    }
}
