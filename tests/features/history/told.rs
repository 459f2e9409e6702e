//! A plain Kalman filter that knows each feature's true motion.

use super::simulator::Disturbance;
use glam::DVec2;

/// One feature. Its estimate moves with the true motion, so that only noise remains to be filtered.
pub struct DeviceCheck {
    /// The estimated place minus the true one.
    off: DVec2,
    /// Variance of each coordinate.
    variance: f64,
    /// The variance of a detection.
    noise: f64,
    truth: DVec2,
}

/// The half width, in standard deviations, of a box that holds two independent coordinates with 99 %: (2 Phi(k) - 1)^2
/// = 0.99.
const DEVIATIONS: f64 = 2.806;

impl DeviceCheck {
    pub fn new(disturbance: &Disturbance) -> Self {
        let noise = disturbance.noise * disturbance.noise + disturbance.jitter * disturbance.jitter;
        Self { off: DVec2::ZERO, variance: 1.0, noise, truth: DVec2::ZERO }
    }

    /// The window of the next detection; the feature has truly moved to `truth`.
    pub fn window(&mut self, truth: DVec2) -> [f64; 4] {
        self.truth = truth;
        let at = truth + self.off;
        let half = DEVIATIONS * (self.variance + self.noise).sqrt();
        [at.x - half, at.y - half, at.x + half, at.y + half]
    }

    pub fn correct(&mut self, found: DVec2) {
        let gain = self.variance / (self.variance + self.noise);
        self.off += (found - self.truth - self.off) * gain;
        self.variance *= 1.0 - gain;
    }
}
