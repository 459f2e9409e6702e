//! Tails of the normal distribution in one and two dimensions, and square roots of covariances.

use std::f64::consts::{FRAC_1_SQRT_2, PI};
use std::sync::OnceLock;

/// P(X > x) for a standard normal X.
pub fn tail(x: f64) -> f64 {
    0.5 * libm::erfc(x * FRAC_1_SQRT_2)
}

/// The x with P(X > x) = p, for p in (0, 1).
pub fn tail_quantile(p: f64) -> f64 {
    let (mut low, mut high) = (-40.0, 40.0);
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if tail(middle) > p { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// Tables of normal tails. Their relative error of a few thousandths suffices for regions of interest.
///
/// P(X > x) = M(x) exp(-x^2 / 2) with the smooth Mills ratio M. For two thresholds x and correlation rho >= 0, Owen's
/// function (Owen 1956; Drezner and Wesolowsky 1990 for other forms) gives P(X > x and Y > x) = P(X > x) s(x, a), with
/// a = sqrt((1 - rho) / (1 + rho)) and s = 1 - (1 / (pi M(x))) int_0^a exp(-x^2 t^2 / 2) / (1 + t^2) dt.
pub struct Tails {
    /// One row for each x: M, then s for a = 0 .. 1.
    rows: Vec<[f64; TAIL_COLUMNS]>,
}

/// Number of steps of a.
pub const TAIL_CELLS: usize = 64;
/// Entries of a row.
pub const TAIL_COLUMNS: usize = TAIL_CELLS + 2;
/// Rows per unit of x.
pub const TAIL_STEPS: f64 = 8.0;
/// Number of rows; the last is for 9 standard deviations.
pub const TAIL_ROWS: usize = 73;

impl Tails {
    /// The shared table.
    pub fn get() -> &'static Self {
        static TABLE: OnceLock<Tails> = OnceLock::new();
        TABLE.get_or_init(Self::new)
    }

    fn new() -> Self {
        let row = |i: usize| {
            let x = i as f64 / TAIL_STEPS;
            let mills = tail(x) * (0.5 * x * x).exp();
            let integrand = |t: f64| (-0.5 * x * x * t * t).exp() / (1.0 + t * t);
            let mut row = [mills; TAIL_COLUMNS];
            let (mut sum, width) = (0.0, 1.0 / TAIL_CELLS as f64);
            for cell in 0..=TAIL_CELLS {
                row[cell + 1] = 1.0 - sum / (PI * mills);
                let t = cell as f64 * width;
                // Simpson's rule.
                sum += width / 6.0 * (integrand(t) + 4.0 * integrand(t + 0.5 * width) + integrand(t + width));
            }
            row
        };
        Self { rows: (0..TAIL_ROWS).map(row).collect() }
    }

    /// The rows, for upload to shaders.
    pub fn rows(&self) -> &[[f64; TAIL_COLUMNS]] {
        &self.rows
    }

    /// Returns the row at or before x >= 0, and the fraction towards the next row.
    fn row(&self, x: f64) -> (usize, f64) {
        let at = (x * TAIL_STEPS).clamp(0.0, (TAIL_ROWS - 1) as f64);
        let i = (at as usize).min(TAIL_ROWS - 2);
        (i, at - i as f64)
    }

    /// Mills' ratio, P(X > x) exp(x^2 / 2), for x >= 0.
    pub fn mills(&self, x: f64) -> f64 {
        let (i, share) = self.row(x);
        let [below, above] = [self.rows[i][0], self.rows[i + 1][0]];
        below + share * (above - below)
    }

    /// P(X > x) for x >= 0.
    pub fn tail(&self, x: f64) -> f64 {
        self.mills(x) * (-0.5 * x * x).exp()
    }

    /// P(Y > x | X > x) for x >= 0, with the separation from [`apart`].
    pub fn shared(&self, x: f64, apart: f64) -> f64 {
        let (i, share) = self.row(x);
        let at = (apart * TAIL_CELLS as f64).clamp(0.0, TAIL_CELLS as f64);
        let j = (at as usize).min(TAIL_CELLS - 1);
        let part = at - j as f64;
        let along = |row: &[f64; TAIL_COLUMNS]| row[j + 1] + part * (row[j + 2] - row[j + 1]);
        let (below, above) = (along(&self.rows[i]), along(&self.rows[i + 1]));
        below + share * (above - below)
    }
}

/// Separation of two directions: the tangent of half the angle between them.
pub fn apart(rho: f64) -> f64 {
    ((1.0 - rho).max(0.0) / (1.0 + rho)).sqrt()
}

/// Returns F such that F F^T is the nearest positive semidefinite matrix. Entries are first scaled by their standard
/// deviations, because metres and radians, or nanometres and kilometres, may be mixed. Rounding to six digits can make
/// an eigenvalue slightly negative; it becomes 0. No direction gets a smaller variance than given.
pub(super) fn square_root<const N: usize>(covariance: &[[f64; N]; N]) -> [[f64; N]; N] {
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

/// Remainder of a scaled covariance that counts as rounding.
const NOTHING: f64 = 1e-12;

/// Pivoted Cholesky decomposition; columns beyond the rank are 0. Returns `None` if the matrix is indefinite beyond
/// rounding, because a small pivot would then produce huge entries.
fn by_pivots<const N: usize>(scaled: &[[f64; N]; N]) -> Option<[[f64; N]; N]> {
    let mut rest = *scaled;
    let mut factor = [[0.0; N]; N];
    for column in 0..N {
        let pivot = (0..N).fold(0, |best, i| if rest[i][i] > rest[best][best] { i } else { best });
        if rest[pivot][pivot] <= NOTHING {
            let nothing = rest.as_flattened().iter().all(|x| x.abs() <= NOTHING);
            return nothing.then_some(factor);
        }
        let root = rest[pivot][pivot].sqrt();
        let line: [f64; N] = std::array::from_fn(|i| rest[i][pivot] / root);
        for i in 0..N {
            if line[i] * line[i] > rest[i][i] * (1.0 + 1e-9) + NOTHING {
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

/// Jacobi rotations with negative eigenvalues set to 0 (Higham 1988: the nearest positive semidefinite matrix).
fn by_eigenvectors<const N: usize>(mut a: [[f64; N]; N]) -> [[f64; N]; N] {
    let mut vectors = [[0.0; N]; N];
    for i in 0..N {
        vectors[i][i] = 1.0;
    }
    // Six sweeps reduce a matrix of six rows to rounding, because each converges quadratically.
    for _ in 0..12 {
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q] == 0.0 {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let tangent = theta.signum() / (theta.abs() + theta.hypot(1.0));
                let cosine = 1.0 / tangent.hypot(1.0);
                let sine = tangent * cosine;
                let turn = |x: f64, y: f64| (cosine * x - sine * y, sine * x + cosine * y);
                for k in 0..N {
                    (a[k][p], a[k][q]) = turn(a[k][p], a[k][q]);
                }
                for k in 0..N {
                    (a[p][k], a[q][k]) = turn(a[p][k], a[q][k]);
                    (vectors[k][p], vectors[k][q]) = turn(vectors[k][p], vectors[k][q]);
                }
            }
        }
    }
    std::array::from_fn(|i| std::array::from_fn(|k| vectors[i][k] * a[k][k].max(0.0).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn tails_are_the_textbooks() {
        assert!((tail(1.959_963_984_540_054) - 0.025).abs() < 1e-15);
        assert!((tail_quantile(0.005) - 2.575_829_303_548_901).abs() < 1e-12);
    }

    #[test]
    fn tables_are_the_tails() {
        let tails = Tails::get();
        for i in 0..900 {
            let x = f64::from(i) * 0.01;
            let relative = tails.tail(x) / tail(x) - 1.0;
            // Linear interpolation of a convex function never underestimates.
            assert!(relative > -1e-12 && relative < if x < 1.5 { 2.1e-3 } else { 7e-4 }, "{x}: {relative}");
        }
        // Independent, then equal, then 1/4 + asin(rho) / (2 pi) at the median.
        assert!((tails.shared(2.5, apart(0.0)) - tail(2.5)).abs() < 1e-4);
        assert_eq!(tails.shared(2.5, apart(1.0)), 1.0);
        for rho in [0.1, 0.5, 0.95] {
            let exact = 0.25 + f64::asin(rho) / TAU;
            assert!((0.5 * tails.shared(0.0, apart(rho)) - exact).abs() < 1e-4, "{rho}");
        }
        // Compared with the integral over one variable.
        for (x, rho) in [(2.5f64, 0.9), (2.03, 0.5), (2.57, 0.99), (3.1, 0.97), (4.4, 0.8), (1.3, 0.2)] {
            let steps = 200_000;
            let width = 10.0 / f64::from(steps);
            let density = |x: f64| (-0.5 * x * x).exp() / TAU.sqrt();
            let sum: f64 = (0..steps)
                .map(|i| {
                    let y = x + (f64::from(i) + 0.5) * width;
                    density(y) * tail((x - rho * y) / (1.0 - rho * rho).sqrt()) * width
                })
                .sum();
            let got = tails.shared(x, apart(rho)) * tail(x);
            assert!((got - sum).abs() < 2e-3 * tail(x), "{x} {rho}: {got} and {sum}");
        }
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
}
