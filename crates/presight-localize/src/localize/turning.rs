//! Scans that take time are moved to one moment before they are matched: to the middle of the scan, where an error of the speed
//! does least, because half of the points are off to one side and half to the other.

use presight_model::error::{Error, Result};
use presight_model::measured::Frame;

/// A mean distance of frames may be shorter than the turn by this part: drivers round.
const ROUNDING: f64 = 1.1;
/// Frames after which their mean distance is known.
const KNOWN: f64 = 3.0;

/// Refuses scans that would have to be measured at once with the next one; `since` the first frame `count` frames have come.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if a turn takes longer than the frames are apart, in the mean.
pub(super) fn check(frame: &Frame, since: f64, count: f64) -> Result<()> {
    let [first, last] = frame.sensor().scan_interval();
    let max = ROUNDING * since / count + 4.0 * frame.sensor().spec().noise.stamp_sigma / count;
    if count < KNOWN || last - first <= max {
        return Ok(());
    }
    let what = format!("a scan of {:.3} s, but the scans come every {:.3} s", last - first, since / count);
    Err(Error::invalid(what, "give the time of one turn in the sensor file, or 0 if a scan is measured at once"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::measured::Measurement;
    use presight_model::sensor::{Angles, Geometry, RayTimes, Scanner, Sensor, SensorSpec, StampAt};

    /// Scans of 0.1 s are refused if they come every 0.05 s, once that is known; every 0.1 s they are accepted.
    #[test]
    fn a_turn_longer_than_the_frame_distance_is_refused() {
        let azimuth = Angles::Uniform { start_deg: -180.0, step_deg: 1.0, count: 360 };
        let scanner = Scanner { azimuth, elevation: Angles::Listed(vec![0.0]), beam_height_deg: None };
        let spec = SensorSpec::new("scanner", "laser", Geometry::Scanner(scanner));
        let sensor = Sensor::new(spec.with_times(RayTimes::turning(0.1, StampAt::First))).unwrap();
        let frame = Frame::new(0.0, sensor, Measurement::Range(vec![2.0; 360])).unwrap();
        let e = check(&frame, 0.2, 4.0).unwrap_err();
        assert!(e.to_string().contains("a scan of 0.100 s, but the scans come every 0.050 s"), "{e}");
        assert!(check(&frame, 0.4, 4.0).is_ok() && check(&frame, 0.05, 1.0).is_ok());
    }
}
