//! The search window of a feature: a box that holds all of its points with a stated probability.

use crate::matching::{MAX_OUTLINE, Shape};
use glam::{DMat2, DVec2};
use presight_model::statistics::tail_quantile;

/// The predicted position of a feature.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// The feature's number.
    pub id: u32,
    /// Expected position.
    pub shape: Shape,
    /// Covariance of each defining point as detected, pixels squared.
    pub covariances: Vec<DMat2>,
    /// x0, y0, x1, y1 of the box that holds the feature with the stated probability, clipped to the image. In a
    /// 360-degree image x1 may exceed the width.
    pub bounds: [f64; 4],
}

/// Number of standard deviations from a point to the sides of its box, for one confidence.
#[derive(Clone, Debug)]
pub(super) struct BoxLevel {
    /// By the number of points, starting at 1.
    deviations: [f64; MAX_OUTLINE],
}

impl BoxLevel {
    /// A point leaves its box through one of four sides. The probabilities of leaving through any side, over all n
    /// points, add up to 1 - confidence if each is (1 - confidence) / 4n. Events that coincide make the box a little
    /// larger than necessary, never smaller.
    pub fn new(confidence: f64) -> Self {
        Self { deviations: std::array::from_fn(|i| tail_quantile((1.0 - confidence) / (4.0 * (i + 1) as f64))) }
    }

    /// Returns x0, y0, x1, y1 of the box that holds all points, which have these covariances.
    pub fn bounds(&self, points: &[DVec2], covariances: &[DMat2]) -> [f64; 4] {
        let k = self.deviations[points.len().clamp(1, MAX_OUTLINE) - 1];
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for (p, c) in points.iter().zip(covariances) {
            let reach = k * DVec2::new(c.x_axis.x.max(0.0).sqrt(), c.y_axis.y.max(0.0).sqrt());
            (low, high) = (low.min(*p - reach), high.max(*p + reach));
        }
        [low.x, low.y, high.x, high.y]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;
    use presight_model::statistics::normal_pair;

    #[test]
    fn one_point_has_the_textbooks_box() {
        // Bonferroni's bound over four sides: the deviate of a tail of 0.0025 is 2.807.
        let b = BoxLevel::new(0.99).bounds(&[DVec2::new(10.0, 20.0)], &[DMat2::from_diagonal(DVec2::new(4.0, 1.0))]);
        for (got, expected) in b.into_iter().zip([10.0 - 5.614, 20.0 - 2.807, 10.0 + 5.614, 20.0 + 2.807]) {
            assert!((got - expected).abs() < 0.01, "{b:?}");
        }
    }

    /// The share of random outlines inside is the confidence or more.
    #[test]
    fn boxes_hold_what_they_say() {
        let mut random = SplitMix64(5);
        let square = [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y].map(|p| 3.0 * p);
        for (confidence, points) in [(0.9, &square[..1]), (0.9, &square[..2]), (0.99, &square[..])] {
            let covariances = vec![DMat2::from_diagonal(DVec2::new(1.0, 4.0)); points.len()];
            let bounds = BoxLevel::new(confidence).bounds(points, &covariances);
            let mut inside = 0;
            for _ in 0..20_000 {
                inside += u32::from(points.iter().all(|p| {
                    let [x, y] = normal_pair(1.0 - random.unit(), random.unit(), 1.0);
                    let q = *p + DVec2::new(x, 2.0 * y);
                    q.x >= bounds[0] && q.x <= bounds[2] && q.y >= bounds[1] && q.y <= bounds[3]
                }));
            }
            let share = f64::from(inside) / 20_000.0;
            assert!(share > confidence - 0.003, "{confidence}: {share}");
        }
    }
}
