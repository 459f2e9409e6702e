//! One pose is followed: from its belief before a frame to what the frame leaves of it.

use super::hypotheses::Hypotheses;
use super::likelihood::PoseLikelihood;
use super::lookout::Lookout;
use super::odds::{Odds, Said};
use super::reflectors::ODDS;
use super::rivals::Rivals;
use super::{Localizer, Phase, State, Step, widened};
use crate::estimate::{Estimate, EstimateState, Freedom};
use crate::motion::{motion_between, moved};
use crate::verdict::Verdict;
use presight_model::error::Result;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate};
use presight_model::matrix::{add_to, inverse, quadratic, scaled};
use presight_model::measured::{Frame, Motion};
use presight_model::random::SplitMix64;
use presight_model::world::World;
use presight_render::row::is_level;

/// Distances from a pose at which descents to other minima start, metres (two rings of this number of directions) and radians.
const BESIDE: ([f64; 2], usize, f64) = ([0.1, 0.2], 8, 0.06);
/// Squared deviations from the prior of a pose that the robot jumped to.
const UNLIKELY: f64 = 27.0;
/// Two minima are two if they are farther apart, metres and radians.
const APART: (f64, f64) = (0.05, 0.017);
/// Evidence by which a neighbouring minimum has to be better to replace the pose: less may be noise of one object.
const BETTER: f64 = 20.0;
/// Deviations that are added to the prior for neighbouring minima, metres and radians.
const LOOSENED: (f64, f64) = (0.15, 0.06);
/// Priors that are wider get starts of their own, metres.
const WIDE: f64 = 0.1;
/// Way after which neighbouring minima of a pose without a rival are searched again, metres and radians alike.
const LOOK_AGAIN: f64 = 3.0;
/// Age of the rivals, frames, from which on they are renewed for a frame that does not single out a place.
const STALE: usize = 2;

/// A pose that is followed.
#[derive(Clone, Debug)]
pub(super) struct Followed {
    pub belief: PoseEstimate,
    pub odds: Odds,
    /// Frames since it was given or found.
    pub frames: usize,
    /// Way since neighbouring minima were searched.
    pub since_beside: f64,
    /// The latest frame had no evidence for it.
    pub carried: bool,
}

impl Followed {
    pub fn new(belief: PoseEstimate, odds: Odds) -> Self {
        Self { belief, odds, frames: 0, since_beside: 0.0, carried: false }
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
        if !self.rivals.as_ref().is_some_and(|rivals| rivals.serve(world, frame)) {
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
            return Ok(Said { odds, evidence: odds, full: odds, deciding: 1.0, scale: 1.0, blind: false });
        };
        let pose = estimate.pose.world_from_robot;
        self.rivals_for(world, frame, &pose)?;
        let Some(rivals) = &mut self.rivals else { return Ok(nothing) };
        if rivals.readings(frame)? == 0 {
            return Ok(nothing);
        }
        let null = rivals.null(&mut self.estimator, world, frame, &[pose], oldest)?;
        let (ranges, full) = rivals.of_place(&mut self.estimator, world, frame, &pose)?;
        let evidence = ranges + null.scale * ODDS * estimate.reflectors.0 as f64;
        let odds = null.odds_of(evidence, f64::NEG_INFINITY);
        Ok(Said { odds, evidence, full, scale: null.scale, deciding: deciding(estimate), blind: false })
    }

    /// One frame of a pose that is followed, which is carried on to it already.
    pub(super) fn follow(&mut self, world: &World, frames: &[&Frame], mut own: Followed, way: f64) -> Result<Step> {
        let prior = own.belief;
        let (mut estimate, mut said) = self.look(world, frames, &prior, usize::MAX)?;
        let near = estimate.pose;
        if !said.blind && said.odds <= 0.0 && !estimate.rests_on_reflectors() {
            said = self.said_of(world, frames, &estimate, STALE)?;
            (estimate, said) =
                self.look_elsewhere(world, frames, &prior, frames[0].motion.is_some(), estimate, said)?;
            if said.odds <= 0.0 && self.is_weighable(frames[0]) {
                let hypotheses = self.doubt(world, frames[0], &prior)?;
                return self.follow_hypotheses(world, frames, own, hypotheses, None, way);
            }
        }
        own.carried = said.blind || said.odds < 0.0;
        own.since_beside += way;
        let jumped = own.frames > 0 && self.is_jump(&prior, &estimate);
        if jumped || own.odds.is_sudden(&said) {
            own.odds.beside = None;
        }
        if jumped {
            own.odds.leap(&said, way, &self.options.rates);
            own.carried |= own.odds.now < 0.0;
        } else {
            own.odds.add(&said, way, &self.options.rates);
        }
        if !own.carried && self.looks_beside(&own) && frames[0].grey().is_none() {
            own.since_beside = 0.0;
            self.look_beside(world, frames, &prior, &mut own, &mut estimate, said.scale, way)?;
        }
        // Another minimum than that of the prior says nothing about the speed.
        if jumped || estimate.pose.world_from_robot != near.world_from_robot {
            self.velocity.restart();
        } else if !own.carried {
            self.velocity.learn(&prior, &near, self.estimator.options.freedom);
        }
        self.end(frames[0], own, estimate, said, None)
    }

    /// True if an estimate is improbable by the prior: one in 100,000 for three numbers.
    fn is_jump(&self, prior: &PoseEstimate, estimate: &Estimate) -> bool {
        let off = motion_between(&prior.world_from_robot, &estimate.pose.world_from_robot);
        self.squared_off(prior, &off) > UNLIKELY && is_apart(&off)
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

    fn looks_beside(&mut self, own: &Followed) -> bool {
        let is_clear = own.odds.beside.is_some_and(|odds| odds >= self.options.rates.most());
        !is_clear || own.since_beside >= LOOK_AGAIN
    }

    /// Looks for neighbouring minima of an estimate: as far as the prior reaches, and up to 20 cm away. A better one replaces it;
    /// the lead over the next one are odds of their own.
    #[expect(clippy::too_many_arguments, reason = "a frame, its prior, and its results")]
    fn look_beside(
        &mut self,
        world: &World,
        frames: &[&Frame],
        prior: &PoseEstimate,
        own: &mut Followed,
        estimate: &mut Estimate,
        scale: f64,
        way: f64,
    ) -> Result<()> {
        let (at, freedom) = (estimate.pose.world_from_robot, self.estimator.options.freedom);
        let loose = loosened(prior);
        let around = PoseEstimate::new(at, loose.covariance);
        let mut ends = vec![at];
        ends.extend(self.estimator.minima(world, frames, &around, &starts(&around, prior, freedom), APART)?);
        let Some(rivals) = &self.rivals else { return Ok(()) };
        let evidence = rivals.of_minima(&mut self.estimator, world, frames[0], &ends)?;
        let information = inverse(loose.covariance.as_rows(), freedom.axes());
        let pull = |end: &Pose| 0.5 * quadratic(&information, &motion_between(&prior.world_from_robot, end));
        let merits: Vec<f64> = evidence.iter().zip(&ends).map(|(log, end)| log - pull(end)).collect();
        let top = (0..ends.len()).max_by(|a, b| merits[*a].total_cmp(&merits[*b])).unwrap_or(0);
        let best = if merits[top] > merits[0] + BETTER { top } else { 0 };
        let apart = |k: &usize| is_apart(&motion_between(&ends[best], &ends[*k]));
        let second = (0..ends.len()).filter(apart).max_by(|a, b| merits[*a].total_cmp(&merits[*b]));
        if best > 0 {
            let there = PoseEstimate::new(ends[best], loose.covariance);
            *estimate = self.estimator.follow(world, frames, &there)?;
            own.odds.beside = None;
        }
        let lead = second.map_or(f64::INFINITY, |k| (merits[best] - merits[k]) / scale);
        own.odds.add_beside(lead.min(self.options.rates.most()), way, &self.options.rates);
        if let Some(k) = second.filter(|_| own.odds.beside < Some(self.options.rates.tracked())) {
            let off = motion_between(&ends[best], &ends[k]);
            let outer = std::array::from_fn(|i| std::array::from_fn(|j| off[i] * off[j]));
            let share = 1.0 / (1.0 + own.odds.beside.unwrap_or(0.0).exp());
            let mut covariance = *estimate.pose.covariance.as_rows();
            add_to(&mut covariance, &scaled(&outer, share));
            estimate.pose.covariance = PoseCovariance::from_rows(covariance);
        }
        Ok(())
    }

    /// True if hypotheses can be weighed by the frames of a sensor: a level scanner, or a row.
    fn is_weighable(&self, frame: &Frame) -> bool {
        let sensor = frame.sensor();
        let scanned = (sensor.height() == 1 || is_level(&sensor.spec().mount)) && !sensor.is_camera();
        self.estimator.options.freedom == Freedom::Planar && scanned && frame.grey().is_none()
    }

    /// Hypotheses drawn from the prior of a frame.
    fn doubt(&mut self, world: &World, frame: &Frame, prior: &PoseEstimate) -> Result<Hypotheses> {
        let (sensor, dependence) = (frame.sensor(), self.options.beam_dependence);
        let model_sigma = self.estimator.options.model_sigma;
        let level_from_sensor = prior.world_from_robot.rotation * sensor.spec().mount.rotation;
        let likelihood = PoseLikelihood::new(sensor, level_from_sensor, world, model_sigma, dependence)?;
        Ok(Hypotheses::new(prior, self.options.hypotheses, likelihood))
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
        if !one {
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
        let Odds { now, beside, .. } = own.odds;
        let (tracked, options) = (self.options.rates.tracked(), &self.options);
        let spread = (own.belief.covariance[0][0] + own.belief.covariance[1][1]).sqrt();
        let explained = format!("{:.0} % explained", 100.0 * estimate.explained);
        let why = match &estimate.state {
            EstimateState::Determined => explained,
            EstimateState::Undetermined(why) => why.clone(),
        };
        let mut reason = format!("{why}; log-odds {now:.1}, {:.1} by this frame", said.odds);
        let known = own.carried || estimate.is_determined();
        let confirmed = own.frames >= options.agreeing && !own.odds.unproven;
        let beside_is_clear = beside.is_none_or(|odds| odds >= tracked);
        if hypotheses.is_some() {
            reason += &format!("; {} hypotheses are spread over {spread:.2} m", options.hypotheses);
        } else if own.carried {
            reason += "; the frame has no evidence for the pose, which is carried on";
        }
        // Hypotheses are spread far enough for a fall.
        let lost = if hypotheses.is_some() { now < 0.0 } else { own.odds.is_lost(&options.rates) };
        let phase = if lost {
            Phase::Lost
        } else if now >= tracked && known && confirmed && beside_is_clear && spread <= options.spread {
            Phase::Tracking
        } else {
            Phase::Candidates
        };
        if phase == Phase::Candidates {
            reason += &match () {
                () if now < tracked => format!(", less than {tracked:.1}"),
                () if !confirmed => format!("; {} of {} frames", own.frames, options.agreeing),
                () if !beside_is_clear => {
                    format!("; log-odds against a neighbouring minimum {:.1}", beside.unwrap_or_default())
                }
                () => String::new(),
            };
        }
        self.phase = phase;
        let (pose, carried) = (own.belief, own.carried);
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
        Ok(Step { stamp: frame.stamp, phase, reason, pose, estimate, candidates: Vec::new(), odds: now, carried })
    }
}

/// Share of the decided readings that are not before what the map has.
fn deciding(estimate: &Estimate) -> f64 {
    let Some(verdicts) = estimate.verdicts.first() else { return 1.0 };
    let counts = verdicts.counts();
    let of = |verdict: Verdict| counts[verdict as usize] as f64;
    let (there, nearer) = (of(Verdict::Confirmed) + of(Verdict::Farther), of(Verdict::Nearer));
    there / (there + nearer).max(1.0)
}

fn is_apart(off: &[f64; 6]) -> bool {
    let length = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    length(&off[..3]) > APART.0 || length(&off[3..]) > APART.1
}

/// A belief with this additional deviation of its place, metres.
fn with_variance(belief: &PoseEstimate, sigma: f64) -> PoseEstimate {
    let mut known = *belief;
    (0..3).for_each(|i| known.covariance[i][i] += sigma * sigma);
    known
}

/// A prior that leaves room for neighbouring minima.
fn loosened(prior: &PoseEstimate) -> PoseEstimate {
    let mut loose = *prior;
    (0..3).for_each(|i| loose.covariance[i][i] += LOOSENED.0 * LOOSENED.0);
    (3..6).for_each(|i| loose.covariance[i][i] += LOOSENED.1 * LOOSENED.1);
    loose
}

/// Where descents to neighbouring minima start: on two rings around a pose, turned to both sides, and from all over a wide
/// prior.
fn starts(around: &PoseEstimate, prior: &PoseEstimate, freedom: Freedom) -> Vec<Pose> {
    let (rings, directions, turn) = BESIDE;
    let mut offs: Vec<[f64; 6]> = Vec::new();
    for radius in rings {
        for k in 0..directions {
            let a = std::f64::consts::TAU * k as f64 / directions as f64 + radius;
            offs.push([radius * a.cos(), radius * a.sin(), 0.0, 0.0, 0.0, 0.0]);
        }
    }
    let axes = freedom.axes();
    for (axis, by) in [(2, rings[0]), (3, turn), (4, turn), (5, turn)] {
        if axes.contains(&axis) {
            offs.extend([by, -by].map(|by| std::array::from_fn(|i| if i == axis { by } else { 0.0 })));
        }
    }
    let mut starts: Vec<Pose> = offs.iter().map(|off| moved(&around.world_from_robot, off)).collect();
    if (prior.covariance[0][0] + prior.covariance[1][1]).sqrt() > WIDE {
        let mut random = SplitMix64(0xbe51de);
        let one = |_| crate::estimate::drawn(&prior.world_from_robot, &prior.covariance, freedom, &mut random);
        starts.extend((0..2 * directions).map(one));
    }
    starts
}
