//! Inputs that are well formed and make no sense: in another unit, or far from everything. Each finding names its figure
//! and a remedy.

use crate::error::{Error, Result};
use crate::geometry::Aabb;
use crate::sensor::{Angles, Geometry, SensorSpec};
use glam::DVec3;

/// Later than any time in seconds since 1970 that is meant: the year 5138. Milliseconds since 1970 passed it in 1973.
const MAX_STAMP_S: f64 = 1e11;

/// Checks a time stamp in seconds.
///
/// # Errors
/// [`crate::ErrorKind::Invalid`] if it is not finite, or can only be in a smaller unit.
pub fn check_stamp(seconds: f64) -> Result<()> {
    if !seconds.is_finite() {
        return Err(Error::invalid(format!("a time stamp of {seconds}"), "give finite seconds"));
    }
    if seconds.abs() <= MAX_STAMP_S {
        return Ok(());
    }
    let (unit, per_second) = unit_of(seconds.abs() / 1.7e9);
    let what = format!("a time stamp of {seconds:e} s is after the year 5000: are the times {unit}?");
    Err(Error::invalid(what, format!("give seconds: divide by {per_second:e}")))
}

/// The unit in which a time is this many times too large.
fn unit_of(times: f64) -> (&'static str, f64) {
    match times {
        t if t < 3e4 => ("milliseconds", 1e3),
        t if t < 3e7 => ("microseconds", 1e6),
        _ => ("nanoseconds", 1e9),
    }
}

/// Notices logs whose times are in another unit than seconds, by the time between their frames.
#[derive(Clone, Debug, Default)]
pub struct FramePeriod {
    last: Option<f64>,
    /// The shortest time between two frames, and their number.
    shortest: Option<f64>,
    count: usize,
}

/// Seconds between frames beyond which no robot records: one frame a minute. Milliseconds at 10 frames a second are 100.
const MAX_PERIOD_S: f64 = 60.0;

/// Minimum number of frames for a notice on the unit of time.
const MIN_FRAMES: usize = 3;

impl FramePeriod {
    /// Adds the stamp of the next frame.
    pub fn add(&mut self, seconds: f64) {
        if let Some(last) = self.last.replace(seconds) {
            let period = (seconds - last).abs();
            self.shortest = Some(self.shortest.map_or(period, |shortest| shortest.min(period)));
        }
        self.count += 1;
    }

    /// The notice, if all frames so far are too far apart.
    pub fn notice(&self) -> Option<String> {
        let period = self.shortest.filter(|period| self.count >= MIN_FRAMES && *period > MAX_PERIOD_S)?;
        // Robots record some 10 frames a second.
        let (unit, per_second) = unit_of(period / 0.1);
        Some(format!("frames are at least {period:.3e} s apart: are the times {unit}? Divide them by {per_second:e}"))
    }
}

/// A notice on a pose from which nothing is seen because it is farther outside of the model than the model is large.
pub fn far_outside(bounds: &Aabb, position: DVec3) -> Option<String> {
    let far = !bounds.is_empty() && bounds.distance_squared(position).sqrt() > bounds.size();
    far.then(|| {
        let (min, max) = (bounds.min, bounds.max);
        format!(
            "a pose is farther outside of the model than the model is large (x {:.1} to {:.1}, y {:.1} to {:.1}, z {:.1} to \
             {:.1} m): check the unit of its position and the axes",
            min.x, max.x, min.y, max.y, min.z, max.z
        )
    })
}

/// The notice on a list of poses, if one is farther outside of the model than the model is large.
pub fn poses_far_outside(bounds: &Aabb, positions: impl IntoIterator<Item = DVec3>) -> Option<String> {
    let (mut count, mut first, mut notice) = (0, None, None);
    for (index, position) in positions.into_iter().enumerate() {
        count += 1;
        if notice.is_none() {
            notice = far_outside(bounds, position);
            first = notice.as_ref().map(|_| index);
        }
    }
    notice.map(|notice| match (first, count) {
        (Some(first), 2..) => format!("pose {first} of {count}, from 0: {notice}"),
        _ => notice,
    })
}

/// Multiples of 15 degrees in a turn.
const TWENTY_FOURTHS: i32 = 24;

/// A notice on angles in degrees that are likely in radians: no angle is larger than a turn in radians, and one is a
/// multiple of 15 degrees in radians, rounded to three decimals or more, or of 90 degrees to two. 24 of the 6,283
/// numbers of three decimals below a turn are such multiples, and 4 of the 628 of two: of angles in degrees that small,
/// 1 in 157 is taken for radians. A whole number is never taken for radians.
pub fn radians(degrees: &[f64]) -> Option<String> {
    if degrees.iter().any(|angle| angle.abs() > std::f64::consts::TAU + 1e-3) {
        return None;
    }
    let meant = |angle: f64| (1..=TWENTY_FOURTHS).map(|n| f64::from(n) * 15.0).find(|meant| is_rounded(angle, *meant));
    let (angle, meant) = degrees.iter().find_map(|angle| Some((angle, meant(angle.abs())?)))?;
    Some(format!("the angle {angle} is {} degrees in radians: angles are in degrees", angle.signum() * meant))
}

/// True if a number is the angle in radians, rounded to some number of decimals.
fn is_rounded(number: f64, degrees: f64) -> bool {
    let fewest = if degrees % 90.0 == 0.0 { 2 } else { 3 };
    (fewest..=15).any(|decimals| {
        let scale = 10f64.powi(decimals);
        // A pose that was composed has lost some digits.
        ((degrees.to_radians() * scale).round() / scale - number).abs() < 1e-12
    })
}

/// Metres between the origin of a robot and its sensor beyond which no robot reaches.
const MAX_MOUNT: f64 = 100.0;

/// Notices on the angles and the mount of a sensor: radians for degrees, and millimetres for metres.
pub fn of_sensor(spec: &SensorSpec) -> Vec<String> {
    let (roll, pitch, yaw) = spec.mount.rpy();
    let turned = radians(&[roll, pitch, yaw].map(f64::to_degrees)).map(|notice| format!("the mount: {notice}"));
    let distance = spec.mount.translation.length();
    let far = (distance > MAX_MOUNT).then(|| {
        format!("the mount is {distance:.0} m from the origin of the robot: is it in millimetres? Divide it by 1000")
    });
    let angles = match &spec.geometry {
        Geometry::Scanner(scanner) => radians(&ends(&scanner.azimuth)).map(|notice| format!("the azimuth: {notice}")),
        _ => None,
    };
    turned.into_iter().chain(far).chain(angles).collect()
}

/// The first and the last of the angles, degrees.
fn ends(angles: &Angles) -> Vec<f64> {
    match angles {
        Angles::Uniform { start_deg, step_deg, count } => {
            vec![*start_deg, start_deg + step_deg * f64::from(count.saturating_sub(1))]
        }
        Angles::Listed(all) => all.first().into_iter().chain(all.last()).copied().collect(),
    }
}

/// Share of readings at exactly the maximum range that means "no detection". A driver that rounds ranges to a
/// thousandth of its reach gives it to 1 reading in 1000 by chance: a fiftieth of this share.
const MAX_AT_REACH: f64 = 0.05;

/// Minimum number of readings for this notice: the chance that one in 20 is at the reach is then below 1e-9.
const MIN_READINGS: u64 = 100;

/// A notice on readings at exactly the maximum range: some drivers write it for rays without a detection.
pub fn at_reach(count: u64, all: u64, range_max: f64) -> Option<String> {
    let is_much = all >= MIN_READINGS && count as f64 > MAX_AT_REACH * all as f64;
    is_much.then(|| {
        format!(
            "{count} of {all} readings are exactly range_max, {range_max} m: if the driver writes it for rays without \
             a detection, write inf for them, or lower range_max"
        )
    })
}

/// Notices positions of the robot in millimetres, by the speed that they state.
#[derive(Clone, Debug, Default)]
pub struct Speeds {
    last: Option<f64>,
    fast: usize,
    moving: usize,
    fastest: f64,
}

/// Metres per second that no robot on wheels, legs or rotors reaches.
const MAX_SPEED: f64 = 100.0;

impl Speeds {
    /// Adds the distance that the robot moved until a stamp, metres.
    pub fn add(&mut self, seconds: f64, distance: Option<f64>) {
        let since = self.last.replace(seconds).map(|last| seconds - last);
        let speed = since.zip(distance).map(|(since, distance)| distance / since);
        if let Some(speed) = speed.filter(|speed| speed.is_finite() && *speed > 0.0) {
            self.moving += 1;
            self.fast += usize::from(speed > MAX_SPEED);
            self.fastest = self.fastest.max(speed);
        }
    }

    /// The notice, if the robot moves that fast in most frames; a single jump gives no notice.
    pub fn notice(&self, of: &str) -> Option<String> {
        let is_most = self.fast >= MIN_FRAMES && 2 * self.fast > self.moving;
        is_most.then(|| {
            format!(
                "{of} moves at up to {:.0} m/s: are its positions in millimetres? Divide them by 1000",
                self.fastest
            )
        })
    }
}

#[cfg(test)]
#[expect(clippy::approx_constant, reason = "angles as people round them")]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::sensor::Scanner;

    #[test]
    fn times_in_other_units_are_named() {
        for (stamp, unit) in [(1.7e12, "milliseconds"), (1.7e15, "microseconds"), (1.7e18, "nanoseconds")] {
            let e = check_stamp(stamp).unwrap_err().to_string();
            assert!(e.contains(unit), "{e}");
        }
        assert!(check_stamp(1.7e9).is_ok() && check_stamp(-5.0).is_ok() && check_stamp(f64::NAN).is_err());
        let notice = |period: f64| {
            let mut periods = FramePeriod::default();
            (0..4).for_each(|k| periods.add(f64::from(k) * period));
            periods.notice().unwrap_or_default()
        };
        assert!(notice(1e8).contains("nanoseconds") && notice(1e5).contains("microseconds"));
        assert!(notice(100.0).contains("milliseconds") && notice(1.0).is_empty());
    }

    /// By hand: a cube of 2 m has a diagonal of 3.46 m.
    #[test]
    fn poses_far_outside_are_named() {
        let bounds = Aabb { min: DVec3::splat(-1.0), max: DVec3::ONE };
        assert!(far_outside(&bounds, DVec3::X * 4.4).is_none());
        assert!(far_outside(&bounds, DVec3::X * 4.5).is_some());
        assert!(far_outside(&Aabb::EMPTY, DVec3::X * 4.5).is_none());
    }

    /// By hand: pi / 2 to two, three and five decimals; and what degrees look like.
    #[test]
    fn radians_are_told_from_degrees() {
        for angle in [1.57, 1.571, 1.570_80, -std::f64::consts::FRAC_PI_2, 0.7854, 3.14, 2.0944, 6.2832, 0.262] {
            assert!(radians(&[0.0, 0.0, angle]).is_some(), "{angle}");
        }
        for angle in [0.0, 1.0, 2.0, 1.5, 0.5, 90.0, 1.6, 0.26, 1.58, 3.2, 45.0] {
            assert_eq!(radians(&[0.0, 0.0, angle]), None, "{angle}");
        }
        assert_eq!(radians(&[0.0, 20.0, 1.5708]), None, "20 is an angle in degrees");
    }

    #[test]
    fn mounts_and_azimuths_in_other_units_are_named() {
        let scanner = |start_deg, step_deg| Scanner {
            azimuth: Angles::Uniform { start_deg, step_deg, count: 271 },
            elevation: Angles::Uniform { start_deg: 0.0, step_deg: 0.0, count: 1 },
            beam_height_deg: None,
        };
        let spec = |start, step| SensorSpec::new("s", "laser", Geometry::Scanner(scanner(start, step)));
        let mount = |x: f64, yaw_deg: f64| Pose::from_xyz_rpy(DVec3::new(x, 0.0, 0.2), 0.0, 0.0, yaw_deg.to_radians());
        assert_eq!(of_sensor(&spec(-135.0, 1.0).with_mount(mount(0.3, 90.0))), Vec::<String>::new());
        assert!(of_sensor(&spec(-135.0, 1.0).with_mount(mount(300.0, 0.0)))[0].contains("millimetres"));
        assert!(of_sensor(&spec(-135.0, 1.0).with_mount(mount(0.3, 1.5708)))[0].contains("the mount: the angle 1.570"));
        assert!(of_sensor(&spec(-2.356, 0.01745))[0].contains("the azimuth"));
    }

    #[test]
    fn readings_at_the_reach_and_positions_in_millimetres_are_named() {
        assert!(at_reach(250, 1000, 8.0).unwrap().contains("250 of 1000 readings are exactly range_max, 8 m"));
        assert!(at_reach(50, 1000, 8.0).is_none() && at_reach(25, 99, 8.0).is_none());
        let notice = |step: f64| {
            let mut speeds = Speeds::default();
            (0..10).for_each(|k| speeds.add(f64::from(k) / 10.0, (k > 0).then_some(step)));
            speeds.notice("the odometry")
        };
        // 1 m/s at 10 frames a second, in metres and in millimetres.
        assert_eq!(notice(0.1), None);
        assert_eq!(
            notice(100.0).unwrap(),
            "the odometry moves at up to 1000 m/s: are its positions in millimetres? Divide them by 1000"
        );
        let mut once = Speeds::default();
        (0..10).for_each(|k| once.add(f64::from(k), Some(if k == 5 { 1e4 } else { 1.0 })));
        assert_eq!(once.notice("the odometry"), None, "one jump");
    }
}
