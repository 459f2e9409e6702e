//! The motion that all features share when the sensor turns or shakes.
//!
//! A single track needs several frames to distinguish such a motion from noise. All tracks together measure it in one
//! frame, and more accurately. The shared displacement is therefore a [`PointMotion`] of its own, and each track
//! follows the rest. A displacement beyond its prediction adds an unknown acceleration since the last frame. A
//! displacement that comes and goes is shaking: windows must cover it, and tracks must not follow it.

use super::motion::{PointMotion, isotropic};
use glam::{DMat2, DVec2};

/// Memory of the shared motion, frames.
const MEMORY: f64 = 4.0;
/// Squared deviation, relative to the variance of one coordinate, beyond which the motion has changed. A chi-squared
/// variable with two degrees of freedom exceeds it with probability 0.05.
const CHANGED: f64 = 6.0;
/// Factor per frame by which the variance of a changed acceleration fades.
const FADE: f64 = 0.1;
/// Time constant of the learnt shaking, frames.
const SHAKE_FRAMES: f64 = 20.0;
/// Initial and smallest variance of shaking, pixels squared.
const SHAKE: f64 = 0.04;
const LEAST_SHAKE: f64 = 1e-3;
/// Expected squared displacement by shaking and filter, in units of the shaking variance, while the motion is steady.
const CALM: f64 = 1.5;
/// Fewest points that estimate the shared motion.
const LEAST_WITNESSES: usize = 8;
/// Residuals beyond this many standard deviations get less weight.
const OUTLIER: f64 = 2.0;

/// Evidence from one point of a track.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointEvidence {
    /// Measured minus predicted position.
    pub innovation: DVec2,
    /// Inverse covariance of the innovation; 0 along directions without information.
    pub information: DMat2,
}

/// The shared motion and its uncertainty.
#[derive(Clone, Debug)]
pub(super) struct CommonMotion {
    /// Its position is the displacement since the last frame.
    motion: PointMotion,
    /// Variance of the shaking, pixels squared.
    shake: f64,
    /// Variance that an unknown acceleration may add in the next interval, pixels squared.
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

    /// Displacement since the last frame, or since the last [`Self::rebase`].
    pub fn displacement(&self) -> DVec2 {
        self.motion.position
    }

    pub fn speed(&self) -> DVec2 {
        self.motion.speed
    }

    pub fn acceleration(&self) -> DVec2 {
        self.motion.acceleration
    }

    /// Covariance of the displacement of a detection, including shaking.
    pub fn covariance(&self) -> DMat2 {
        self.motion.pp + isotropic(self.shake)
    }

    /// Restarts the displacement at 0.
    pub fn rebase(&mut self) {
        self.motion.position = DVec2::ZERO;
    }

    /// Adds an unknown change of acceleration in the last `interval` seconds, in which features left their windows.
    pub fn lose(&mut self, variance: f64, interval: f64) {
        self.motion.change_acceleration(variance, interval);
        self.changed = self.changed.max(variance);
    }

    /// Its motion, whose position is 0, if there are too few witnesses to follow it. It begins again without motion.
    pub fn give_up(&mut self, witnesses: &[PointEvidence]) -> Option<PointMotion> {
        (witnesses.len() < LEAST_WITNESSES).then(|| {
            self.rebase();
            let shake = self.shake;
            std::mem::replace(self, Self { shake, ..Self::still() }).motion
        })
    }

    /// Corrects the shared motion by the evidence of a frame after `interval` seconds. Returns the mean displacement of
    /// the detections from their predictions, including shaking.
    pub fn correct(&mut self, witnesses: &[PointEvidence], interval: f64) -> DVec2 {
        if interval <= 0.0 || witnesses.len() < LEAST_WITNESSES {
            return DVec2::ZERO;
        }
        let prior = 0.5 * (self.motion.pp.x_axis.x + self.motion.pp.y_axis.y) + self.shake;
        // The prediction is not used here, because it is wrong when the motion has changed.
        let (rough, _) = weigh(witnesses, None);
        let (told, certain) = weigh(witnesses, Some(rough));
        let squared = told.length_squared();
        self.changed *= FADE;
        if squared > CHANGED * (prior + certain) {
            let excess = 0.5 * squared - prior - certain;
            self.motion.change_acceleration(excess, interval);
            self.changed = self.changed.max(excess);
        }
        let rate = 0.5 * squared / (certain + CALM * self.shake) - 1.0;
        self.shake = (self.shake * (rate.clamp(-1.0, 1.0) / SHAKE_FRAMES).exp()).max(LEAST_SHAKE);
        self.motion.correct(told, isotropic(certain + self.shake));
        told
    }
}

/// Returns the weighted mean innovation and its variance per coordinate. Those far from `before` get less weight.
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
    // If all points slide in one direction, that direction has no information and its innovation is set to 0.
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

    /// All features start to accelerate by 2 pixels per frame squared. After three frames the shared motion follows.
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
