//! Nominal images of material points, and their derivatives with respect to each error.

use super::errors::{BodyPoint, ErrorVector, FeatureErrorModel, KIND, NominalPoint};
use super::{Projection, SIDES, Side};
use glam::DVec3;

/// A point in the image.
#[derive(Clone, Copy, Debug)]
pub(super) struct ImagePoint {
    pub point: NominalPoint,
    /// Pixel coordinates; the column is unwrapped to that of the first point.
    pub at: [f64; 2],
    /// Derivatives of column and row with respect to the position, body frame.
    pub gradient: [DVec3; 2],
    pub lever: f64,
    /// See [`Projection::clearance`].
    pub clearance: f64,
    /// Upper bound on the standard deviation of its position, body frame.
    pub spread: f64,
}

/// A point with the derivatives of its image.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointDerivatives {
    pub rough: ImagePoint,
    /// Derivatives of column and row with respect to each error.
    pub slopes: [ErrorVector; 2],
    pub sigma: [f64; 2],
}

impl PointDerivatives {
    pub fn new(uncertain: &FeatureErrorModel, rough: &ImagePoint) -> Self {
        let [g, h] = rough.gradient;
        let slopes = [uncertain.slopes(&rough.point, g), uncertain.slopes(&rough.point, h)];
        let sigma = [dot(&slopes[0], &slopes[0]).sqrt(), dot(&slopes[1], &slopes[1]).sqrt()];
        Self { rough: *rough, slopes, sigma }
    }

    /// Covariance of column and row, pixels squared.
    pub fn covariance(&self) -> [[f64; 2]; 2] {
        let [a, b] = self.sigma;
        let across = dot(&self.slopes[0], &self.slopes[1]);
        [[a * a, across], [across, b * b]]
    }

    /// Position towards a side at `k` standard deviations.
    pub fn reach(&self, side: Side, k: f64) -> f64 {
        side.sign * self.rough.at[side.axis] + k * self.sigma[side.axis]
    }
}

/// Sums each kind separately, so that the compiler vectorizes the additions.
#[inline]
pub(super) fn dot([a, b, c]: &ErrorVector, [d, e, f]: &ErrorVector) -> f64 {
    let sums: [f64; KIND] = std::array::from_fn(|k| a[k] * d[k] + b[k] * e[k] + c[k] * f[k]);
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + (sums[4] + sums[5])
}

/// Nominal images of points.
pub(super) fn rough(
    projection: &impl Projection,
    uncertain: &FeatureErrorModel,
    points: &[BodyPoint],
    into: &mut Vec<ImagePoint>,
) {
    into.clear();
    for point in points {
        let point = uncertain.nominal(point);
        let Some(mut at) = projection.project(point.p) else { continue };
        if let Some(first) = into.first() {
            at[0] = unwrapped(projection, at[0], first.at[0]);
        }
        // The projection is singular if it has no derivative.
        let (gradient, lever) = match projection.gradient(point.p, at) {
            Some(gradient) => (gradient, projection.lever(point.p)),
            None => ([DVec3::ZERO; 2], 0.0),
        };
        let (clearance, spread) = (projection.clearance(point.p), uncertain.spread(&point));
        into.push(ImagePoint { point, at, gradient, lever, clearance, spread });
    }
}

/// Up to this number, all points are kept.
const FEW: usize = 4;

/// Selects the points that may determine a side at `k` standard deviations, with their derivatives. A point is omitted
/// if it stays behind another one even with the largest possible deviation.
pub(super) fn see(uncertain: &FeatureErrorModel, all: &[ImagePoint], k: f64, into: &mut Vec<PointDerivatives>) {
    into.clear();
    if all.len() <= FEW {
        into.extend(all.iter().map(|rough| PointDerivatives::new(uncertain, rough)));
        return;
    }
    let mut limits = [f64::NEG_INFINITY; 4];
    let mut leaders = [0; 4];
    for (side, Side { axis: c, sign }) in SIDES.into_iter().enumerate() {
        leaders[side] = (0..all.len()).fold(0, |b, i| if sign * all[i].at[c] > sign * all[b].at[c] { i } else { b });
        let seen = PointDerivatives::new(uncertain, &all[leaders[side]]);
        for (limit, side) in limits.iter_mut().zip(SIDES) {
            *limit = limit.max(seen.reach(side, k));
        }
    }
    let may = |rough: &ImagePoint| {
        let most = [0, 1].map(|c| (k + MARGIN) * rough.spread * rough.gradient[c].length());
        SIDES.into_iter().zip(limits).any(|(Side { axis: c, sign }, limit)| sign * rough.at[c] + most[c] >= limit)
    };
    let chosen = all.iter().enumerate().filter(|(i, rough)| leaders.contains(i) || may(rough));
    into.extend(chosen.map(|(_, rough)| PointDerivatives::new(uncertain, rough)));
}

/// Standard deviations beyond the common number at which an event no longer counts. At 3, less than 0.6 % is left.
pub const MARGIN: f64 = 1.5;

/// The equivalent column nearest to `near`, in images that cover a full turn.
pub(super) fn unwrapped(projection: &impl Projection, column: f64, near: f64) -> f64 {
    match projection.turn() {
        Some(turn) => column - turn * ((column - near) / turn).round(),
        None => column,
    }
}

/// Derivatives of column and row by central differences. The step is 1e-5 of the lever, so the error is about 1e-10.
pub fn differences(projection: &(impl Projection + ?Sized), p: DVec3, at: [f64; 2]) -> Option<[DVec3; 2]> {
    let step = 1e-5 * projection.lever(p).abs().max(1e-9 * p.length());
    let near = |column: f64| match projection.turn() {
        Some(turn) => column - turn * ((column - at[0]) / turn).round(),
        None => column,
    };
    let mut gradient = [DVec3::ZERO; 2];
    for k in 0..3 {
        let mut by = DVec3::ZERO;
        by[k] = step;
        let (up, down) = (projection.project(p + by)?, projection.project(p - by)?);
        gradient[0][k] = (near(up[0]) - near(down[0])) / (2.0 * step);
        gradient[1][k] = (up[1] - down[1]) / (2.0 * step);
    }
    Some(gradient)
}
