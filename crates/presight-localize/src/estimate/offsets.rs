//! How far polygons are off along their normals, by what is left of a frame's residuals.

use super::normal::{CommonError, Freedom, GroupSum, Normal};
use crate::motion::Vector;
use presight_model::matrix::{Matrix, add_to, apply, inverse, quadratic, restricted};

/// Least standard deviation, metres.
const LEAST: f64 = 1e-5;
/// The variance is told by at least so many groups that count alike. What is stated counts as much as so many.
const FEWEST: f64 = 6.0;
/// Share of the frames before that is forgotten in each, and what each counts at least.
const FORGET: f64 = 0.1;

/// The variance of the offsets that polygons of one plane share, learnt frame by frame from what is stated.
#[derive(Clone, Copy, Debug)]
pub(super) struct OffsetVariance {
    stated: f64,
    /// Square metres, without bias: below 0 as noise has it.
    variance: f64,
    /// Groups that it rests on.
    groups: f64,
}

/// What one frame tells of it.
struct SeenOffsets {
    variance: f64,
    /// Groups that tell: one whose noise is as large as the offsets are taken to be counts a quarter.
    groups: f64,
}

impl OffsetVariance {
    /// The offsets have a standard deviation of `sigma`, metres, as far as is known.
    pub fn of_sigma(sigma: f64) -> Self {
        let stated = sigma.powi(2).max(LEAST * LEAST);
        Self { stated, variance: stated, groups: FEWEST }
    }

    /// Standard deviation, metres.
    pub fn sigma(&self) -> f64 {
        self.variance.max(0.0).sqrt().max(LEAST)
    }

    /// Takes in the residuals of a frame at its best pose; `prior` is the information that the pose has beside them.
    pub fn learn(&mut self, normal: &Normal, prior: &Matrix, freedom: Freedom) {
        if let Some(seen) = self.seen(normal, prior, freedom) {
            // Less than nothing in one frame is as likely as too much, where there are no offsets.
            let gain = (seen.groups / (self.groups + seen.groups)).max(FORGET);
            self.variance += gain * (seen.variance - self.variance);
            self.groups = (1.0 - FORGET) * (self.groups + seen.groups);
        }
    }

    /// The variance by one frame alone. `None` if too few groups tell.
    ///
    /// The mean residual m of a group has the variance n + f s^2, with s the deviation of the offsets, n what noise makes of it, and f what
    /// the pose leaves of an offset that it is free to follow: s^2 is the slope of m^2 - n over f.
    fn seen(&self, normal: &Normal, prior: &Matrix, freedom: Freedom) -> Option<SeenOffsets> {
        let (known, scale) = (self.sigma().powi(2), self.variance.max(self.stated));
        let mut information = restricted(&normal.information, freedom.axes());
        add_to(&mut information, prior);
        let solution = inverse(&information, freedom.axes());
        let is_offset = |error: &CommonError| matches!(error, CommonError::Offset(_));
        let offsets = normal.groups.iter().filter(|(error, g)| is_offset(error) && g.weight > 0.0);
        let groups: Vec<(&GroupSum, Vector)> =
            offsets.map(|(_, g)| (g, std::array::from_fn(|i| -g.pull[i][0]))).collect();
        let mut pulls = [[0.0; 6]; 6];
        for (_, pull) in &groups {
            (0..6).for_each(|i| (0..6).for_each(|j| pulls[i][j] += pull[i] * pull[j]));
        }
        let (mut sum, mut weight, mut squares, mut count) = (0.0, 0.0, 0.0, 0.0);
        for (group, pull) in &groups {
            let mean = group.residual / group.weight;
            // How the pose answers to an offset of this group.
            let answer = apply(&solution, &pull.map(|p| p / group.weight));
            let leverage: f64 = (0..6).map(|i| pull[i] * answer[i]).sum();
            let alone = group.variance / group.weight;
            let own = (alone - leverage).max(1e-3 * alone) / group.weight;
            let left = (1.0 - 2.0 * leverage + quadratic(&pulls, &answer)).max(0.0);
            let certainty = left * (own + known * left).powi(-2);
            sum += certainty * (mean * mean - own);
            weight += certainty * left;
            squares += (certainty * left).powi(2);
            count += (scale * left / (own + scale * left)).powi(2);
        }
        (weight * weight > FEWEST * squares).then(|| SeenOffsets { variance: sum / weight, groups: count })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;

    /// Walls of all directions that are off by so much, with 100 points of 1 cm each: derivatives and mean residuals.
    fn walls(truth: f64, count: usize, random: &mut SplitMix64) -> Vec<(Vector, f64)> {
        let mut normal_number = || (0..12).map(|_| random.unit()).sum::<f64>() - 6.0;
        (0..count)
            .map(|_| {
                let j: Vector = std::array::from_fn(|_| normal_number());
                (j, truth * normal_number() + 0.001 * normal_number())
            })
            .collect()
    }

    /// Offsets of 2 mm are told in the mean of many frames, though the pose follows them, and none are told where there are none.
    #[test]
    fn offsets_are_told_without_bias() {
        let mut random = SplitMix64(3);
        let stated = OffsetVariance::of_sigma(0.001);
        for truth in [0.0, 0.002] {
            let (mut sum, frames) = (0.0, 400);
            for _ in 0..frames {
                let fitted = fitted(&walls(truth, 40, &mut random));
                sum += stated.seen(&fitted, &[[0.0; 6]; 6], Freedom::Full).unwrap().variance / f64::from(frames);
            }
            let squared = truth * truth;
            assert!((sum - squared).abs() < 1e-7 + 0.04 * squared, "{sum:e} instead of {squared:e}");
        }
        assert!(stated.seen(&Normal::default(), &[[0.0; 6]; 6], Freedom::Full).is_none());
    }

    /// A stated deviation of 3 mm counts as much as six walls: after two frames of forty walls without offsets little is left of it, and of
    /// offsets that are twice as large most is known. One that is stated as nothing counts like noise that hides offsets: it gives way slowly.
    #[test]
    fn what_is_stated_gives_way_to_what_is_seen() {
        let (mut random, mut normal) = (SplitMix64(5), Normal::default());
        for (truth, least, most) in [(0.0, 0.0, 0.0009), (0.006, 0.0045, 0.0075)] {
            let mut learnt = OffsetVariance::of_sigma(0.003);
            for _ in 0..2 {
                normal = fitted(&walls(truth, 40, &mut random));
                learnt.learn(&normal, &[[0.0; 6]; 6], Freedom::Full);
            }
            assert!((least..=most).contains(&learnt.sigma()), "{} instead of {truth}", learnt.sigma());
        }
        let mut none = OffsetVariance::of_sigma(0.0);
        none.learn(&normal, &[[0.0; 6]; 6], Freedom::Full);
        assert!((0.001..0.003).contains(&none.sigma()), "{}", none.sigma());
    }

    /// The normal equations at the best pose of walls with these derivatives and mean residuals, of 100 points of 1 cm each.
    fn fitted(walls: &[(Vector, f64)]) -> Normal {
        const WEIGHT: f64 = 100.0 / (0.01 * 0.01);
        let mut normal = Normal::default();
        for (j, mean) in walls {
            (0..6).for_each(|a| (0..6).for_each(|b| normal.information[a][b] += WEIGHT * j[a] * j[b]));
            (0..6).for_each(|a| normal.gradient[a] += WEIGHT * j[a] * mean);
        }
        let step = apply(&inverse(&normal.information, Freedom::Full.axes()), &normal.gradient);
        for (k, (j, mean)) in walls.iter().enumerate() {
            let left = mean - (0..6).map(|a| j[a] * step[a]).sum::<f64>();
            let mut group =
                GroupSum { weight: WEIGHT, residual: WEIGHT * left, variance: WEIGHT, ..GroupSum::default() };
            (0..6).for_each(|a| group.pull[a][0] = -WEIGHT * j[a]);
            normal.groups.insert(CommonError::Offset(k as u32), group);
        }
        normal
    }
}
