//! A sequential test: has a share left the distribution that it had?

use std::fmt;

/// Half of the shift that the test is fastest for, in standard deviations. What is explained changes along the way by one or
/// two of these, as places differ in what the model leaves out; at a wrong place it halves.
const SLACK: f64 = 2.5;
/// A frame counts for no more than so many standard deviations, so that no single one decides.
const MOST: f64 = 3.75;
/// Least standard deviation of a share, unless another is given.
const LEAST_SIGMA: f64 = 0.08;
/// A mean forgets by this part a frame.
const FORGET: f64 = 0.05;

/// Page's cumulative sum on a share that may only fall, against its own learnt mean and deviation.
///
/// For independent Gaussian shares the mean number of frames between false alarms is
/// `(exp(2 k b) - 2 k b - 1) / (2 k^2)` with b = h + 1.166 (Siegmund, Sequential Analysis, 1985); the threshold h follows from it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cusum {
    threshold: f64,
    least_sigma: f64,
    sum: f64,
    mean: f64,
    variance: f64,
    count: f64,
}

impl Cusum {
    /// A test with so many frames between false alarms, in the mean.
    pub fn new(frames_per_false_alarm: f64) -> Self {
        let rate = |h: f64| {
            let x = 2.0 * SLACK * (h + 1.166);
            (x.exp() - x - 1.0) / (2.0 * SLACK * SLACK)
        };
        let (mut low, mut high) = (0.0, 50.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if rate(middle) < frames_per_false_alarm { low = middle } else { high = middle }
        }
        Self { threshold: high, least_sigma: LEAST_SIGMA, sum: 0.0, mean: 0.0, variance: 0.0, count: 0.0 }
    }

    /// Shares differ by no less than this, one standard deviation, however alike those were that it learns from.
    #[must_use]
    pub fn with_least_sigma(self, sigma: f64) -> Self {
        Self { least_sigma: sigma, ..self }
    }

    /// Takes in a share; true if it has left its distribution.
    pub fn add(&mut self, share: f64) -> bool {
        if self.count > 0.0 {
            let sigma = self.variance.sqrt().max(self.least_sigma);
            let drop = ((self.mean - share) / sigma).min(MOST);
            self.sum = (self.sum + drop - SLACK).max(0.0);
            if self.sum > self.threshold {
                return true;
            }
        }
        // Shares that speak for being lost do not teach what is usual.
        if self.sum == 0.0 {
            self.count += 1.0;
            let gain = FORGET.max(1.0 / self.count);
            let off = share - self.mean;
            self.mean += gain * off;
            self.variance = (1.0 - gain) * (self.variance + gain * off * off);
            if self.count == 1.0 {
                self.variance = (2.0 * self.least_sigma).powi(2);
            }
        }
        false
    }

    /// Learns from a share if it knows of none yet: of a robot that was found just now, the next frame may be the one that is wrong.
    pub(super) fn begin_with(&mut self, share: f64) {
        if self.count == 0.0 {
            self.add(share);
        }
    }

    /// The least share that is usual: so far below the mean that the sum begins to grow. `None` before the first share.
    pub(super) fn least_usual(&self) -> Option<f64> {
        let sigma = self.variance.sqrt().max(self.least_sigma);
        (self.count > 0.0).then_some(self.mean - SLACK * sigma)
    }

    /// Forgets what speaks for being lost; what is usual stays.
    pub fn restart(&mut self) {
        self.sum = 0.0;
    }

    /// Learns anew what is usual.
    pub(super) fn forget(&mut self) {
        (self.sum, self.mean, self.variance, self.count) = (0.0, 0.0, 0.0, 0.0);
    }
}

impl fmt::Display for Cusum {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sigma = self.variance.sqrt().max(self.least_sigma);
        write!(f, "usually {:.2} +- {:.2}; {:.1} against {:.1}", self.mean, sigma, self.sum, self.threshold)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_share_raises_no_alarm_and_a_drop_does() {
        let mut explained = Cusum::new(30_000.0);
        assert!((0..100).all(|k| !explained.add(0.95 + 0.01 * f64::from(k % 3))));
        assert!((0..5).any(|_| explained.add(0.3)));
    }
}
