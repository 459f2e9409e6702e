//! Where a map explains little: hypotheses take over from one Gaussian, and hand back to it when they agree.

use super::hypotheses::Hypotheses;
use super::likelihood::PoseLikelihood;
use super::{Localizer, Phase, Step};
use crate::estimate::{Estimate, EstimateState, Freedom};
use presight_model::error::Result;
use presight_model::geometry::PoseEstimate;
use presight_model::measured::{Frame, Motion};
use presight_model::world::World;
use presight_render::row::is_level;

/// One Gaussian takes over again where the map explains so much more than what hypotheses are for.
const MORE: f64 = 0.15;

impl Localizer {
    /// True if one Gaussian should not decide on the frame of a level scanner, or of a row.
    pub(super) fn is_doubtful(&self, frame: &Frame, estimate: &Estimate) -> bool {
        let followed = matches!(self.phase, Phase::Tracking | Phase::Candidates);
        let sensor = frame.sensor();
        let scanned = (sensor.height() == 1 || is_level(&sensor.spec().mount)) && !sensor.is_camera();
        let weighable = self.estimator.options.freedom == Freedom::Planar && scanned;
        let coarse = self.is_coarse();
        let little = !estimate.rests_on_reflectors()
            && (coarse || estimate.explained < self.options.little || !estimate.is_determined());
        followed && weighable && estimate.predictions > 0 && little
    }

    /// Draws hypotheses from what was known before the frame.
    pub(super) fn doubt(&mut self, world: &World, frame: &Frame, prior: &PoseEstimate) -> Result<()> {
        let model_sigma = self.estimator.options.model_sigma;
        let (sensor, dependence) = (frame.sensor(), self.options.beam_dependence);
        let level_from_sensor = prior.world_from_robot.rotation * sensor.spec().mount.rotation;
        let likelihood = PoseLikelihood::new(sensor, level_from_sensor, world, model_sigma, dependence)?;
        self.hypotheses = Some(Hypotheses::new(prior, self.options.hypotheses, likelihood));
        self.agreed_again = 0;
        Ok(())
    }

    /// One frame of the hypotheses; without a motion they are where they should be already.
    pub(super) fn follow_hypotheses(&mut self, world: &World, frame: &Frame, motion: Option<&Motion>) -> Result<Step> {
        let Some(mut hypotheses) = self.hypotheses.take() else {
            unreachable!("they are followed while there are some")
        };
        if let Some(motion) = motion {
            hypotheses.carry(motion);
        }
        hypotheses.weigh(&mut self.estimator.predictor, world, frame)?;
        let belief = hypotheses.belief();
        hypotheses.resample();
        // The model's own error is the same for all of them: no number of frames takes it away.
        let known = with_variance(&belief, self.estimator.options.model_sigma);
        let mut estimate = self.estimator.refine(world, frame, &known)?;
        let spread = (belief.covariance[0][0] + belief.covariance[1][1]).sqrt();
        let explains = estimate.explained >= self.options.little + MORE || estimate.rests_on_reflectors();
        self.agreed_again = if explains { self.agreed_again + 1 } else { 0 };
        let why = format!("{} hypotheses are spread over {spread:.2} m", self.options.hypotheses);
        estimate.state = if spread <= self.options.spread {
            EstimateState::Determined
        } else {
            EstimateState::Undetermined(why.clone())
        };
        self.hypotheses = Some(hypotheses);
        let decided = self.decide(&estimate);
        self.belief = known;
        let coarse = self.is_coarse();
        let hand_back = (!coarse || estimate.rests_on_reflectors())
            && self.agreed_again >= self.options.agreeing
            && estimate.is_determined();
        if hand_back {
            self.belief = estimate.pose;
        } else {
            estimate.pose = known;
        }
        if hand_back || matches!(self.phase, Phase::Lost | Phase::Unknown) {
            self.hypotheses = None;
        }
        let reason = if decided == why { why } else { format!("{decided}; {why}") };
        Ok(self.told(frame, reason, estimate))
    }
}

/// A belief with so much more variance of its place, metres.
fn with_variance(belief: &PoseEstimate, sigma: f64) -> PoseEstimate {
    let mut known = *belief;
    (0..3).for_each(|i| known.covariance[i][i] += sigma * sigma);
    known
}
