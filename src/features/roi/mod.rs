//! Regions of interest: the image box in which a feature will be found with a stated probability (paper section 3.4).
//!
//! Errors of the sensor's pose, of the object's pose and of the feature are one standard normal vector, taken through
//! square roots of their covariances. A side of the box is passed by the feature when a linear function of that vector
//! passes a threshold; the thresholds are set at the same number k of standard deviations on all sides, and k so that the
//! probability to pass any of them is at most 1 - confidence: Bonferroni's sum less the joint tails along a greatest
//! spanning tree (Hunter 1976, Worsley 1982), which is a bound for any correlations and nearly exact for few events.
//!
//! Where projection bends over the reach of the errors, the side is instead the farthest value over all errors of that size
//! (the design point of first-order reliability), with the size raised for the curvature there (Breitung 1984).

use crate::environment::FeatureShape;
use crate::features::normal::{joint_tail, square_root, tail, tail_quantile};
use crate::geometry::Pose;
use glam::{DMat3, DQuat, DVec3};

/// Covariance of a pose: x y z, then rotation about fixed x y z; metres and radians.
pub type PoseCovariance = [[f64; 6]; 6];

/// How a box was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RoiFlag {
    /// Errors went through the projection's derivative.
    Linear,
    /// Projection bends over the errors: their whole set went through.
    Set,
    /// The feature may come behind the sensor, or anywhere in over half of the image.
    WholeImage,
}

impl RoiFlag {
    /// As in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Set => "set",
            Self::WholeImage => "whole_image",
        }
    }
}

/// A box in continuous pixel coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Roi {
    /// x0, y0, x1, y1. Over a full circle's seam x1 is beyond the width.
    pub bounds: [f64; 4],
    /// How it was found.
    pub flag: RoiFlag,
}

/// What the sensor does to a point, and the image it does it in.
pub trait Projection: Sync {
    /// Continuous pixel coordinates of a point in the body frame, inside the image or not; `None` where there are none
    /// (behind a camera, in the scanner's centre).
    fn project(&self, p_in_body: DVec3) -> Option<[f64; 2]>;

    /// How far the point is from where the projection is singular: depth before a camera, distance from a scanner's axis.
    fn lever(&self, p_in_body: DVec3) -> f64;

    /// Columns and rows.
    fn size(&self) -> (u32, u32);

    /// Columns of a full turn, if the image goes round: columns are then modulo this number.
    fn turn(&self) -> Option<f64>;
}

/// The uncertain state of one feature: all errors, through one matrix.
#[derive(Clone, Debug)]
pub struct Uncertain {
    body_from_world: DMat3,
    /// Body from the feature's frame, composed in f64 with world positions subtracted first.
    body_from_frame: DMat3,
    /// The frame's origin relative to the sensor's, world axes.
    apart: DVec3,
    /// Columns of the square root: what one unit of each standard normal does.
    columns: Vec<Error>,
}

/// Errors of all kinds: sensor (world axes), object (its own axes), both ends of the feature (its frame).
#[derive(Clone, Copy, Debug, Default)]
struct Error {
    sensor: [DVec3; 2],
    object: [DVec3; 2],
    ends: [DVec3; 2],
}

/// A material point of a feature: where it is in the feature's frame, and how much of each end's error it takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Position in the feature's frame, metres.
    pub at: DVec3,
    /// Shares of the errors of the first and the second end; (1, 0) for features that move as a whole.
    pub shares: [f64; 2],
}

impl Material {
    /// A point of a feature: by its share t of the length for segments, or anywhere on one that moves as a whole.
    pub fn on_segment(ends: &[DVec3; 2], t: f64) -> Self {
        Self { at: ends[0].lerp(ends[1], t), shares: [1.0 - t, t] }
    }

    /// A point of a feature that moves as a whole.
    pub fn rigid(at: DVec3) -> Self {
        Self { at, shares: [1.0, 0.0] }
    }
}

impl Uncertain {
    /// The errors of a feature seen from a pose. `world_from_frame` is the pose of the feature's object (identity for
    /// the world) with its covariance in the object's own axes; the sensor's covariance is along the world's axes,
    /// rotation by Exp(dtheta) from the left.
    pub fn new(
        world_from_body: &Pose,
        sensor: &PoseCovariance,
        world_from_frame: &Pose,
        object: Option<&PoseCovariance>,
        shape: &FeatureShape,
    ) -> Self {
        let body_from_world = world_from_body.rotation_matrix().transpose();
        let mut columns = Vec::new();
        let pair = |f: &[[f64; 6]; 6], c: usize| {
            [DVec3::new(f[0][c], f[1][c], f[2][c]), DVec3::new(f[3][c], f[4][c], f[5][c])]
        };
        let mut add = |factor: [[f64; 6]; 6], put: fn([DVec3; 2]) -> Error| {
            for c in 0..6 {
                let column = pair(&factor, c);
                if column != [DVec3::ZERO; 2] {
                    columns.push(put(column));
                }
            }
        };
        add(square_root(sensor), |sensor| Error { sensor, ..Error::default() });
        if let Some(object) = object {
            add(square_root(object), |object| Error { object, ..Error::default() });
        }
        add(square_root(&ends_covariance(shape)), |ends| Error { ends, ..Error::default() });
        Self {
            body_from_world,
            body_from_frame: body_from_world * world_from_frame.rotation_matrix(),
            apart: world_from_frame.translation - world_from_body.translation,
            columns,
        }
    }

    /// Number of independent errors.
    pub fn dimensions(&self) -> usize {
        self.columns.len()
    }

    /// Where a point comes to be, body frame, under errors `xi` (standard normal, one for each dimension); exact.
    pub fn place(&self, point: &Material, xi: &[f64]) -> DVec3 {
        let mut e = Error::default();
        for (column, x) in self.columns.iter().zip(xi) {
            for i in 0..2 {
                e.sensor[i] += column.sensor[i] * *x;
                e.object[i] += column.object[i] * *x;
                e.ends[i] += column.ends[i] * *x;
            }
        }
        let p = point.at + e.ends[0] * point.shares[0] + e.ends[1] * point.shares[1];
        let p = DQuat::from_scaled_axis(e.object[1]) * p + e.object[0];
        // Object and sensor may turn by large angles: their pose errors are exact, not linear.
        let in_body = self.body_from_frame * p + self.body_from_world * (self.apart - e.sensor[0]);
        let turned = self.body_from_world * e.sensor[1];
        DQuat::from_scaled_axis(-turned) * in_body
    }

    /// Derivatives of [`Uncertain::place`] at no error, one a dimension.
    fn slopes(&self, point: &Material) -> Vec<DVec3> {
        let in_body = self.place(point, &[]);
        let slope = |c: &Error| {
            let p =
                c.ends[0] * point.shares[0] + c.ends[1] * point.shares[1] + c.object[1].cross(point.at) + c.object[0];
            let turned = self.body_from_world * c.sensor[1];
            self.body_from_frame * p - self.body_from_world * c.sensor[0] - turned.cross(in_body)
        };
        self.columns.iter().map(slope).collect()
    }
}

/// Covariance of both ends, 6 x 6; features that move as a whole have one end.
fn ends_covariance(shape: &FeatureShape) -> [[f64; 6]; 6] {
    let mut all = [[0.0; 6]; 6];
    let mut put = |row: usize, column: usize, m: &DMat3| {
        for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
            all[row + i][column + j] = m.col(j)[i];
        }
    };
    match shape {
        FeatureShape::Segment { covariances: [a, b], cross, .. } => {
            put(0, 0, a);
            put(3, 3, b);
            put(0, 3, cross);
            put(3, 0, &cross.transpose());
        }
        FeatureShape::Point { covariance, .. }
        | FeatureShape::Patch { covariance, .. }
        | FeatureShape::Reflector { covariance, .. }
        | FeatureShape::Fiducial { covariance, .. } => put(0, 0, covariance),
    }
    all
}

/// A point in the image with what each error does to it.
struct Seen {
    point: Material,
    at: [f64; 2],
    /// Derivatives of column and row by each error.
    slopes: [Vec<f64>; 2],
    sigma: [f64; 2],
    lever: f64,
    lever_sigma: f64,
    /// Standard deviation of its position, body frame.
    spread: f64,
}

/// One of the four sides: which coordinate, and +1 or -1.
const SIDES: [(usize, f64); 4] = [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)];

/// What is left of a point's lever where it counts as lost.
const GRAZING: f64 = 0.05;

/// Errors that move a point by no more than this share of its lever do not bend its projection.
const BENT: f64 = 0.02;

/// Where the derivative and the projection differ by more than this share of a side's distance, the derivative is given
/// up; below, the difference widens the box.
const SLIGHTLY: f64 = 0.1;

/// The box of a feature's material points (those visible at the nominal pose) that holds all of them with probability
/// `confidence`; clipped to the image, at least a pixel wide and high. `None` if no point has an image.
pub fn roi(projection: &impl Projection, uncertain: &Uncertain, points: &[Material], confidence: f64) -> Option<Roi> {
    let seen = see(projection, uncertain, points);
    if seen.is_empty() {
        return None;
    }
    let fail = 1.0 - confidence;
    let k = common_deviation(&seen, fail);
    // Where the set reaches behind the sensor, or round its axis, no box holds it.
    if seen.iter().any(|s| s.lever - k * s.lever_sigma <= GRAZING * s.lever) {
        return Some(Roi { bounds: whole(projection), flag: RoiFlag::WholeImage });
    }
    let linear = linear_bounds(&seen, k);
    let near = seen.iter().map(|s| k * s.spread / s.lever).fold(0.0, f64::max) <= BENT;
    let (bounds, flag) = match if near { Some(linear) } else { bent_bounds(projection, uncertain, &seen, linear, k) } {
        Some(bounds) => (bounds, RoiFlag::Linear),
        None => match set_bounds(projection, uncertain, &seen, fail, k) {
            Some(bounds) => (bounds, RoiFlag::Set),
            None => (whole(projection), RoiFlag::WholeImage),
        },
    };
    Some(clip(projection, bounds, flag))
}

/// Covariance of a point's image, pixels squared, by the projection's derivative.
pub fn image_covariance(
    projection: &impl Projection,
    uncertain: &Uncertain,
    point: &Material,
) -> Option<[[f64; 2]; 2]> {
    let seen = see(projection, uncertain, std::slice::from_ref(point));
    let [a, b] = &seen.first()?.slopes;
    let dot = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| x * y).sum::<f64>();
    Some([[dot(a, a), dot(a, b)], [dot(a, b), dot(b, b)]])
}

/// The whole image.
fn whole(projection: &impl Projection) -> [f64; 4] {
    let (w, h) = projection.size();
    [-0.5, -0.5, f64::from(w) - 0.5, f64::from(h) - 0.5]
}

/// Nominal images and their slopes. Columns are unwrapped to the first point's.
fn see(projection: &impl Projection, uncertain: &Uncertain, points: &[Material]) -> Vec<Seen> {
    let mut all: Vec<Seen> = Vec::with_capacity(points.len());
    for point in points {
        let p = uncertain.place(point, &[]);
        let Some(mut at) = projection.project(p) else { continue };
        if let Some(first) = all.first() {
            at[0] = unwrapped(projection, at[0], first.at[0]);
        }
        let Some(gradient) = gradient(projection, p, at) else { continue };
        let moves = uncertain.slopes(point);
        let slopes = gradient.map(|g| moves.iter().map(|s| g.dot(*s)).collect::<Vec<f64>>());
        let sigma = [0, 1].map(|k| dot(&slopes[k], &slopes[k]).sqrt());
        let spread = moves.iter().map(|s| s.length_squared()).sum::<f64>().sqrt();
        let lever = projection.lever(p);
        let towards = |s: &DVec3| (projection.lever(p + *s * 1e-6) - projection.lever(p - *s * 1e-6)) / 2e-6;
        let lever_sigma = moves.iter().map(|s| towards(s).powi(2)).sum::<f64>().sqrt();
        all.push(Seen { point: *point, at, slopes, sigma, lever, lever_sigma, spread });
    }
    all
}

/// The column nearest to another, where columns go round.
fn unwrapped(projection: &impl Projection, column: f64, near: f64) -> f64 {
    match projection.turn() {
        Some(turn) => column - turn * ((column - near) / turn).round(),
        None => column,
    }
}

/// Derivatives of column and row by the position, by central differences: their error is of the second order of 1e-5.
fn gradient(projection: &impl Projection, p: DVec3, at: [f64; 2]) -> Option<[DVec3; 2]> {
    let step = 1e-5 * projection.lever(p).abs().max(1e-9 * p.length());
    let mut gradient = [DVec3::ZERO; 2];
    for k in 0..3 {
        let mut by = DVec3::ZERO;
        by[k] = step;
        let (up, down) = (projection.project(p + by)?, projection.project(p - by)?);
        gradient[0][k] = (unwrapped(projection, up[0], at[0]) - unwrapped(projection, down[0], at[0])) / (2.0 * step);
        gradient[1][k] = (up[1] - down[1]) / (2.0 * step);
    }
    Some(gradient)
}

fn linear_bounds(seen: &[Seen], k: f64) -> [f64; 4] {
    let limit = |(c, sign): (usize, f64)| {
        sign * seen.iter().map(|s| sign * s.at[c] + k * s.sigma[c]).fold(f64::NEG_INFINITY, f64::max)
    };
    let [right, left, bottom, top] = SIDES.map(limit);
    [left, top, right, bottom]
}

/// The linear bounds, widened by what the projection itself says at the errors that the sides stand for; `None` if that
/// is much.
fn bent_bounds(
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

/// The number of standard deviations k at which no side is passed but with probability `fail`.
fn common_deviation(seen: &[Seen], fail: f64) -> f64 {
    let lowest = tail_quantile(fail);
    // Which events count, and the tree, are settled at Bonferroni's k for four sides; there the tails hardly change.
    let first = tail_quantile(0.25 * fail);
    let events = events(seen, first);
    if events.is_empty() {
        return lowest;
    }
    let edges = tree(&events);
    let passed = |k: f64| {
        let reach = |e: &Event| e.deviations + (k - first);
        let sum: f64 = events.iter().map(|e| tail(reach(e))).sum();
        sum - edges.iter().map(|(i, j, rho)| joint_tail(reach(&events[*i]), reach(&events[*j]), *rho)).sum::<f64>()
    };
    let (mut low, mut high) = (lowest, tail_quantile(fail / events.len() as f64).max(lowest) + 1e-9);
    for _ in 0..30 {
        let middle = 0.5 * (low + high);
        if passed(middle) > fail { low = middle } else { high = middle }
    }
    high
}

/// A point passing a side.
struct Event {
    /// Unit vector of errors along which it goes there.
    direction: Vec<f64>,
    /// How many standard deviations away the side is.
    deviations: f64,
}

fn events(seen: &[Seen], k: f64) -> Vec<Event> {
    /// Most points a side that are looked at: the ends and those that stand out.
    const MOST: usize = 4;
    let mut events: Vec<Event> = Vec::new();
    for (c, sign) in SIDES {
        let limit = seen.iter().map(|s| sign * s.at[c] + k * s.sigma[c]).fold(f64::NEG_INFINITY, f64::max);
        let mut near: Vec<(f64, &Seen)> = seen
            .iter()
            .filter(|s| s.sigma[c] > 0.0)
            .map(|s| ((limit - sign * s.at[c]) / s.sigma[c], s))
            .filter(|(deviations, _)| *deviations < k + 1.5)
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        let before = events.len();
        for (deviations, s) in near {
            let direction: Vec<f64> = s.slopes[c].iter().map(|x| sign * x / s.sigma[c]).collect();
            // Points that move as one pass as one.
            let same = |e: &Event| dot(&e.direction, &direction) > 1.0 - 1e-6;
            if events.len() < before + MOST && !events[before..].iter().any(same) {
                events.push(Event { direction, deviations });
            }
        }
    }
    events
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// The spanning tree of greatest joint tails: pairs and their correlations (Prim).
fn tree(events: &[Event]) -> Vec<(usize, usize, f64)> {
    let mut edges = Vec::with_capacity(events.len().saturating_sub(1));
    let mut best: Vec<(f64, usize, f64)> = vec![(-1.0, 0, 0.0); events.len()];
    let mut out: Vec<usize> = (1..events.len()).collect();
    let mut last = 0;
    while !out.is_empty() {
        for &i in &out {
            let rho = dot(&events[i].direction, &events[last].direction).clamp(-1.0, 1.0);
            let joint = joint_tail(events[i].deviations, events[last].deviations, rho);
            if joint > best[i].0 {
                best[i] = (joint, last, rho);
            }
        }
        let at = (0..out.len()).fold(0, |b, i| if best[out[i]].0 > best[out[b]].0 { i } else { b });
        last = out.swap_remove(at);
        edges.push((last, best[last].1, best[last].2));
    }
    edges
}

/// Bounds where projection bends; `None` if errors of that probability may bring a point behind the sensor, or anywhere.
fn set_bounds(
    projection: &impl Projection,
    uncertain: &Uncertain,
    seen: &[Seen],
    fail: f64,
    linear: f64,
) -> Option<[f64; 4]> {
    let mut reach = linear;
    // Curvature raises the tails beyond the design points: k rises until they fit.
    for _ in 0..4 {
        let mut limits = [0.0; 4];
        let mut growth: f64 = 1.0;
        for (limit, side) in limits.iter_mut().zip(SIDES) {
            let mut farthest = f64::NEG_INFINITY;
            for s in seen {
                let (value, factor) = farthest_value(projection, uncertain, s, side, reach)?;
                if value > farthest {
                    farthest = value;
                    growth = growth.max(factor);
                }
            }
            *limit = side.1 * farthest;
        }
        let wanted = tail_quantile((tail(linear) / growth).max(1e-300)).max(linear);
        // All of the ball: no set of errors of that probability is larger.
        let ball = ball_radius(uncertain.dimensions(), fail);
        let wanted = wanted.min(ball.max(linear));
        if wanted <= reach + 1e-3 {
            let [right, left, bottom, top] = limits;
            return Some([left, top, right, bottom]);
        }
        reach = wanted;
    }
    let ball = ball_radius(uncertain.dimensions(), fail).max(reach);
    let mut limits = [0.0; 4];
    for (limit, side) in limits.iter_mut().zip(SIDES) {
        let mut farthest = f64::NEG_INFINITY;
        for s in seen {
            farthest = farthest.max(farthest_value(projection, uncertain, s, side, ball)?.0);
        }
        *limit = side.1 * farthest;
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
) -> Option<(f64, f64)> {
    let n = uncertain.dimensions();
    let value = |xi: &[f64]| -> Option<f64> {
        let p = uncertain.place(&seen.point, xi);
        let mut at = projection.project(p)?;
        if projection.lever(p) <= GRAZING * seen.lever {
            return None;
        }
        at[0] = unwrapped(projection, at[0], seen.at[0]);
        Some(sign * at[c])
    };
    if seen.sigma[c] <= 0.0 && seen.spread <= 0.0 {
        return Some((sign * seen.at[c], 1.0));
    }
    let start = if seen.sigma[c] > 0.0 { &seen.slopes[c] } else { &seen.slopes[1 - c] };
    let length = dot(start, start).sqrt().max(f64::MIN_POSITIVE);
    let mut xi: Vec<f64> = start.iter().map(|x| sign * x / length * reach).collect();
    let mut best = value(&xi)?;
    // The derivative at no error may miss the way that matters: a turn moves what is straight ahead up or down by the
    // second order only. So each axis is tried as well.
    for i in 0..n {
        for reach in [reach, -reach] {
            let mut axis = vec![0.0; n];
            axis[i] = reach;
            let there = value(&axis)?;
            if there > best {
                (xi, best) = (axis, there);
            }
        }
    }
    let mut slope = vec![0.0; n];
    for _ in 0..6 {
        for i in 0..n {
            let (mut up, mut down) = (xi.clone(), xi.clone());
            (up[i], down[i]) = (up[i] + 1e-4, down[i] - 1e-4);
            slope[i] = (value(&up)? - value(&down)?) / 2e-4;
        }
        let length = dot(&slope, &slope).sqrt();
        if length == 0.0 {
            break;
        }
        let next: Vec<f64> = slope.iter().map(|s| s / length * reach).collect();
        let there = value(&next)?;
        if there <= best + 1e-9 * best.abs().max(1.0) {
            break;
        }
        (xi, best) = (next, there);
    }
    let gradient = dot(&slope, &slope).sqrt();
    if gradient == 0.0 || reach <= 0.0 {
        return Some((best, 1.0));
    }
    // Along a great circle the value falls by gradient * reach * angle^2 / 2 if the limit is flat, less if it bends round.
    let angle = 0.2f64;
    let mut growth = 1.0;
    for i in 0..n {
        let along = xi[i] / reach;
        let mut side: Vec<f64> = xi.iter().map(|x| -along * x / reach).collect();
        side[i] += 1.0;
        let length = dot(&side, &side).sqrt();
        if length < 1e-3 {
            continue;
        }
        let turned = |sign: f64| -> Option<f64> {
            let (sin, cos) = (sign * angle).sin_cos();
            value(&xi.iter().zip(&side).map(|(x, s)| cos * x + sin * reach * s / length).collect::<Vec<f64>>())
        };
        let mean = 0.5 * (turned(1.0)? + turned(-1.0)?);
        let flat = gradient * reach * (1.0 - angle.cos());
        let share = ((best - mean) / flat).clamp(0.04, 1.0);
        // Several axes may lie in the same bend: the worst stands for all but one more.
        growth = f64::max(growth, 1.0 / share.sqrt());
    }
    // Passed on both sides of no error alike: twice as often.
    let opposite = value(&xi.iter().map(|x| -x).collect::<Vec<f64>>())?;
    let twice = if best - opposite < 0.3 * gradient * reach { 2.0 } else { 1.0 };
    Some((best, twice * growth * growth.sqrt()))
}

/// The radius of the ball that holds a standard normal vector with probability 1 - fail (Wilson and Hilferty, which is
/// within 1 % here, and 1 % more).
fn ball_radius(dimensions: usize, fail: f64) -> f64 {
    let n = dimensions.max(1) as f64;
    let spread = (2.0 / (9.0 * n)).sqrt();
    let cube = 1.0 - 2.0 / (9.0 * n) + tail_quantile(fail) * spread;
    1.01 * (n * cube.powi(3)).sqrt()
}

/// Within the image, at least a pixel a side; over a full circle's seam x1 goes on beyond the width.
fn clip(projection: &impl Projection, [x0, y0, x1, y1]: [f64; 4], flag: RoiFlag) -> Roi {
    let (w, h) = projection.size();
    let (w, h) = (f64::from(w), f64::from(h));
    let widen = |low: f64, high: f64| {
        let short = (1.0 - (high - low)).max(0.0) / 2.0;
        (low - short, high + short)
    };
    let within = |low: f64, high: f64, size: f64| {
        let (low, high) = widen(low, high);
        let (low, high) = (low.clamp(-0.5, size - 1.5), high.clamp(0.5, size - 0.5));
        (low, high)
    };
    let (y0, y1) = within(y0, y1, h);
    let (x0, x1) = match projection.turn() {
        Some(turn) if x1 - x0 >= turn => (-0.5, w - 0.5),
        Some(turn) => {
            let (x0, x1) = widen(x0, x1);
            let back = turn * ((x0 + 0.5) / turn).floor();
            (x0 - back, x1 - back)
        }
        None => within(x0, x1, w),
    };
    let large = (x1 - x0) * (y1 - y0) > 0.5 * w * h;
    if large && flag != RoiFlag::Linear {
        return Roi { bounds: whole(projection), flag: RoiFlag::WholeImage };
    }
    Roi { bounds: [x0, y0, x1, y1], flag }
}

#[cfg(test)]
mod tests;
