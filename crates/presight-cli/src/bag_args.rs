//! Flags for logs that are ROS 2 bags.

use super::pose::parse_pose;
use presight::files::BagOptions;
use presight::{Error, Result};

/// The heading of these flags in the help.
const HEADING: &str = "ROS 2 bags";

/// Choices that a bag leaves open.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct BagArgs {
    /// The measured topic of a bag [default: the only one that presight can read]. Several are sensors of one drive,
    /// where a command takes a robot
    #[arg(long, help_heading = HEADING, value_name = "TOPIC")]
    topic: Vec<String>,

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
    /// [`presight::ErrorKind::Usage`] for a second topic, a mount that is not a pose, or an intensity that is not
    /// positive.
    pub fn options(&self) -> Result<BagOptions> {
        if let [_, second, ..] = self.topic.as_slice() {
            let remedy = "give one topic: `update` and `supervise` take several, as sensors of one drive";
            return Err(Error::usage(format!("--topic {second}: this command follows one sensor"), remedy));
        }
        if let Some(value) = self.reflector.filter(|v| !(v.is_finite() && *v > 0.0)) {
            return Err(Error::usage(
                format!("--reflector {value}"),
                "give the intensity of a full reflector, such as 255",
            ));
        }
        let mount = self.mount.as_deref().map(parse_pose).transpose().map_err(|e| e.at("--mount"))?;
        let options = BagOptions::default().with_topic(self.topic.first().cloned()).with_base(self.base.clone());
        Ok(options.with_mount(mount).with_reflector(self.reflector))
    }

    /// The topics of `count` logs of one drive, one each, or the same for all; without a robot as many logs as topics.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] for a topic that is given twice, a mount for several topics, or another number of
    /// topics than logs.
    pub fn topics(&self, count: Option<usize>) -> Result<Vec<Option<String>>> {
        let topics = &self.topic;
        if topics.len() < 2 {
            return Ok(vec![topics.first().cloned(); count.unwrap_or(1)]);
        }
        if let Some(count) = count.filter(|count| *count != topics.len()) {
            let what = format!("{} times --topic for {count} logs", topics.len());
            return Err(Error::usage(what, "give one --topic for each NAME=LOG, in their order, or one for all"));
        }
        if count.is_none() {
            if let Some(double) = topics.iter().enumerate().find(|(i, topic)| topics[..*i].contains(topic)) {
                return Err(Error::usage(format!("--topic {} is given twice", double.1), "give each topic once"));
            }
            if self.mount.is_some() {
                let remedy = "record /tf_static, or give --robot with the mounts of its sensors";
                return Err(Error::usage("--mount is one pose, but several topics have one each", remedy));
            }
        }
        Ok(topics.iter().cloned().map(Some).collect())
    }

    /// These choices for one topic.
    pub fn of_topic(&self, topic: Option<String>) -> Self {
        Self { topic: topic.into_iter().collect(), ..self.clone() }
    }
}
