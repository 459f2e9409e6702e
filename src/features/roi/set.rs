//! Bounds where projection bends: the farthest value over a set of errors.
//!
//! The farthest value of a side over all errors of length k is that of first-order reliability's design point (Hasofer and
//! Lind 1974); where the limit bends there the tail beyond it is larger by the curvature (Breitung 1984), and k rises until
//! the tails fit, at most to the ball that holds all errors with the confidence.

use super::errors::{Each, Uncertain, each};
use super::passing::Level;
use super::seen::{Rough, Seen, dot, unwrapped};
use super::{GRAZING, Projection, SIDES};
use crate::features::normal::{tail, tail_quantile};

/// Bounds where projection bends; `None` if errors of that probability may bring a point behind the sensor, or anywhere.
pub(super) fn set_bounds(
    projection: &impl Projection,
    uncertain: &Uncertain,
    rough: &[Rough],
    level: &Level,
    linear: f64,
) -> Option<[f64; 4]> {
    let seen: Vec<Seen> = rough.iter().map(|rough| Seen::new(uncertain, rough)).collect();
    // All of the ball: no set of errors of that probability is larger.
    let ball = ball_radius(uncertain.dimensions(), level.fail).max(linear);
    // Where each point was farthest towards each side: where the next search begins.
    let mut known: Vec<[Option<Each>; 4]> = vec![[None; 4]; seen.len()];
    let mut farthest = |side: usize, reach: f64| -> Option<(f64, f64)> {
        let mut best = (f64::NEG_INFINITY, 1.0);
        for (s, known) in seen.iter().zip(&mut known) {
            let found = farthest_value(projection, uncertain, s, SIDES[side], reach, &mut known[side])?;
            if found.0 > best.0 {
                best = found;
            }
        }
        Some(best)
    };
    let mut reach = linear;
    // Curvature raises the tails beyond the design points: k rises until they fit.
    for _ in 0..4 {
        let mut limits = [0.0; 4];
        let mut growth: f64 = 1.0;
        for (side, limit) in limits.iter_mut().enumerate() {
            let (value, factor) = farthest(side, reach)?;
            growth = growth.max(factor);
            *limit = SIDES[side].1 * value;
        }
        let wanted = tail_quantile((tail(linear) / growth).max(1e-300)).max(linear).min(ball);
        if wanted <= reach + 1e-3 {
            let [right, left, bottom, top] = limits;
            return Some([left, top, right, bottom]);
        }
        reach = wanted;
    }
    let mut limits = [0.0; 4];
    for (side, limit) in limits.iter_mut().enumerate() {
        *limit = SIDES[side].1 * farthest(side, ball.max(reach))?.0;
    }
    let [right, left, bottom, top] = limits;
    Some([left, top, right, bottom])
}

/// The farthest value of a side's coordinate over errors of length `reach`, and by how much the curvature of the limit
/// there raises the tail beyond it. `None` if the way leads out of the projection.
fn farthest_value(
    projection: &impl Projection,
    uncertain: &Uncertain,
    seen: &Seen,
    (c, sign): (usize, f64),
    reach: f64,
    known: &mut Option<Each>,
) -> Option<(f64, f64)> {
    let point = &seen.rough.point;
    let value = |xi: &Each| -> Option<f64> {
        let p = uncertain.moved(point, xi);
        let mut at = projection.project(p)?;
        if projection.lever(p) <= GRAZING * seen.rough.lever {
            return None;
        }
        at[0] = unwrapped(projection, at[0], seen.rough.at[0]);
        Some(sign * at[c])
    };
    if seen.sigma[c] <= 0.0 && seen.rough.spread <= 0.0 {
        return Some((sign * seen.rough.at[c], 1.0));
    }
    let start = match known {
        Some(known) => each(known, |x| sign * x),
        None if seen.sigma[c] > 0.0 => seen.slopes[c],
        None => seen.slopes[1 - c],
    };
    let length = dot(&start, &start).sqrt().max(f64::MIN_POSITIVE);
    let mut xi = each(&start, |x| sign * x / length * reach);
    let mut best = value(&xi)?;
    // The derivative at no error may miss the way that matters: a turn moves what is straight ahead up or down by the
    // second order only. So each axis is tried as well.
    for i in uncertain.used().filter(|_| known.is_none()) {
        for reach in [reach, -reach] {
            let mut axis = Each::default();
            axis.as_flattened_mut()[i] = reach;
            let there = value(&axis)?;
            if there > best {
                (xi, best) = (axis, there);
            }
        }
    }
    let mut slope = Each::default();
    for _ in 0..6 {
        let there = uncertain.moved(point, &xi);
        let gradient = projection.gradient(there, projection.project(there)?)?[c];
        slope = uncertain.slopes_at(point, &xi, there, sign * gradient);
        let length = dot(&slope, &slope).sqrt();
        if length == 0.0 {
            break;
        }
        let next = each(&slope, |s| s / length * reach);
        let there = value(&next)?;
        if there <= best + 1e-9 * best.abs().max(1.0) {
            break;
        }
        (xi, best) = (next, there);
    }
    *known = Some(xi);
    let gradient = dot(&slope, &slope).sqrt();
    if gradient == 0.0 || reach <= 0.0 {
        return Some((best, 1.0));
    }
    let growth = growth(uncertain, &value, &xi, best, gradient, reach)?;
    // Passed on both sides of no error alike: twice as often.
    let opposite = value(&each(&xi, |x| -x))?;
    let twice = if best - opposite < 0.3 * gradient * reach { 2.0 } else { 1.0 };
    Some((best, twice * growth * growth.sqrt()))
}

/// By how much more than at a flat limit errors pass beyond the design point `xi`, for one axis in its bend.
fn growth(
    uncertain: &Uncertain,
    value: &impl Fn(&Each) -> Option<f64>,
    xi: &Each,
    best: f64,
    gradient: f64,
    reach: f64,
) -> Option<f64> {
    // Along a great circle the value falls by gradient * reach * angle^2 / 2 if the limit is flat, less if it bends round.
    let angle = 0.2f64;
    let mut growth = 1.0;
    for i in uncertain.used() {
        let along = xi.as_flattened()[i] / reach;
        let mut side = each(xi, |x| -along * x / reach);
        side.as_flattened_mut()[i] += 1.0;
        let length = dot(&side, &side).sqrt();
        if length < 1e-3 {
            continue;
        }
        let turned = |sign: f64| -> Option<f64> {
            let (sin, cos) = (sign * angle).sin_cos();
            let at = |kind: usize, j: usize| cos * xi[kind][j] + sin * reach * side[kind][j] / length;
            value(&std::array::from_fn(|kind| std::array::from_fn(|j| at(kind, j))))
        };
        let mean = 0.5 * (turned(1.0)? + turned(-1.0)?);
        let flat = gradient * reach * (1.0 - angle.cos());
        let share = ((best - mean) / flat).clamp(0.04, 1.0);
        // Several axes may lie in the same bend: the worst stands for all but one more.
        growth = f64::max(growth, 1.0 / share.sqrt());
    }
    Some(growth)
}

/// The radius of the ball that holds a standard normal vector with probability 1 - fail (Wilson and Hilferty, which is
/// within 1 % here, and 1 % more).
fn ball_radius(dimensions: usize, fail: f64) -> f64 {
    let n = dimensions.max(1) as f64;
    let spread = (2.0 / (9.0 * n)).sqrt();
    let cube = 1.0 - 2.0 / (9.0 * n) + tail_quantile(fail) * spread;
    1.01 * (n * cube.powi(3)).sqrt()
}
