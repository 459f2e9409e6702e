//! Constant motion of a rigid body.

use super::Pose;
use crate::error::{Error, Result};
use glam::{DMat3, DQuat, DVec3};

/// A constant velocity in the body's own axes (`geometry_msgs/Twist` of `child_frame_id`).
///
/// # Examples
/// ```
/// use presight::Twist;
/// // A quarter turn to the left on a circle of radius 1 m, in one second.
/// let quarter = std::f64::consts::FRAC_PI_2;
/// let twist = Twist::new(glam::DVec3::X * quarter, glam::DVec3::Z * quarter);
/// assert!(twist.over(1.0).translation.distance(glam::DVec3::new(1.0, 1.0, 0.0)) < 1e-12);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Metres per second.
    pub linear: DVec3,
    /// Radians per second about x, y, z.
    pub angular: DVec3,
}

/// Below this angle, radians, the series of [`mean_rotation`] is exact in f64: its next term is below 1e-9 of its first.
const SMALL: f64 = 1e-4;

impl Twist {
    /// Metres and radians per second, body axes.
    pub fn new(linear: DVec3, angular: DVec3) -> Self {
        Self { linear, angular }
    }

    /// From vx, vy, vz, wx, wy, wz, metres and radians per second, body axes.
    pub fn from_array([vx, vy, vz, wx, wy, wz]: [f64; 6]) -> Self {
        Self::new(DVec3::new(vx, vy, vz), DVec3::new(wx, wy, wz))
    }

    /// As vx, vy, vz, wx, wy, wz.
    pub fn to_array(&self) -> [f64; 6] {
        let (v, w) = (self.linear, self.angular);
        [v.x, v.y, v.z, w.x, w.y, w.z]
    }

    /// The pose after `seconds`, in the frame at the start: the exponential map of SE(3).
    pub fn over(&self, seconds: f64) -> Pose {
        let angles = self.angular * seconds;
        Pose { translation: mean_rotation(angles) * (self.linear * seconds), rotation: DQuat::from_scaled_axis(angles) }
    }

    /// The twist that leads to a pose (in the frame at the start) in `seconds`: the inverse of [`Twist::over`] for turns
    /// of less than half a revolution.
    pub fn to(pose: &Pose, seconds: f64) -> Self {
        let turn = if pose.rotation.w < 0.0 { -pose.rotation } else { pose.rotation };
        let angles = turn.normalize().to_scaled_axis();
        let translation = mean_rotation(angles).inverse() * pose.translation;
        Self { linear: translation / seconds, angular: angles / seconds }
    }

    /// # Errors
    /// [`crate::ErrorKind::Invalid`] if a component is not finite, or leads out of all coordinates within a second.
    pub fn check(&self) -> Result<()> {
        if self.linear.is_finite() && self.angular.is_finite() && self.over(1.0).check().is_ok() {
            return Ok(());
        }
        // Debug format, because Display has no exponents: 1e300 would fill the screen.
        let what = format!("a twist of {:?} m/s and rad/s", self.to_array());
        Err(Error::invalid(what, "give metres and radians per second, along and about the axes of the robot"))
    }
}

/// The mean of the rotations from the identity to a rotation vector (the left Jacobian of SO(3)).
fn mean_rotation(angles: DVec3) -> DMat3 {
    let theta = angles.length();
    let skew = DMat3::from_cols(
        DVec3::new(0.0, angles.z, -angles.y),
        DVec3::new(-angles.z, 0.0, angles.x),
        DVec3::new(angles.y, -angles.x, 0.0),
    );
    let (first, second) = if theta < SMALL {
        (0.5, 1.0 / 6.0)
    } else {
        ((1.0 - theta.cos()) / (theta * theta), (theta - theta.sin()) / theta.powi(3))
    };
    DMat3::IDENTITY + skew * first + skew * skew * second
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_twist_and_its_pose_determine_each_other() {
        for (linear, angular) in [
            (DVec3::new(1.5, -0.2, 0.1), DVec3::new(0.1, -0.3, 2.0)),
            (DVec3::new(1.0, 0.0, 0.0), DVec3::ZERO),
            (DVec3::new(-2.0, 0.5, 0.0), DVec3::new(0.0, 0.0, 1e-6)),
        ] {
            let twist = Twist::new(linear, angular);
            let back = Twist::to(&twist.over(0.7), 0.7);
            assert!(back.linear.distance(linear) < 1e-12 && back.angular.distance(angular) < 1e-12, "{back:?}");
            let twice = twist.over(0.3) * twist.over(0.4);
            assert!(twice.translation.distance(twist.over(0.7).translation) < 1e-12);
        }
        assert!(Twist::new(DVec3::NAN, DVec3::ZERO).check().is_err());
    }
}
