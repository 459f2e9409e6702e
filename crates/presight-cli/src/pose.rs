//! Poses as the command line gives them.

use clap::ValueEnum;
use glam::{DQuat, DVec3};
use presight::features::roi::PoseCovariance;
use presight::features::sensor_covariance;
use presight::geometry::Pose;
use presight::limits;
use presight::sensor::{SensorSpec, body_from_optical_rotation};
use presight::{Error, Result};

/// Which axes a pose turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PoseFrame {
    /// x forward, y left, z up, for cameras too
    Body,
    /// z forward, x right, y down
    Optical,
}

/// Whose pose it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PoseOf {
    /// The sensor's
    Sensor,
    /// The robot's; the sensor sits on it as its `[mount]` says
    Robot,
}

/// In which world a pose is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum WorldFrame {
    /// presight's: z up, metres
    ZUp,
    /// The glTF file's: y up, metres
    Gltf,
}

/// The flags by which every command reads poses.
#[derive(Clone, Debug, clap::Args)]
pub struct PoseArgs {
    /// Where the sensor is: x,y,z,roll_deg,pitch_deg,yaw_deg or x,y,z,qx,qy,qz,qw
    ///
    /// Metres; rotation about the fixed axes x, then y, then z; positive pitch looks down, positive yaw to the left.
    #[arg(long, value_name = "POSE", allow_hyphen_values = true)]
    pose: String,

    /// Which axes the pose turns
    #[arg(long, value_enum, default_value_t = PoseFrame::Body)]
    pose_frame: PoseFrame,

    /// Whose pose it is
    #[arg(long, value_enum, default_value_t = PoseOf::Sensor)]
    pose_of: PoseOf,

    /// In which world the pose is
    #[arg(long, value_enum, default_value_t = WorldFrame::ZUp)]
    world_frame: WorldFrame,
}

impl PoseArgs {
    /// Reads the numbers.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] on text, NaN, infinity, what is too far away, a wrong count, or an optical frame of a robot.
    pub fn parse(&self) -> Result<GivenPose> {
        let pose = parse_pose(&self.pose).map_err(|e| e.at(format!("--pose {}", self.pose)))?;
        GivenPose::new(pose, self.pose_frame, self.pose_of, self.world_frame)
    }
}

/// A pose as given, with what it means.
#[derive(Clone, Copy, Debug)]
pub struct GivenPose {
    pose: Pose,
    frame: PoseFrame,
    of: PoseOf,
    world: WorldFrame,
}

impl GivenPose {
    /// A pose from a file, in the frame that flags name.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] for an optical frame of a robot.
    pub fn new(pose: Pose, frame: PoseFrame, of: PoseOf, world: WorldFrame) -> Result<Self> {
        if of == PoseOf::Robot && frame == PoseFrame::Optical {
            let remedy = "drop --pose-frame optical, or give the pose of the sensor";
            return Err(Error::usage("--pose-of robot: a robot has no optical frame", remedy));
        }
        Ok(Self { pose, frame, of, world })
    }

    /// world_from_sensor, body axes, in presight's world.
    pub fn of_sensor(&self, sensor: &SensorSpec, world_from_gltf: &Pose) -> Pose {
        let mut pose = self.pose;
        if self.frame == PoseFrame::Optical {
            let optical_from_body = body_from_optical_rotation().conjugate();
            pose = pose * Pose { rotation: optical_from_body, translation: DVec3::ZERO };
        }
        if self.of == PoseOf::Robot {
            pose = pose * sensor.mount;
        }
        if self.world == WorldFrame::Gltf {
            pose = *world_from_gltf * pose;
        }
        pose
    }

    /// The covariance of the sensor's pose along the axes of presight's world, from that of the pose as given.
    pub fn covariance_of_sensor(
        &self,
        covariance: &PoseCovariance,
        sensor: &SensorSpec,
        world_from_sensor: &Pose,
        world_from_gltf: &Pose,
    ) -> PoseCovariance {
        let mut moved = *covariance;
        if self.world == WorldFrame::Gltf {
            let turn = world_from_gltf.rotation_matrix().transpose().to_cols_array_2d();
            let turn = |i: usize, k: usize| if i / 3 == k / 3 { turn[i % 3][k % 3] } else { 0.0 };
            let cell = |i: usize, j: usize| {
                (0..36).map(|kl| turn(i, kl / 6) * covariance[kl / 6][kl % 6] * turn(j, kl % 6)).sum()
            };
            moved = std::array::from_fn(|i| std::array::from_fn(|j| cell(i, j)));
        }
        if self.of == PoseOf::Robot {
            let world_from_robot = world_from_sensor.rotation * sensor.mount.rotation.conjugate();
            moved = sensor_covariance(&moved, world_from_robot * sensor.mount.translation);
        }
        moved
    }
}

const REMEDY: &str = "give x,y,z,roll_deg,pitch_deg,yaw_deg or x,y,z,qx,qy,qz,qw";

/// Reads `x,y,z,roll_deg,pitch_deg,yaw_deg` or `x,y,z,qx,qy,qz,qw`.
///
/// # Errors
/// [`presight::ErrorKind::Usage`] on text, NaN, infinity, a wrong count, or a quaternion without length.
pub fn parse_pose(text: &str) -> Result<Pose> {
    let mut numbers = Vec::new();
    for word in text.split(',').map(str::trim) {
        let number: f64 = word.parse().map_err(|_| Error::usage(format!("{word:?} is no number"), REMEDY))?;
        if !number.is_finite() {
            return Err(Error::usage(format!("{word} is not finite"), REMEDY));
        }
        numbers.push(number);
    }
    if let Some(far) = numbers.iter().take(3).find(|x| x.abs() > limits::MAX_COORDINATE) {
        return Err(Error::usage(format!("{far} m is beyond {:e} m", limits::MAX_COORDINATE), REMEDY));
    }
    match numbers[..] {
        [x, y, z, roll, pitch, yaw] => {
            Ok(Pose::from_xyz_rpy(DVec3::new(x, y, z), roll.to_radians(), pitch.to_radians(), yaw.to_radians()))
        }
        [x, y, z, qx, qy, qz, qw] => Pose::new(DVec3::new(x, y, z), DQuat::from_xyzw(qx, qy, qz, qw)),
        _ => Err(Error::usage(format!("{} numbers", numbers.len()), REMEDY)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight::sensor::{Camera, Geometry};

    fn given(text: &str) -> PoseArgs {
        let (pose_frame, pose_of, world_frame) = (PoseFrame::Body, PoseOf::Sensor, WorldFrame::ZUp);
        PoseArgs { pose: text.into(), pose_frame, pose_of, world_frame }
    }

    fn camera() -> SensorSpec {
        let geometry = Geometry::Camera(Camera::pinhole(2, 2, 1.0, 1.0, 0.5, 0.5));
        let mount = Pose::from_xyz_rpy(DVec3::new(0.0, 0.0, 2.0), 0.0, 0.0, 0.0);
        SensorSpec { mount, ..SensorSpec::new("c", "video", geometry) }
    }

    fn y_up() -> Pose {
        Pose::from_xyz_rpy(DVec3::ZERO, std::f64::consts::FRAC_PI_2, 0.0, 0.0)
    }

    fn forward(args: &PoseArgs) -> (DVec3, DVec3) {
        let pose = args.parse().unwrap().of_sensor(&camera(), &y_up());
        (pose.translation, pose.rotation * DVec3::X)
    }

    fn near(a: DVec3, b: DVec3) -> bool {
        (a - b).length() < 1e-12
    }

    #[test]
    fn both_notations_and_negative_numbers_are_read() {
        let (p, f) = forward(&given("-1,2.5,-3e-1,0,0,90"));
        assert!(near(p, DVec3::new(-1.0, 2.5, -0.3)) && near(f, DVec3::Y));
        let (p, f) = forward(&given("-1, 2, 3, 0, 0, 2, 2"));
        assert!(near(p, DVec3::new(-1.0, 2.0, 3.0)) && near(f, DVec3::Y));
    }

    #[test]
    fn an_optical_pose_looks_along_its_z() {
        let args = PoseArgs { pose_frame: PoseFrame::Optical, ..given("0,0,0,0,0,0") };
        let pose = args.parse().unwrap().of_sensor(&camera(), &y_up());
        assert!(near(pose.rotation * DVec3::X, DVec3::Z));
        assert!(near(pose.rotation * DVec3::Y, -DVec3::X));
        assert!(near(pose.rotation * DVec3::Z, -DVec3::Y));
    }

    #[test]
    fn a_robot_carries_its_sensor_and_gltf_worlds_are_turned_up() {
        let args = PoseArgs { pose_of: PoseOf::Robot, ..given("1,0,0,0,0,0") };
        assert!(near(forward(&args).0, DVec3::new(1.0, 0.0, 2.0)));
        let args = PoseArgs { world_frame: WorldFrame::Gltf, ..given("1,2,3,0,0,0") };
        assert!(near(forward(&args).0, DVec3::new(1.0, -3.0, 2.0)));
    }

    #[test]
    fn wrong_poses_are_wrong_usage() {
        let wrong = ["", "1,2,3", "0,0,nan,0,0,0", "0,0,0,inf,0,0", "a,0,0,0,0,0", "0,0,0,0,0,0,0", "1,2,3,4,5,6,7,8"];
        // Squares that overflow: no rotation is left of such a quaternion, and no range of such a place.
        let huge = ["0,0,0,1e200,0,0,1", "1e300,0,0,0,0,0", "0,-1e13,0,0,0,0,1"];
        for text in wrong.into_iter().chain(huge) {
            let e = given(text).parse().unwrap_err();
            assert_eq!(e.kind(), presight::ErrorKind::Usage, "{text}");
            assert!(!e.remedy().is_empty() && e.place().is_some_and(|p| p.contains("--pose")), "{e}");
        }
        let args = PoseArgs { pose_of: PoseOf::Robot, pose_frame: PoseFrame::Optical, ..given("0,0,0,0,0,0") };
        assert!(args.parse().is_err());
    }
}
