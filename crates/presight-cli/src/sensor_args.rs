//! `--rectified` and `--destagger`, for all commands that take `--sensor`.

use super::print;
use presight::files::{SensorOptions, load_sensor_with};
use presight::{Result, Sensor};

/// Which image of a calibration is meant.
#[derive(Clone, Debug, clap::Args)]
pub struct SensorArgs {
    /// The rectified image of a ROS camera_info given as --sensor (P, R), not the raw one (K, D)
    ///
    /// Poses are still poses of the raw camera: R turns the image, not the camera.
    #[arg(long, requires = "sensor")]
    pub rectified: bool,

    /// The destaggered image of a lidar's beam table given as --sensor: a column is a direction, not a time
    #[arg(long, requires = "sensor")]
    pub destagger: bool,
}

impl SensorArgs {
    /// Loads the sensor that `--sensor` names, and prints notices on unused parts of its file.
    ///
    /// # Errors
    /// Those of [`load_sensor_with`].
    pub fn load(&self, sensor: &str) -> Result<Sensor> {
        let options = SensorOptions::default().with_rectified(self.rectified).with_destagger(self.destagger);
        let (sensor, notices) = load_sensor_with(sensor, options)?;
        print::notices(&notices);
        Ok(sensor)
    }
}
