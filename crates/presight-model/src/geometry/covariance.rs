//! Covariances of poses, with their axes in the type, and the robot's pose with its covariance.

use super::{Pose, RobotPose};
use crate::environment::check_covariance;
use crate::error::{Error, Result};
use crate::matrix::{sandwich, turn};
use glam::DVec3;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::marker::PhantomData;
use std::ops::{Index, IndexMut};

/// Marks a covariance along the axes of the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InWorld;

/// Marks a covariance along the robot's own axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InRobot;

/// Marks a covariance along an object's own axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InObject;

/// Covariance of a pose along the axes `A` ([`InWorld`], [`InRobot`] or [`InObject`]): x y z, then rotation about fixed
/// x y z; metres and radians. The rotation error is Exp(dtheta) from the left, about the origin of the body.
///
/// ```
/// use presight::{InObject, InWorld, Pose, PoseCovariance};
/// // The position of a door has a standard deviation of 1 cm across its leaf (its own x). It is turned by 90 degrees.
/// let own = PoseCovariance::<InObject>::from_sigmas([0.01, 0.0, 0.0, 0.0, 0.0, 0.0]);
/// let world_from_door = Pose::from_xyz_rpy(glam::DVec3::ZERO, 0.0, 0.0, 90f64.to_radians());
/// let in_world: PoseCovariance<InWorld> = own.in_world(&world_from_door);
/// assert!((in_world[1][1] - 1e-4).abs() < 1e-15 && in_world[0][0] < 1e-15);
/// ```
///
/// Covariances along other axes do not fit:
/// ```compile_fail,E0308
/// use presight::features::BoxOptions;
/// use presight::{InObject, PoseCovariance};
/// BoxOptions::default().with_sensor(PoseCovariance::<InObject>::ZERO);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseCovariance<A> {
    rows: [[f64; 6]; 6],
    axes: PhantomData<A>,
}

impl<A> PoseCovariance<A> {
    /// An exactly known pose.
    pub const ZERO: Self = Self::from_rows([[0.0; 6]; 6]);

    /// Independent errors with these standard deviations: x, y, z in metres, rotation about x, y, z in radians.
    pub fn from_sigmas(sigmas: [f64; 6]) -> Self {
        let variance = |i: usize, j: usize| if i == j { sigmas[i] * sigmas[i] } else { 0.0 };
        Self::from_rows(std::array::from_fn(|i| std::array::from_fn(|j| variance(i, j))))
    }

    /// From 36 numbers, row by row, as ROS messages have them.
    ///
    /// ```
    /// use presight::{InWorld, PoseCovariance};
    /// let mut message = [0.0; 36];
    /// (message[0], message[7], message[35]) = (0.04, 0.04, 0.01);
    /// let covariance = PoseCovariance::<InWorld>::from_row_major(&message)?;
    /// let sigmas = covariance.sigmas();
    /// assert!((sigmas[0] - 0.2).abs() < 1e-12 && (sigmas[5] - 0.1).abs() < 1e-12);
    /// message[1] = 1.0;
    /// assert!(PoseCovariance::<InWorld>::from_row_major(&message).is_err(), "not symmetric");
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] unless there are 36 numbers; the errors of [`PoseCovariance::check`].
    pub fn from_row_major(numbers: &[f64]) -> Result<Self> {
        let covariance = Self::unchecked_row_major(numbers)?;
        covariance.check()?;
        Ok(covariance)
    }

    /// [`PoseCovariance::from_row_major`] for readers of files that check the matrix later.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`] unless there are 36 numbers.
    pub fn unchecked_row_major(numbers: &[f64]) -> Result<Self> {
        if numbers.len() != 36 {
            let remedy = "give 36 numbers, row-major: x y z, then rotation about x y z, metres and radians";
            return Err(Error::invalid(format!("{} numbers where 36 are needed", numbers.len()), remedy));
        }
        Ok(Self::from_rows(std::array::from_fn(|i| std::array::from_fn(|j| numbers[6 * i + j]))))
    }

    /// Names the axes of a matrix that a sister crate computed; unchecked.
    pub const fn from_rows(rows: [[f64; 6]; 6]) -> Self {
        Self { rows, axes: PhantomData }
    }

    /// The matrix.
    pub fn as_rows(&self) -> &[[f64; 6]; 6] {
        &self.rows
    }

    /// Standard deviations: x, y, z in metres, rotation about x, y, z in radians.
    pub fn sigmas(&self) -> [f64; 6] {
        std::array::from_fn(|i| self.rows[i][i].max(0.0).sqrt())
    }

    /// Checks that the matrix is finite, symmetric and positive semidefinite, as far as six printed digits allow.
    /// Functions that take a covariance do this check.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`], naming the entry at fault.
    pub fn check(&self) -> Result<()> {
        check_covariance(&self.rows)
    }
}

impl PoseCovariance<InObject> {
    /// Along the axes of the world, for an object with this pose.
    pub fn in_world(&self, world_from_object: &Pose) -> PoseCovariance<InWorld> {
        PoseCovariance::from_rows(sandwich(&turn(world_from_object.rotation), &self.rows))
    }
}

impl PoseCovariance<InRobot> {
    /// Along the axes of the world, for a robot with this pose.
    pub fn in_world(&self, world_from_robot: &Pose) -> PoseCovariance<InWorld> {
        PoseCovariance::from_rows(sandwich(&turn(world_from_robot.rotation), &self.rows))
    }
}

impl PoseCovariance<InWorld> {
    /// Along the axes of an object with this pose.
    pub fn in_object(&self, world_from_object: &Pose) -> PoseCovariance<InObject> {
        PoseCovariance::from_rows(sandwich(&turn(world_from_object.inverse().rotation), &self.rows))
    }

    /// The covariance of the pose of another point of the same rigid body: `world_axes_lever` leads to it from the
    /// point that this covariance is of, along the axes of the world, metres.
    #[must_use]
    pub fn moved_by(&self, world_axes_lever: DVec3) -> Self {
        let l = world_axes_lever;
        // d_there = d_here + dtheta x lever.
        let cross = [[0.0, l.z, -l.y], [-l.z, 0.0, l.x], [l.y, -l.x, 0.0]];
        let mut adjoint = [[0.0; 6]; 6];
        for i in 0..6 {
            adjoint[i][i] = 1.0;
        }
        for i in 0..3 {
            for j in 0..3 {
                adjoint[i][3 + j] = cross[i][j];
            }
        }
        let mut moved = [[0.0; 6]; 6];
        for (i, j) in (0..6).flat_map(|i| (0..6).map(move |j| (i, j))) {
            for (k, l) in (0..6).flat_map(|k| (0..6).map(move |l| (k, l))) {
                moved[i][j] += adjoint[i][k] * self.rows[k][l] * adjoint[j][l];
            }
        }
        Self::from_rows(moved)
    }
}

impl<A> Default for PoseCovariance<A> {
    /// An exactly known pose.
    fn default() -> Self {
        Self::ZERO
    }
}

/// A row of the matrix.
impl<A> Index<usize> for PoseCovariance<A> {
    type Output = [f64; 6];

    fn index(&self, row: usize) -> &[f64; 6] {
        &self.rows[row]
    }
}

impl<A> IndexMut<usize> for PoseCovariance<A> {
    fn index_mut(&mut self, row: usize) -> &mut [f64; 6] {
        &mut self.rows[row]
    }
}

/// As six rows.
impl<A> Serialize for PoseCovariance<A> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.rows.serialize(serializer)
    }
}

/// From six rows; unchecked.
impl<'de, A> Deserialize<'de> for PoseCovariance<A> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        <[[f64; 6]; 6]>::deserialize(deserializer).map(Self::from_rows)
    }
}

/// The pose of the robot in the world, with its uncertainty.
///
/// ```
/// use presight::{Pose, PoseEstimate, RobotPose};
/// use glam::DVec3;
/// // Position to 5 cm, angles to 0.02; a scanner is mounted 1 m ahead of the robot's origin.
/// let robot = RobotPose::from_xyz_rpy(DVec3::new(2.0, 1.0, 0.0), 0.0, 0.0, 0.0);
/// let believed = PoseEstimate::of_sigmas(robot, 0.05, 0.02);
/// let mut spec = presight::preset("laser-scanner")?.spec().clone();
/// spec.mount = Pose::from_xyz_rpy(DVec3::X, 0.0, 0.0, 0.0);
/// let scanner = presight::Sensor::new(spec)?;
/// assert_eq!(believed.robot().sensor(&scanner).world_from_sensor().translation.x, 3.0);
/// // At the scanner the heading adds 1 m x 0.02 across.
/// let variance = believed.sensor_covariance(&scanner.spec().mount)[1][1];
/// assert!((variance - (0.05f64.powi(2) + 0.02f64.powi(2))).abs() < 1e-15);
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseEstimate {
    /// The pose of the robot; [`PoseEstimate::robot`] gives it as a typed pose.
    pub world_from_robot: Pose,
    /// The covariance of that pose, along the axes of the world.
    pub covariance: PoseCovariance<InWorld>,
}

impl PoseEstimate {
    /// A pose with its covariance.
    pub fn new(robot: RobotPose, covariance: PoseCovariance<InWorld>) -> Self {
        Self { world_from_robot: robot.world_from_robot(), covariance }
    }

    /// A pose without uncertainty.
    pub fn exact(robot: RobotPose) -> Self {
        Self::new(robot, PoseCovariance::ZERO)
    }

    /// A pose with the same standard deviation along each axis, metres, and about each, radians.
    pub fn of_sigmas(robot: RobotPose, translation: f64, rotation: f64) -> Self {
        let (t, r) = (translation, rotation);
        Self::new(robot, PoseCovariance::from_sigmas([t, t, t, r, r, r]))
    }

    /// The robot's pose without the covariance.
    pub fn robot(&self) -> RobotPose {
        RobotPose::new(self.world_from_robot)
    }

    /// The pose after a known motion: `here_from_there` is the pose then, in the robot's frame now.
    #[must_use]
    pub fn after(&self, here_from_there: &Pose) -> Self {
        let there = self.world_from_robot * *here_from_there;
        let way = there.translation - self.world_from_robot.translation;
        Self { world_from_robot: there, covariance: self.covariance.moved_by(way) }
    }

    /// The covariance of the pose of a sensor with this mount (`robot_from_sensor`).
    pub fn sensor_covariance(&self, mount: &Pose) -> PoseCovariance<InWorld> {
        self.covariance.moved_by(self.world_from_robot.rotation * mount.translation)
    }

    /// The robot's pose in the frame of an object, and its covariance along the object's axes.
    pub fn in_object(&self, world_from_object: &Pose) -> (Pose, PoseCovariance<InObject>) {
        (world_from_object.inverse() * self.world_from_robot, self.covariance.in_object(world_from_object))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lever_turns_heading_into_position() {
        let robot = PoseCovariance::<InWorld>::from_sigmas([0.0, 0.0, 0.0, 0.0, 0.0, 0.1]);
        let moved = robot.moved_by(DVec3::new(2.0, 0.0, 1.0));
        // A turn by 0.1 moves a point 2 m ahead by 0.2 m to the left.
        assert!((moved[1][1] - 0.04).abs() < 1e-15 && (moved[1][5] - 0.02).abs() < 1e-15);
        assert_eq!((moved[0][0], moved[2][2]), (0.0, 0.0));
        assert!((moved[5][5] - 0.01).abs() < 1e-15);
    }

    /// A covariance moved to a sensor and back is the robot's again.
    #[test]
    fn a_covariance_survives_the_lever_to_the_sensor_and_back() {
        let mount = Pose::from_xyz_rpy(DVec3::new(0.4, -0.1, 0.5), 0.1, 0.2, 0.7);
        let robot = Pose::from_xyz_rpy(DVec3::new(3.0, 2.0, 0.1), 0.05, -0.1, 2.0);
        let sigmas = [0.1, 0.2, 0.05, 0.01, 0.02, 0.03];
        let known = PoseEstimate::new(RobotPose::new(robot), PoseCovariance::from_sigmas(sigmas));
        let covariance = known.sensor_covariance(&mount);
        assert!((covariance[0][0] - known.covariance[0][0]).abs() > 1e-5, "the mount has a lever");
        let back = covariance.moved_by(robot.translation - (robot * mount).translation);
        let apart = |i: usize, j: usize| (back[i][j] - known.covariance[i][j]).abs();
        assert!((0..36).all(|k| apart(k / 6, k % 6) < 1e-12));
    }

    /// A turn by 90 degrees about z makes an object's x the world's y; the inverse turn undoes it.
    #[test]
    fn covariances_turn_with_their_axes() {
        let own = PoseCovariance::<InObject>::from_sigmas([0.1, 0.0, 0.0, 0.0, 0.2, 0.0]);
        let pose = Pose::from_xyz_rpy(DVec3::new(5.0, 0.0, 0.0), 0.0, 0.0, std::f64::consts::FRAC_PI_2);
        let world = own.in_world(&pose);
        for (got, expected) in world.sigmas().into_iter().zip([0.0, 0.1, 0.0, 0.2, 0.0, 0.0]) {
            assert!((got - expected).abs() < 1e-12, "{world:?}");
        }
        let back = world.in_object(&pose);
        assert!((0..36).all(|k| (back[k / 6][k % 6] - own[k / 6][k % 6]).abs() < 1e-15));
    }
}
