//! Times of single rays, and their agreement with the times that a sensor states.

use presight_model::error::{Error, Result};
use presight_model::sensor::{RayTimes, Sensor, SensorSpec};

/// Times of rays contradict the sensor if they differ by more than this part of its scan. A robot at 1.5 m/s that takes
/// 0.1 s for a scan moves by 15 mm in a tenth of it, less than the noise of a lidar; times from the wrong end of the
/// scan are off by all of it.
const MAX_DEVIATION: f64 = 0.1;

/// Checks the seconds after the stamp of each ray, row by row.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if there is not one for each ray, one is not finite or too far from the
/// stamp, or they contradict the times of the sensor.
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

/// The times of the rays of a cloud, an image of `size` columns and rows: times of its points, or else of the given
/// sensor. A notice says if the sensor's times cannot be used.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] if both are there and contradict each other.
pub(super) fn of_cloud(
    own: Option<Vec<f32>>,
    given: Option<&SensorSpec>,
    size: (u32, u32),
    is_organized: bool,
) -> Result<(RayTimes, Option<&'static str>)> {
    let given = given.filter(|spec| !spec.times.is_at_once());
    let Some(own) = own else {
        let Some(spec) = given else { return Ok((RayTimes::AtOnce, None)) };
        let fits = is_organized && (spec.geometry.size() == size || !matches!(spec.times, RayTimes::Listed(_)));
        if fits {
            return Ok((spec.times.clone(), None));
        }
        let notice = "the sensor states the times of its columns, but the points have neither its columns nor times: \
                      they are taken as measured at the stamp";
        return Ok((RayTimes::AtOnce, Some(notice)));
    };
    let times = RayTimes::Listed(own.into());
    if let Some(spec) = given {
        let (found, stated) = (times.interval(size), spec.times.interval(spec.geometry.size()));
        let slack = MAX_DEVIATION * (stated[1] - stated[0]);
        // Points without a reading are missing, so that a scan may seem shorter.
        if found[0] < stated[0] - slack || found[1] > stated[1] + slack {
            let what = format!(
                "the points were measured from {:.4} s to {:.4} s after the stamp, but by the times of the sensor from \
                 {:.4} s to {:.4} s",
                found[0], found[1], stated[0], stated[1]
            );
            return Err(Error::invalid(what, "leave out turn_s of the sensor, or correct it and its stamp"));
        }
    }
    Ok((times, None))
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
