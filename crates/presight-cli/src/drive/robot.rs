//! A drive of a robot with several sensors.

use super::Drive;
use crate::print;
use presight::files::load_robot;
use presight::{Error, Result, Sensor};
use std::path::{Path, PathBuf};

/// The log of one of a robot's sensors.
#[derive(Clone, Debug)]
pub(super) struct RobotLog {
    pub log: PathBuf,
    /// The sensor of a robot file; otherwise the log's own.
    pub sensor: Option<Sensor>,
    /// The topic in a bag.
    pub topic: Option<String>,
}

impl Drive {
    /// The drive with the sensors of a robot: its log and the others are then NAME=LOG. Without a robot the sensors are
    /// the topics of a bag, if several are given; otherwise it is the same drive.
    ///
    /// # Errors
    /// Errors from reading the robot; [`presight::ErrorKind::Usage`] for a log without the name of one of its sensors,
    /// and as [`BagArgs::topics`](crate::bag_args::BagArgs::topics).
    pub fn of_robot(&self, robot: Option<&Path>, beside: &[String]) -> Result<Self> {
        let mut drive = self.clone();
        let Some(path) = robot else {
            let topics = self.logs.bag.topics(None)?;
            if topics.len() > 1 {
                let sensor = |topic| RobotLog { log: self.log.clone(), sensor: None, topic };
                drive.robot = topics.into_iter().map(sensor).collect();
            }
            return Ok(drive);
        };
        let topics = self.logs.bag.topics(Some(1 + beside.len()))?;
        let (robot, notices) = load_robot(path)?;
        print::notices(&notices);
        let first = drive.log.to_string_lossy().into_owned();
        for (named, topic) in std::iter::once(&first).chain(beside).zip(topics) {
            let Some((name, log)) = named.split_once('=') else {
                let what = format!("{named}: with --robot each log needs the name of its sensor");
                return Err(Error::usage(what, "give NAME=LOG"));
            };
            let Some(sensor) = robot.sensors.iter().find(|s| s.spec().name == name) else {
                let names: Vec<&str> = robot.sensors.iter().map(|s| s.spec().name.as_str()).collect();
                let what = format!("{named}: the robot has no sensor {name:?}");
                return Err(Error::usage(what, format!("name one of {}", names.join(", "))));
            };
            drive.robot.push(RobotLog { log: PathBuf::from(log), sensor: Some(sensor.clone()), topic });
        }
        drive.log.clone_from(&drive.robot[0].log);
        Ok(drive)
    }

    /// One drive for each of its logs, with the sensor of that log.
    #[cfg(feature = "store")]
    pub fn each_log(&self) -> Vec<Self> {
        if self.robot.is_empty() {
            return vec![self.clone()];
        }
        let one = |of: &RobotLog| Self { log: of.log.clone(), robot: vec![of.clone()], ..self.clone() };
        self.robot.iter().map(one).collect()
    }
}
