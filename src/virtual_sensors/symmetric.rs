//! Eigenvalues of small symmetric matrices, by Jacobi's rotations.

/// At most six by six: a pose.
pub type Matrix = [[f64; 6]; 6];

/// Eigenvalues and eigenvectors (vector k is column k) of the upper left n x n part of a symmetric matrix.
///
/// Rotations run until nothing is left off the diagonal that f64 could tell; that takes some six sweeps, and 64 are never
/// exceeded.
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

/// Makes a[p][q] zero.
fn rotate(a: &mut Matrix, v: &mut Matrix, p: usize, q: usize, n: usize) {
    let apq = a[p][q];
    // Too small to move either of the two.
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

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
