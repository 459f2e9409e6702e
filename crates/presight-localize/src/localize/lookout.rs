//! The search for a robot: in the whole map, or around its last pose. Places that fit a frame are candidates; they
//! are carried on by odometry until the odds single out one of them.

use super::beside::Look;
use super::follow::{Followed, way_of};
use super::odds::{Details, Odds, Said};
use super::rivals::Rivals;
use super::search::{Candidate, distinct, is_same};
use super::{Localizer, Phase, State, Step, carried, widened};
use crate::estimate::{Estimate, EstimateState};
use presight_model::error::Result;
use presight_model::geometry::{Pose, PoseEstimate};
use presight_model::measured::{Frame, Motion};
use presight_model::world::World;

/// Most candidates that are followed at once; a search adds the best ones of a frame.
const MOST: (usize, usize) = (8, 5);
/// Frames between searches of the whole map.
const SEARCH_AGAIN: usize = 3;

/// The search for a robot.
#[derive(Clone, Debug, Default)]
pub(super) struct Lookout {
    /// Where it would be if it were not lost, carried on by its odometry.
    own: Option<Followed>,
    candidates: Vec<Candidate>,
    /// How many views since nothing was known: each is a chance for a wrong place to fit.
    views: f64,
    /// Frames since the last search.
    age: usize,
    /// Searches around the last pose so far.
    parts: u64,
}

impl Lookout {
    /// Around a pose that is no longer likely.
    pub fn around(own: Followed) -> Self {
        Self { own: Some(own), ..Self::default() }
    }
}

impl Localizer {
    /// One frame of a search.
    pub(super) fn look_out(
        &mut self,
        world: &World,
        frames: &[&Frame],
        mut lookout: Lookout,
        motion: Option<&Motion>,
    ) -> Result<Step> {
        let (frame, way) = (frames[0], way_of(motion));
        lookout.views += way;
        lookout.age += 1;
        self.carry_own(world, frames, &mut lookout, motion)?;
        self.carry_candidates(world, frame, &mut lookout.candidates, motion, way)?;
        let again = lookout.candidates.is_empty() || lookout.age >= SEARCH_AGAIN;
        if again {
            lookout.age = 0;
            self.add_candidates(world, frames, &mut lookout)?;
        }
        let order = |a: &Candidate, b: &Candidate| b.odds.now.total_cmp(&a.odds.now);
        lookout.candidates.sort_by(order);
        let tracked = self.options.rates.tracked();
        lookout.candidates.retain(|c| c.odds.now > -tracked);
        lookout.candidates.truncate(MOST.0);
        self.choose(world, frames, lookout)
    }

    /// Where the robot would be if it were not lost.
    fn carry_own(
        &mut self,
        world: &World,
        frames: &[&Frame],
        lookout: &mut Lookout,
        motion: Option<&Motion>,
    ) -> Result<()> {
        let Some(own) = &mut lookout.own else { return Ok(()) };
        if let Some(motion) = motion {
            own.belief = carried(&own.belief, motion, self.estimator.options.freedom);
        }
        let prior = own.belief;
        let estimate = self.estimator.refine(world, frames[0], &prior)?;
        let said = self.said_of(world, frames, &estimate, usize::MAX)?;
        let Some(own) = &mut lookout.own else { return Ok(()) };
        own.odds.add(&said, way_of(motion), &self.options.rates);
        if said.odds > 0.0 {
            own.belief = estimate.pose;
        }
        Ok(())
    }

    /// Moves all candidates on, refines and weighs them.
    fn carry_candidates(
        &mut self,
        world: &World,
        frame: &Frame,
        candidates: &mut Vec<Candidate>,
        motion: Option<&Motion>,
        way: f64,
    ) -> Result<()> {
        let (Some(motion), false) = (motion, candidates.is_empty()) else { return Ok(()) };
        for c in candidates.iter_mut() {
            let prior = carried(&c.pose, motion, self.estimator.options.freedom);
            c.estimate = self.estimator.refine(world, frame, &prior)?;
            c.pose = c.estimate.pose;
            c.frames += 1;
            c.explained += (c.estimate.explained - c.explained) / c.frames as f64;
        }
        let poses: Vec<Pose> = candidates.iter().map(|c| c.pose.world_from_robot).collect();
        let Some(rivals) = self.rivals.as_mut() else { return Ok(()) };
        let null = rivals.null(&mut self.estimator, world, frame, &poses, usize::MAX)?;
        let mut details = rivals.details(&mut self.estimator, world, frame, &poses)?;
        for (details, c) in details.iter_mut().zip(candidates.iter()) {
            details.evidence += null.scale * super::reflectors::ODDS * c.estimate.reflectors.0 as f64;
        }
        let logs: Vec<f64> = details.iter().map(|details| details.evidence).collect();
        for ((k, c), details) in candidates.iter_mut().enumerate().zip(details) {
            let others = (0..poses.len()).filter(|j| !is_same(&poses[*j], &poses[k])).map(|j| logs[j]);
            let said = null.said(details, others.fold(f64::NEG_INFINITY, f64::max));
            c.odds.add(&said, way, &self.options.rates);
            c.log_likelihood = c.odds.now;
        }
        *candidates = distinct(std::mem::take(candidates));
        Ok(())
    }

    /// Adds the places that fit this frame best, of the whole map or around the last pose.
    fn add_candidates(&mut self, world: &World, frames: &[&Frame], lookout: &mut Lookout) -> Result<()> {
        let found = match &self.search {
            Some(search) => search.candidates(&mut self.estimator, world, frames[0])?,
            None => return self.add_one_around(world, frames, lookout),
        };
        let Some(first) = found.first() else { return Ok(()) };
        let (frame, at) = (frames[0], first.pose.world_from_robot);
        self.rivals_for(world, frame, &at)?;
        let Some(rivals) = self.rivals.as_mut() else { return Ok(()) };
        let poses: Vec<Pose> = found.iter().map(|c| c.pose.world_from_robot).collect();
        let ranges = rivals.of_places(&mut self.estimator, world, frame, &poses)?;
        let readings = rivals.readings(frame)?;
        let scale = rivals.null(&mut self.estimator, world, frame, &poses, usize::MAX)?.scale;
        let reflectors = |c: &Candidate| scale * super::reflectors::ODDS * c.estimate.reflectors.0 as f64;
        let mut found: Vec<(f64, Candidate)> =
            ranges.into_iter().zip(found).map(|(log, c)| (log + reflectors(&c), c)).collect();
        found.sort_by(|a, b| b.0.total_cmp(&a.0));
        let leader = lookout.candidates.iter().max_by(|a, b| a.odds.now.total_cmp(&b.odds.now));
        let is_leader = |c: &Candidate| {
            leader.is_some_and(|l| l.odds.now > 0.0 && is_same(&l.pose.world_from_robot, &c.pose.world_from_robot))
        };
        // All but the leader, or the best one, are wrong, and show the evidence of wrong places.
        let right = found.iter().position(|(_, c)| is_leader(c)).unwrap_or(0);
        let wrong: Vec<f64> = (0..found.len()).filter(|k| *k != right).map(|k| found[k].0).collect();
        let null = rivals.searched(&wrong, readings);
        let (top, second) = (found[0].0, found.get(1).map_or(0.0, |(log, _)| log.max(0.0)));
        found.truncate(MOST.1);
        let poses: Vec<Pose> = found.iter().map(|(_, c)| c.pose.world_from_robot).collect();
        let details = rivals.details(&mut self.estimator, world, frame, &poses)?;
        for ((log, mut c), details) in found.into_iter().zip(details) {
            if lookout.candidates.iter().all(|k| !is_same(&k.pose.world_from_robot, &c.pose.world_from_robot)) {
                let rival = if log == top { second } else { top };
                // The best of all places is selected from them: that was paid by its lead over the second one. Each view is
                // another chance.
                let odds = (log - rival) / null.scale - (1.0 + lookout.views).ln();
                let details = Details { evidence: log, ..details };
                c.odds = Odds::of(0.0, lookout.views);
                c.odds.add(&Said { odds, ..null.said(details, rival) }, 1.0, &self.options.rates);
                c.log_likelihood = c.odds.now;
                lookout.candidates.push(c);
            }
        }
        Ok(())
    }

    /// The place around the last pose that explains this frame, if it is singled out there.
    fn add_one_around(&mut self, world: &World, frames: &[&Frame], lookout: &mut Lookout) -> Result<()> {
        let around = widened(lookout.own.as_ref().map_or(&self.start, |own| &own.belief), &self.options);
        let part = (self.options.search_starts, lookout.parts);
        lookout.parts += 1;
        let estimate = self.estimator.look_on(world, frames, &around, part)?;
        let mut said = self.said_of(world, frames, &estimate, usize::MAX)?;
        // Wrong places are looked at again only for a place that may be right: they cost more than the search.
        if said.evidence > 0.0 {
            said = self.said_of(world, frames, &estimate, SEARCH_AGAIN)?;
        }
        let pose = estimate.pose;
        let is_new = |c: &Candidate| !is_same(&c.pose.world_from_robot, &pose.world_from_robot);
        if said.odds > 0.0 && lookout.candidates.iter().all(is_new) {
            let mut found = Odds::given(0.0);
            let odds = said.odds - (1.0 + lookout.views).ln();
            found.add(&Said { odds, ..said }, 1.0, &self.options.rates);
            let explained = estimate.explained;
            let log_likelihood = found.now;
            lookout.candidates.push(Candidate { pose, log_likelihood, explained, frames: 1, estimate, odds: found });
        }
        Ok(())
    }

    /// The next state.
    fn choose(&mut self, world: &World, frames: &[&Frame], lookout: Lookout) -> Result<Step> {
        let (tracked, frame) = (self.options.rates.tracked(), frames[0]);
        let first = lookout.candidates.first().map(|c| c.pose.world_from_robot);
        let is_first = |own: &Followed| first.is_some_and(|pose| is_same(&pose, &own.belief.world_from_robot));
        // The best candidate does not rival the pose that the robot was followed to if it is that pose.
        let agrees = lookout.own.as_ref().is_some_and(is_first);
        let own = lookout.own.as_ref().filter(|_| !agrees).map_or(f64::NEG_INFINITY, |own| own.odds.now);
        let best = lookout.candidates.first().map(|c| (c.odds.now, c.frames));
        let second = lookout.candidates.get(1).map_or(f64::NEG_INFINITY, |c| c.odds.now);
        if let (Some(own), true) = (&lookout.own, own >= tracked && best.is_none_or(|(odds, _)| own - odds >= tracked))
        {
            let prior = own.belief;
            let estimate = self.estimator.refine(world, frame, &prior)?;
            let reason = format!("the robot is where it was followed to; log-odds {:.1}", own.odds.now);
            let phase = if self.options.is_narrow(&prior) { Phase::Tracking } else { Phase::Kept };
            return Ok(self.found(frame, own.clone(), phase, reason, estimate));
        }
        let Some((odds, count)) = best else {
            let at = lookout.own.as_ref().map_or(self.start, |own| own.belief);
            let phase = if lookout.own.is_some() { Phase::Lost } else { Phase::Unknown };
            let mut estimate = self.estimator.refine(world, frame, &at)?;
            let why = match (estimate.predictions, &self.search) {
                (0, _) => "no beam measured a range".to_owned(),
                (_, Some(_)) => "no place of the whole map fits".to_owned(),
                (_, None) => format!(
                    "no place fits within {:.1} m and {:.0} deg of the last pose, by {} starts so far",
                    2.0 * self.options.search,
                    2.0 * self.options.search_turn.to_degrees(),
                    self.options.search_starts as u64 * lookout.parts
                ),
            };
            estimate.state = EstimateState::Undetermined(why.clone());
            let odds = own.max(-self.options.rates.most());
            self.phase = phase;
            self.state = State::Lookout(lookout);
            return Ok(self.told(frame, why, at, estimate, odds));
        };
        let lead = odds - second.max(own);
        let c = &lookout.candidates[0];
        let why = format!(
            "{} candidates; the best one has log-odds {odds:.1}, leads by {lead:.1} and explains {:.0} % of {count} frames",
            lookout.candidates.len(),
            100.0 * c.explained
        );
        let (pose, estimate) = (c.pose, c.estimate.clone());
        if odds >= tracked && lead >= tracked && count >= self.options.agreeing && !c.odds.unproven {
            let own = Followed { frames: self.options.agreeing, ..Followed::new(pose, c.odds.clone()) };
            return self.found_beside(world, frames, own, why, estimate);
        }
        self.phase = if lookout.own.is_some() && odds <= own { Phase::Lost } else { Phase::Candidates };
        let candidates = lookout.candidates.clone();
        self.state = State::Lookout(lookout);
        let estimate = Estimate { state: EstimateState::Undetermined(why.clone()), ..estimate };
        Ok(Step { candidates, ..self.told(frame, why, pose, estimate, odds) })
    }

    /// A candidate that is singled out is followed from now on; it is tracked if no minimum near it explains as much.
    fn found_beside(
        &mut self,
        world: &World,
        frames: &[&Frame],
        mut own: Followed,
        why: String,
        mut estimate: Estimate,
    ) -> Result<Step> {
        let prior = own.belief;
        if let Some(scale) = self.rivals.as_ref().and_then(Rivals::scale) {
            let look = Look { scale, way: 1.0, is_new: true };
            self.weigh_beside(world, frames, &prior, &mut own, &mut estimate, look)?;
            own.belief = estimate.pose;
        }
        let told = own.beside.widened(&own.belief);
        let is_clear = own.beside.is_clear(&self.options.rates) && self.options.is_narrow(&told);
        let phase = if is_clear { Phase::Tracking } else { Phase::Kept };
        Ok(Step { pose: told, ..self.found(frames[0], own, phase, why, estimate) })
    }

    fn found(&mut self, frame: &Frame, own: Followed, phase: Phase, why: String, estimate: Estimate) -> Step {
        let (pose, odds, fit_odds) = (own.belief, own.odds.now, own.beside.odds());
        self.phase = phase;
        self.velocity.restart();
        self.state = State::Following(own);
        let estimate = Estimate { state: EstimateState::Determined, ..estimate };
        Step { fit_odds, ..self.told(frame, why, pose, estimate, odds) }
    }

    pub(super) fn told(
        &self,
        frame: &Frame,
        reason: String,
        pose: PoseEstimate,
        estimate: Estimate,
        odds: f64,
    ) -> Step {
        let (phase, stamp) = (self.phase, frame.stamp);
        let (candidates, carried, scan_motion, fit_odds) = (Vec::new(), false, None, None);
        Step { stamp, phase, reason, pose, estimate, candidates, odds, fit_odds, carried, scan_motion }
    }
}
