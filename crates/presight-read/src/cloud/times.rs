//! Times of points: which field holds them, in which unit, and from when they count.

use presight_model::error::{Error, Result};
use std::collections::HashSet;

/// The names of fields that drivers give to the time of a point.
const FIELDS: [&str; 4] = ["t", "time", "timestamp", "offset_time"];

/// Seconds of the longest scan: see [`presight_model::sensor::RayTimes`].
const MAX_SCAN_S: f64 = 60.0;
/// No clock counts that many seconds: as a number of seconds it is a time three thousand years from now, as nanoseconds
/// two minutes.
const MIN_NANOSECONDS: f64 = 1e11;
/// A driver stamps a scan within this time of its rays, seconds: it waits for one turn and sends it. Times farther from
/// the stamp come from another clock.
const MAX_STAMP_DISTANCE_S: f64 = 1.0;
/// A shorter scan than this is a wrong unit: no lidar makes a thousand scans a second. A robot at 2 m/s moves by 2 mm
/// in it.
const MIN_SCAN_S: f64 = 1e-3;
/// Minimum duration of a scan as a part of the known time between scans: microseconds taken as nanoseconds are a
/// thousandth of it, and the narrowest windows of spinning lidars a tenth.
const MIN_SCAN_PART: f64 = 0.05;
/// Fewer different times than this among as many points as [`MANY`] were rounded: at 1.5 m/s and 0.1 s for a scan,
/// points move by over 9 mm from one time to the next.
const MIN_DIFFERENT: usize = 16;
const MANY: usize = 256;

/// The times of the points of a cloud, as its field has them.
#[derive(Clone, Debug, PartialEq)]
pub struct PointTimes {
    /// The name of the field.
    pub field: String,
    /// A number for each point.
    pub values: Vec<f64>,
    /// True if the type of the field is a whole number.
    pub is_whole: bool,
}

/// The times of the rays of a scan.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct RaySeconds {
    /// The stamp of the scan, seconds.
    pub stamp: f64,
    /// Seconds after it for each point; 0 for one without a reading. `None` if the times are not usable.
    pub seconds: Option<Vec<f32>>,
    /// The interpretation of the field, and oddities of its times.
    pub notices: Vec<String>,
}

impl RaySeconds {
    /// The stamp alone, for a cloud without times.
    pub fn none(stamp: f64) -> Self {
        Self { stamp, seconds: None, notices: Vec::new() }
    }
}

/// The time of a scan as known without its points.
#[derive(Clone, Copy, Debug)]
pub(crate) enum ScanStamp {
    /// The stamp, seconds.
    Known(f64),
    /// No more than its place among other scans: times of a clock are the stamp.
    Counted(f64),
}

/// The index of the field of times among the names of fields. In a file that also has a field `s`, `t` is a coordinate
/// of a texture.
pub(crate) fn field_of<'a>(names: impl Iterator<Item = &'a str> + Clone) -> Option<usize> {
    let has_texture = names.clone().any(|name| name == "s");
    let place = |field: &&str| names.clone().position(|name| name == *field);
    FIELDS.iter().filter(|field| !(has_texture && **field == "t")).find_map(place)
}

impl PointTimes {
    /// Seconds after the stamp, from the times of the points that were measured. Scans come every `period` seconds, if
    /// that is known.
    ///
    /// Whole numbers are nanoseconds. Others are seconds, unless they span over a minute or are too large for a clock:
    /// then they are also nanoseconds. They count from the stamp or are times of a clock, whichever puts them nearer to
    /// the stamp.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::Invalid`] if they span over a minute in either unit.
    pub(crate) fn after(
        &self,
        stamp: ScanStamp,
        period: Option<f64>,
        is_measured: impl Fn(usize) -> bool,
    ) -> Result<RaySeconds> {
        let measured =
            || self.values.iter().enumerate().filter(|(i, t)| t.is_finite() && is_measured(*i)).map(|(_, t)| *t);
        let (min, max) = measured().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), t| (a.min(t), b.max(t)));
        let (ScanStamp::Known(given) | ScanStamp::Counted(given)) = stamp;
        let none = |stamp, notice: String| Ok(RaySeconds { stamp, seconds: None, notices: vec![notice] });
        let field = &self.field;
        if !(min <= max) {
            return none(given, format!("the field {field} has no time: points are taken as measured at the stamp"));
        }
        let (unit, in_unit) = self.unit(min, max);
        let (first, last) = (min * unit, max * unit);
        if last - first > MAX_SCAN_S {
            let what = format!("the times in the field {field} span {:.3} s", last - first);
            let remedy = format!("give scans of at most {MAX_SCAN_S} s, in seconds or whole nanoseconds");
            return Err(Error::invalid(what, remedy));
        }
        let origin = Origin::of(first, last, stamp);
        if min == max {
            let stamp = if let Origin::OwnClock = origin { first } else { given };
            return none(
                stamp,
                format!("all times in the field {field} are the same: points are taken as measured at the stamp"),
            );
        }
        let (stamp, zero) = origin.stamp_and_zero(first, given);
        let mut notices =
            vec![format!("times of points are taken from the field {field}: {in_unit}, {}", origin.name(last))];
        notices.extend(self.oddity(last - first, period, measured()));
        let seconds = |(i, t): (usize, &f64)| match t.is_finite() && is_measured(i) {
            true => (*t * unit - zero) as f32,
            false => 0.0,
        };
        Ok(RaySeconds { stamp, seconds: Some(self.values.iter().enumerate().map(seconds).collect()), notices })
    }

    /// Seconds in a unit, and its name.
    fn unit(&self, min: f64, max: f64) -> (f64, &'static str) {
        let is_seconds = !self.is_whole && max - min <= MAX_SCAN_S && min.abs().max(max.abs()) < MIN_NANOSECONDS;
        if is_seconds { (1.0, "seconds") } else { (1e-9, "nanoseconds") }
    }

    /// An oddity of the times.
    fn oddity(&self, span: f64, period: Option<f64>, measured: impl Iterator<Item = f64>) -> Option<String> {
        let field = &self.field;
        let expected = period.map_or(MIN_SCAN_S, |period| (MIN_SCAN_PART * period).max(MIN_SCAN_S));
        if span < expected {
            let every = period.map_or_else(String::new, |period| format!(", although scans come every {period:.3} s"));
            return Some(format!(
                "the times in the field {field} span only {span:.6} s{every}: the driver may count in another unit"
            ));
        }
        let (mut different, mut count) = (HashSet::new(), 0);
        for time in measured {
            count += 1;
            different.insert(time.to_bits());
            if different.len() >= MIN_DIFFERENT {
                return None;
            }
        }
        let few = different.len();
        (count >= MANY)
            .then(|| format!("the times in the field {field} have only {few} different values: they were rounded"))
    }
}

/// What times count from.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Origin {
    Stamp,
    /// The clock of the stamps.
    Clock,
    /// A clock that also gives the stamp.
    OwnClock,
    /// A clock that the stamps are not from.
    OtherClock,
}

impl Origin {
    /// The origin of times from first to last, seconds.
    fn of(first: f64, last: f64, stamp: ScanStamp) -> Self {
        let distance = |zero: f64| (first - zero).max(zero - last).max(0.0);
        match stamp {
            ScanStamp::Counted(_) if distance(0.0) > MAX_STAMP_DISTANCE_S => Self::OwnClock,
            ScanStamp::Counted(_) => Self::Stamp,
            ScanStamp::Known(stamp) => match (distance(0.0), distance(stamp)) {
                (from_stamp, by_clock) if from_stamp.min(by_clock) > MAX_STAMP_DISTANCE_S => Self::OtherClock,
                (from_stamp, by_clock) if from_stamp <= by_clock => Self::Stamp,
                _ => Self::Clock,
            },
        }
    }

    /// The stamp of the scan, and the time of the field at it.
    fn stamp_and_zero(self, first: f64, given: f64) -> (f64, f64) {
        match self {
            Self::Stamp => (given, 0.0),
            Self::Clock => (given, given),
            Self::OwnClock => (first, first),
            Self::OtherClock => (given, first),
        }
    }

    fn name(self, last: f64) -> &'static str {
        match self {
            Self::Stamp if last <= 0.0 => "counted back from the stamp",
            Self::Stamp => "counted from the stamp",
            Self::Clock => "on the clock of the stamps",
            Self::OwnClock => "which also give the stamp, that of the first ray",
            Self::OtherClock => "of another clock than the stamps: the first ray is taken as measured at the stamp",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(values: &[f64], is_whole: bool, stamp: ScanStamp) -> RaySeconds {
        let times = PointTimes { field: "t".into(), values: values.to_vec(), is_whole };
        times.after(stamp, Some(0.1), |_| true).unwrap()
    }

    /// By hand: three points in a tenth of a second, as the drivers of the makers write them.
    #[test]
    fn unit_and_origin_follow_from_type_and_range() {
        let stamp = 1_700_000_000.25;
        let known = ScanStamp::Known(stamp);
        let after = [0.0, 0.05, 0.1];
        let before = [-0.1, -0.05, 0.0];
        let on = |base: f64, unit: f64| after.map(|t| (base + t) * unit);
        for (values, is_whole, truth, words) in [
            (on(0.0, 1e9), true, after, "nanoseconds, counted from the stamp"),
            (on(0.0, 1.0), false, after, "seconds, counted from the stamp"),
            (before, false, before, "seconds, counted back from the stamp"),
            (on(0.0, 1e9), false, after, "nanoseconds, counted from the stamp"),
            (before.map(|t| 1e9 * t), true, before, "nanoseconds, counted back"),
            (on(stamp, 1.0), false, after, "seconds, on the clock of the stamps"),
            (on(stamp - 0.1, 1.0), false, before, "seconds, on the clock"),
            (on(stamp, 1e9), true, after, "nanoseconds, on the clock"),
            (on(stamp, 1e9), false, after, "nanoseconds, on the clock"),
            // A lidar whose clock is not set.
            (on(345.0, 1.0), false, after, "seconds, of another clock"),
            (on(345.0, 1e9), true, after, "nanoseconds, of another clock"),
        ] {
            let found = taken(&values, is_whole, known);
            let seconds = found.seconds.unwrap();
            assert!(
                seconds.iter().zip(truth).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-6),
                "{values:?}: {seconds:?}"
            );
            assert_eq!((found.stamp, found.notices.len()), (stamp, 1), "{:?}", found.notices);
            assert!(found.notices[0].contains(words), "{values:?}: {:?}", found.notices);
        }
        // A simulator's clock starts at 0, and so may a log's: the nearer reading counts.
        let found = taken(&on(5.0, 1.0), false, ScanStamp::Known(5.0));
        assert!(found.seconds.unwrap()[0].abs() < 1e-6 && found.notices[0].contains("clock of the stamps"));
        // Times of a clock are the stamp of a scan that has no other.
        let found = taken(&on(stamp, 1e9), true, ScanStamp::Counted(3.0));
        assert!((found.stamp - stamp).abs() < 1e-6 && found.seconds.unwrap()[2] > 0.0999);
        assert_eq!(taken(&after, false, ScanStamp::Counted(3.0)).stamp, 3.0);
    }

    #[test]
    fn odd_times_are_noticed() {
        let known = ScanStamp::Known(10.0);
        let same = taken(&[0.02; 5], false, known);
        assert!(same.seconds.is_none() && same.notices[0].contains("all times in the field t are the same"));
        let none = taken(&[f64::NAN; 5], false, known);
        assert!(none.seconds.is_none() && none.notices[0].contains("has no time"));
        let microseconds = taken(&[0.0, 5e4, 1e5], true, known);
        assert!(microseconds.notices[1].contains("span only 0.000100 s, although scans come every 0.100 s"));
        let rounded: Vec<f64> = (0..1000).map(|i| f64::from(i / 100) * 0.01).collect();
        assert!(taken(&rounded, false, known).notices[1].contains("only 10 different values"));
        let fine: Vec<f64> = (0..1000).map(|i| f64::from(i) * 1e-4).collect();
        assert_eq!(taken(&fine, false, known).notices.len(), 1);
        let long = PointTimes { field: "t".into(), values: vec![0.0, 61e9], is_whole: true };
        let e = long.after(known, None, |_| true).unwrap_err();
        assert!(e.to_string().contains("span 61.000 s") && !e.remedy().is_empty(), "{e}");
        // Points without a reading have no influence.
        let mixed = PointTimes { field: "t".into(), values: vec![0.0, 0.1, 1e30, f64::NAN], is_whole: false };
        assert_eq!(mixed.after(known, None, |i| i < 2).unwrap().seconds.unwrap(), [0.0, 0.1, 0.0, 0.0]);
    }

    #[test]
    fn a_texture_is_no_time() {
        assert_eq!(field_of(["x", "y", "z", "t"].into_iter()), Some(3));
        assert_eq!(field_of(["x", "y", "z", "s", "t"].into_iter()), None);
        assert_eq!(field_of(["offset_time", "x", "timestamp"].into_iter()), Some(2));
        assert_eq!(field_of(["x", "y", "z"].into_iter()), None);
    }
}
