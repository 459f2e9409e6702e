//! Small motions of a pose as six numbers.

use glam::{DQuat, DVec3};
use presight_model::geometry::{Pose, PoseEstimate, RobotPose};
use presight_model::matrix::{inverse, quadratic};

/// A small motion: x y z in metres, then rotation about fixed x y z in radians.
pub type Vector = [f64; 6];

/// The pose after a small motion in world axes.
pub fn moved(pose: &Pose, motion: &Vector) -> Pose {
    let [x, y, z, rx, ry, rz] = *motion;
    Pose {
        translation: pose.translation + DVec3::new(x, y, z),
        rotation: (DQuat::from_scaled_axis(DVec3::new(rx, ry, rz)) * pose.rotation).normalize(),
    }
}

/// The motion in world axes from one pose to another: the inverse of [`moved`].
pub fn motion_between(from: &Pose, to: &Pose) -> Vector {
    let t = to.translation - from.translation;
    let turn = to.rotation * from.rotation.conjugate();
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let r = turn.normalize().to_scaled_axis();
    [t.x, t.y, t.z, r.x, r.y, r.z]
}

/// The normalized estimation error squared (NEES) and its number of axes: e' C^-1 e, with e the motion from a pose to
/// the true pose, and C its covariance (as in [`moved`]). Axes with zero variance were not estimated and do not count.
pub fn nees(estimate: &PoseEstimate, truth: &RobotPose) -> (f64, usize) {
    let covariance = estimate.covariance.as_rows();
    let axes: Vec<usize> = (0..6).filter(|i| covariance[*i][*i] > 0.0).collect();
    let error = motion_between(&estimate.world_from_robot, &truth.world_from_robot());
    (quadratic(&inverse(covariance, &axes), &error), axes.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motions_lead_from_pose_to_pose() {
        let a = Pose::from_xyz_rpy(DVec3::new(1.0, -2.0, 0.5), 0.3, -0.2, 2.0);
        let motion = [0.1, 0.2, -0.3, 0.4, -0.5, 0.6];
        let back = motion_between(&a, &moved(&a, &motion));
        assert!(motion.iter().zip(back).all(|(m, b)| (m - b).abs() < 1e-12), "{back:?}");
    }
}
