//! `--rectified`, for all commands that take `--sensor`.

use super::print;
use presight::files::{load_rectified, load_sensor};
use presight::{Result, Sensor};

/// Which image of a calibration is meant.
#[derive(Clone, Debug, clap::Args)]
pub struct SensorArgs {
    /// The rectified image of a ROS camera_info given as --sensor (P, R), not the raw one (K, D)
    ///
    /// Poses are still poses of the raw camera: R turns the image, not the camera.
    #[arg(long, requires = "sensor")]
    pub rectified: bool,
}

impl SensorArgs {
    /// Loads the sensor that `--sensor` names, and prints notices on unused parts of its file.
    ///
    /// # Errors
    /// Those of [`load_sensor`] and [`load_rectified`].
    pub fn load(&self, sensor: &str) -> Result<Sensor> {
        let (sensor, notices) = if self.rectified { load_rectified(sensor) } else { load_sensor(sensor) }?;
        print::notices(&notices);
        Ok(sensor)
    }
}
