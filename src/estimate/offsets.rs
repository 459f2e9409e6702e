//! How far polygons are off along their normals, by what is left of a frame's residuals.

use super::normal::{CommonError, Freedom, GroupSum, Normal};
use crate::matrix::{Matrix, add_to, apply, inverse, quadratic, restricted};
use crate::motion::Vector;

/// The variance is told by at least so many groups that count alike.
const FEWEST: f64 = 6.0;

/// Variance of the offsets that polygons of one plane share, square metres, by one frame: without bias, so that it may be below 0 where there
/// are none. `known` is the standard deviation by the frames before, which weighs groups. `None` if too few of them tell.
///
/// The mean residual m of a group has the variance n + f s^2, with s the deviation of the offsets, n what noise makes of it, and f what the
/// pose leaves of an offset that it is free to follow: s^2 is the slope of m^2 - n over f.
pub(super) fn offset_variance(normal: &Normal, prior: &Matrix, freedom: Freedom, known: f64) -> Option<f64> {
    let mut information = restricted(&normal.information, freedom.axes());
    add_to(&mut information, prior);
    let solution = inverse(&information, freedom.axes());
    let offsets = normal.groups.iter().filter(|(error, g)| matches!(error, CommonError::Offset(_)) && g.weight > 0.0);
    let groups: Vec<(&GroupSum, Vector)> = offsets.map(|(_, g)| (g, std::array::from_fn(|i| -g.pull[i][0]))).collect();
    let mut pulls = [[0.0; 6]; 6];
    for (_, pull) in &groups {
        (0..6).for_each(|i| (0..6).for_each(|j| pulls[i][j] += pull[i] * pull[j]));
    }
    let (mut sum, mut weight, mut squares) = (0.0, 0.0, 0.0);
    for (group, pull) in &groups {
        let mean = group.residual / group.weight;
        // How the pose answers to an offset of this group.
        let answer = apply(&solution, &pull.map(|p| p / group.weight));
        let leverage: f64 = (0..6).map(|i| pull[i] * answer[i]).sum();
        let alone = group.variance / group.weight;
        let own = (alone - leverage).max(1e-3 * alone) / group.weight;
        let seen = (1.0 - 2.0 * leverage + quadratic(&pulls, &answer)).max(0.0);
        let certainty = seen * (own + known * known * seen).powi(-2);
        sum += certainty * (mean * mean - own);
        weight += certainty * seen;
        squares += (certainty * seen).powi(2);
    }
    (weight * weight > FEWEST * squares).then(|| sum / weight)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::SplitMix64;

    /// Forty walls of all directions, each with 100 points of 1 cm: their offsets of 2 mm are told in the mean of many frames, though the pose
    /// follows them, and none are told where there are none.
    #[test]
    fn offsets_are_told_without_bias() {
        let mut random = SplitMix64(3);
        let mut normal_number = move || (0..12).map(|_| random.unit()).sum::<f64>() - 6.0;
        for truth in [0.0, 0.002] {
            let (mut sum, frames) = (0.0, 400);
            for _ in 0..frames {
                let walls: Vec<(Vector, f64)> = (0..40)
                    .map(|_| {
                        let j: Vector = std::array::from_fn(|_| normal_number());
                        (j, truth * normal_number() + 0.001 * normal_number())
                    })
                    .collect();
                sum +=
                    offset_variance(&fitted(&walls), &[[0.0; 6]; 6], Freedom::Full, 0.001).unwrap() / f64::from(frames);
            }
            assert!(
                (sum - truth * truth).abs() < 1e-7 + 0.04 * truth * truth,
                "{sum:e} instead of {:e}",
                truth * truth
            );
        }
        assert!(offset_variance(&Normal::default(), &[[0.0; 6]; 6], Freedom::Full, 0.001).is_none());
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
