//! How the robot moves during a scan, from the arguments of a prediction.

use super::arrays::{Conventions, numbers, pose_of};
use super::errors::{apart, raised, usage};
use glam::{DQuat, DVec3};
use presight::files::read_tum;
use presight::measured::{ScanMotion, Trajectory};
use presight::sensor::ExternalPose;
use presight::{Error, Pose, Result, Sensor, Twist};
use pyo3::prelude::*;
use std::path::PathBuf;

/// A twist of (6,) metres and degrees per second, robot axes.
pub fn twist_motion(twist: &Bound<'_, PyAny>) -> PyResult<ScanMotion> {
    let given = numbers::<f64>(twist, "twist")?.1;
    let [vx, vy, vz, wx, wy, wz] = given[..] else {
        let remedy = "give (6,) vx vy vz wx wy wz, metres and degrees per second";
        return Err(usage(twist.py(), "twist", format!("it has {} numbers", given.len()), remedy));
    };
    let [wx, wy, wz] = [wx, wy, wz].map(f64::to_radians);
    Ok(ScanMotion::Twist(Twist::from_array([vx, vy, vz, wx, wy, wz])))
}

/// The motion as given; poses are in the conventions of the prediction's.
pub enum GivenMotion {
    Still,
    Twist(ScanMotion),
    End(Pose),
    Along(Vec<(f64, Pose)>, f64),
}

impl GivenMotion {
    pub fn new(
        py: Python<'_>,
        twist: Option<&Bound<'_, PyAny>>,
        pose_end: Option<&Bound<'_, PyAny>>,
        trajectory: Option<&Bound<'_, PyAny>>,
        stamp: Option<f64>,
    ) -> PyResult<Self> {
        if stamp.is_some() && trajectory.is_none() {
            return Err(usage(py, "stamp", "there is no trajectory with such a clock", "give trajectory="));
        }
        match (twist, pose_end, trajectory) {
            (None, None, None) => Ok(Self::Still),
            (Some(twist), None, None) => twist_motion(twist).map(Self::Twist),
            (None, Some(end), None) => pose_of(end, "pose_end").map(Self::End),
            (None, None, Some(trajectory)) => {
                let stamp = stamp.ok_or_else(|| {
                    usage(py, "trajectory", "the stamp of the scan is missing", "give stamp=, seconds on its clock")
                })?;
                Ok(Self::Along(stamped_poses(trajectory)?, stamp))
            }
            _ => Err(usage(py, "twist", "more than one motion is given", "give one of twist, pose_end, trajectory")),
        }
    }

    /// The motion during the scan of a sensor at the `given` pose. `robot` places the robot in the world.
    pub fn during(
        &self,
        sensor: &Sensor,
        given: &ExternalPose,
        conventions: Conventions,
        robot: impl Fn(&ExternalPose) -> Result<Pose>,
    ) -> Result<Option<ScanMotion>> {
        let placed = |pose: &Pose| robot(&conventions.given(*pose));
        match self {
            Self::Still => Ok(None),
            Self::Twist(motion) => Ok(Some(motion.clone())),
            Self::End(end) => {
                let moved = robot(given)?.inverse() * placed(end)?;
                let motion = ScanMotion::until(&moved, sensor.scan_interval()[1]);
                motion.map(Some).map_err(|e: Error| e.at("pose_end"))
            }
            Self::Along(poses, stamp) => {
                let poses = poses.iter().map(|(time, pose)| Ok((*time, placed(pose)?))).collect::<Result<_>>()?;
                let motion = Trajectory::new(poses).and_then(|t| t.scan(*stamp, sensor.scan_interval()));
                motion.map(Some).map_err(|e| e.at("trajectory"))
            }
        }
    }
}

/// (n, 8) timestamp x y z qx qy qz qw, or the path of a TUM file.
fn stamped_poses(given: &Bound<'_, PyAny>) -> PyResult<Vec<(f64, Pose)>> {
    let py = given.py();
    if let Ok(path) = given.extract::<PathBuf>() {
        return apart(py, || Ok(read_tum(&path)?.into_iter().map(|stamped| (stamped.time, stamped.pose)).collect()));
    }
    let (shape, values) = numbers::<f64>(given, "trajectory")?;
    if shape.len() != 2 || shape[1] != 8 {
        let remedy = "give (n, 8) timestamp x y z qx qy qz qw, or the path of a TUM file";
        return Err(usage(py, "trajectory", format!("the shape is {shape:?}"), remedy));
    }
    let pose = |line: &[f64]| {
        Pose::new(DVec3::new(line[1], line[2], line[3]), DQuat::from_xyzw(line[4], line[5], line[6], line[7]))
    };
    let one = |(i, line): (usize, &[f64])| {
        pose(line).map(|pose| (line[0], pose)).map_err(|e| raised(py, &e.at(format!("trajectory: pose {i}"))))
    };
    values.chunks(8).enumerate().map(one).collect()
}
