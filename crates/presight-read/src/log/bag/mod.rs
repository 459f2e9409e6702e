//! ROS 2 bags as logs: the frames of one topic, with mount, odometry and reference from the bag's transforms.
//!
//! - **Measured**: `LaserScan`; `PointCloud2`; `Image` of `32FC1`, `16UC1` (millimetres, REP-118), `mono8` and
//!   `mono16`; `CompressedImage` of `compressedDepth` in PNG.
//! - **Mount**: `/tf_static` from the robot's base to the frame of the messages, wherever in the bag it was recorded.
//! - **Odometry**: `/tf` from `odom` to the base, else the one topic of `nav_msgs/msg/Odometry`.
//! - **Reference**: `/tf` from `map` to the base. Estimates must not use it.
//!
//! Transforms are taken at the stamp of the message, interpolated and never extrapolated (REP-105). The motion during a
//! scan follows all transforms of the odometry from its first ray to its last. If they end before the last ray, the
//! velocity between the last two transforms is extended.

mod choice;
mod convert;
mod drive;
mod live;
mod report;
mod scan_motion;
mod stream;

pub use choice::{Choice, Measured};
pub use drive::BagFrames;
pub use live::LiveFrames;
pub use report::BagReport;

/// Seconds per nanosecond.
const NANO: f64 = 1e-9;
