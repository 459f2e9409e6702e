//! Times of single rays beside those that a sensor states.

use presight_model::error::{Error, Result};
use presight_model::sensor::{RayTimes, Sensor, SensorSpec};

/// Times of rays contradict the sensor's own if they differ by more than this part of its scan. A robot at 1.5 m/s that takes
/// 0.1 s for a scan moves by 15 mm meanwhile, less than the noise of a lidar; the wrong end of the scan is off by all of it.
const MAX_DEVIATION: f64 = 0.1;

/// Checks the seconds after the stamp of each ray, row by row.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if there is not one for each ray, one is not finite or too far from the stamp, or
/// they contradict the times of the sensor.
pub(super) fn check(times: &[f32], sensor: &SensorSpec) -> Result<()> {
    let size = sensor.geometry.size();
    let listed = RayTimes::Listed(times.into());
    listed.check(size).map_err(|e| e.at("times"))?;
    if sensor.times.is_at_once() {
        return Ok(());
    }
    let [first, last] = sensor.times.interval(size);
    let pixels = (0..size.1).flat_map(|r| (0..size.0).map(move |c| (c, r)));
    let off = |(c, r)| (listed.seconds(c, r, size) - sensor.times.seconds(c, r, size), (c, r));
    let worst = pixels.map(off).fold((0.0, (0, 0)), |a: (f64, _), b| if b.0.abs() > a.0.abs() { b } else { a });
    if worst.0.abs() <= MAX_DEVIATION * (last - first) {
        return Ok(());
    }
    let (off, (c, r)) = worst;
    let stated = sensor.times.seconds(c, r, size);
    let what = format!(
        "ray {c},{r} was measured {:.4} s after the stamp, but by the times of the sensor it is {stated:.4} s",
        stated + off
    );
    Err(Error::invalid(what, "leave out turn_s of the sensor, or the times of the rays").at("times"))
}

/// The sensor with these seconds after the stamp for each ray.
///
/// # Errors
/// As [`check`] and [`Sensor::new`].
pub(super) fn listed(sensor: &Sensor, times: &[f32]) -> Result<Sensor> {
    check(times, sensor.spec())?;
    Sensor::new(sensor.spec().clone().with_times(RayTimes::Listed(times.into())))
}

/// The sensor of frames that bring the times of their rays. It is kept for as long as these stay the same.
#[derive(Debug)]
pub(super) struct TimedSensor {
    sensor: Sensor,
    last: Option<Sensor>,
}

impl TimedSensor {
    pub fn new(sensor: Sensor) -> Self {
        Self { sensor, last: None }
    }

    /// The sensor with the times of a frame.
    ///
    /// # Errors
    /// As [`check`] and [`Sensor::new`].
    pub fn with(&mut self, times: Option<&[f32]>) -> Result<Sensor> {
        let Some(times) = times else { return Ok(self.sensor.clone()) };
        let is_same = |s: &&Sensor| matches!(&s.spec().times, RayTimes::Listed(own) if **own == *times);
        if let Some(last) = self.last.as_ref().filter(is_same) {
            return Ok(last.clone());
        }
        Ok(self.last.insert(listed(&self.sensor, times)?).clone())
    }
}
