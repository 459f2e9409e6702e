//! From an unknown start to one pose: candidates are carried on by odometry until one of them leads and explains enough.

use super::decide::standing;
use super::search::{Candidate, distinct, is_same};
use super::{Localizer, Phase, Step, carried};
use crate::estimate::{Estimate, EstimateState};
use presight_model::error::Result;
use presight_model::measured::{Frame, Motion};
use presight_model::world::World;

/// Candidates that are so much less likely are dropped, natural logarithm of the odds.
const HOPELESS: f64 = 20.0;

impl Localizer {
    /// True if the robot is looked for in the whole map.
    pub(super) fn is_searched(&self) -> bool {
        let nowhere = matches!(self.phase, Phase::Unknown | Phase::Lost);
        self.search.is_some() && (nowhere || !self.candidates.is_empty())
    }

    /// One frame of the search.
    pub(super) fn search_on(&mut self, world: &World, frame: &Frame, motion: Option<&Motion>) -> Result<Step> {
        if let (Some(followed), Some(motion)) = (&mut self.followed, motion) {
            *followed = carried(followed, motion, self.estimator.options.freedom);
        }
        match motion {
            Some(motion) if !self.candidates.is_empty() => self.carry(world, frame, motion)?,
            _ => {
                let Some(search) = &self.search else { unreachable!("a robot is searched by a search") };
                self.candidates = search.candidates(&mut self.estimator, world, frame)?;
            }
        }
        let Some(best) = self.candidates.first() else {
            self.phase = Phase::Unknown;
            let estimate = self.estimator.refine(world, frame, &self.belief)?;
            return Ok(self.told(frame, "no beam measured a range".into(), estimate));
        };
        self.belief = best.pose;
        let estimate = best.estimate.clone();
        let reason = self.choose(world, frame)?;
        let state = if self.phase == Phase::Tracking {
            EstimateState::Determined
        } else {
            EstimateState::Undetermined(reason.clone())
        };
        let step = self.told(frame, reason, Estimate { state, ..estimate });
        if self.phase == Phase::Unknown {
            self.candidates.clear();
        }
        Ok(step)
    }

    /// Moves all candidates on, refines and weighs them.
    fn carry(&mut self, world: &World, frame: &Frame, motion: &Motion) -> Result<()> {
        let Some(search) = &self.search else { return Ok(()) };
        for c in &mut self.candidates {
            let freedom = self.estimator.options.freedom;
            let prior = carried(&c.pose, motion, freedom);
            c.estimate = self.estimator.refine(world, frame, &prior)?;
            c.pose = c.estimate.pose;
            c.frames += 1;
            c.explained += (search.explained(frame, &c.estimate) - c.explained) / c.frames as f64;
        }
        let logs = search.weigh(&mut self.estimator, world, frame, &self.candidates)?;
        self.candidates.iter_mut().zip(logs).for_each(|(c, log)| c.log_likelihood += log);
        self.candidates = distinct(std::mem::take(&mut self.candidates));
        let most = self.candidates.first().map_or(0.0, |c| c.log_likelihood);
        self.candidates.retain(|c| most - c.log_likelihood <= HOPELESS);
        Ok(())
    }

    /// The next phase, and why.
    fn choose(&mut self, world: &World, frame: &Frame) -> Result<String> {
        let options = self.options;
        let Candidate { explained, frames, log_likelihood, .. } = self.candidates[0];
        let lead = self.candidates.get(1).map_or(HOPELESS, |second| log_likelihood - second.log_likelihood);
        let why = format!(
            "{} candidates; the best one leads by log-odds of {lead:.1} and explains {:.0} % of {frames} frames",
            self.candidates.len(),
            100.0 * explained
        );
        let returned = self.has_returned();
        let enough = returned || explained >= options.least_found;
        if enough && lead >= options.lead && frames >= options.least_frames {
            if self.add_rivals(world, frame)? {
                self.phase = Phase::Candidates;
                return Ok(format!("{why}; a place elsewhere fits this frame better"));
            }
            self.phase = Phase::Tracking;
            let found = self.candidates.swap_remove(0).estimate;
            self.candidates.clear();
            if returned {
                self.explained.forget();
                self.standing.forget();
            }
            self.restart_tests(found.explained, standing(&found));
            self.velocity.restart();
            let changed = "; the robot was followed to there: the map has changed";
            return Ok(why + if returned { changed } else { "" });
        }
        if frames % options.least_frames.max(1) == 0 && lead < options.lead {
            // None of them may be right: a place that the first frame did not tell may fit this one better.
            self.add_rivals(world, frame)?;
        }
        let given_up = !enough && frames >= options.patience;
        self.phase = if given_up { Phase::Unknown } else { Phase::Candidates };
        Ok(if given_up { format!("{why}: less than {:.0} %, none is right", 100.0 * options.least_found) } else { why })
    }

    /// True if the best place of the whole map is where the robot had been followed to before it counted as lost. A robot that was carried
    /// away is elsewhere; this one's surroundings have changed, and little of them is explained.
    fn has_returned(&self) -> bool {
        let best = &self.candidates[0];
        let there =
            self.followed.is_some_and(|followed| is_same(&followed.world_from_robot, &best.pose.world_from_robot));
        there && best.explained >= self.options.least_agreeing
    }

    /// Looks through the whole map once more: places that fit this frame better than the best candidate join them.
    fn add_rivals(&mut self, world: &World, frame: &Frame) -> Result<bool> {
        let Some(search) = &self.search else { return Ok(false) };
        let best = self.candidates[0].clone();
        let here = search.weigh(&mut self.estimator, world, frame, std::slice::from_ref(&best))?[0];
        let mut rivals = search.candidates(&mut self.estimator, world, frame)?;
        rivals.retain(|r| r.log_likelihood > here && !is_same(&r.pose.world_from_robot, &best.pose.world_from_robot));
        let found = !rivals.is_empty();
        // They are taken to have fitted the frames before as well as the best one did.
        rivals.iter_mut().for_each(|r| r.log_likelihood += best.log_likelihood - here);
        self.candidates.append(&mut rivals);
        self.candidates = distinct(std::mem::take(&mut self.candidates));
        Ok(found)
    }
}
