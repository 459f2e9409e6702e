//! Flags that state the motion of the robot during a scan.

use super::pose::{PoseArgs, PoseOf};
use glam::DVec3;
use presight::files::read_tum;
use presight::measured::{ScanMotion, Trajectory};
use presight::sensor::ExternalPose;
use presight::{Error, Pose, Result, Scene, Sensor, Twist};
use std::path::{Path, PathBuf};

/// How the robot moves while the sensor measures its rays; poses are those at the stamp of the scan.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct MotionArgs {
    /// Constant velocity of the robot in its own axes: vx,vy,vz,wx_deg,wy_deg,wz_deg, metres and degrees per second
    #[arg(long, value_name = "TWIST", allow_hyphen_values = true, conflicts_with_all = ["pose_end", "trajectory"])]
    twist: Option<String>,

    /// Pose of the same body as --pose when the last ray is measured
    #[arg(long, value_name = "POSE", allow_hyphen_values = true, conflicts_with = "trajectory")]
    pose_end: Option<String>,

    /// Poses over time, whose motion the scans follow; each pose has the stamp of its scan
    ///
    /// Lines of timestamp tx ty tz qx qy qz qw, in the frames of --pose. Between two poses the position is linear and
    /// the orientation spherically linear.
    #[arg(long, value_name = "FILE.tum")]
    trajectory: Option<PathBuf>,

    /// Stamp of the scan at --pose, seconds on the clock of the trajectory
    #[arg(long, value_name = "SECONDS", requires = "trajectory", allow_hyphen_values = true)]
    stamp: Option<f64>,
}

/// The motion during each scan.
pub enum ScanMotions {
    /// The robot stands.
    Still,
    /// The same at every pose.
    Alike(ScanMotion),
    /// By the stamp of the scan.
    Along(Trajectory, PathBuf),
}

impl ScanMotions {
    /// The motion during the scan of a sensor with this stamp; `None` if the robot stands.
    ///
    /// # Errors
    /// Those of [`Trajectory::scan`].
    pub fn at(&self, sensor: &Sensor, stamp: f64) -> Result<Option<ScanMotion>> {
        match self {
            Self::Still => Ok(None),
            Self::Alike(motion) => Ok(Some(motion.clone())),
            Self::Along(trajectory, path) => {
                trajectory.scan(stamp, sensor.scan_interval()).map(Some).map_err(|e| e.in_file(path))
            }
        }
    }
}

impl MotionArgs {
    /// True if the robot moves.
    pub fn is_given(&self) -> bool {
        self.twist.is_some() || self.pose_end.is_some() || self.trajectory.is_some()
    }

    /// The file of the trajectory.
    pub fn inputs(&self) -> Option<&Path> {
        self.trajectory.as_deref()
    }

    /// The stamp of the scan at a single pose.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] if a trajectory needs one and there is none.
    pub fn stamp(&self) -> Result<f64> {
        match (self.stamp, &self.trajectory) {
            (Some(stamp), _) => Ok(stamp),
            (None, None) => Ok(0.0),
            (None, Some(_)) => {
                let remedy = "give --stamp SECONDS, or --poses FILE with the stamps of the scans";
                Err(Error::usage("--trajectory: the stamp of the scan at --pose is missing", remedy))
            }
        }
    }

    /// The motion during the scans of a sensor; `given` is its pose at the stamp, if there is a single one. `meaning`
    /// states which body, axes and world poses describe.
    ///
    /// # Errors
    /// Usage errors, and the errors of [`Trajectory::new`].
    pub fn motions(
        &self,
        scene: &Scene,
        sensor: &Sensor,
        given: Option<&ExternalPose>,
        meaning: impl Fn(Pose) -> Result<ExternalPose>,
    ) -> Result<ScanMotions> {
        if self.is_given() {
            check_sensor(sensor)?;
        }
        let robot = |given: &ExternalPose| -> Result<Pose> {
            let sensor_pose = given.of_sensor(sensor.spec(), &scene.world_from_gltf)?;
            Ok(sensor_pose.world_from_sensor() * sensor.spec().mount.inverse())
        };
        if let Some(text) = &self.twist {
            let twist = parse_twist(text).map_err(|e| e.at(format!("--twist {text}")))?;
            return Ok(ScanMotions::Alike(ScanMotion::Twist(twist)));
        }
        if let Some(text) = &self.pose_end {
            let place = |e: Error| e.at(format!("--pose-end {text}"));
            let Some(given) = given else {
                let remedy = "give --trajectory FILE or --twist for a series of poses";
                return Err(place(Error::usage("a series has a last pose for each scan", remedy)));
            };
            let end = ExternalPose::new(super::pose::parse_pose(text).map_err(place)?);
            let end = end.with_frame(given.frame).with_of(given.of).with_world(given.world);
            let moved = robot(given)?.inverse() * robot(&end)?;
            let motion = ScanMotion::until(&moved, sensor.scan_interval()[1]).map_err(place)?;
            return Ok(ScanMotions::Alike(motion));
        }
        let Some(path) = &self.trajectory else { return Ok(ScanMotions::Still) };
        let poses = read_tum(path)?.into_iter().map(|stamped| Ok((stamped.time, robot(&meaning(stamped.pose)?)?)));
        let trajectory = poses.collect::<Result<_>>().and_then(Trajectory::new).map_err(|e| e.in_file(path))?;
        Ok(ScanMotions::Along(trajectory, path.clone()))
    }
}

/// Refuses sensors for which no motion can be predicted.
fn check_sensor(sensor: &Sensor) -> Result<()> {
    if !sensor.spec().times.is_at_once() {
        return Ok(());
    }
    let what =
        format!("sensor {:?} measures all rays at the stamp: its image does not depend on motion", sensor.spec().name);
    Err(Error::usage(what, "state when its rays are measured (turn_s of a scanner), or give no motion"))
}

/// Parses `vx,vy,vz,wx_deg,wy_deg,wz_deg`.
fn parse_twist(text: &str) -> Result<Twist> {
    const REMEDY: &str = "give vx,vy,vz,wx_deg,wy_deg,wz_deg: metres and degrees per second in the axes of the robot";
    let number = |word: &str| {
        let number = word.trim().parse::<f64>().ok().filter(|x| x.is_finite());
        number.ok_or_else(|| Error::usage(format!("{:?} is not a finite number", word.trim()), REMEDY))
    };
    let numbers = text.split(',').map(number).collect::<Result<Vec<f64>>>()?;
    match numbers[..] {
        [vx, vy, vz, wx, wy, wz] => {
            let turn = DVec3::new(wx.to_radians(), wy.to_radians(), wz.to_radians());
            let twist = Twist::new(DVec3::new(vx, vy, vz), turn);
            twist.check().map(|()| twist)
        }
        _ => Err(Error::usage(format!("{} numbers", numbers.len()), REMEDY)),
    }
}

/// The pose flags as the meaning of other poses.
pub fn meaning_of(args: &PoseArgs, of: PoseOf) -> impl Fn(Pose) -> Result<ExternalPose> {
    let args = args.clone();
    move |pose| args.given(pose, of)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn twists_are_in_degrees_and_bad_ones_are_refused() {
        let twist = parse_twist("1.5, 0,-0.1,0,0,180").unwrap();
        assert_eq!((twist.linear, twist.angular.z), (DVec3::new(1.5, 0.0, -0.1), std::f64::consts::PI));
        for bad in ["1,2,3", "1,2,3,4,5,x", "1,2,3,4,5,nan", ""] {
            assert_eq!(parse_twist(bad).unwrap_err().kind(), presight::ErrorKind::Usage, "{bad}");
        }
    }
}
