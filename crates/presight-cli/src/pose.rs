//! Poses on the command line.

use super::print;
use clap::ValueEnum;
use glam::{DQuat, DVec3};
use presight::sensor::{self, ExternalPose};
use presight::tools;
use presight::{Error, Pose, Result};
use std::path::Path;

/// The axes of the frame that a pose describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PoseFrame {
    /// x forward, y left, z up, for cameras too
    Body,
    /// z forward, x right, y down
    Optical,
}

/// The body that a pose describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PoseOf {
    /// The sensor's
    Sensor,
    /// The robot's; the sensor's pose follows from its `[mount]`
    Robot,
}

/// The world frame of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum WorldFrame {
    /// presight's: z up, metres
    ZUp,
    /// The glTF file's: y up, metres
    Gltf,
}

/// Flags shared by all commands that read poses.
#[derive(Clone, Debug, clap::Args)]
pub struct PoseArgs {
    /// Pose of the sensor: x,y,z,roll_deg,pitch_deg,yaw_deg or x,y,z,qx,qy,qz,qw
    ///
    /// Metres; rotation about the fixed axes x, then y, then z; positive pitch looks down, positive yaw to the left.
    /// Numbers are separated by commas or blanks.
    #[arg(long, value_name = "POSE", allow_hyphen_values = true)]
    pose: Option<String>,

    /// The axes of the frame that the pose describes
    #[arg(long, value_enum, default_value_t = PoseFrame::Body)]
    pose_frame: PoseFrame,

    /// Pose of the sensor or of the robot [default: sensor, with --robot robot]
    #[arg(long, value_enum)]
    pose_of: Option<PoseOf>,

    /// The world frame of the pose
    #[arg(long, value_enum, default_value_t = WorldFrame::ZUp)]
    world_frame: WorldFrame,
}

impl PoseArgs {
    /// Parses `--pose`.
    ///
    /// # Errors
    /// Those of [`parse_pose`] and [`PoseArgs::given`].
    pub fn parse(&self) -> Result<ExternalPose> {
        self.parse_as(PoseOf::Sensor)
    }

    /// As [`PoseArgs::parse`]; `None` without `--pose`.
    #[cfg(feature = "edit")]
    pub fn parse_if_given(&self) -> Result<Option<ExternalPose>> {
        self.pose.as_ref().map(|_| self.parse()).transpose()
    }

    /// As [`PoseArgs::parse`], with a default for `--pose-of`.
    pub fn parse_as(&self, of: PoseOf) -> Result<ExternalPose> {
        let meaning = self.given(Pose::IDENTITY, of)?;
        let text = self.pose.as_deref().ok_or_else(|| Error::usage("--pose is missing", REMEDY))?;
        let file = Path::new(text);
        if file.extension().is_some_and(|e| e.eq_ignore_ascii_case("tum")) || file.is_file() {
            let remedy = "presight predict --poses FILE reads poses from a file, one per line";
            return Err(Error::usage("this is a file, not a pose", remedy).at(format!("--pose {text}")));
        }
        let pose = parse_pose(text).map_err(|e| e.at(format!("--pose {text}")))?;
        Ok(ExternalPose::new(pose).with_frame(meaning.frame).with_of(meaning.of).with_world(meaning.world))
    }

    /// Interprets a pose from another source according to the flags.
    ///
    /// # Errors
    /// [`presight::ErrorKind::Usage`] for an optical frame of a robot, or a sensor's pose with `--robot`.
    pub fn given(&self, pose: Pose, of: PoseOf) -> Result<ExternalPose> {
        if of == PoseOf::Robot && self.pose_of == Some(PoseOf::Sensor) {
            let remedy = "drop --pose-of sensor, or give one --sensor";
            return Err(Error::usage("--pose-of sensor: the sensors of a robot have different poses", remedy));
        }
        given_pose(pose, self.pose_frame, self.pose_of.unwrap_or(of), self.world_frame)
    }
}

/// Interprets a pose according to the flags.
///
/// # Errors
/// [`presight::ErrorKind::Usage`] for an optical frame of a robot.
pub fn given_pose(pose: Pose, frame: PoseFrame, of: PoseOf, world: WorldFrame) -> Result<ExternalPose> {
    let frame = match frame {
        PoseFrame::Body => sensor::PoseFrame::Body,
        PoseFrame::Optical => sensor::PoseFrame::Optical,
    };
    let of = match of {
        PoseOf::Sensor => sensor::PoseOf::Sensor,
        PoseOf::Robot => sensor::PoseOf::Robot,
    };
    let world = match world {
        WorldFrame::ZUp => sensor::WorldFrame::ZUp,
        WorldFrame::Gltf => sensor::WorldFrame::Gltf,
    };
    let given = ExternalPose::new(pose).with_frame(frame).with_of(of).with_world(world);
    given.check()?;
    Ok(given)
}

const REMEDY: &str = "give x,y,z,roll_deg,pitch_deg,yaw_deg or x,y,z,qx,qy,qz,qw";

/// Parses `x,y,z,roll_deg,pitch_deg,yaw_deg` or `x,y,z,qx,qy,qz,qw`, separated by commas or blanks.
///
/// # Errors
/// [`presight::ErrorKind::Usage`] for text, NaN, infinity, too distant positions, a wrong count, or a quaternion whose
/// length is not 1.
pub fn parse_pose(text: &str) -> Result<Pose> {
    let mut numbers = Vec::new();
    let words: Vec<&str> = match text.contains(',') {
        true => text.split(',').map(str::trim).collect(),
        false => text.split_whitespace().collect(),
    };
    for word in words {
        let number: f64 = word.parse().map_err(|_| Error::usage(format!("{word:?} is not a number"), REMEDY))?;
        if !number.is_finite() {
            return Err(Error::usage(format!("{word} is not finite"), REMEDY));
        }
        numbers.push(number);
    }
    if let Some(far) = numbers.iter().take(3).find(|x| x.abs() > tools::MAX_COORDINATE) {
        return Err(Error::usage(format!("{far} m exceeds the limit of {:e} m", tools::MAX_COORDINATE), REMEDY));
    }
    match numbers[..] {
        [x, y, z, roll, pitch, yaw] => {
            print::notices(&tools::notice_of_radians(&[roll, pitch, yaw]).map(|notice| format!("{text}: {notice}")));
            Ok(Pose::from_xyz_rpy(DVec3::new(x, y, z), roll.to_radians(), pitch.to_radians(), yaw.to_radians()))
        }
        [x, y, z, qx, qy, qz, qw] => Pose::new(DVec3::new(x, y, z), DQuat::from_xyzw(qx, qy, qz, qw)),
        _ => Err(Error::usage(format!("{} numbers", numbers.len()), REMEDY)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn given(text: &str) -> PoseArgs {
        let (pose_frame, world_frame) = (PoseFrame::Body, WorldFrame::ZUp);
        PoseArgs { pose: Some(text.into()), pose_frame, pose_of: None, world_frame }
    }

    fn near(a: DVec3, b: DVec3) -> bool {
        (a - b).length() < 1e-12
    }

    #[test]
    fn both_notations_and_negative_numbers_are_read() {
        let forward =
            |args: &PoseArgs| args.parse().map(|given| (given.pose.translation, given.pose.rotation * DVec3::X));
        let (p, f) = forward(&given("-1,2.5,-3e-1,0,0,90")).unwrap();
        assert!(near(p, DVec3::new(-1.0, 2.5, -0.3)) && near(f, DVec3::Y));
        let (p, f) = forward(&given(" -1 2.5  -3e-1 0 0\t90")).unwrap();
        assert!(near(p, DVec3::new(-1.0, 2.5, -0.3)) && near(f, DVec3::Y));
        let (p, f) = forward(&given("-1, 2, 3, 0, 0, 0.7071, 0.7071")).unwrap();
        assert!(near(p, DVec3::new(-1.0, 2.0, 3.0)) && near(f, DVec3::Y));
        let e = given("-1, 2, 3, 0, 0, 2, 2").parse().unwrap_err().to_string();
        assert!(e.contains("a quaternion of length 2.828427, not 1"), "{e}");
    }

    #[test]
    fn wrong_poses_are_wrong_usage() {
        let wrong = [
            "",
            "1,2,3",
            "0,0,nan,0,0,0",
            "0,0,0,inf,0,0",
            "a,0,0,0,0,0",
            "0,0,0,0,0,0,0",
            "1,2,3,4,5,6,7,8",
            "1,2 3 4 5 6",
            "t.tum",
        ];
        // Their squares overflow, so such a quaternion has no rotation and such a position no range.
        let huge = ["0,0,0,1e200,0,0,1", "1e300,0,0,0,0,0", "0,-1e13,0,0,0,0,1"];
        for text in wrong.into_iter().chain(huge) {
            let e = given(text).parse().unwrap_err();
            assert_eq!(e.kind(), presight::ErrorKind::Usage, "{text}");
            assert!(!e.remedy().is_empty() && e.place().is_some_and(|p| p.contains("--pose")), "{e}");
        }
        let args = PoseArgs { pose_of: Some(PoseOf::Robot), pose_frame: PoseFrame::Optical, ..given("0,0,0,0,0,0") };
        assert!(args.parse().is_err());
    }
}
