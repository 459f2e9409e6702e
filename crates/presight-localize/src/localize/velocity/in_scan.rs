//! The twist during a scan: how it improves the estimate of the robot's motion, and the pose at the stamp that follows from it.

use super::super::drift::variance_of_means;
use super::super::scan::DuringScan;
use super::{FORGET, LEAST_CHANGE, TWIST, Velocity};
use crate::estimate::Freedom;
use presight_model::geometry::PoseEstimate;
use presight_model::matrix::Matrix;

/// A variance in one second that scans teach; the stated one counts as one scan.
#[derive(Clone, Copy, Debug)]
pub(super) struct Learnt {
    mean: f64,
    /// By the latest scan alone.
    latest: f64,
    scans: f64,
}

impl Learnt {
    pub(in super::super) fn stated((variance, _): (f64, f64)) -> Self {
        Self { mean: variance, latest: 0.0, scans: 1.0 }
    }

    fn add(&mut self, sample: f64) {
        self.scans += 1.0;
        self.mean += (sample - self.mean) * (1.0 / self.scans).max(FORGET);
        self.latest = sample;
    }
}

/// One number of the twist by two measurements.
struct Blend {
    mean: f64,
    variance: f64,
    /// Part of the first measurement's error that is left in it.
    share: f64,
}

impl Velocity {
    /// [`Self::before`] for a scan that is measured around the belief's time, with the twist that it was measured with.
    pub(in super::super) fn before_in_scan(
        &self,
        belief: &PoseEstimate,
        seconds: f64,
        stamp_sigma: f64,
        freedom: Freedom,
        scan: &DuringScan,
    ) -> PoseEstimate {
        let mut then = self.clone();
        then.hold(belief);
        let mut twist = scan.twist;
        // The share of the motion's error that remains in each component of the twist, and the component's variance.
        let (mut shares, mut variances) = ([0.0; 6], [0.0; 6]);
        for i in 0..6 {
            let Blend { mean, variance, share } = self.blend(i, (-seconds.max(0.0), -seconds.min(0.0)), scan);
            (twist[i], variances[i], shares[i]) = match scan.to_middle {
                Some(to_middle) => (to_middle[i], scan.covariance[i][i], 0.0),
                None => (mean, variance, share),
            };
        }
        for i in 0..6 {
            let known = shares[i] * shares[i] * then.covariance[TWIST + i][TWIST + i];
            for j in 0..TWIST {
                then.covariance[TWIST + i][j] *= shares[i];
                then.covariance[j][TWIST + i] *= shares[i];
            }
            (0..6).for_each(|j| then.covariance[TWIST + i][TWIST + j] *= shares[i] * shares[j]);
            then.covariance[TWIST + i][TWIST + i] = variances[i].max(known);
        }
        then.twist = twist;
        then.led_back(belief, seconds, stamp_sigma, freedom)
    }

    /// One number of the mean twist in a window around the latest frame, by the motion to this frame and by its scan: the best
    /// linear estimate, where the twist changes by white acceleration.
    fn blend(&self, i: usize, (from, to): (f64, f64), scan: &DuringScan) -> Blend {
        let (density, of_scan) = (self.scan_density(&self.scan_bend, i), (-scan.half, scan.half));
        let apart = |a: (f64, f64), b: (f64, f64)| {
            if a.0 < a.1 && b.0 < b.1 { density * variance_of_means(&[(1.0, a.0, a.1), (-1.0, b.0, b.1)]) } else { 0.0 }
        };
        let (at, scanned, noise) = (scan.twist[i], apart((from, to), of_scan), scan.covariance[i][i]);
        if self.seconds <= 0.0 {
            return Blend { mean: at, variance: scanned + noise, share: 0.0 };
        }
        let (of_motion, known) = ((-self.seconds, 0.0), self.covariance[TWIST + i][TWIST + i]);
        let (wanted, total) = (apart((from, to), of_motion), apart(of_scan, of_motion) + known + noise);
        let shared = 0.5 * (wanted + apart(of_scan, of_motion) - scanned) + known;
        let gain = if total > 0.0 { shared / total } else { 0.0 };
        let mean = self.twist[i] + gain * (at - self.twist[i]);
        Blend { mean, variance: (wanted + known - gain * shared).max(0.0), share: (1.0 - gain).clamp(0.0, 1.0) }
    }

    /// Variance of the twist's change in one second, as scans taught it.
    fn scan_density(&self, learnt: &[Learnt; 6], i: usize) -> f64 {
        // A robot that has driven evenly may have begun to turn in the latest scan.
        learnt[i].mean.max(learnt[i].latest).max(LEAST_CHANGE * self.noise.density(i))
    }

    /// Learns from the twist during the latest frame's scan how much the twist changes from scan to scan, and how far the motion
    /// between two scans is off their mean.
    pub(in super::super) fn learn_scan(&mut self, scan: &DuringScan) {
        let before = self.scan.replace(*scan).filter(|_| self.seconds > 0.0);
        let Some(before) = before else { return };
        let (seconds, half) = (self.seconds, scan.half);
        let (now, then) = ((-half, half), (-half - seconds, half - seconds));
        let change = variance_of_means(&[(1.0, now.0, now.1), (-1.0, then.0, then.1)]);
        let bend = variance_of_means(&[(1.0, -seconds, 0.0), (-0.5, now.0, now.1), (-0.5, then.0, then.1)]);
        for i in (0..6).filter(|i| scan.is_seen[*i] && before.is_seen[*i]) {
            let noise = scan.covariance[i][i] + before.covariance[i][i];
            let off = scan.twist[i] - before.twist[i];
            self.scan_change[i].add((off * off - noise) / change);
            let off = self.twist[i] - 0.5 * (scan.twist[i] + before.twist[i]);
            self.scan_bend[i].add((off * off - 0.25 * noise - self.covariance[TWIST + i][TWIST + i]) / bend);
        }
    }

    /// Takes over the twist of the first scan.
    pub(in super::super) fn begin(&mut self, scan: &DuringScan) {
        if !self.is_fresh {
            return;
        }
        (self.twist, self.is_fresh) = (scan.twist, false);
        for i in 0..6 {
            (0..6).for_each(|j| self.covariance[TWIST + i][TWIST + j] = scan.covariance[i][j]);
        }
    }

    /// Covariance of the mean acceleration during a scan: it is what the mean twists of the scan's halves differ by.
    pub(in super::super) fn acceleration(&self, half: f64) -> Matrix {
        let halves = variance_of_means(&[(1.0, 0.0, half), (-1.0, -half, 0.0)]) / (half * half);
        std::array::from_fn(|i| {
            std::array::from_fn(|j| if i == j { halves * self.scan_density(&self.scan_change, i) } else { 0.0 })
        })
    }
}
