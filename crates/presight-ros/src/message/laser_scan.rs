//! `sensor_msgs/msg/LaserScan`.

use super::{Header, Message};
use crate::cdr::fields;

/// A planar scan.
#[derive(Clone, Debug, PartialEq)]
pub struct LaserScan {
    /// Stamp of the first ray, and the frame of the scanner: rays lie in its x-y plane.
    pub header: Header,
    /// Angle of the first ray about +z, radians.
    pub angle_min: f32,
    /// Angle of the last ray, radians.
    pub angle_max: f32,
    /// Angle from one ray to the next, radians; negative for a scanner that turns clockwise.
    pub angle_increment: f32,
    /// Seconds from one ray to the next; 0 if the driver does not know it.
    pub time_increment: f32,
    /// Seconds from one scan to the next; 0 if the driver does not know it.
    pub scan_time: f32,
    /// Minimum range, metres.
    pub range_min: f32,
    /// Maximum range, metres.
    pub range_max: f32,
    /// Range of each ray, metres; REP-117.
    pub ranges: Vec<f32>,
    /// Strength of each echo in units of the driver; empty if it gives none.
    pub intensities: Vec<f32>,
}

impl Message<'_> for LaserScan {
    const TYPE: &'static str = "sensor_msgs/msg/LaserScan";
}

fields!(LaserScan {
    header,
    angle_min,
    angle_max,
    angle_increment,
    time_increment,
    scan_time,
    range_min,
    range_max,
    ranges,
    intensities
});
