//! Bounds from the projection's derivative, and a check of their linearization error.

use super::errors::{FeatureErrorModel, each};
use super::image_point::{PointDerivatives, dot, unwrapped};
use super::{Projection, SIDES, Side};

/// The derivative is rejected if it differs from the projection by more than this share of a side's distance. A smaller
/// difference widens the box.
pub const SLIGHTLY: f64 = 0.1;

/// Absolute difference allowed in addition, pixels.
pub const SLIGHT: f64 = 0.1;

/// The point that sets a side.
fn maker(seen: &[PointDerivatives], side: Side, k: f64) -> Option<&PointDerivatives> {
    seen.iter().max_by(|a, b| a.reach(side, k).total_cmp(&b.reach(side, k)))
}

/// Left, top, right, bottom.
pub(super) fn linear_bounds(seen: &[PointDerivatives], k: f64) -> [f64; 4] {
    let limit = |side: Side| side.sign * seen.iter().map(|s| s.reach(side, k)).fold(f64::NEG_INFINITY, f64::max);
    let [right, left, bottom, top] = SIDES.map(limit);
    [left, top, right, bottom]
}

/// Widens the linear bounds by the linearization error at the errors that set the sides. Returns `None` if it is large.
pub(super) fn bent_bounds(
    projection: &impl Projection,
    uncertain: &FeatureErrorModel,
    seen: &[PointDerivatives],
    bounds: [f64; 4],
    k: f64,
) -> Option<[f64; 4]> {
    let [left, top, right, bottom] = bounds;
    let mut widen = [0.0f64; 4];
    for side in SIDES {
        let Side { axis: c, sign } = side;
        // The point that sets this side, moved by the error that sets it.
        let s = maker(seen, side, k)?;
        if s.sigma[c] <= 0.0 {
            continue;
        }
        let scale = sign * k / s.sigma[c];
        let xi = each(&s.slopes[c], |x| scale * x);
        let mut at = projection.project(uncertain.moved(&s.rough.point, &xi))?;
        at[0] = unwrapped(projection, at[0], s.rough.at[0]);
        let off = [0, 1].map(|c| at[c] - s.rough.at[c] - dot(&s.slopes[c], &xi));
        for (side, Side { axis: c, sign }) in SIDES.into_iter().enumerate() {
            if off[c].abs() > SLIGHTLY * k * s.sigma[c] + SLIGHT {
                return None;
            }
            widen[side] = widen[side].max(sign * off[c]);
        }
    }
    Some([left - widen[1], top - widen[3], right + widen[0], bottom + widen[2]])
}
