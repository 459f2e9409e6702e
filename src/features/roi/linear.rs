//! Bounds by the projection's derivative, and how far the projection itself is from them.

use super::errors::Uncertain;
use super::passing::dot;
use super::seen::{Seen, unwrapped};
use super::{Projection, SIDES};

/// Where the derivative and the projection differ by more than this share of a side's distance, the derivative is given
/// up; below, the difference widens the box.
const SLIGHTLY: f64 = 0.1;

pub(super) fn linear_bounds(seen: &[Seen], k: f64) -> [f64; 4] {
    let limit = |(c, sign): (usize, f64)| {
        sign * seen.iter().map(|s| sign * s.at[c] + k * s.sigma[c]).fold(f64::NEG_INFINITY, f64::max)
    };
    let [right, left, bottom, top] = SIDES.map(limit);
    [left, top, right, bottom]
}

/// The linear bounds, widened by what the projection itself says at the errors that the sides stand for; `None` if that
/// is much.
pub(super) fn bent_bounds(
    projection: &impl Projection,
    uncertain: &Uncertain,
    seen: &[Seen],
    bounds: [f64; 4],
    k: f64,
) -> Option<[f64; 4]> {
    let [left, top, right, bottom] = bounds;
    let mut widen = [0.0f64; 4];
    for (c, sign) in SIDES {
        // The point that makes this side, moved by the error that makes it.
        let reach = |s: &Seen| sign * s.at[c] + k * s.sigma[c];
        let s = seen.iter().max_by(|a, b| reach(a).total_cmp(&reach(b)))?;
        if s.sigma[c] <= 0.0 {
            continue;
        }
        let xi: Vec<f64> = s.slopes[c].iter().map(|x| sign * k * x / s.sigma[c]).collect();
        let mut at = projection.project(uncertain.place(&s.point, &xi))?;
        at[0] = unwrapped(projection, at[0], s.at[0]);
        for (side, (c, sign)) in SIDES.into_iter().enumerate() {
            let off = sign * (at[c] - s.at[c] - dot(&s.slopes[c], &xi));
            if off.abs() > SLIGHTLY * k * s.sigma[c] + 0.1 {
                return None;
            }
            widen[side] = widen[side].max(off);
        }
    }
    Some([left - widen[1], top - widen[3], right + widen[0], bottom + widen[2]])
}
