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
    /// The measured topic of a bag [default: the only one that presight can read]. Several are sensors of one drive,
    /// where a command takes a robot
    #[arg(long, value_name = "TOPIC")]
    topic: Vec<String>,

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
    pub bag: BagArgs,

    /// Leave out frames that cannot be read and frames whose time falls; their number and places are printed. Without
    /// it the first one ends the command
    #[arg(long)]
    skip_bad: bool,
}

impl LogArgs {
    /// Opens a log.
    ///
    /// # Errors
    /// The errors of [`LogFrames::open_with`] and of [`BagArgs::options`].
    pub fn open(&self, log: &Path, sensor: Option<&Sensor>, noise: &OdometryNoise) -> Result<LogFrames> {
        let bag = self.bag.options()?;
        match self.skip_bad {
            true => LogFrames::open_skipping_bad(log, sensor, noise, &bag),
            false => LogFrames::open_with(log, sensor, noise, &bag),
        }
    }

    /// These flags for one topic of a bag.
    pub fn of_topic(&self, topic: Option<String>) -> Self {
        Self { bag: self.bag.of_topic(topic), skip_bad: self.skip_bad }
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
