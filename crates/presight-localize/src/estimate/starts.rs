//! Starts other than the prior's pose: where else a frame may lead.

use super::descent::{JUDGE, LOOK, LOOK_NEAR, SEARCH, SETTLE, descend};
use super::normal::Freedom;
use super::reflectors::MatchedReflectors;
use super::run::{Expectation, LEAD, Minimum, Run};
use super::solve::{Asked, Estimator, LOOSE, length};
use crate::motion::{Vector, motion_between, moved};
use presight_model::error::Result;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::{eigen, restricted, scaled};
use presight_model::measured::Frame;
use presight_model::random::SplitMix64;
use presight_model::world::World;
use rayon::prelude::*;
use std::sync::Arc;

/// Starts that are drawn from the prior in one go.
const DRAWS: usize = 16;

impl Estimator {
    /// Where descents from `starts` come to rest other than at the prior's pose: farther from it than `apart`, metres and
    /// radians. A descent that comes nearer than half of that ends there.
    ///
    /// # Errors
    /// Those of [`Estimator::estimate`].
    pub(crate) fn minima(
        &mut self,
        world: &World,
        frames: &[&Frame],
        prior: &PoseEstimate,
        starts: &[Pose],
        apart: (f64, f64),
    ) -> Result<Vec<Pose>> {
        let mut run = self.start(world, frames, prior)?;
        if run.is_blind() {
            return Ok(Vec::new());
        }
        let expected = match self.at_hand(&run) {
            Some(before) => before,
            None => self.expected(&mut run, prior)?,
        };
        run.first = Some(expected.clone());
        let freedom = self.options.freedom;
        let off = |a: &Pose, b: &Pose| {
            let off = motion_between(a, b);
            length(&off[..3]) > apart.0 || length(&off[3..]) > apart.1
        };
        let half = |a: &Pose, b: &Pose| {
            let off = motion_between(a, b);
            length(&off[..3]) < 0.5 * apart.0 && length(&off[3..]) < 0.5 * apart.1
        };
        let comes_back = |pose: &Pose| half(&prior.world_from_robot, pose);
        let look = |start: &Pose| descend(&run, &expected, *start, &LOOK_NEAR, freedom, comes_back).pose;
        let ends: Vec<Pose> = self.predictor.on_threads(|| starts.par_iter().map(look).collect())?;
        let mut found: Vec<Pose> = Vec::new();
        for end in ends {
            if off(&prior.world_from_robot, &end) && found.iter().all(|other| off(other, &end)) {
                found.push(self.descend(&run, &expected, end, &SETTLE).pose);
            }
        }
        found.retain(|end| off(&prior.world_from_robot, end));
        Ok(found)
    }

    /// Looks for a second pose that explains the measurement about as well: starts from the far ends of the prior, along the
    /// axes along which it leaves room for one, go where they go.
    pub(super) fn other_minima(&mut self, run: &mut Run<'_>, best: &Minimum) -> Result<Vec<Minimum>> {
        if run.extent.0 < LOOSE.0 && run.extent.1 < LOOSE.1 {
            return Ok(Vec::new());
        }
        let (freedom, offset_sigma) = (self.options.freedom, self.offsets.sigma());
        let starts = far_ends(run, best, freedom);
        let reflectors = MatchedReflectors::at(run, &best.expected, &best.pose).counts();
        let ends = if reflectors.1 > 0 {
            // Reflectors matched here would pull a start back from places whose reflectors look alike, and ranges alone may not hold it.
            let around = PoseCovariance::from_rows(scaled(run.prior.covariance.as_rows(), 0.25));
            let look = |start: &Pose| -> Result<Minimum> {
                let expected = self.expected(run, &PoseEstimate::new(RobotPose::new(*start), around))?;
                Ok(self.descend(run, &expected, *start, &SEARCH))
            };
            starts.iter().map(look).collect::<Result<Vec<Minimum>>>()?
        } else {
            let comes_back = |pose: &Pose| run.is_same(&best.pose, pose, offset_sigma);
            let look = |start: &Pose| descend(run, &best.expected, *start, &LOOK, freedom, comes_back);
            self.predictor.on_threads(|| starts.par_iter().map(look).collect())?
        };
        let mut others: Vec<Minimum> = Vec::new();
        for there in ends {
            // Not worth a prediction unless it is elsewhere and explains something.
            let near = |m: &Minimum| run.is_same(&m.pose, &there.pose, offset_sigma);
            if near(best)
                || others.iter().any(near)
                || there.normal.explained_share() < 0.5 * best.normal.explained_share()
            {
                continue;
            }
            let there = self.settle_with(run, &there, &JUDGE)?;
            let as_good = there.normal.explained_share() >= best.normal.explained_share() - LEAD
                && MatchedReflectors::at(run, &there.expected, &there.pose).counts().0 >= reflectors.0;
            let near = |m: &Minimum| run.is_same(&m.pose, &there.pose, offset_sigma);
            if as_good && !near(best) && !others.iter().any(near) {
                others.push(there);
            }
        }
        Ok(others)
    }

    /// Draws starts from the prior. All search in the prediction at the prior's pose; the most promising ones predict again. A pose that explains
    /// enough, but is hardly where the robot was known to be, gives way to a likely pose that explains as much. Few points show where a
    /// start leads and how good it is there; the best one settles with all of them.
    pub(super) fn restart(
        &mut self,
        run: &mut Run<'_>,
        expected: &Arc<Expectation>,
        best: Minimum,
        asked: &Asked,
    ) -> Result<Minimum> {
        // Where the prediction at hand serves, a start costs none: the rounds are counted, too.
        let (least, (draws, part)) = (asked.least, asked.part.unwrap_or((DRAWS, 0)));
        let explains = best.normal.explained_share() >= least;
        let rounds = if explains || asked.part.is_some() { 1 } else { self.options.most_predictions.div_ceil(3) };
        let schedule = if explains { &LOOK_NEAR } else { &LOOK };
        let (mut best, mut is_settled) = (best, true);
        let mut random = SplitMix64(0x5eed + part);
        for _ in 0..rounds {
            if run.predictions + 3 > self.options.most_predictions {
                break;
            }
            let mut found: Vec<Minimum> = (0..draws)
                .map(|_| {
                    self.descend(
                        run,
                        expected,
                        drawn(&run.prior.world_from_robot, &run.prior.covariance, self.options.freedom, &mut random),
                        schedule,
                    )
                })
                .collect();
            found.sort_by(|a, b| run.merit(b).total_cmp(&run.merit(a)));
            for start in found.iter().take(3) {
                // What came to rest where the best one did needs no prediction.
                if explains && run.is_same(&best.pose, &start.pose, self.offsets.sigma()) {
                    continue;
                }
                let end = self.settle_with(run, start, &JUDGE)?;
                if run.merit(&end) > run.merit(&best) {
                    (best, is_settled) = (end, false);
                }
                if !explains && best.normal.explained_share() >= least && !run.is_unlikely(&best.pose) {
                    return self.settle(run, &best);
                }
            }
        }
        if is_settled { Ok(best) } else { self.settle(run, &best) }
    }
}

/// Two prior standard deviations to either side of a minimum, along every principal axis of the prior that leaves room for a second
/// one. No axis is left out because the measurement says much along it: where things repeat, it says much at each place.
fn far_ends(run: &Run<'_>, best: &Minimum, freedom: Freedom) -> Vec<Pose> {
    let (values, vectors) = eigen(restricted(run.prior.covariance.as_rows(), freedom.axes()), 6);
    let axis = |k: usize| -> Vector { std::array::from_fn(|i| 2.0 * values[k].max(0.0).sqrt() * vectors[i][k]) };
    let wide = |v: &Vector| length(&v[..3]) > LOOSE.0 || length(&v[3..]) > LOOSE.1;
    let axes = (0..6).map(axis).filter(wide);
    axes.flat_map(|v| [1.0, -1.0].map(|s| moved(&best.pose, &v.map(|x| s * x)))).collect()
}

/// A pose drawn from a normal distribution around another.
pub fn drawn<A>(mean: &Pose, covariance: &PoseCovariance<A>, freedom: Freedom, random: &mut SplitMix64) -> Pose {
    let (values, vectors) = eigen(restricted(covariance.as_rows(), freedom.axes()), 6);
    let mut motion = [0.0; 6];
    for (k, value) in values.iter().enumerate() {
        let x = random.normal(value.max(0.0).sqrt());
        (0..6).for_each(|i| motion[i] += x * vectors[i][k]);
    }
    moved(mean, &motion)
}
