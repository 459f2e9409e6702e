//! Small motions of a pose: six numbers, and the matrices that weigh them.

use crate::geometry::Pose;
use crate::virtual_sensors::symmetric::{Matrix, eigen};
use glam::{DMat3, DQuat, DVec3};

/// Six numbers of a small motion: x y z in metres, then rotation about fixed x y z in radians.
pub type Vector = [f64; 6];

/// The pose after a small motion in world axes.
pub fn moved(pose: &Pose, motion: &Vector) -> Pose {
    let [x, y, z, rx, ry, rz] = *motion;
    Pose {
        translation: pose.translation + DVec3::new(x, y, z),
        rotation: (DQuat::from_scaled_axis(DVec3::new(rx, ry, rz)) * pose.rotation).normalize(),
    }
}

/// The motion in world axes that takes one pose to another: the inverse of [`moved`].
pub fn motion_between(from: &Pose, to: &Pose) -> Vector {
    let t = to.translation - from.translation;
    let turn = to.rotation * from.rotation.conjugate();
    let turn = if turn.w < 0.0 { -turn } else { turn };
    let r = turn.normalize().to_scaled_axis();
    [t.x, t.y, t.z, r.x, r.y, r.z]
}

/// The normalized estimation error squared (NEES): e' C^-1 e, e the motion from a pose to where it truly was, C its covariance (as
/// in [`moved`]), and how many numbers e has. Numbers without a variance were not looked for and do not count.
///
/// # Examples
/// ```
/// use presight::estimate::{moved, nees};
/// let there = moved(&presight::Pose::IDENTITY, &[0.02, 0.0, 0.0, 0.0, 0.0, 0.03]);
/// // x is known to 1 cm, y to 1 cm, yaw to 0.01: (2 + 0 + 3 deviations) squared each.
/// let mut covariance = [[0.0; 6]; 6];
/// [(0, 1e-4), (1, 1e-4), (5, 1e-4)].map(|(i, variance)| covariance[i][i] = variance);
/// let (squared, numbers) = nees(&presight::Pose::IDENTITY, &covariance, &there);
/// assert!((squared - 13.0).abs() < 1e-9 && numbers == 3);
/// ```
pub fn nees(pose: &Pose, covariance: &Matrix, truth: &Pose) -> (f64, usize) {
    let axes: Vec<usize> = (0..6).filter(|i| covariance[*i][*i] > 0.0).collect();
    let error = motion_between(pose, truth);
    (quadratic(&inverse(covariance, &axes), &error), axes.len())
}

/// The matrix that turns the motions of one frame into those of another with other axes.
pub fn turn(rotation: DQuat) -> Matrix {
    let m = DMat3::from_quat(rotation);
    std::array::from_fn(|i| std::array::from_fn(|j| if i / 3 == j / 3 { m.col(j % 3)[i % 3] } else { 0.0 }))
}

pub fn add_to(sum: &mut Matrix, other: &Matrix) {
    sum.as_flattened_mut().iter_mut().zip(other.as_flattened()).for_each(|(s, o)| *s += o);
}

pub fn scaled(m: &Matrix, factor: f64) -> Matrix {
    m.map(|row| row.map(|x| factor * x))
}

pub fn product(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..6).map(|k| a[i][k] * b[k][j]).sum()))
}

pub fn transposed(a: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

/// a b a'.
pub fn sandwich(a: &Matrix, b: &Matrix) -> Matrix {
    product(&product(a, b), &transposed(a))
}

pub fn apply(a: &Matrix, x: &Vector) -> Vector {
    std::array::from_fn(|i| (0..6).map(|k| a[i][k] * x[k]).sum())
}

/// v' m v.
pub fn quadratic(m: &Matrix, v: &Vector) -> f64 {
    (0..6).map(|i| (0..6).map(|j| v[i] * m[i][j] * v[j]).sum::<f64>()).sum()
}

/// The rows and columns of the axes that are looked for; 0 elsewhere.
pub fn restricted(m: &Matrix, axes: &[usize]) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| if axes.contains(&i) && axes.contains(&j) { m[i][j] } else { 0.0 }))
}

/// Eigenvalues and unit eigenvectors of the numbers that are looked for, rotations counted as lengths at `reach` metres.
/// Vectors are motions: metres, and radians times reach.
pub fn directions(m: &Matrix, axes: &[usize], reach: f64) -> Vec<(f64, Vector)> {
    let scale = |i: usize| if i >= 3 { reach } else { 1.0 };
    let n = axes.len();
    let small =
        std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                if i < n && j < n { m[axes[i]][axes[j]] / (scale(axes[i]) * scale(axes[j])) } else { 0.0 }
            })
        });
    let (values, vectors) = eigen(small, n);
    let vector = |k: usize| {
        let mut v = [0.0; 6];
        (0..n).for_each(|i| v[axes[i]] = vectors[i][k]);
        v
    };
    (0..n).map(|k| (values[k], vector(k))).collect()
}

/// An eigenvalue below this, with ones on the diagonal, is rounding.
const OPEN: f64 = 1e-12;

/// The inverse on the axes that are looked for, without the directions that are open: along these it is 0. Axes are scaled by
/// their own diagonal first, so that what is known far better does not make the rest look open.
pub fn inverse(m: &Matrix, axes: &[usize]) -> Matrix {
    let root: [f64; 6] = std::array::from_fn(|i| if m[i][i] > 0.0 { m[i][i].sqrt() } else { 1.0 });
    let even = std::array::from_fn(|i| std::array::from_fn(|j| m[i][j] / (root[i] * root[j])));
    let found = directions(&even, axes, 1.0);
    let mut sum = [[0.0; 6]; 6];
    for (value, v) in found.iter().filter(|(value, _)| *value > OPEN) {
        for i in 0..6 {
            for j in 0..6 {
                sum[i][j] += v[i] * v[j] / (value * root[i] * root[j]);
            }
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn diagonal(d: [f64; 6]) -> Matrix {
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { d[i] } else { 0.0 }))
    }

    #[test]
    fn motions_lead_from_pose_to_pose() {
        let a = Pose::from_xyz_rpy(DVec3::new(1.0, -2.0, 0.5), 0.3, -0.2, 2.0);
        let motion = [0.1, 0.2, -0.3, 0.4, -0.5, 0.6];
        let back = motion_between(&a, &moved(&a, &motion));
        assert!(motion.iter().zip(back).all(|(m, b)| (m - b).abs() < 1e-12), "{back:?}");
    }

    /// What is known a million times better does not make the rest look open; what nothing is known of stays 0.
    #[test]
    fn inverses_keep_all_that_is_known() {
        let all = [0, 1, 2, 3, 4, 5];
        let m = diagonal([4e-2, 1.0, 1e-12, 1e12, 0.0, 2.0]);
        let inverse = inverse(&m, &all);
        for (i, expected) in [25.0, 1.0, 1e12, 1e-12, 0.0, 0.5].into_iter().enumerate() {
            assert!((inverse[i][i] - expected).abs() <= 1e-9 * expected, "{i}: {}", inverse[i][i]);
        }
        // Two axes of which only the sum is known.
        let mut m = diagonal([1.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
        (m[0][1], m[1][0]) = (1.0, 1.0);
        let inverse = super::inverse(&m, &all);
        assert!((inverse[0][0] - 0.25).abs() < 1e-12 && (inverse[0][1] - 0.25).abs() < 1e-12);
    }

    #[test]
    fn turned_motions_are_those_in_other_axes() {
        let rotation = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2);
        let turned = apply(&turn(rotation), &[1.0, 0.0, 0.0, 0.0, 2.0, 0.0]);
        let expected = [0.0, 1.0, 0.0, -2.0, 0.0, 0.0];
        assert!(turned.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{turned:?}");
    }
}
