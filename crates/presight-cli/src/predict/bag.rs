//! Predictions as messages of a ROS 2 bag.

use super::Args;
use presight::ros::{MessageOrigin, Record};
use presight::{Prediction, Result};

/// The messages of a prediction; with the mount of its sensor at the first pose, and the pose of the robot
/// with its first sensor.
pub fn records(
    args: &Args,
    prediction: &Prediction,
    stamp: &str,
    (is_first, tells_pose): (bool, bool),
) -> Result<Vec<Record>> {
    let sensor = &prediction.sensor;
    let mut origin = MessageOrigin::of_sensor(stamp.parse().unwrap_or_default(), sensor);
    origin.stamp_ns = nanoseconds(stamp).unwrap_or(origin.stamp_ns);
    origin.map.clone_from(&args.bag_frame);
    let mount = is_first.then(|| origin.mount(sensor));
    let pose = tells_pose.then(|| origin.localization(&prediction.pose.robot(sensor).world_from_robot()));
    let images = origin.prediction(sensor, &prediction.images, args.outputs)?;
    Ok(mount.into_iter().chain(pose).chain(images).collect())
}

/// Nanoseconds of a time in seconds as it was written, without the rounding of f64; `None` if it has an exponent.
fn nanoseconds(stamp: &str) -> Option<i64> {
    let (seconds, fraction) = stamp.split_once('.').unwrap_or((stamp, ""));
    let digits: String = fraction.chars().chain("000000000".chars()).take(9).collect();
    let (seconds, digits) = (seconds.parse::<i64>().ok()?, digits.parse::<u32>().ok()?);
    let fraction = if stamp.starts_with('-') { -i64::from(digits) } else { digits.into() };
    seconds.checked_mul(1_000_000_000)?.checked_add(fraction)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_keep_all_of_their_digits() {
        assert_eq!(nanoseconds("1700000000.123456789"), Some(1_700_000_000_123_456_789));
        assert_eq!(nanoseconds("-1.25"), Some(-1_250_000_000));
        assert_eq!(nanoseconds("-0.5"), Some(-500_000_000));
        assert_eq!(nanoseconds("3"), Some(3_000_000_000));
        assert_eq!(nanoseconds("1e9"), None);
    }
}
