//! Normal deviates; tails and quantiles of the normal and the chi-squared distribution; medians and quantiles of
//! values.

use std::cmp::Ordering;
use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};
use std::sync::OnceLock;

/// Two independent normal numbers with mean 0 and this standard deviation, from two uniform ones in (0, 1] and [0, 1]
/// (G. Box and M. Muller 1958).
#[inline]
pub fn normal_pair(x: f64, y: f64, sigma: f64) -> [f64; 2] {
    let (sin, cos) = (TAU * y).sin_cos();
    let length = sigma * (-2.0 * x.ln()).sqrt();
    [length * cos, length * sin]
}

/// [`normal_pair`] of standard deviation 1, with the same bits on every machine.
pub fn portable_normal_pair(x: f64, y: f64) -> [f64; 2] {
    let length = (-2.0 * libm::log(x)).sqrt();
    [length * libm::cos(TAU * y), length * libm::sin(TAU * y)]
}

/// The value with `rank` others before it, in this order; `None` if there are too few.
pub fn ranked<T: Copy>(values: &mut [T], rank: usize, order: impl FnMut(&T, &T) -> Ordering) -> Option<T> {
    (rank < values.len()).then(|| *values.select_nth_unstable_by(rank, order).1)
}

/// The upper median: for an even count, the larger of the two middle values; `None` without values.
pub fn upper_median<T: Copy>(values: &mut [T], order: impl FnMut(&T, &T) -> Ordering) -> Option<T> {
    ranked(values, values.len() / 2, order)
}

/// The median: for an even count, the mean of the two middle values; `None` without values.
pub fn median(values: &mut [f64]) -> Option<f64> {
    let n = values.len();
    let upper = ranked(values, n / 2, f64::total_cmp)?;
    Some(0.5 * (ranked(values, (n - 1) / 2, f64::total_cmp)? + upper))
}

/// The quantile by nearest rank: the least value with at least this share of the values at or below it.
pub fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    let rank = (share * values.len() as f64).ceil() as usize;
    ranked(values, rank.saturating_sub(1), f64::total_cmp)
}

/// Bound of the noise of a measurement in standard deviations. Gaussian noise exceeds it once in 1,000 measurements.
pub const NOISE_BOUND: f64 = 3.3;

/// P(X > x) for a standard normal X.
#[inline]
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

/// Quantile of a chi-squared variable with `dimensions` degrees of freedom for probability p, whose standard normal
/// deviate is `deviate`. It is within 3 % for p above 0.9 (E. B. Wilson and M. M. Hilferty 1931).
pub fn chi_squared_quantile(dimensions: u32, deviate: f64) -> f64 {
    let n = f64::from(dimensions.max(1));
    let spread = 2.0 / (9.0 * n);
    n * (1.0 - spread + deviate * spread.sqrt()).powi(3)
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
    #[inline]
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
    #[inline]
    fn row(&self, x: f64) -> (usize, f64) {
        let at = (x * TAIL_STEPS).clamp(0.0, (TAIL_ROWS - 1) as f64);
        let i = (at as usize).min(TAIL_ROWS - 2);
        (i, at - i as f64)
    }

    /// Mills' ratio, P(X > x) exp(x^2 / 2), for x >= 0.
    #[inline]
    pub fn mills(&self, x: f64) -> f64 {
        let (i, share) = self.row(x);
        let [below, above] = [self.rows[i][0], self.rows[i + 1][0]];
        below + share * (above - below)
    }

    /// P(X > x) for x >= 0.
    #[inline]
    pub fn tail(&self, x: f64) -> f64 {
        self.mills(x) * (-0.5 * x * x).exp()
    }

    /// P(Y > x | X > x) for x >= 0, with the separation from [`apart`].
    #[inline]
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
#[inline]
pub fn apart(rho: f64) -> f64 {
    ((1.0 - rho).max(0.0) / (1.0 + rho)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::SplitMix64;

    #[test]
    fn normal_pairs_have_the_moments_of_normal_numbers() {
        // Radius sqrt(-2 ln exp(-2)) = 2, a quarter turn.
        let e = (-2f64).exp();
        let wide = normal_pair(e, 0.25, 3.0).map(|x| x / 3.0);
        for [x, y] in [normal_pair(e, 0.25, 1.0), portable_normal_pair(e, 0.25), wide] {
            assert!(x.abs() < 1e-15 && (y - 2.0).abs() < 1e-15, "{x} {y}");
        }
        let mut random = SplitMix64(1);
        let n = 100_000;
        // E x^2 = 1, E x^4 = 3, E x y = 0, each within about five standard deviations of its mean.
        let mut sums = [0.0; 4];
        for _ in 0..n {
            let [x, y] = normal_pair(1.0 - random.unit(), random.unit(), 1.0);
            for (sum, term) in sums.iter_mut().zip([x, x * x, x.powi(4), x * y]) {
                *sum += term / f64::from(n);
            }
        }
        let [mean, square, fourth, product] = sums;
        assert!(mean.abs() < 0.016 && (square - 1.0).abs() < 0.023, "{sums:?}");
        assert!((fourth - 3.0).abs() < 0.16 && product.abs() < 0.016, "{sums:?}");
    }

    #[test]
    fn medians_and_quantiles_are_by_rank() {
        let (mut even, mut odd) = ([4.0, 1.0, 3.0, 2.0], [9.0, -1.0, 5.0]);
        assert_eq!((median(&mut even), median(&mut odd), median(&mut [])), (Some(2.5), Some(5.0), None));
        assert_eq!(upper_median(&mut even, f64::total_cmp), Some(3.0));
        assert_eq!(upper_median(&mut odd, f64::total_cmp), Some(5.0));
        assert_eq!(upper_median(&mut [0.5f32, 0.25], f32::total_cmp), Some(0.5));
        let of = |share| quantile(&mut [40.0, 10.0, 30.0, 20.0], share);
        assert_eq!([0.0, 0.25, 0.26, 0.75, 1.0].map(of), [10.0, 10.0, 20.0, 30.0, 40.0].map(Some));
        assert_eq!((quantile(&mut [], 0.5), ranked(&mut odd, 3, f64::total_cmp)), (None, None));
    }

    #[test]
    fn chi_squared_quantiles_are_the_tables() {
        // Abramowitz and Stegun, table 26.8: 99 % and 99.9 %.
        for (n, p99, p999) in [(1, 6.635, 10.828), (2, 9.210, 13.816), (5, 15.086, 20.515), (10, 23.209, 29.588)] {
            assert!((chi_squared_quantile(n, 2.326_348) / p99 - 1.0).abs() < 0.03);
            assert!((chi_squared_quantile(n, 3.090_232) / p999 - 1.0).abs() < 0.035);
        }
    }

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
}
