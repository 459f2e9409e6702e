//! Small matrices: covariances and information of poses, eigenvalues of symmetric ones by Jacobi rotations, Cholesky
//! decompositions and square roots of covariances of any size.

use glam::{DMat3, DQuat};

/// The numbers of a pose, at most six.
pub type Matrix = [[f64; 6]; 6];

/// Eigenvalues and eigenvectors (vector k is column k) of the upper left n x n part of a symmetric matrix.
///
/// Rotates until the off-diagonal elements vanish in f64, which takes about six sweeps, and at most 64.
pub fn eigen(a: Matrix, n: usize) -> ([f64; 6], Matrix) {
    jacobi(a, n)
}

fn jacobi<const N: usize>(mut a: [[f64; N]; N], n: usize) -> ([f64; N], [[f64; N]; N]) {
    let mut v = [[0.0; N]; N];
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
fn rotate<const N: usize>(a: &mut [[f64; N]; N], v: &mut [[f64; N]; N], p: usize, q: usize, n: usize) {
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

/// Entries and eigenvalues below this are rounding, in matrices with ones on the diagonal.
const ROUNDING: f64 = 1e-12;

/// The inverse on the estimated axes. Along undetermined directions it is 0. Axes are first scaled by their own
/// diagonal, so that one known far better does not make the others look undetermined.
pub fn inverse(m: &Matrix, axes: &[usize]) -> Matrix {
    let root: [f64; 6] = std::array::from_fn(|i| if m[i][i] > 0.0 { m[i][i].sqrt() } else { 1.0 });
    let even = std::array::from_fn(|i| std::array::from_fn(|j| m[i][j] / (root[i] * root[j])));
    let found = directions(&even, axes, 1.0);
    let mut sum = [[0.0; 6]; 6];
    for (value, v) in found.iter().filter(|(value, _)| *value > ROUNDING) {
        for i in 0..6 {
            for j in 0..6 {
                sum[i][j] += v[i] * v[j] / (value * root[i] * root[j]);
            }
        }
    }
    sum
}

/// The lower triangular L with L L' = a (Cholesky decomposition); reads the lower triangle of a. `pivot` gets the
/// square of each diagonal entry of L and returns the value to use instead, or `None` to give up.
pub fn cholesky<const N: usize>(a: &[[f64; N]; N], pivot: impl Fn(f64) -> Option<f64>) -> Option<[[f64; N]; N]> {
    let mut l = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..=i {
            let rest = a[i][j] - (0..j).map(|k| l[i][k] * l[j][k]).sum::<f64>();
            l[i][j] = if i == j { pivot(rest)?.sqrt() } else { rest / l[j][j] };
        }
    }
    Some(l)
}

/// The x with L L' x = b, for a lower triangular L.
pub fn solve_factored<const N: usize>(l: &[[f64; N]; N], b: &[f64; N]) -> [f64; N] {
    let mut x = [0.0; N];
    for i in 0..N {
        let known: f64 = (0..i).map(|k| l[i][k] * x[k]).sum();
        x[i] = (b[i] - known) / l[i][i];
    }
    for i in (0..N).rev() {
        let known: f64 = (i + 1..N).map(|k| l[k][i] * x[k]).sum();
        x[i] = (x[i] - known) / l[i][i];
    }
    x
}

/// Returns F such that F F^T is the nearest positive semidefinite matrix. Entries are first scaled by their standard
/// deviations, because metres and radians, or nanometres and kilometres, may be mixed. Rounding to six digits can make
/// an eigenvalue slightly negative; it becomes 0. No direction gets a smaller variance than given.
pub fn square_root<const N: usize>(covariance: &[[f64; N]; N]) -> [[f64; N]; N] {
    let sigma: [f64; N] = std::array::from_fn(|i| covariance[i][i].max(0.0).sqrt());
    let mut scaled = [[0.0; N]; N];
    for i in 0..N {
        for j in 0..N {
            let scale = sigma[i] * sigma[j];
            scaled[i][j] = if scale > 0.0 { 0.5 * (covariance[i][j] + covariance[j][i]) / scale } else { 0.0 };
        }
    }
    let mut factor = by_pivots(&scaled).unwrap_or_else(|| by_eigenvectors(scaled));
    for (row, sigma) in factor.iter_mut().zip(sigma) {
        row.iter_mut().for_each(|x| *x *= sigma);
    }
    factor
}

/// Pivoted Cholesky decomposition; columns beyond the rank are 0. Returns `None` if the matrix is indefinite beyond
/// rounding, because a small pivot would then produce huge entries.
fn by_pivots<const N: usize>(scaled: &[[f64; N]; N]) -> Option<[[f64; N]; N]> {
    let mut rest = *scaled;
    let mut factor = [[0.0; N]; N];
    for column in 0..N {
        let pivot = (0..N).fold(0, |best, i| if rest[i][i] > rest[best][best] { i } else { best });
        if rest[pivot][pivot] <= ROUNDING {
            let nothing = rest.as_flattened().iter().all(|x| x.abs() <= ROUNDING);
            return nothing.then_some(factor);
        }
        let root = rest[pivot][pivot].sqrt();
        let line: [f64; N] = std::array::from_fn(|i| rest[i][pivot] / root);
        for i in 0..N {
            if line[i] * line[i] > rest[i][i] * (1.0 + 1e-9) + ROUNDING {
                return None;
            }
            factor[i][column] = line[i];
            for j in 0..N {
                rest[i][j] -= line[i] * line[j];
            }
        }
        for i in 0..N {
            (rest[i][pivot], rest[pivot][i]) = (0.0, 0.0);
        }
    }
    Some(factor)
}

/// By eigenvalues, with negative ones set to 0 (Higham 1988: the nearest positive semidefinite matrix).
fn by_eigenvectors<const N: usize>(a: [[f64; N]; N]) -> [[f64; N]; N] {
    let (values, vectors) = jacobi(a, N);
    std::array::from_fn(|i| std::array::from_fn(|k| vectors[i][k] * values[k].max(0.0).sqrt()))
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
        // Two axes with information on their sum only.
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

    /// The factor is worked out by hand: rows (2), (1, 3), (-1, 2, 1).
    #[test]
    fn cholesky_factors_multiply_back_and_solve() {
        let a = [[4.0, f64::NAN, f64::NAN], [2.0, 10.0, f64::NAN], [-2.0, 5.0, 6.0]];
        let l = cholesky(&a, Some).unwrap();
        assert_eq!(l, [[2.0, 0.0, 0.0], [1.0, 3.0, 0.0], [-1.0, 2.0, 1.0]]);
        // a (1, 2, 3)' = (2, 37, 26)'.
        assert_eq!(solve_factored(&l, &[2.0, 37.0, 26.0]), [1.0, 2.0, 3.0]);
        let positive = |rest: f64| (rest > 0.0).then_some(rest);
        assert_eq!(cholesky(&[[1.0, 2.0], [2.0, 3.0]], positive), None);
        assert_eq!(
            cholesky(&[[1.0, 2.0], [2.0, 3.0]], |rest| Some(rest.max(9.0))),
            Some([[3.0, 0.0], [2.0 / 3.0, 3.0]])
        );
    }

    #[test]
    fn square_roots_square_back() {
        let full = [[4.0, 2.0, 0.6], [2.0, 5.0, 1.0], [0.6, 1.0, 3.0]];
        let line = [1e-9, 3.0, -2.0];
        let singular = [0, 1, 2].map(|i| [0, 1, 2].map(|j| line[i] * line[j]));
        let mixed = [[1e6, 0.0, 0.0], [0.0, 1e-18, 0.0], [0.0, 0.0, 0.0]];
        for m in [full, singular, mixed] {
            let f = square_root(&m);
            for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
                let back: f64 = (0..3).map(|k| f[i][k] * f[j][k]).sum();
                assert!((back - m[i][j]).abs() <= 1e-12 * (m[i][i] * m[j][j]).sqrt() + 1e-30, "{m:?}: {back}");
            }
        }
    }

    /// Matrices that are slightly indefinite, as in files: no entry becomes huge, and no direction gets more certain.
    #[test]
    fn square_roots_of_what_is_hardly_no_covariance_are_of_the_nearest() {
        let e = 1e-5;
        let wrong = [
            [[1.0, 1.0 + e, 0.0], [1.0 + e, 1.0, 0.0], [0.0, 0.0, 1.0]],
            [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0 - e], [1.0, 1.0 - e, 1.0]],
            [[1.0, 1.0, 0.0], [1.0, 1.0 + 1e-13, e], [0.0, e, 1e-8]],
            [[1e-18, 1.000_01e-9, 0.0], [1.000_01e-9, 1.0, 0.0], [0.0, 0.0, 1e6]],
        ];
        for m in wrong {
            let f = square_root(&m);
            let mut more = [[0.0; 3]; 3];
            for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
                let scale = (m[i][i] * m[j][j]).sqrt();
                more[i][j] = ((0..3).map(|k| f[i][k] * f[j][k]).sum::<f64>() - m[i][j]) / scale;
                assert!(more[i][j].abs() <= 1e-4 || m[2][2] == 1e-8, "{m:?}: {more:?}");
            }
            // The added part has no negative eigenvalue.
            let left = by_eigenvectors(more.map(|row| row.map(|x| -x)));
            assert!(left.as_flattened().iter().all(|x| x * x < 1e-13), "{m:?}: {left:?}");
        }
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
