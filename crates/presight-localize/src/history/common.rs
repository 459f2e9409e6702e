//! The part of the motion that all features share: the sensor turns, and shakes.
//!
//! A turning or shaking sensor moves its whole image. Each track alone would take frames to tell such a motion from noise; all
//! tracks together tell it at once, and far better than any of them. The shared displacement is therefore a [`PointMotion`] of
//! its own, and tracks follow what is left. Where the displacement says that the motion has changed, an unknown acceleration since the
//! last frame explains it; where it comes and goes it is shaking, which windows have to hold and tracks need not follow.

use super::motion::{PointMotion, isotropic};
use glam::{DMat2, DVec2};

/// Frames that the shared motion remembers.
const MEMORY: f64 = 4.0;
/// Squared deviation, by the variance of one coordinate, beyond which the motion has changed: chi-squared of two, 3 in 100.
const CHANGED: f64 = 7.0;
/// What is left, a frame later, of the variance of an acceleration that has changed.
const FADE: f64 = 0.1;
/// Frames over which shaking is learnt.
const SHAKE_FRAMES: f64 = 20.0;
/// Variance of shaking at first, and at least, pixels squared.
const SHAKE: f64 = 0.04;
const LEAST_SHAKE: f64 = 1e-3;
/// What is expected of squared displacements while nothing changes, beside shaking: what the filter adds.
const CALM: f64 = 1.5;
/// Fewer tracks tell too little.
const LEAST_WITNESSES: usize = 8;
/// Residuals beyond so many standard deviations count less.
const OUTLIER: f64 = 2.0;

/// What one track's point tells.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointEvidence {
    /// Measured less predicted position.
    pub innovation: DVec2,
    /// Inverse of its covariance; 0 in directions that tell nothing.
    pub information: DMat2,
}

/// The shared motion and what is known of it.
#[derive(Clone, Debug)]
pub(super) struct CommonMotion {
    /// Its position is the displacement since the last frame.
    motion: PointMotion,
    /// Variance of what comes and goes with each frame, pixels squared.
    shake: f64,
    /// Variance that an unknown acceleration may bring in the next interval, pixels squared.
    changed: f64,
}

impl CommonMotion {
    pub fn still() -> Self {
        let motion = PointMotion::new(DVec2::ZERO, DMat2::ZERO, 0.0, 0.0);
        Self { motion, shake: SHAKE, changed: 0.0 }
    }

    /// The shared motion `interval` seconds later; `usual` is the mean interval.
    pub fn propagated(&self, interval: f64, usual: f64) -> Self {
        let mut moved = self.clone();
        if interval > 0.0 && usual > 0.0 {
            moved.motion = self.motion.propagated(interval, MEMORY.powi(-6) * self.shake / usual.powi(5));
            moved.motion.change_acceleration(self.changed * (interval / usual).powi(4), interval);
        }
        moved
    }

    /// Displacement since the last frame, or by its correction.
    pub fn displacement(&self) -> DVec2 {
        self.motion.position
    }

    pub fn speed(&self) -> DVec2 {
        self.motion.speed
    }

    pub fn acceleration(&self) -> DVec2 {
        self.motion.acceleration
    }

    /// Covariance of a detection's displacement, shaking included.
    pub fn covariance(&self) -> DMat2 {
        self.motion.pp + isotropic(self.shake)
    }

    /// Displacements count from here on.
    pub fn rebase(&mut self) {
        self.motion.position = DVec2::ZERO;
    }

    /// Features are displaced from their windows, nobody knows where to.
    pub fn lose(&mut self, variance: f64) {
        self.changed = self.changed.max(variance);
    }

    /// Takes in what tracks tell after a frame of `interval` seconds. Tells by what this frame's detections are displaced from where
    /// they were predicted, shaking included.
    pub fn correct(&mut self, witnesses: &[PointEvidence], interval: f64) -> DVec2 {
        if interval <= 0.0 {
            return DVec2::ZERO;
        }
        if witnesses.len() < LEAST_WITNESSES {
            *self = Self { shake: self.shake, ..Self::still() };
            return DVec2::ZERO;
        }
        let prior = 0.5 * (self.motion.pp.x_axis.x + self.motion.pp.y_axis.y) + self.shake;
        // Where the motion has changed, what was expected says nothing: the witnesses alone are asked.
        let (rough, _) = weigh(witnesses, None);
        let (told, certain) = weigh(witnesses, Some(rough));
        let squared = told.length_squared();
        self.changed *= FADE;
        if squared > CHANGED * (prior + certain) {
            let excess = 0.5 * squared;
            self.motion.change_acceleration(excess, interval);
            self.changed = self.changed.max(excess);
        }
        let rate = 0.5 * squared / (certain + CALM * self.shake) - 1.0;
        self.shake = (self.shake * (rate.clamp(-1.0, 1.0) / SHAKE_FRAMES).exp()).max(LEAST_SHAKE);
        self.motion.correct(told, isotropic(certain + self.shake));
        told
    }
}

/// The mean innovation by weight, and the variance of a coordinate of it; those far from `before` count less.
fn weigh(witnesses: &[PointEvidence], before: Option<DVec2>) -> (DVec2, f64) {
    let (mut sum, mut pulled) = (DMat2::ZERO, DVec2::ZERO);
    for w in witnesses {
        let mut information = w.information;
        if let Some(before) = before {
            let left = w.innovation - before;
            let deviation = left.dot(information * left).max(0.0).sqrt();
            if deviation > OUTLIER {
                information *= OUTLIER / deviation;
            }
        }
        sum += information;
        pulled += information * w.innovation;
    }
    // Where all witnesses slide in one direction, nothing is known of it: take it as still.
    let inverse = (sum + isotropic(1e-6)).inverse();
    (inverse * pulled, 0.5 * (inverse.x_axis.x + inverse.y_axis.y))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: f64 = 0.05;

    fn witnesses(shift: DVec2) -> Vec<PointEvidence> {
        let wild = PointEvidence { innovation: DVec2::new(-5.0, 9.0), information: isotropic(4.0) };
        let seen = PointEvidence { innovation: shift, information: isotropic(4.0) };
        std::iter::repeat_n(seen, 60).chain(std::iter::once(wild)).collect()
    }

    /// All features begin to accelerate by 2 pixels a frame squared: after three frames the shared motion has it.
    #[test]
    fn a_turn_is_followed_within_three_frames() {
        let mut common = CommonMotion::still();
        let mut at = DVec2::ZERO;
        let mut wide = Vec::new();
        for k in 0..30 {
            let mut moved = common.propagated(FRAME, FRAME);
            let since = f64::from((k - 19).max(0));
            let truth = DVec2::new(since * since, 0.0);
            at += moved.displacement();
            moved.rebase();
            wide.push(moved.covariance().x_axis.x.sqrt());
            let off = truth - at;
            if k >= 23 {
                assert!(off.length() < 0.5, "{k}: {off}");
            }
            moved.correct(&witnesses(off), FRAME);
            at += moved.displacement();
            moved.rebase();
            common = moved;
        }
        assert!(wide[19] < 0.3 && wide[21] > 2.0 * wide[19], "windows grow: {wide:?}");
    }

    #[test]
    fn shaking_is_held_and_not_followed() {
        let mut common = CommonMotion::still();
        let (mut at, mut furthest) = (DVec2::ZERO, 0.0f64);
        for k in 0..200 {
            let mut moved = common.propagated(FRAME, FRAME);
            at += moved.displacement();
            moved.rebase();
            let shake = DVec2::new([0.6, -0.6, -0.6, 0.6][k % 4], 0.0);
            moved.correct(&witnesses(shake - at), FRAME);
            at += moved.displacement();
            moved.rebase();
            common = moved;
            furthest = if k >= 100 { furthest.max(at.length()) } else { 0.0 };
        }
        let deviation = common.covariance().x_axis.x.sqrt();
        assert!((0.3..1.5).contains(&deviation), "{deviation}");
        assert!(furthest < 0.6, "{furthest}");
    }

    #[test]
    fn few_witnesses_tell_nothing() {
        let mut common = CommonMotion::still();
        assert_eq!(common.correct(&witnesses(DVec2::ONE)[..7], FRAME), DVec2::ZERO);
        assert_eq!(common.correct(&[], FRAME), DVec2::ZERO);
        assert_eq!(common.displacement(), DVec2::ZERO);
    }
}
