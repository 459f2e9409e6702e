//! One pose is followed: from its belief before a frame to what the frame leaves of it.

use super::beside::{Beside, Look, is_apart};
use super::hypotheses::Hypotheses;
use super::likelihood::PoseLikelihood;
use super::lookout::Lookout;
use super::odds::{ASKED, Odds, Said};
use super::reflectors::ODDS;
use super::rivals::Rivals;
use super::{LocalizeOptions, Localizer, Phase, State, Step, widened};
use crate::estimate::{Estimate, EstimateState, Freedom};
use crate::motion::{motion_between, moved};
use crate::verdict::Verdict;
use presight_model::error::Result;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::{add_to, inverse, quadratic, scaled};
use presight_model::measured::{Frame, Motion};
use presight_model::world::World;
use presight_render::row::is_level;

/// Squared deviations from the prior of a pose that the robot jumped to.
const UNLIKELY: f64 = 27.0;
/// Age of the rivals, frames, from which on they are renewed for a frame that does not single out a place.
const STALE: usize = 2;

/// A pose that is followed.
#[derive(Clone, Debug)]
pub(super) struct Followed {
    pub belief: PoseEstimate,
    pub odds: Odds,
    /// Frames since it was given or found.
    pub frames: usize,
    /// It was given at the start: no frame selected it.
    pub is_given: bool,
    /// What may be right instead, nearby.
    pub beside: Beside,
    /// The latest frame had no evidence for it.
    pub carried: bool,
}

impl Followed {
    pub fn new(belief: PoseEstimate, odds: Odds) -> Self {
        Self { belief, odds, frames: 0, is_given: false, beside: Beside::default(), carried: false }
    }
}

/// How much of another view the next frame is, 0 to 1: metres and radians count alike.
pub(super) fn way_of(motion: Option<&Motion>) -> f64 {
    motion.map_or(0.0, |motion| {
        let off = motion_between(&Pose::IDENTITY, &motion.previous_from_current);
        let length = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        (length(&off[..3]) + length(&off[3..])).min(1.0)
    })
}

impl Localizer {
    /// The rivals of a frame's sensor.
    pub(super) fn rivals_for(&mut self, world: &World, frame: &Frame, robot: &Pose) -> Result<&mut Rivals> {
        let serve = |rivals: &Option<Rivals>| rivals.as_ref().is_some_and(|rivals| rivals.serve(world, frame));
        if !serve(&self.rivals) {
            // The search for a lost robot takes fewer pixels; the rivals of whole frames are kept meanwhile.
            std::mem::swap(&mut self.rivals, &mut self.spare);
        }
        if !serve(&self.rivals) {
            self.rivals = None;
        }
        let rivals = match self.rivals.take() {
            Some(rivals) => rivals,
            None => Rivals::new(&mut self.estimator, world, frame, robot)?,
        };
        Ok(self.rivals.insert(rivals))
    }

    /// What a frame says of an estimate of it. Rivals are looked at again if they are older than `oldest` frames.
    pub(super) fn said_of(
        &mut self,
        world: &World,
        frames: &[&Frame],
        estimate: &Estimate,
        oldest: usize,
    ) -> Result<Said> {
        let nothing = Said::NOTHING;
        if estimate.predictions == 0 {
            return Ok(nothing);
        }
        let Some(frame) = frames.iter().find(|frame| frame.grey().is_none()) else {
            // Grey images have no evidence but whether their features agree.
            let odds = if estimate.is_determined() { ODDS } else { -ODDS };
            return Ok(Said { odds, evidence: odds, full: odds, deciding: 1.0, blind: false, ..nothing });
        };
        let pose = estimate.pose.world_from_robot;
        self.rivals_for(world, frame, &pose)?;
        let Some(rivals) = &mut self.rivals else { return Ok(nothing) };
        if rivals.readings(frame)? == 0 {
            return Ok(nothing);
        }
        let null = rivals.null(&mut self.estimator, world, frame, &[pose], oldest)?;
        let Some(mut details) = rivals.details(&mut self.estimator, world, frame, &[pose])?.pop() else {
            return Ok(nothing);
        };
        details.evidence += null.scale * ODDS * estimate.reflectors.0 as f64;
        Ok(Said { deciding: deciding(estimate), ..null.said(details, f64::NEG_INFINITY) })
    }

    /// One frame of a pose that is followed, which is carried on to it already.
    pub(super) fn follow(&mut self, world: &World, frames: &[&Frame], mut own: Followed, way: f64) -> Result<Step> {
        let prior = own.belief;
        let (mut estimate, mut said) = self.look(world, frames, &prior, usize::MAX)?;
        let near = estimate.pose;
        let leads_off = self.is_jump(&prior, &estimate) && !said.singles_out();
        if !said.blind && (said.odds <= 0.0 || leads_off) && !estimate.rests_on_reflectors() {
            said = self.said_of(world, frames, &estimate, STALE)?;
            (estimate, said) =
                self.look_elsewhere(world, frames, &prior, frames[0].motion.is_some(), estimate, said)?;
            if said.odds <= 0.0 && self.is_weighable(frames[0]) {
                let hypotheses = self.doubt(world, frames[0], &own)?;
                return self.follow_hypotheses(world, frames, own, hypotheses, None, way);
            }
        }
        // To where neither the start nor the motion leads, a frame leads only if it singles out that place. A motion that nobody
        // measured is a guess: there it suffices that nothing is missing.
        let (is_off, is_first) = (self.is_jump(&prior, &estimate), own.frames == 0);
        let is_whole = said.is_whole(&self.options.rates);
        let is_guess = !is_first && frames[0].motion.is_none() && is_whole;
        let strays = is_off && !said.singles_out() && !is_guess;
        if is_off && !strays && own.odds.unproven {
            // Another place than the one that was given: it has the odds that the frames give it, and no others.
            (own.odds, own.is_given) = (Odds::given(0.0), false);
        }
        let jumped = is_off && !is_first;
        own.carried = said.blind || said.odds < 0.0 || strays;
        // A poor view may have another minimum than the one before.
        let is_new = own.odds.is_sudden(&said) || said.odds < self.options.rates.tracked();
        if jumped {
            own.beside = Beside::default();
            own.odds.leap(&said, way, &self.options.rates);
            own.carried |= own.odds.now < 0.0;
        } else {
            let nothing = Said::NOTHING;
            own.odds.add(if strays { &nothing } else { &said }, way, &self.options.rates);
        }
        if !own.carried && frames[0].grey().is_none() {
            let look = Look { scale: said.scale, way, is_new };
            self.weigh_beside(world, frames, &prior, &mut own, &mut estimate, look)?;
        }
        let is_other = jumped || estimate.pose.world_from_robot != near.world_from_robot;
        // Another minimum than that of the prior says nothing about the speed.
        if !strays && is_other {
            self.velocity.restart();
        } else if !own.carried {
            self.velocity.learn(&prior, &near, self.estimator.options.freedom);
        }
        self.end(frames[0], own, estimate, said, None)
    }

    /// True if an estimate is improbable by the prior: one in 100,000 for three numbers.
    fn is_jump(&self, prior: &PoseEstimate, estimate: &Estimate) -> bool {
        let off = motion_between(&prior.world_from_robot, &estimate.pose.world_from_robot);
        self.squared_off(prior, &off) > UNLIKELY && is_apart(&prior.world_from_robot, &estimate.pose.world_from_robot)
    }

    /// Squared deviations from the prior.
    fn squared_off(&self, prior: &PoseEstimate, off: &[f64; 6]) -> f64 {
        quadratic(&inverse(prior.covariance.as_rows(), self.estimator.options.freedom.axes()), off)
    }

    /// The estimate that a prior leads to, and what the frame says of it.
    fn look(
        &mut self,
        world: &World,
        frames: &[&Frame],
        prior: &PoseEstimate,
        oldest: usize,
    ) -> Result<(Estimate, Said)> {
        let estimate = self.estimator.follow(world, frames, prior)?;
        let said = self.said_of(world, frames, &estimate, oldest)?;
        Ok((estimate, said))
    }

    /// Another start, from all over the prior, for a frame that the prior's own minimum does not explain. Without odometry a
    /// robot that stood still and now moves is not where it was, nor where its last motion leads.
    fn look_elsewhere(
        &mut self,
        world: &World,
        frames: &[&Frame],
        prior: &PoseEstimate,
        has_odometry: bool,
        estimate: Estimate,
        said: Said,
    ) -> Result<(Estimate, Said)> {
        let around = if has_odometry { *prior } else { widened(prior, &self.options) };
        let other = self.estimator.look_round(world, frames, &around)?;
        let there = self.said_of(world, frames, &other, usize::MAX)?;
        // What the motion says against it, at most that the robot was carried away.
        let squared =
            |e: &Estimate| self.squared_off(prior, &motion_between(&prior.world_from_robot, &e.pose.world_from_robot));
        let against = (0.5 * (squared(&other) - squared(&estimate))).clamp(1.0, self.options.rates.most());
        let is_better = there.evidence > said.evidence + said.scale * against;
        if is_better { Ok((other, there)) } else { Ok((estimate, said)) }
    }

    /// True if hypotheses can be weighed by the frames of a sensor: a level scanner, or a row.
    fn is_weighable(&self, frame: &Frame) -> bool {
        let sensor = frame.sensor();
        let scanned = (sensor.height() == 1 || is_level(&sensor.spec().mount)) && !sensor.is_camera();
        self.estimator.options.freedom == Freedom::Planar && scanned && frame.grey().is_none()
    }

    /// Hypotheses drawn from the belief before a frame.
    fn doubt(&mut self, world: &World, frame: &Frame, own: &Followed) -> Result<Hypotheses> {
        let (sensor, dependence) = (frame.sensor(), self.options.beam_dependence);
        let model_sigma = self.estimator.options.model_sigma;
        let level_from_sensor = own.belief.world_from_robot.rotation * sensor.spec().mount.rotation;
        let likelihood = PoseLikelihood::new(sensor, level_from_sensor, world, model_sigma, dependence)?;
        Ok(Hypotheses::new(&own.belief, own.beside.second(), self.options.hypotheses, likelihood))
    }

    /// One frame of hypotheses; without a motion they are where they should be already. One pose takes over again once a
    /// frame singles it out.
    pub(super) fn follow_hypotheses(
        &mut self,
        world: &World,
        frames: &[&Frame],
        mut own: Followed,
        mut hypotheses: Hypotheses,
        motion: Option<&Motion>,
        way: f64,
    ) -> Result<Step> {
        if let Some(motion) = motion {
            hypotheses.carry(motion);
        }
        hypotheses.weigh(&mut self.estimator.predictor, world, frames[0])?;
        let belief = hypotheses.belief();
        hypotheses.resample();
        // The model's own error is the same for all of them: no number of frames takes it away.
        let known = with_variance(&belief, self.estimator.options.model_sigma);
        let mut estimate = self.estimator.refine(world, frames[0], &known)?;
        let said = self.said_of(world, frames, &estimate, STALE)?;
        let one = said.odds > 0.0 || estimate.rests_on_reflectors();
        own.odds.add(&said, way, &self.options.rates);
        own.carried = said.blind;
        own.beside = Beside::default();
        if one {
            let look = Look { scale: said.scale, way, is_new: true };
            self.weigh_beside(world, frames, &known, &mut own, &mut estimate, look)?;
            let is_sure = estimate.rests_on_reflectors();
            let share = if is_sure { 1.0 } else { 1.0 - (-said.odds.max(0.0)).exp() };
            estimate.pose = mixed(&known, &estimate.pose, share);
        } else {
            estimate.pose = known;
        }
        own.belief = estimate.pose;
        estimate.state = EstimateState::Determined;
        self.end(frames[0], own, estimate, said, (!one).then_some(hypotheses))
    }

    /// The next state, by the odds that a frame leaves.
    fn end(
        &mut self,
        frame: &Frame,
        mut own: Followed,
        mut estimate: Estimate,
        said: Said,
        hypotheses: Option<Hypotheses>,
    ) -> Result<Step> {
        own.frames += 1;
        if hypotheses.is_none() && !own.carried {
            own.belief = estimate.pose;
        }
        let now = own.odds.now;
        let (tracked, options) = (self.options.rates.tracked(), &self.options);
        let explained = format!("{:.0} % explained", 100.0 * estimate.explained);
        let why = match &estimate.state {
            EstimateState::Determined => explained,
            EstimateState::Undetermined(why) => why.clone(),
        };
        let mut reason = format!("{why}; log-odds {now:.1}, {:.1} by this frame", said.odds);
        let known = own.carried || estimate.is_determined();
        // A frame may be wrong in a way of its own. A given start, which no frame selected, is tracked at once if the frame by itself
        // is as sure as a tracked pose has to be, or lacks nothing.
        let is_sure = said.odds >= tracked || said.is_whole(&options.rates);
        let at_once = own.is_given && is_sure && hypotheses.is_none();
        let confirmed = (at_once || own.frames >= options.agreeing) && !own.odds.unproven;
        let beside_is_clear = own.beside.is_clear(&options.rates);
        let told = own.beside.widened(&own.belief);
        let spread = spread_of(&told);
        let is_narrow = options.is_narrow(&told);
        if hypotheses.is_some() {
            reason += &format!("; {} hypotheses are spread over {spread:.2} m", options.hypotheses);
        } else if own.carried {
            reason += "; the frame has no evidence for the pose, which is carried on";
        }
        // Hypotheses are spread far enough for a fall.
        let lost = if hypotheses.is_some() { now < 0.0 } else { own.odds.is_lost(&options.rates) };
        let phase = if lost {
            Phase::Lost
        } else if now >= tracked && known && confirmed && beside_is_clear && is_narrow {
            Phase::Tracking
        } else {
            Phase::Kept
        };
        if phase == Phase::Kept {
            reason += &self.missing(&own, &told, &said, confirmed);
        }
        self.phase = phase;
        let (pose, carried, fit_odds) = (told, own.carried, own.beside.odds());
        if phase == Phase::Tracking && hypotheses.is_none() && !own.carried {
            self.estimator.learn(&estimate);
        }
        if phase == Phase::Lost && estimate.is_determined() {
            estimate.state = EstimateState::Undetermined(reason.clone());
        }
        if phase == Phase::Lost {
            self.velocity.restart();
        }
        self.state = match (phase, hypotheses) {
            (Phase::Lost, _) => State::Lookout(Lookout::around(own)),
            (_, Some(hypotheses)) => State::Hypotheses(own, hypotheses),
            (_, None) => State::Following(own),
        };
        Ok(Step { carried, fit_odds, ..self.told(frame, reason, pose, estimate, now) })
    }
}

impl Localizer {
    /// What a pose that is followed lacks to be tracked, and what provides it.
    fn missing(&self, own: &Followed, told: &PoseEstimate, said: &Said, confirmed: bool) -> String {
        let (tracked, options) = (self.options.rates.tracked(), &self.options);
        let (spread, turned) = (spread_of(told), turned_of(told).to_degrees());
        if own.odds.now < tracked || own.odds.unproven {
            let other = match said.rival_at {
                _ if said.blind => "no reading has evidence".to_owned(),
                _ if said.odds > 0.0 => format!("{:.1} by one frame prove a place", ASKED),
                Some(at) => format!("another place, ({:.1}, {:.1}), explains as much", at.x, at.y),
                None => "too little of the frame agrees with the map".to_owned(),
            };
            return format!("; {other}: drive on, or state higher odds of the start");
        }
        match own.beside.odds().filter(|_| !own.beside.is_clear(&options.rates)) {
            _ if !confirmed => format!("; {} of {} frames", own.frames, options.agreeing),
            Some(odds) => {
                format!(
                    "; a neighbouring minimum explains nearly as much, log-odds {odds:.1} of {tracked:.1}: drive on"
                )
            }
            None if !options.is_narrow(told) => {
                format!("; uncertain by {spread:.2} m and {turned:.1} deg: drive to where more is seen")
            }
            None => String::new(),
        }
    }
}

/// The belief after a frame that leads to `after` rightly with a probability of `share`, and otherwise says nothing: a mixture of
/// both, by its mean and covariance (probabilistic data association; Bar-Shalom and Fortmann, Tracking and Data Association,
/// 1988).
fn mixed(before: &PoseEstimate, after: &PoseEstimate, share: f64) -> PoseEstimate {
    let off = motion_between(&before.world_from_robot, &after.world_from_robot);
    let mean = moved(&before.world_from_robot, &off.map(|x| share * x));
    let mut covariance = scaled(after.covariance.as_rows(), share);
    add_to(&mut covariance, &scaled(before.covariance.as_rows(), 1.0 - share));
    let outer = std::array::from_fn(|i| std::array::from_fn(|j| off[i] * off[j]));
    add_to(&mut covariance, &scaled(&outer, share * (1.0 - share)));
    PoseEstimate::new(RobotPose::new(mean), PoseCovariance::from_rows(covariance))
}

impl LocalizeOptions {
    /// True if a pose is known as well as promised.
    pub(super) fn is_narrow(&self, pose: &PoseEstimate) -> bool {
        spread_of(pose) <= self.spread && turned_of(pose) <= self.spread_turn
    }
}

/// How far a pose is spread in the plane, one standard deviation, metres.
fn spread_of(pose: &PoseEstimate) -> f64 {
    (pose.covariance[0][0] + pose.covariance[1][1]).sqrt()
}

/// How far the heading and lean of a pose are spread, one standard deviation, radians.
fn turned_of(pose: &PoseEstimate) -> f64 {
    (3..6).map(|i| pose.covariance[i][i]).sum::<f64>().sqrt()
}

/// Share of the decided readings that are not before what the map has.
fn deciding(estimate: &Estimate) -> f64 {
    let Some(verdicts) = estimate.verdicts.first() else { return 1.0 };
    let counts = verdicts.counts();
    let of = |verdict: Verdict| counts[verdict as usize] as f64;
    let (there, nearer) = (of(Verdict::Confirmed) + of(Verdict::Farther), of(Verdict::Nearer));
    there / (there + nearer).max(1.0)
}

/// A belief with this additional deviation of its place, metres.
fn with_variance(belief: &PoseEstimate, sigma: f64) -> PoseEstimate {
    let mut known = *belief;
    // Hypotheses move on a floor.
    (0..2).for_each(|i| known.covariance[i][i] += sigma * sigma);
    known
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    /// By hand: a place is known to 2 cm, and a frame leads 3 cm on, known to 1 cm. It is right with a probability of one half: 1.5 cm
    /// on, with a variance of (4 + 1) / 2 + 9 / 4 square centimetres. With a probability of 1 it is what the frame says.
    #[test]
    fn a_frame_that_may_be_wrong_counts_by_its_probability() {
        let known = |x: f64, sigma: f64| {
            PoseEstimate::of_sigmas(RobotPose::from_xyz_rpy(DVec3::X * x, 0.0, 0.0, 0.0), sigma, 0.01)
        };
        let (before, after) = (known(0.0, 0.02), known(0.03, 0.01));
        for (share, x, variance) in [(0.5, 0.015, 4.75e-4), (1.0, 0.03, 1e-4), (0.0, 0.0, 4e-4)] {
            let found = mixed(&before, &after, share);
            assert!((found.world_from_robot.translation.x - x).abs() < 1e-12, "{share}");
            assert!((found.covariance[0][0] - variance).abs() < 1e-12, "{share}: {}", found.covariance[0][0]);
        }
    }
}
