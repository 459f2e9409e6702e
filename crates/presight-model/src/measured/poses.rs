//! Where the sensor is when it measures each ray of a scan.

use super::ScanMotion;
use crate::error::{Error, Result};
use crate::geometry::{Pose, Twist};
use crate::sensor::{Bundles, Sensor};
use glam::DVec3;

/// The pose of each bundle of a scan: rays that leave the sensor at one point and are measured at one time. Directions
/// of rays stay in the axes of the sensor at the time of the ray.
#[derive(Clone, Debug)]
pub struct ScanPoses {
    sensor: Sensor,
    moves: bool,
    poses: Vec<Pose>,
}

impl ScanPoses {
    /// Poses of the bundles of a sensor with this pose (body axes) at the stamp; `None` if one pose holds for all rays.
    /// Without a motion the robot stands.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the motion does not reach over the scan; [`crate::ErrorKind::System`] if there
    /// is no memory for the bundles.
    pub fn new(sensor: &Sensor, world_from_sensor: &Pose, motion: Option<&ScanMotion>) -> Result<Option<Self>> {
        let moves = motion.is_some_and(|motion| !motion.is_still()) && !sensor.spec().times.is_at_once();
        if !moves && !sensor.has_origins() {
            return Ok(None);
        }
        let still = ScanMotion::Twist(Twist::default());
        let motion = motion.filter(|_| moves).unwrap_or(&still);
        Self::in_bundles(sensor, world_from_sensor, motion, moves).map(Some)
    }

    /// The poses of all bundles, even if all are the same.
    #[doc(hidden)]
    pub fn in_bundles(sensor: &Sensor, world_from_sensor: &Pose, motion: &ScanMotion, moves: bool) -> Result<Self> {
        let bundles = sensor.bundles(moves)?;
        let mount = sensor.spec().mount;
        let mut last: Option<(f64, Pose)> = None;
        let mut pose = |(origin, seconds): &(DVec3, f64)| {
            let at_time = match last.filter(|(known, _)| known == seconds) {
                Some((_, pose)) => pose,
                None => sensor_at(world_from_sensor, &mount, motion, *seconds)?,
            };
            last = Some((*seconds, at_time));
            Ok(if *origin == DVec3::ZERO {
                at_time
            } else {
                Pose { translation: at_time.transform_point(*origin), ..at_time }
            })
        };
        let poses = bundles.starts().iter().map(&mut pose).collect::<Result<_>>()?;
        Ok(Self { sensor: sensor.clone(), moves, poses })
    }

    /// The bundles.
    #[doc(hidden)]
    pub fn bundles(&self) -> &Bundles {
        self.sensor.bundles(self.moves).expect("they were made")
    }

    /// World from sensor for each bundle, body axes: its translation is where the rays leave the sensor
    /// ([`Sensor::start`]).
    pub fn poses(&self) -> &[Pose] {
        &self.poses
    }

    /// World from sensor when the ray of a pixel is measured, body axes; its translation is where the ray starts
    /// ([`Sensor::start`]).
    #[inline]
    pub fn of_pixel(&self, column: u32, row: u32) -> &Pose {
        &self.poses[self.bundles().of_pixel(column, row) as usize]
    }
}

/// World from sensor some seconds after the stamp.
fn sensor_at(world_from_sensor: &Pose, mount: &Pose, motion: &ScanMotion, seconds: f64) -> Result<Pose> {
    let moved = motion.at(seconds).ok_or_else(|| {
        let what = format!("a motion that does not reach {seconds:.6} s after the stamp");
        Error::invalid(what, "give poses from before the first ray until after the last")
    })?;
    if moved == Pose::IDENTITY {
        return Ok(*world_from_sensor);
    }
    Ok(*world_from_sensor * mount.inverse() * moved * *mount)
}

impl ScanMotion {
    /// World from sensor `seconds` after the stamp, body axes, for its pose at the stamp.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if the motion does not reach so far.
    pub fn sensor_at(&self, sensor: &Sensor, world_from_sensor: &Pose, seconds: f64) -> Result<Pose> {
        sensor_at(world_from_sensor, &sensor.spec().mount, self, seconds)
    }
}
