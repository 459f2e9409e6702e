//! How far a random walk leads away from its last known value.

/// Variance of a sum of means of a random walk over windows of time, `(weight, from, to)` in seconds, per unit of its noise. The
/// weights sum to 0.
///
/// The walk is the integral of white noise. Noise at a time u moves the mean of a window by the share of the window after u, so
/// the variance is the integral of the squared sum of weighted shares. Between the ends of windows that is a square of
/// linear functions, which Simpson's rule integrates exactly.
pub(super) fn variance_of_means(windows: &[(f64, f64, f64)]) -> f64 {
    let mut ends: Vec<f64> = windows.iter().flat_map(|(_, from, to)| [*from, *to]).collect();
    ends.sort_by(f64::total_cmp);
    let at = |u: f64| {
        let share = |(weight, from, to): &(f64, f64, f64)| weight * ((to - u) / (to - from)).clamp(0.0, 1.0);
        windows.iter().map(share).sum::<f64>().powi(2)
    };
    let piece = |a: f64, b: f64| (b - a) / 6.0 * (at(a) + 4.0 * at(0.5 * (a + b)) + at(b));
    ends.windows(2).map(|e| piece(e[0], e[1])).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;

    /// By hand: the second half of a window and the whole of it differ by half of the difference of the halves, and that has a
    /// variance of 2 x (1/2)^3 / 3 / (1/2)^2 = 1/3 of the length: 1/12. Two windows in a row: 2/3 of the length of one.
    #[test]
    fn means_of_a_random_walk_differ() {
        let half = variance_of_means(&[(1.0, -0.5, 0.0), (-1.0, -1.0, 0.0)]);
        assert!((half - 1.0 / 12.0).abs() < 1e-12, "{half}");
        let next = variance_of_means(&[(1.0, 0.0, 2.0), (-1.0, -2.0, 0.0)]);
        assert!((next - 4.0 / 3.0).abs() < 1e-12, "{next}");
    }

    /// 4,000 walks of 200 steps: the mean of the last quarter, less what two earlier windows lead to.
    #[test]
    fn the_variance_is_that_of_simulated_walks() {
        let mut random = SplitMix64(3);
        let windows = [(1.0, 1.5, 2.0), (-1.4, 0.5, 1.5), (0.4, 0.0, 0.5)];
        let mut squares = 0.0;
        for _ in 0..4000 {
            let (mut x, mut sum) = (0.0, 0.0);
            for k in 0..200 {
                x += random.normal(0.1);
                let t = (f64::from(k) + 0.5) * 0.01;
                sum += windows.iter().filter(|w| t > w.1 && t < w.2).map(|w| w.0 * x * 0.01 / (w.2 - w.1)).sum::<f64>();
            }
            squares += sum * sum / 4000.0;
        }
        let expected = variance_of_means(&windows);
        assert!((squares / expected - 1.0).abs() < 0.07, "{squares} {expected}");
    }
}
