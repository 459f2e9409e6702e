//! The smallest box that holds all of a feature's points with a stated probability.

use glam::{DMat2, DVec2};
use presight_model::statistics::{TAIL_CELLS, Tails, apart, tail_quantile};

/// Number of sides through which one point can leave its box.
const SIDES: f64 = 4.0;
/// Largest number of events in the table. Boxes do not grow beyond it.
const MOST: usize = 40;
/// Table rows per event.
const ROWS: usize = 8;
/// Another point counts as an event if it would pass a side with this many more standard deviations.
const MARGIN: f64 = 1.0;
/// Features with at most this many points need no allocation.
const FEW: usize = 4;

/// Tables for one confidence, computed once.
///
/// A feature leaves its box if a point passes any side. All sides are at the same number k of standard deviations of
/// the points that set them, which gives the smallest box for a normal distribution. k is chosen so that the sum of the
/// tails, minus the joint tails of two sides set by one point, equals 1 - confidence (as in
/// [`presight_features::roi`]).
#[derive(Clone, Debug)]
pub(super) struct BoxLevel {
    /// k for four independent sides.
    first: f64,
    /// k by the number of events, starting at 1.
    by_events: Vec<f64>,
    /// Share of a tail at `first` that coincides with another tail, by their separation ([`apart`]) from 0 to 1.
    together: Vec<f64>,
}

impl BoxLevel {
    pub fn new(confidence: f64) -> Self {
        let of = |events: f64| tail_quantile((1.0 - confidence) / events);
        let by_events = (0..=(MOST - 1) * ROWS).map(|i| of(1.0 + i as f64 / ROWS as f64)).collect();
        let first = of(SIDES);
        let together = (0..=TAIL_CELLS).map(|i| Tails::get().shared(first, i as f64 / TAIL_CELLS as f64)).collect();
        Self { first, by_events, together }
    }

    /// Number of standard deviations from a point to the sides of its box, for independent coordinates.
    pub fn deviations(&self) -> f64 {
        self.first
    }

    /// Returns x0, y0, x1, y1 of the box that holds all points, which have these covariances.
    pub fn bounds(&self, points: &[DVec2], covariances: &[DMat2]) -> [f64; 4] {
        let of = |c: &DMat2| DVec2::new(c.x_axis.x.max(0.0).sqrt(), c.y_axis.y.max(0.0).sqrt());
        let mut few = [DVec2::ZERO; FEW];
        let more: Vec<DVec2>;
        let sigma = if let Some(few) = few.get_mut(..covariances.len()) {
            few.iter_mut().zip(covariances).for_each(|(s, c)| *s = of(c));
            &*few
        } else {
            more = covariances.iter().map(of).collect();
            &more
        };
        let k = self.first;
        let mut makers = [0; 4];
        let mut limits = [f64::NEG_INFINITY; 4];
        for (i, (p, s)) in points.iter().zip(sigma).enumerate() {
            for (side, reach) in sides(*p, *s * k).into_iter().enumerate() {
                if reach > limits[side] {
                    (limits[side], makers[side]) = (reach, i);
                }
            }
        }
        let events = SIDES + self.others(points, sigma, &makers, &limits) - self.joint(covariances, &makers);
        let k = self.deviations_for(events);
        let mut most = [f64::NEG_INFINITY; 4];
        for (p, s) in points.iter().zip(sigma) {
            for (most, reach) in most.iter_mut().zip(sides(*p, *s * k)) {
                *most = most.max(reach);
            }
        }
        [-most[1], -most[3], most[0], most[2]]
    }

    fn deviations_for(&self, events: f64) -> f64 {
        let at = ((events - 1.0) * ROWS as f64).clamp(0.0, (self.by_events.len() - 1) as f64);
        let i = (at as usize).min(self.by_events.len() - 2);
        let share = at - i as f64;
        self.by_events[i] + share * (self.by_events[i + 1] - self.by_events[i])
    }

    /// Counts how often a point that does not set a side could also pass it.
    fn others(&self, points: &[DVec2], sigma: &[DVec2], makers: &[usize; 4], limits: &[f64; 4]) -> f64 {
        let mut count = 0;
        if points.len() > 1 {
            for (i, (p, s)) in points.iter().zip(sigma).enumerate() {
                let reaches = sides(*p, *s * (self.first + MARGIN));
                count += (0..4).filter(|side| i != makers[*side] && limits[*side] < reaches[*side]).count();
            }
        }
        count as f64
    }

    /// Returns the number of events that coincide with another because one point sets two sides.
    fn joint(&self, covariances: &[DMat2], makers: &[usize; 4]) -> f64 {
        let mut sum = 0.0;
        let mut last = None;
        for (side, maker) in makers[..2].iter().enumerate() {
            if !makers[2..].contains(maker) {
                continue;
            }
            let (rho, shared) = match last {
                Some((before, rho, shared)) if before == *maker => (rho, shared),
                _ => {
                    let rho = correlation(&covariances[*maker]);
                    (rho, if rho.is_finite() { self.shared(rho) } else { 0.0 })
                }
            };
            last = Some((*maker, rho, shared));
            // A positive correlation joins right with bottom and left with top; a negative one joins right with top.
            let partner = if (rho > 0.0) == (side == 0) { 2 } else { 3 };
            if makers[partner] == *maker {
                sum += shared;
            }
        }
        sum
    }

    /// Share of a tail that coincides with the other, for a point with this correlation.
    fn shared(&self, rho: f64) -> f64 {
        if rho == 0.0 {
            return self.together[TAIL_CELLS];
        }
        let at = apart(rho.abs().min(1.0)) * TAIL_CELLS as f64;
        let i = (at as usize).min(TAIL_CELLS - 1);
        self.together[i] + (at - i as f64) * (self.together[i + 1] - self.together[i])
    }
}

/// Correlation of column and row; NaN if a variance is 0.
fn correlation(c: &DMat2) -> f64 {
    let (product, scale) = (c.y_axis.x, c.x_axis.x * c.y_axis.y);
    if product == 0.0 && scale > 0.0 { 0.0 } else { product / scale.sqrt() }
}

/// How far a point with half extent `reach` extends to the right, left, bottom and top.
fn sides(p: DVec2, reach: DVec2) -> [f64; 4] {
    [p.x + reach.x, reach.x - p.x, p.y + reach.y, reach.y - p.y]
}

#[cfg(test)]
mod tests {
    use super::*;
    use presight_model::random::SplitMix64;
    use presight_model::statistics::normal_pair;
    use std::f64::consts::TAU;

    fn normal(random: &mut SplitMix64) -> DVec2 {
        let [x, y] = [random.unit(), random.unit()];
        normal_pair(1.0 - x, y, 1.0).into()
    }

    #[test]
    fn one_point_stands_where_the_textbook_says() {
        // Independent: (2 Phi(k) - 1)^2 = 0.99 at k = 2.8062.
        let b = BoxLevel::new(0.99).bounds(&[DVec2::new(10.0, 20.0)], &[DMat2::from_diagonal(DVec2::new(4.0, 1.0))]);
        for (got, expected) in b.into_iter().zip([10.0 - 5.612, 20.0 - 2.806, 10.0 + 5.612, 20.0 + 2.806]) {
            assert!((got - expected).abs() < 0.01, "{b:?}");
        }
        // Fully correlated: one variable, k = 2.5758.
        let c = DMat2::from_cols_array(&[1.0, 1.0, 1.0, 1.0]);
        let b = BoxLevel::new(0.99).bounds(&[DVec2::ZERO], &[c]);
        assert!((b[2] - 2.5758).abs() < 0.01 && (b[3] + b[1]).abs() < 1e-12, "{b:?}");
    }

    /// The share of random points inside is the confidence, and not much more: the box is small.
    #[test]
    fn boxes_hold_what_they_say() {
        let mut random = SplitMix64(5);
        for confidence in [0.9, 0.99] {
            let level = BoxLevel::new(confidence);
            for case in 0..24 {
                let across = DVec2::from_angle(TAU * random.unit());
                let (a, b) = (1.0 + random.unit(), [1.0, 30.0][case % 2]);
                let roots = [across * a, across.perp() * b];
                let outer = |v: DVec2| DMat2::from_cols(v * v.x, v * v.y);
                let covariance = outer(roots[0]) + outer(roots[1]);
                let ends: Vec<DVec2> =
                    if case % 3 == 0 { vec![DVec2::ZERO] } else { vec![DVec2::ZERO, 100.0 * across.perp()] };
                let bounds = level.bounds(&ends, &vec![covariance; ends.len()]);
                let draws = 40_000;
                let mut inside = 0;
                for _ in 0..draws {
                    inside += u32::from(ends.iter().all(|end| {
                        let n = normal(&mut random);
                        let p = *end + roots[0] * n.x + roots[1] * n.y;
                        p.x >= bounds[0] && p.x <= bounds[2] && p.y >= bounds[1] && p.y <= bounds[3]
                    }));
                }
                let share = f64::from(inside) / f64::from(draws);
                assert!(share > confidence - 0.006, "{case}: {share}");
                assert!(share < confidence + 0.6 * (1.0 - confidence), "{case}: {share}");
            }
        }
    }
}
