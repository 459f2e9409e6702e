//! Small motions of a pose as six numbers, and the least-squares problem that determines them.

use glam::{DQuat, DVec3};
use presight_model::geometry::{Pose, PoseEstimate, RobotPose};
use presight_model::matrix::{Matrix, add_to, apply, inverse, quadratic};

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

/// Normal equations of a small motion in world axes, from weighted residuals e with derivatives J.
#[derive(Clone, Debug, Default)]
pub struct NormalEquations {
    /// J' W J.
    pub information: Matrix,
    /// J' W e.
    pub gradient: Vector,
}

impl NormalEquations {
    /// Adds a residual.
    pub fn add(&mut self, residual: f64, derivative: &Vector, weight: f64) {
        for a in 0..6 {
            self.gradient[a] += weight * residual * derivative[a];
            (0..6).for_each(|b| self.information[a][b] += weight * derivative[a] * derivative[b]);
        }
    }

    /// One Gauss-Newton step: the motion along `axes` that minimizes the residuals together with a prior, and its
    /// covariance. `prior` is the information of the prior, and `off` the motion from the prior to the current pose.
    pub fn step(mut self, prior: &Matrix, off: &Vector, axes: &[usize]) -> (Vector, Matrix) {
        add_to(&mut self.information, prior);
        let pull = apply(prior, off);
        (0..6).for_each(|i| self.gradient[i] += pull[i]);
        let covariance = inverse(&self.information, axes);
        (apply(&covariance, &self.gradient).map(|x| -x), covariance)
    }
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

    /// By hand: two residuals of 0.1 m along x, each of variance 0.01, against a prior of variance 0.01 at its own
    /// place: two thirds of the way, with a third of the variance. Other axes stay.
    #[test]
    fn a_step_weighs_residuals_against_the_prior() {
        let mut equations = NormalEquations::default();
        (0..2).for_each(|_| equations.add(0.1, &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0], 100.0));
        let prior: Matrix = std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 100.0 } else { 0.0 }));
        let (step, covariance) = equations.step(&prior, &[0.0; 6], &[0, 1, 5]);
        assert!((step[0] + 0.2 / 3.0).abs() < 1e-12 && step[1..].iter().all(|x| *x == 0.0), "{step:?}");
        assert!((covariance[0][0] - 0.01 / 3.0).abs() < 1e-12 && covariance[2][2] == 0.0, "{covariance:?}");
    }
}
