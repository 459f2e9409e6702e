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

/// Information below this part of the largest is none.
const OPEN: f64 = 1e-10;

/// The inverse on the axes that are looked for, without the directions that are open: along these it is 0.
pub fn inverse(m: &Matrix, axes: &[usize], reach: f64) -> Matrix {
    let scale = |i: usize| if i >= 3 { reach } else { 1.0 };
    let found = directions(m, axes, reach);
    let most = found.iter().map(|(value, _)| *value).fold(0.0, f64::max);
    let mut sum = [[0.0; 6]; 6];
    for (value, v) in found.iter().filter(|(value, _)| *value > OPEN * most && *value > 0.0) {
        for i in 0..6 {
            for j in 0..6 {
                sum[i][j] += v[i] * v[j] / (value * scale(i) * scale(j));
            }
        }
    }
    sum
}
