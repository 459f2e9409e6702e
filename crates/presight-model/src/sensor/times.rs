//! When the rays of a scan are measured.

use crate::error::{Error, Result};
use std::sync::Arc;

/// Maximum time between the first ray of a scan and the last, and between any ray and the stamp, seconds.
pub(super) const MAX_SCAN_S: f64 = 60.0;

/// The ray of a scan to which the stamp of a frame belongs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum StampAt {
    /// The ray measured first, as `sensor_msgs/LaserScan` has it.
    #[default]
    First,
    /// Halfway between the first ray and the last.
    Middle,
    /// The ray measured last.
    Last,
}

impl StampAt {
    /// Part of the scan's duration at the stamp.
    pub fn share(self) -> f64 {
        match self {
            Self::First => 0.0,
            Self::Middle => 0.5,
            Self::Last => 1.0,
        }
    }
}

/// When each ray of a scan is measured, relative to the stamp of its frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum RayTimes {
    /// All rays at the stamp.
    #[default]
    AtOnce,
    /// Column by column, in even steps.
    Columns {
        /// Seconds from the first column to one step behind the last. Negative if the last column is measured first.
        turn_s: f64,
        /// The ray to which the stamp belongs.
        stamp: StampAt,
    },
    /// Row by row, in even steps: a rolling shutter.
    Rows {
        /// Seconds from the first row to one step behind the last. Negative if the last row is measured first.
        readout_s: f64,
        /// The ray to which the stamp belongs.
        stamp: StampAt,
    },
    /// Seconds after the stamp for each ray, row by row; negative before it.
    Listed(Arc<[f32]>),
}

impl RayTimes {
    /// Times of a sensor that turns: see [`RayTimes::Columns`]. A turn of 0 s is [`RayTimes::AtOnce`].
    pub fn turning(turn_s: f64, stamp: StampAt) -> Self {
        if turn_s == 0.0 { Self::AtOnce } else { Self::Columns { turn_s, stamp } }
    }

    /// True if all rays are measured at the stamp.
    pub fn is_at_once(&self) -> bool {
        match self {
            Self::AtOnce => true,
            Self::Columns { turn_s: duration, .. } | Self::Rows { readout_s: duration, .. } => *duration == 0.0,
            Self::Listed(times) => times.iter().all(|t| *t == 0.0),
        }
    }

    /// Seconds after the stamp of a ray of an image of `size` columns and rows.
    pub fn seconds(&self, column: u32, row: u32, size: (u32, u32)) -> f64 {
        match self {
            Self::AtOnce => 0.0,
            Self::Columns { turn_s, stamp } => evenly(*turn_s, *stamp, column, size.0),
            Self::Rows { readout_s, stamp } => evenly(*readout_s, *stamp, row, size.1),
            Self::Listed(times) => f64::from(times[row as usize * size.0 as usize + column as usize]),
        }
    }

    /// Seconds after the stamp of the earliest ray and the latest.
    pub fn interval(&self, size: (u32, u32)) -> [f64; 2] {
        match self {
            Self::AtOnce => [0.0; 2],
            Self::Columns { turn_s, stamp } => even_interval(*turn_s, *stamp, size.0),
            Self::Rows { readout_s, stamp } => even_interval(*readout_s, *stamp, size.1),
            Self::Listed(times) => {
                let ends = times.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], t| [a.min(*t), b.max(*t)]);
                if times.is_empty() { [0.0; 2] } else { ends.map(f64::from) }
            }
        }
    }

    /// Checks that they fit an image of `size` columns and rows.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] for a number of times that is not that of the rays, and for a time that is not finite or
    /// is too far from the stamp.
    pub fn check(&self, size: (u32, u32)) -> Result<()> {
        let limit = format!("give seconds, at most {MAX_SCAN_S}; 0 if all rays are measured at the same time");
        match self {
            Self::AtOnce => {}
            Self::Columns { turn_s: s, .. } if !(s.abs() <= MAX_SCAN_S) => {
                return Err(Error::invalid(format!("turn_s of {s} s"), limit));
            }
            Self::Rows { readout_s: s, .. } if !(s.abs() <= MAX_SCAN_S) => {
                return Err(Error::invalid(format!("readout_s of {s} s"), limit));
            }
            Self::Columns { .. } | Self::Rows { .. } => {}
            Self::Listed(times) => {
                let rays = u64::from(size.0) * u64::from(size.1);
                if times.len() as u64 != rays {
                    let what = format!("{} times for {} x {} rays", times.len(), size.0, size.1);
                    return Err(Error::invalid(what, "give one time per ray, row by row"));
                }
                if let Some(at) = times.iter().position(|t| !(f64::from(t.abs()) <= MAX_SCAN_S)) {
                    let what = format!("a time of {} s after the stamp", times[at]);
                    return Err(Error::invalid(what, limit).at(format!("ray {at}")));
                }
            }
        }
        Ok(())
    }
}

/// Seconds from the first measured of `count` even steps to the last.
fn even_span(duration: f64, count: u32) -> f64 {
    duration.abs() * f64::from(count.saturating_sub(1)) / f64::from(count.max(1))
}

fn even_interval(duration: f64, stamp: StampAt, count: u32) -> [f64; 2] {
    let span = even_span(duration, count);
    [-stamp.share() * span, (1.0 - stamp.share()) * span]
}

fn evenly(duration: f64, stamp: StampAt, step: u32, count: u32) -> f64 {
    let done = if duration < 0.0 { count - 1 - step } else { step };
    duration.abs() * f64::from(done) / f64::from(count) - stamp.share() * even_span(duration, count)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: four columns in 0.4 s are 0.1 s apart, and the last is 0.3 s after the first.
    #[test]
    fn stamps_belong_to_the_first_the_middle_or_the_last_ray() {
        let seconds = |turn_s, stamp| {
            let times = RayTimes::turning(turn_s, stamp);
            let found = [0, 1, 2, 3].map(|c| times.seconds(c, 0, (4, 1)));
            let ends = times.interval((4, 1));
            assert!((found.iter().copied().fold(f64::INFINITY, f64::min) - ends[0]).abs() < 1e-12);
            assert!((found.iter().copied().fold(f64::NEG_INFINITY, f64::max) - ends[1]).abs() < 1e-12);
            found.map(|t| (t * 1e6).round() / 1e6)
        };
        assert_eq!(seconds(0.4, StampAt::First), [0.0, 0.1, 0.2, 0.3]);
        assert_eq!(seconds(-0.4, StampAt::First), [0.3, 0.2, 0.1, 0.0]);
        assert_eq!(seconds(0.4, StampAt::Last), [-0.3, -0.2, -0.1, 0.0]);
        assert_eq!(seconds(-0.4, StampAt::Middle), [0.15, 0.05, -0.05, -0.15]);
        assert_eq!(seconds(0.0, StampAt::Last), [0.0; 4]);
    }

    #[test]
    fn times_that_do_not_fit_are_refused() {
        assert!(RayTimes::Listed(vec![0.0; 3].into()).check((2, 2)).is_err());
        let e = RayTimes::Listed(vec![0.0, f32::NAN].into()).check((2, 1)).unwrap_err();
        assert!(e.to_string().contains("ray 1"), "{e}");
        assert!(RayTimes::turning(61.0, StampAt::First).check((2, 1)).is_err());
    }
}
