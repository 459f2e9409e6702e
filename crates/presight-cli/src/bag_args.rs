//! Flags for logs that are ROS 2 bags.

use super::pose::parse_pose;
use presight::files::BagOptions;
use presight::{Error, Result};

/// The heading of these flags in the help.
const HEADING: &str = "ROS 2 bags";

/// Choices that a bag leaves open.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct BagArgs {
    /// The measured topic of a bag [default: the only one that presight can read]
    #[arg(long, help_heading = HEADING, value_name = "TOPIC")]
    topic: Option<String>,

    /// The frame of the robot in a bag [default: base_link, else base_footprint]
    #[arg(long, help_heading = HEADING, value_name = "FRAME")]
    base: Option<String>,

    /// Pose of the sensor on the robot, body axes, for a bag without this transform: x,y,z,roll_deg,pitch_deg,yaw_deg
    #[arg(long, help_heading = HEADING, value_name = "POSE", allow_hyphen_values = true)]
    mount: Option<String>,

    /// Intensity of a full reflector in units of the driver; without it the intensities of a bag are not read
    #[arg(long, help_heading = HEADING, value_name = "VALUE")]
    reflector: Option<f32>,
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
