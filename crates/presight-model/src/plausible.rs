//! Inputs that are well formed and make no sense: in another unit, or far from everything. Each finding names its figure
//! and a remedy.

use crate::error::{Error, Result};
use crate::geometry::Aabb;
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
