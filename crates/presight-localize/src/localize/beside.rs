//! Minima near the pose that is followed: as far away as its prior may reach, another pose may explain the frames as well. The
//! likeliest one is followed, too, until the frames decide.

use super::follow::Followed;
use super::{ErrorRates, Localizer};
use crate::estimate::{Estimate, Freedom};
use crate::motion::{motion_between, moved};
use presight_model::error::Result;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::{add_to, inverse, quadratic, scaled};
use presight_model::measured::{Frame, Motion};
use presight_model::random::SplitMix64;
use presight_model::world::World;

/// Distances from a pose at which descents to other minima start, metres (two rings of this number of directions) and radians.
const BESIDE: ([f64; 2], usize, f64) = ([0.1, 0.2], 8, 0.06);
/// Two minima are two if they are farther apart, metres and radians.
const APART: (f64, f64) = (0.05, 0.017);
/// Deviations that are added to the prior for neighbouring minima, metres and radians.
const LOOSENED: (f64, f64) = (0.15, 0.06);
/// Priors that are wider get starts of their own, metres.
const WIDE: f64 = 0.1;
/// Way after which neighbouring minima are searched again, metres and radians alike.
const LOOK_AGAIN: f64 = 3.0;

/// Minima near a pose, and the odds against them.
#[derive(Clone, Debug, Default)]
pub(super) struct Beside {
    /// Log-odds of the pose against the likeliest of them; `None` until they were searched.
    odds: Option<f64>,
    /// The likeliest one, while a robot that is carried away is less likely.
    second: Option<PoseEstimate>,
    /// Way since they were searched.
    way: f64,
}

/// How a frame is looked at.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    /// Scale of the null of its evidence.
    pub scale: f64,
    /// How much of another view it is, 0 to 1.
    pub way: f64,
    /// It differs from the frames before: minima are searched, whatever the way.
    pub is_new: bool,
}

impl Beside {
    /// Log-odds against them, natural logarithm.
    pub fn odds(&self) -> Option<f64> {
        self.odds
    }

    /// True if none is likelier than the rates allow for a pose that is tracked.
    pub fn is_clear(&self, rates: &ErrorRates) -> bool {
        self.odds.is_none_or(|odds| odds >= rates.tracked())
    }

    /// Moves the second pose on.
    pub fn carry(&mut self, motion: &Motion, freedom: Freedom) {
        if let Some(second) = &mut self.second {
            *second = super::carried(second, motion, freedom);
        }
    }

    /// The second pose and its probability.
    pub fn second(&self) -> Option<(PoseEstimate, f64)> {
        Some((self.second?, 1.0 / (1.0 + self.odds?.exp())))
    }

    /// A belief with the deviation that a second pose adds to it.
    pub fn widened(&self, belief: &PoseEstimate) -> PoseEstimate {
        let Some((second, share)) = self.second() else { return *belief };
        let off = motion_between(&belief.world_from_robot, &second.world_from_robot);
        let outer = std::array::from_fn(|i| std::array::from_fn(|j| off[i] * off[j]));
        let mut covariance = *belief.covariance.as_rows();
        add_to(&mut covariance, &scaled(&outer, share));
        PoseEstimate::new(belief.robot(), PoseCovariance::from_rows(covariance))
    }
}

impl Localizer {
    /// Weighs the minima near an estimate by a frame: the one that is followed, and where a search is due those from 20 cm
    /// around and all over the prior. A likelier one takes the place of the estimate.
    pub(super) fn weigh_beside(
        &mut self,
        world: &World,
        frames: &[&Frame],
        prior: &PoseEstimate,
        own: &mut Followed,
        estimate: &mut Estimate,
        look: Look,
    ) -> Result<()> {
        let (freedom, most) = (self.estimator.options.freedom, self.options.rates.most());
        let (before, second) = (own.beside.odds, own.beside.second.take());
        own.beside.way += look.way;
        let searches = before.is_none() || look.is_new || own.beside.way >= LOOK_AGAIN;
        if !searches && second.is_none() {
            return Ok(());
        }
        let at = estimate.pose.world_from_robot;
        let loose = loosened(prior);
        let mut ends = vec![at];
        if searches {
            own.beside.way = 0.0;
            let around = PoseEstimate::new(RobotPose::new(at), loose.covariance);
            ends.extend(self.estimator.minima(world, frames, &around, &starts(&around, prior, freedom), APART)?);
        }
        let followed = second.map(|second| self.estimator.follow(world, frames, &second)).transpose()?;
        let followed = followed.filter(|there| is_apart(&at, &there.pose.world_from_robot));
        if let Some(there) = &followed {
            ends.retain(|end| *end == at || is_apart(end, &there.pose.world_from_robot));
            ends.push(there.pose.world_from_robot);
        }
        let Some(rivals) = &self.rivals else { return Ok(()) };
        let evidence = rivals.of_minima(&mut self.estimator, world, frames[0], &ends)?;
        let squared = |of: &PoseEstimate, k: usize| {
            let information = inverse(of.covariance.as_rows(), freedom.axes());
            quadratic(&information, &motion_between(&of.world_from_robot, &ends[k]))
        };
        let farther = |of: &PoseEstimate, k: usize| 0.5 * (squared(of, k) - squared(of, 0));
        let odds = |k: usize| {
            let lead = (evidence[0] - evidence[k]) / look.scale;
            if followed.is_some() && k + 1 == ends.len() {
                return before.unwrap_or(0.0) + look.way * lead;
            }
            // Once minima were searched, the prior is to be relied on.
            let known = farther(prior, k).clamp(0.0, before.map_or(0.0, |_| most));
            lead + known.max(farther(&loose, k))
        };
        let odds: Vec<f64> = (0..ends.len()).map(odds).collect();
        let Some(k) = (1..ends.len()).min_by(|a, b| odds[*a].total_cmp(&odds[*b])) else {
            own.beside.odds = Some(most);
            return Ok(());
        };
        own.beside.odds = Some(odds[k].abs().min(most));
        if odds[k] >= most {
            return Ok(());
        }
        let mut there = match followed {
            Some(there) if k + 1 == ends.len() => there,
            _ => self.estimator.follow(world, frames, &PoseEstimate::new(RobotPose::new(ends[k]), loose.covariance))?,
        };
        if odds[k] < 0.0 {
            std::mem::swap(estimate, &mut there);
        }
        own.beside.second =
            Some(there.pose).filter(|second| is_apart(&second.world_from_robot, &estimate.pose.world_from_robot));
        Ok(())
    }
}

/// True if two poses are two minima.
pub(super) fn is_apart(a: &Pose, b: &Pose) -> bool {
    let off = motion_between(a, b);
    let length = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    length(&off[..3]) > APART.0 || length(&off[3..]) > APART.1
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
