//! Many poses where the robot may be, carried on by odometry and weighed by each frame: for maps that explain so little that one
//! Gaussian would settle on the wrong walls.

use super::likelihood::PoseLikelihood;
use super::on_the_floor;
use crate::estimate::{Freedom, drawn};
use crate::motion::{motion_between, moved};
use presight_model::error::Result;
use presight_model::geometry::{Pose, PoseCovariance, PoseEstimate, RobotPose};
use presight_model::matrix::{add_to, scaled};
use presight_model::measured::{Frame, Motion};
use presight_model::random::SplitMix64;
use presight_model::world::World;
use presight_predict::predict::Predictor;

/// Poses of one weight each after [`Hypotheses::resample`], and their log-weights since.
#[derive(Clone, Debug)]
pub(super) struct Hypotheses {
    poses: Vec<Pose>,
    logs: Vec<f64>,
    likelihood: PoseLikelihood,
    random: SplitMix64,
}

impl Hypotheses {
    /// Draws poses from a belief, and as many of them from a second one as its probability says.
    pub fn new(
        belief: &PoseEstimate,
        second: Option<(PoseEstimate, f64)>,
        count: usize,
        likelihood: PoseLikelihood,
    ) -> Self {
        let mut random = SplitMix64(0x0c10_0d5e);
        let one = |k: usize| {
            let of_second = second.filter(|(_, share)| (k as f64 + 0.5) < share * count as f64);
            let from = of_second.map_or(*belief, |(second, _)| second);
            drawn(&from.world_from_robot, &from.covariance, Freedom::Planar, &mut random)
        };
        Self { poses: (0..count).map(one).collect(), logs: vec![0.0; count], likelihood, random }
    }

    /// Moves every pose as odometry may have gone.
    pub fn carry(&mut self, motion: &Motion) {
        let Some(first) = self.poses.first() else { return };
        // They differ in heading only.
        let motion = on_the_floor(first, motion);
        let Motion { previous_from_current, covariance } = &motion;
        let mut draw = || drawn(previous_from_current, covariance, Freedom::Planar, &mut self.random);
        self.poses.iter_mut().for_each(|pose| *pose = *pose * draw());
    }

    /// Adds the log-likelihoods of a frame.
    ///
    /// # Errors
    /// Those of [`PoseLikelihood::at`].
    pub fn weigh(&mut self, predictor: &mut Predictor, world: &World, frame: &Frame) -> Result<()> {
        let logs = self.likelihood.at(predictor, world, frame, self.poses.iter().copied())?;
        self.logs.iter_mut().zip(logs).for_each(|(sum, log)| *sum += log);
        Ok(())
    }

    /// The Gaussian with their mean and covariance.
    pub fn belief(&self) -> PoseEstimate {
        let weights = self.weights();
        let best = (0..weights.len()).max_by(|a, b| weights[*a].total_cmp(&weights[*b])).unwrap_or(0);
        let at = self.poses[best];
        let mut mean = [0.0; 6];
        let offs: Vec<[f64; 6]> = self.poses.iter().map(|pose| motion_between(&at, pose)).collect();
        offs.iter().zip(&weights).for_each(|(off, w)| (0..6).for_each(|i| mean[i] += w * off[i]));
        let mut covariance = [[0.0; 6]; 6];
        for (off, w) in offs.iter().zip(&weights) {
            let from: [f64; 6] = std::array::from_fn(|i| off[i] - mean[i]);
            let outer = std::array::from_fn(|i| std::array::from_fn(|j| from[i] * from[j]));
            add_to(&mut covariance, &scaled(&outer, *w));
        }
        PoseEstimate::new(RobotPose::new(moved(&at, &mean)), PoseCovariance::from_rows(covariance))
    }

    /// Draws as many anew, each as often as it weighs, once half of them weigh next to nothing.
    pub fn resample(&mut self) {
        let weights = self.weights();
        let count = weights.len();
        let effective = 1.0 / weights.iter().map(|w| w * w).sum::<f64>();
        if effective > 0.5 * count as f64 {
            return;
        }
        // Low-variance sampling: one random number for all.
        let (start, mut sum, mut k) = (self.random.unit(), weights[0], 0);
        let mut kept = Vec::with_capacity(count);
        for i in 0..count {
            let at = (i as f64 + start) / count as f64;
            while at > sum && k + 1 < count {
                k += 1;
                sum += weights[k];
            }
            kept.push(self.poses[k]);
        }
        self.poses = kept;
        self.logs.fill(0.0);
    }

    /// Adding up to 1.
    fn weights(&self) -> Vec<f64> {
        let most = self.logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let weights: Vec<f64> = self.logs.iter().map(|log| (log - most).exp()).collect();
        let sum: f64 = weights.iter().sum();
        weights.iter().map(|w| w / sum).collect()
    }
}
