//! Six-by-six matrices: covariances and information of poses, and eigenvalues of symmetric ones by Jacobi rotations.

use glam::{DMat3, DQuat};

/// The numbers of a pose, at most six.
pub type Matrix = [[f64; 6]; 6];

/// Eigenvalues and eigenvectors (vector k is column k) of the upper left n x n part of a symmetric matrix.
///
/// Rotates until the off-diagonal elements vanish in f64, which takes about six sweeps, and at most 64.
pub fn eigen(mut a: Matrix, n: usize) -> ([f64; 6], Matrix) {
    let mut v = [[0.0; 6]; 6];
    (0..n).for_each(|i| v[i][i] = 1.0);
    for _ in 0..64 {
        let off: f64 = (0..n).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[i][j].abs()).sum();
        if off == 0.0 {
            break;
        }
        for p in 0..n {
            for q in p + 1..n {
                rotate(&mut a, &mut v, p, q, n);
            }
        }
    }
    (std::array::from_fn(|i| if i < n { a[i][i] } else { 0.0 }), v)
}

/// The Jacobi rotation that zeroes a[p][q].
fn rotate(a: &mut Matrix, v: &mut Matrix, p: usize, q: usize, n: usize) {
    let apq = a[p][q];
    // Too small to change either diagonal element.
    if apq == 0.0 || apq.abs() < 1e-300 || apq.abs() <= f64::EPSILON * 1e-4 * (a[p][p] * a[q][q]).abs().sqrt() {
        (a[p][q], a[q][p]) = (0.0, 0.0);
        return;
    }
    let theta = (a[q][q] - a[p][p]) / (2.0 * apq);
    let t = theta.signum() / (theta.abs() + theta.hypot(1.0));
    let t = if theta == 0.0 { 1.0 } else { t };
    let c = 1.0 / t.hypot(1.0);
    let s = t * c;
    for k in 0..n {
        let (akp, akq) = (a[k][p], a[k][q]);
        (a[k][p], a[k][q]) = (c * akp - s * akq, s * akp + c * akq);
    }
    for k in 0..n {
        let (apk, aqk) = (a[p][k], a[q][k]);
        (a[p][k], a[q][k]) = (c * apk - s * aqk, s * apk + c * aqk);
    }
    (a[p][q], a[q][p]) = (0.0, 0.0);
    for row in v.iter_mut().take(n) {
        let (vp, vq) = (row[p], row[q]);
        (row[p], row[q]) = (c * vp - s * vq, s * vp + c * vq);
    }
}

/// Adds `other` to `sum`.
pub fn add_to(sum: &mut Matrix, other: &Matrix) {
    sum.as_flattened_mut().iter_mut().zip(other.as_flattened()).for_each(|(s, o)| *s += o);
}

/// The matrix times a factor.
pub fn scaled(m: &Matrix, factor: f64) -> Matrix {
    m.map(|row| row.map(|x| factor * x))
}

/// a b.
pub fn product(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..6).map(|k| a[i][k] * b[k][j]).sum()))
}

/// a'.
pub fn transposed(a: &Matrix) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

/// a b a'.
pub fn sandwich(a: &Matrix, b: &Matrix) -> Matrix {
    product(&product(a, b), &transposed(a))
}

/// a x.
pub fn apply(a: &Matrix, x: &[f64; 6]) -> [f64; 6] {
    std::array::from_fn(|i| (0..6).map(|k| a[i][k] * x[k]).sum())
}

/// The matrix that rotates motions (translation, then rotation) into the axes of another frame.
pub fn turn(rotation: DQuat) -> Matrix {
    let m = DMat3::from_quat(rotation);
    std::array::from_fn(|i| std::array::from_fn(|j| if i / 3 == j / 3 { m.col(j % 3)[i % 3] } else { 0.0 }))
}

/// v' m v.
pub fn quadratic(m: &Matrix, v: &[f64; 6]) -> f64 {
    (0..6).map(|i| (0..6).map(|j| v[i] * m[i][j] * v[j]).sum::<f64>()).sum()
}

/// The rows and columns of the estimated axes; 0 elsewhere.
pub fn restricted(m: &Matrix, axes: &[usize]) -> Matrix {
    std::array::from_fn(|i| std::array::from_fn(|j| if axes.contains(&i) && axes.contains(&j) { m[i][j] } else { 0.0 }))
}

/// Eigenvalues and unit eigenvectors on the estimated axes, with rotations scaled to lengths at `reach` metres. Vectors
/// are motions: metres, and radians times reach.
pub fn directions(m: &Matrix, axes: &[usize], reach: f64) -> Vec<(f64, [f64; 6])> {
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

/// With ones on the diagonal, an eigenvalue below this is rounding.
const OPEN: f64 = 1e-12;

/// The inverse on the estimated axes. Along undetermined directions it is 0. Axes are first scaled by their own
/// diagonal, so that one known far better does not make the others look undetermined.
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
    use proptest::prelude::*;

    fn diagonal(d: [f64; 6]) -> Matrix {
        std::array::from_fn(|i| std::array::from_fn(|j| if i == j { d[i] } else { 0.0 }))
    }

    /// An axis known a million times better does not make the others look undetermined; unknown axes stay 0.
    #[test]
    fn inverses_keep_all_that_is_known() {
        let all = [0, 1, 2, 3, 4, 5];
        let m = diagonal([4e-2, 1.0, 1e-12, 1e12, 0.0, 2.0]);
        let inverse = inverse(&m, &all);
        for (i, expected) in [25.0, 1.0, 1e12, 1e-12, 0.0, 0.5].into_iter().enumerate() {
            assert!((inverse[i][i] - expected).abs() <= 1e-9 * expected, "{i}: {}", inverse[i][i]);
        }
        // Two axes for which only the sum is known.
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

    proptest! {
        #[test]
        fn a_matrix_is_put_together_again(n in 1..7usize, entries in prop::collection::vec(-9.0..9.0f64, 36)) {
            let a: Matrix = std::array::from_fn(|i| std::array::from_fn(|j| {
                if i < n && j < n { entries[6 * i.min(j) + i.max(j)] } else { 0.0 }
            }));
            let (values, v) = eigen(a, n);
            for i in 0..n {
                for j in 0..n {
                    let again: f64 = (0..n).map(|k| v[i][k] * values[k] * v[j][k]).sum();
                    let product: f64 = (0..n).map(|k| v[i][k] * v[j][k]).sum();
                    prop_assert!((again - a[i][j]).abs() < 1e-12, "{} {}", again, a[i][j]);
                    prop_assert!((product - f64::from(u8::from(i == j))).abs() < 1e-13);
                }
            }
        }
    }
}
