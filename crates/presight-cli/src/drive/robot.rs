//! A drive of a robot with several sensors.

use super::Drive;
use crate::print;
use presight::files::load_robot;
use presight::{Error, Result};
use std::path::{Path, PathBuf};

impl Drive {
    /// The drive with the sensors of a robot: its log and the others are then NAME=LOG. Without a robot the same drive.
    ///
    /// # Errors
    /// Errors from reading the robot; [`presight::ErrorKind::Usage`] for a log without the name of one of its sensors.
    pub fn of_robot(&self, robot: Option<&Path>, beside: &[String]) -> Result<Self> {
        let mut drive = self.clone();
        let Some(path) = robot else { return Ok(drive) };
        let (robot, notices) = load_robot(path)?;
        print::notices(&notices);
        let first = drive.log.to_string_lossy().into_owned();
        for named in std::iter::once(&first).chain(beside) {
            let Some((name, log)) = named.split_once('=') else {
                let what = format!("{named}: with --robot each log needs the name of its sensor");
                return Err(Error::usage(what, "give NAME=LOG"));
            };
            let Some(sensor) = robot.sensors.iter().find(|s| s.spec().name == name) else {
                let names: Vec<&str> = robot.sensors.iter().map(|s| s.spec().name.as_str()).collect();
                let what = format!("{named}: the robot has no sensor {name:?}");
                return Err(Error::usage(what, format!("name one of {}", names.join(", "))));
            };
            drive.robot.push((PathBuf::from(log), sensor.clone()));
        }
        drive.log = drive.robot[0].0.clone();
        Ok(drive)
    }

    /// One drive for each of its logs, with the sensor of that log.
    #[cfg(feature = "store")]
    pub fn each_log(&self) -> Vec<Self> {
        if self.robot.is_empty() {
            return vec![self.clone()];
        }
        let one = |of: &(PathBuf, _)| Self { log: of.0.clone(), robot: vec![of.clone()], ..self.clone() };
        self.robot.iter().map(one).collect()
    }
}
