//! Poses from people and other programs: of a sensor or of its robot, with body or optical axes, in presight's world or
//! along the axes of a glTF file.

use crate::error::{Error, Result};
use crate::geometry::{InWorld, Pose, PoseCovariance, RobotPose, SensorPose};
use crate::sensor::{Sensor, SensorSpec, body_from_optical_rotation};
use glam::DVec3;

impl RobotPose {
    /// The pose of a sensor of this robot, by the sensor's mount.
    #[must_use]
    pub fn sensor(&self, sensor: &Sensor) -> SensorPose {
        SensorPose::new(self.world_from_robot() * sensor.spec().mount)
    }
}

impl SensorPose {
    /// The pose of the robot that this sensor is mounted on.
    #[must_use]
    pub fn robot(&self, sensor: &Sensor) -> RobotPose {
        RobotPose::new(self.world_from_sensor() * sensor.spec().mount.inverse())
    }
}

/// The axes of a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PoseFrame {
    /// x forward, y left, z up, also for cameras.
    #[default]
    Body,
    /// z forward, x right, y down.
    Optical,
}

/// Whose pose it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PoseOf {
    /// The sensor's.
    #[default]
    Sensor,
    /// The robot's; the sensor is mounted on it as [`SensorSpec::mount`] says.
    Robot,
}

/// The world frame of a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WorldFrame {
    /// presight's: z up, metres.
    #[default]
    ZUp,
    /// The axes of the glTF file (y up unless set otherwise), in metres.
    Gltf,
}

/// A pose from outside, with its conventions.
///
/// ```
/// # std::env::set_current_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/../..")).unwrap();
/// use presight::sensor::{ExternalPose, PoseOf};
/// use presight::{Pose, Scene};
/// use glam::DVec3;
/// let scene = Scene::open("scenes/room.glb")?;
/// let mut spec = presight::preset("laser-scanner")?.spec().clone();
/// spec.mount = Pose::from_xyz_rpy(DVec3::new(0.2, 0.0, 0.4), 0.0, 0.0, 0.0);
///
/// let robot = ExternalPose::new(Pose::from_xyz_rpy(DVec3::new(1.0, 1.5, 0.0), 0.0, 0.0, 0.0)).with_of(PoseOf::Robot);
/// let sensor = robot.of_sensor(&spec, &scene.world_from_gltf)?;
/// assert_eq!(sensor.world_from_sensor().translation, DVec3::new(1.2, 1.5, 0.4));
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct ExternalPose {
    /// The pose as given.
    pub pose: Pose,
    /// Its axes.
    pub frame: PoseFrame,
    /// Whose pose it is.
    pub of: PoseOf,
    /// Its world frame.
    pub world: WorldFrame,
}

impl ExternalPose {
    /// The pose of a sensor, body axes, in presight's world.
    pub fn new(pose: Pose) -> Self {
        let (frame, of, world) = (PoseFrame::Body, PoseOf::Sensor, WorldFrame::ZUp);
        Self { pose, frame, of, world }
    }

    /// Sets the axes.
    #[must_use]
    pub fn with_frame(self, frame: PoseFrame) -> Self {
        Self { frame, ..self }
    }

    /// Sets whose pose it is.
    #[must_use]
    pub fn with_of(self, of: PoseOf) -> Self {
        Self { of, ..self }
    }

    /// Sets the world frame.
    #[must_use]
    pub fn with_world(self, world: WorldFrame) -> Self {
        Self { world, ..self }
    }

    /// Checks that the conventions fit together.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Usage`] for the optical axes of a robot.
    pub fn check(&self) -> Result<()> {
        if self.of == PoseOf::Robot && self.frame == PoseFrame::Optical {
            let remedy = "drop `PoseFrame::Optical`, or give the pose of the sensor";
            return Err(Error::usage("`PoseOf::Robot`: a robot has no optical frame", remedy));
        }
        Ok(())
    }

    /// The sensor's pose in presight's world, body axes. `world_from_gltf` is `Scene::world_from_gltf`.
    ///
    /// # Errors
    /// Errors of [`ExternalPose::check`].
    pub fn of_sensor(&self, sensor: &SensorSpec, world_from_gltf: &Pose) -> Result<SensorPose> {
        self.check()?;
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
        Ok(SensorPose::new(pose))
    }

    /// Converts the covariance of the given pose, along the axes of its own world frame, to that of the sensor's pose
    /// `pose`, along the axes of presight's world.
    pub fn covariance_of_sensor(
        &self,
        covariance: &PoseCovariance<InWorld>,
        sensor: &SensorSpec,
        pose: &SensorPose,
        world_from_gltf: &Pose,
    ) -> PoseCovariance<InWorld> {
        let mut moved = *covariance;
        if self.world == WorldFrame::Gltf {
            let turn = world_from_gltf.rotation_matrix().transpose().to_cols_array_2d();
            let turn = |i: usize, k: usize| if i / 3 == k / 3 { turn[i % 3][k % 3] } else { 0.0 };
            let cell = |i: usize, j: usize| {
                (0..36).map(|kl| turn(i, kl / 6) * covariance[kl / 6][kl % 6] * turn(j, kl % 6)).sum()
            };
            moved = PoseCovariance::from_rows(std::array::from_fn(|i| std::array::from_fn(|j| cell(i, j))));
        }
        if self.of == PoseOf::Robot {
            let world_from_robot = pose.world_from_sensor().rotation * sensor.mount.rotation.conjugate();
            moved = moved.moved_by(world_from_robot * sensor.mount.translation);
        }
        moved
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::{Camera, Geometry};

    fn camera() -> SensorSpec {
        let geometry = Geometry::Camera(Camera::pinhole(2, 2, 1.0, 1.0, 0.5, 0.5));
        let mount = Pose::from_xyz_rpy(DVec3::new(0.0, 0.0, 2.0), 0.0, 0.0, 0.0);
        SensorSpec::new("c", "video", geometry).with_mount(mount)
    }

    fn sensor_pose(given: ExternalPose) -> Pose {
        let y_up = Pose::from_xyz_rpy(DVec3::ZERO, std::f64::consts::FRAC_PI_2, 0.0, 0.0);
        given.of_sensor(&camera(), &y_up).unwrap().world_from_sensor()
    }

    fn at(x: f64, y: f64, z: f64) -> ExternalPose {
        ExternalPose::new(Pose::from_xyz_rpy(DVec3::new(x, y, z), 0.0, 0.0, 0.0))
    }

    fn near(a: DVec3, b: DVec3) -> bool {
        (a - b).length() < 1e-12
    }

    #[test]
    fn an_optical_pose_looks_along_its_z() {
        let pose = sensor_pose(at(0.0, 0.0, 0.0).with_frame(PoseFrame::Optical));
        assert!(near(pose.rotation * DVec3::X, DVec3::Z));
        assert!(near(pose.rotation * DVec3::Y, -DVec3::X));
        assert!(near(pose.rotation * DVec3::Z, -DVec3::Y));
    }

    #[test]
    fn a_robot_carries_its_sensor_and_gltf_worlds_are_turned_up() {
        let robot = at(1.0, 0.0, 0.0).with_of(PoseOf::Robot);
        assert!(near(sensor_pose(robot).translation, DVec3::new(1.0, 0.0, 2.0)));
        let gltf = at(1.0, 2.0, 3.0).with_world(WorldFrame::Gltf);
        assert!(near(sensor_pose(gltf).translation, DVec3::new(1.0, -3.0, 2.0)));
        assert!(robot.with_frame(PoseFrame::Optical).check().is_err());
    }
}
