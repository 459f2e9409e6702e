//! Poses whose type names their frame, so that one cannot stand for the other.

use super::Pose;
use glam::DVec3;

/// The pose of a sensor in the world: `world_from_sensor`, body axes (x forward, y left, z up).
///
/// Where a call takes this, it does not take the pose of a robot; [`RobotPose::sensor`] converts that by the mount.
///
/// ```
/// use presight::{Pose, RobotPose};
/// use glam::DVec3;
/// let mut spec = presight::preset("laser-scanner")?.spec().clone();
/// spec.mount = Pose::from_xyz_rpy(DVec3::new(0.2, 0.0, 1.2), 0.0, 0.0, 0.0);
/// let scanner = presight::Sensor::new(spec)?;
///
/// let robot = RobotPose::from_xyz_rpy(DVec3::new(3.0, 0.0, 0.0), 0.0, 0.0, 90f64.to_radians());
/// let sensor = robot.sensor(&scanner);
/// assert!(sensor.world_from_sensor().translation.distance(DVec3::new(3.0, 0.2, 1.2)) < 1e-15);
/// assert!(sensor.robot(&scanner).world_from_robot().translation.distance(DVec3::new(3.0, 0.0, 0.0)) < 1e-15);
/// # Ok::<(), presight::Error>(())
/// ```
///
/// A prediction takes the sensor's pose:
///
/// ```compile_fail,E0308
/// use presight::{Options, Predictor, Request, RobotPose, World, environment::Environment};
/// let robot = RobotPose::from_xyz_rpy(glam::DVec3::X, 0.0, 0.0, 0.0);
/// let (world, scanner) = (World::new(Environment::new()), presight::preset("laser-scanner")?);
/// Predictor::new(Options::default())?.predict(&world, &scanner, &robot, &Request::default())?;
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorPose(Pose);

impl SensorPose {
    /// A sensor at the origin of the world, along its axes.
    pub const IDENTITY: Self = Self(Pose::IDENTITY);

    /// Names the frame of a transform.
    pub const fn new(world_from_sensor: Pose) -> Self {
        Self(world_from_sensor)
    }

    /// From a translation in metres and roll, pitch and yaw in radians, as [`Pose::from_xyz_rpy`].
    pub fn from_xyz_rpy(translation: DVec3, roll: f64, pitch: f64, yaw: f64) -> Self {
        Self(Pose::from_xyz_rpy(translation, roll, pitch, yaw))
    }

    /// The transform.
    pub const fn world_from_sensor(&self) -> Pose {
        self.0
    }
}

/// The pose of a robot in the world: `world_from_robot`, body axes (x forward, y left, z up).
///
/// A simulator takes the robot's pose:
///
/// ```compile_fail,E0308
/// use presight::simulate::{Disturbances, Simulator};
/// use presight::{Options, Predictor, SensorPose, World, environment::Environment};
/// let sensor = SensorPose::from_xyz_rpy(glam::DVec3::X, 0.0, 0.0, 0.0);
/// let predictor = Predictor::new(Options::default())?;
/// let mut simulator = Simulator::new(predictor, presight::preset("laser-scanner")?, Disturbances::default(), 1)?;
/// simulator.frame(&World::new(Environment::new()), 0.0, &sensor)?;
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotPose(Pose);

impl RobotPose {
    /// A robot at the origin of the world, along its axes.
    pub const IDENTITY: Self = Self(Pose::IDENTITY);

    /// Names the frame of a transform.
    pub const fn new(world_from_robot: Pose) -> Self {
        Self(world_from_robot)
    }

    /// From a translation in metres and roll, pitch and yaw in radians, as [`Pose::from_xyz_rpy`].
    pub fn from_xyz_rpy(translation: DVec3, roll: f64, pitch: f64, yaw: f64) -> Self {
        Self(Pose::from_xyz_rpy(translation, roll, pitch, yaw))
    }

    /// The transform.
    pub const fn world_from_robot(&self) -> Pose {
        self.0
    }
}
