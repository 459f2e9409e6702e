//! Tails of the normal distribution in one and two dimensions, and square roots of covariances.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};

/// P(X > x) of a standard normal X.
pub(super) fn tail(x: f64) -> f64 {
    0.5 * libm::erfc(x * FRAC_1_SQRT_2)
}

/// The x with P(X > x) = p, for p in (0, 1).
pub(super) fn tail_quantile(p: f64) -> f64 {
    let (mut low, mut high) = (-40.0, 40.0);
    for _ in 0..80 {
        let middle = 0.5 * (low + high);
        if tail(middle) > p { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// P(X > h and Y > k) of standard normal X, Y with correlation rho: Plackett's integral over the correlation (Drezner and
/// Wesolowsky 1990), by Gauss and Legendre.
pub(super) fn joint_tail(h: f64, k: f64, rho: f64) -> f64 {
    /// Nodes and weights on -1..1, 10 points.
    const NODES: [(f64, f64); 5] = [
        (0.148_874_338_981_631_2, 0.295_524_224_714_752_87),
        (0.433_395_394_129_247_2, 0.269_266_719_309_996_35),
        (0.679_409_568_299_024_4, 0.219_086_362_515_982_04),
        (0.865_063_366_688_984_5, 0.149_451_349_150_580_6),
        (0.973_906_528_517_171_7, 0.066_671_344_308_688_14),
    ];
    if rho >= 1.0 - 1e-12 {
        return tail(h.max(k));
    }
    let angle = rho.max(-1.0).asin();
    let integrand = |theta: f64| {
        let (sin, cos) = theta.sin_cos();
        (-(h * h + k * k - 2.0 * h * k * sin) / (2.0 * cos * cos).max(1e-300)).exp()
    };
    let half = 0.5 * angle;
    let sum: f64 = NODES.iter().map(|(x, w)| w * (integrand(half * (1.0 - x)) + integrand(half * (1.0 + x)))).sum();
    (tail(h) * tail(k) + half * sum / TAU).clamp(0.0, tail(h.max(k)))
}

/// F with F F^T = the given symmetric positive semidefinite matrix (pivoted Cholesky; columns beyond the rank are 0).
pub(super) fn square_root<const N: usize>(covariance: &[[f64; N]; N]) -> [[f64; N]; N] {
    let mut rest = *covariance;
    let mut factor = [[0.0; N]; N];
    let greatest = (0..N).map(|i| covariance[i][i]).fold(0.0, f64::max);
    for column in 0..N {
        let pivot = (0..N).fold(0, |best, i| if rest[i][i] > rest[best][best] { i } else { best });
        // What is left is rounding. Scales differ (metres, radians), so each entry is judged beside its own.
        let own = covariance[pivot][pivot].max(f64::MIN_POSITIVE);
        if rest[pivot][pivot] <= 1e-14 * own || rest[pivot][pivot] <= 1e-300 * greatest {
            break;
        }
        let root = rest[pivot][pivot].sqrt();
        let line: [f64; N] = std::array::from_fn(|i| rest[i][pivot] / root);
        for i in 0..N {
            factor[i][column] = line[i];
            for j in 0..N {
                rest[i][j] -= line[i] * line[j];
            }
        }
        for i in 0..N {
            (rest[i][pivot], rest[pivot][i]) = (0.0, 0.0);
        }
    }
    factor
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_are_the_textbooks() {
        assert!((tail(1.959_963_984_540_054) - 0.025).abs() < 1e-15);
        assert!((tail_quantile(0.005) - 2.575_829_303_548_901).abs() < 1e-12);
        // Independent, equal, opposite; and 1/4 + asin(rho) / (2 pi) at the middle.
        assert!((joint_tail(1.0, 2.0, 0.0) - tail(1.0) * tail(2.0)).abs() < 1e-15);
        assert!((joint_tail(1.0, 2.0, 1.0) - tail(2.0)).abs() < 1e-15);
        assert!(joint_tail(2.0, 2.0, -1.0) < 1e-6);
        for rho in [-0.9, -0.3, 0.5, 0.95] {
            let exact = 0.25 + f64::asin(rho) / TAU;
            assert!((joint_tail(0.0, 0.0, rho) - exact).abs() < 1e-12, "{rho}");
        }
        // Against the integral over one variable.
        for (h, k, rho) in [(2.5f64, 2.6, 0.9), (2.0, 3.0, 0.5), (2.5, 2.5, 0.99), (2.6, 3.1, 0.97)] {
            let steps = 200_000;
            let width = 10.0 / f64::from(steps);
            let density = |x: f64| (-0.5 * x * x).exp() / TAU.sqrt();
            let sum: f64 = (0..steps)
                .map(|i| {
                    let x = h + (f64::from(i) + 0.5) * width;
                    density(x) * tail((k - rho * x) / (1.0 - rho * rho).sqrt()) * width
                })
                .sum();
            let got = joint_tail(h, k, rho);
            assert!((got - sum).abs() < 1e-3 * sum, "{h} {k} {rho}: {got} and {sum}");
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
}
