//! A plain Kalman filter that is told how each feature truly moves.

use super::simulator::Disturbance;
use glam::DVec2;

/// One feature: its place is moved on as the true one moves, so that only noise is left to filter.
pub struct DeviceCheck {
    /// Estimated less true place.
    off: DVec2,
    /// Variance of each coordinate.
    variance: f64,
    /// Of what is detected.
    noise: f64,
    truth: DVec2,
}

/// Standard deviations of a box of two independent coordinates that holds 99 %: (2 Phi(k) - 1)^2 = 0.99.
const DEVIATIONS: f64 = 2.806;

impl DeviceCheck {
    pub fn new(disturbance: &Disturbance) -> Self {
        let noise = disturbance.noise * disturbance.noise + disturbance.jitter * disturbance.jitter;
        Self { off: DVec2::ZERO, variance: 1.0, noise, truth: DVec2::ZERO }
    }

    /// Where it will be detected; it has truly moved to `truth`.
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
