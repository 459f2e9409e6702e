//! Flags for logs that are ROS 2 bags.

use super::pose::parse_pose;
use super::print;
use presight::files::{BagOptions, LogFrames};
use presight::measured::OdometryNoise;
use presight::{Error, Result, Sensor};
use std::path::Path;

/// Choices that a bag leaves open.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct BagArgs {
    /// The measured topic of a bag [default: the only one that presight can read]
    #[arg(long, value_name = "TOPIC")]
    topic: Option<String>,

    /// The frame of the robot in a bag [default: base_link, else base_footprint]
    #[arg(long, value_name = "FRAME")]
    base: Option<String>,

    /// Pose of the sensor on the robot, body axes, for a bag without this transform: x,y,z,roll_deg,pitch_deg,yaw_deg
    #[arg(long, value_name = "POSE", allow_hyphen_values = true)]
    mount: Option<String>,

    /// Intensity of a full reflector in units of the driver; without it the intensities of a bag are not read
    #[arg(long, value_name = "VALUE")]
    reflector: Option<f32>,
}

/// Flags for logs: the choices that a bag leaves open, and what to do with frames that cannot be read.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct LogArgs {
    #[command(flatten)]
    bag: BagArgs,

    /// Leave out frames that cannot be read and frames whose time falls; their number and places are printed. Without
    /// it the first one ends the command
    #[arg(long)]
    skip_bad: bool,
}

impl LogArgs {
    /// Opens a log.
    ///
    /// # Errors
    /// As [`LogFrames::open_with`], and those of [`BagArgs::options`].
    pub fn open(&self, log: &Path, sensor: Option<&Sensor>, noise: &OdometryNoise) -> Result<LogFrames> {
        let bag = self.bag.options()?;
        match self.skip_bad {
            true => LogFrames::open_skipping_bad(log, sensor, noise, &bag),
            false => LogFrames::open_with(log, sensor, noise, &bag),
        }
    }

    /// Opens the log of another sensor of the robot, which is no bag.
    ///
    /// # Errors
    /// As [`LogFrames::open`].
    pub fn open_beside(&self, log: &Path, sensor: &Sensor, noise: &OdometryNoise) -> Result<LogFrames> {
        Self { bag: BagArgs::default(), skip_bad: self.skip_bad }.open(log, Some(sensor), noise)
    }

    /// The frame that was read, unless it is bad and bad frames are left out; then a notice names it.
    ///
    /// # Errors
    /// The error of the frame.
    pub fn kept<T>(&self, frame: Result<Option<T>>) -> Result<Option<T>> {
        match frame {
            Err(e) if self.skip_bad => {
                print::notices(&[format!("left out: {e}")]);
                Ok(None)
            }
            frame => frame,
        }
    }
}

impl BagArgs {
    /// The choices as options of the reader.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] for a mount that is not a pose, or an intensity that is not positive.
    pub fn options(&self) -> Result<BagOptions> {
        if let Some(value) = self.reflector.filter(|v| !(v.is_finite() && *v > 0.0)) {
            return Err(Error::usage(
                format!("--reflector {value}"),
                "give the intensity of a full reflector, such as 255",
            ));
        }
        let mount = self.mount.as_deref().map(parse_pose).transpose().map_err(|e| e.at("--mount"))?;
        let options = BagOptions::default().with_topic(self.topic.clone()).with_base(self.base.clone());
        Ok(options.with_mount(mount).with_reflector(self.reflector))
    }
}
