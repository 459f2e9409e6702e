//! Bounds for strongly curved projections: samples of the errors are projected one at a time.
//!
//! Neither a derivative nor second-order terms bound the effect of a large turn: a point may move towards a side and
//! back again. Therefore a fixed set of error samples goes through the exact projection. Samples that pass a side are
//! rare, so they are drawn from a mixture: the normal distribution itself, a wider one, and the places where a first
//! set of samples passed the sides. The weight of a sample is the ratio of the normal density to the density of the
//! mixture (importance sampling from a defensive mixture: Hesterberg 1995, Technometrics 37). The normal part bounds
//! the weights. With badly chosen places the estimate gets uncertain and the box larger, but the box stays valid.
//!
//! Samples are discarded from the outside in, equally on all sides. This stops when their probability plus twice its
//! standard error reaches 1 - confidence. The box holds the remaining samples.

use super::errors::{ERRORS, ErrorVector, FeatureErrorModel};
use super::exceedance::Level;
use super::image_point::{ImagePoint, PointDerivatives, unwrapped};
use super::{GRAZING, Projection, SIDES, Side};
use presight_model::statistics::portable_normal_pair;
use std::sync::OnceLock;

/// Maximum number of samples.
const DRAWS: usize = 2048;

/// All samples are drawn if 1 - confidence is below this, otherwise half of them.
const RARE: f64 = 5e-3;

/// Number of samples that locate the places for the others.
const FIRST: usize = 512;

/// Minimum number of these samples for a mean to give a place.
const AT_LEAST: usize = 12;

/// Share of samples drawn from the normal distribution itself.
const NORMAL: f64 = 0.2;

/// Share drawn from a wider distribution, for places that the first samples missed.
const WIDE: f64 = 0.3;

/// Scale of the wider distribution.
const WIDTH: f64 = 1.6;

/// Maximum number of places: two for each side.
const CENTERS: usize = 8;

/// Standard errors added to the estimated probability of the discarded samples.
const STANDARD_ERRORS: f64 = 2.0;

/// Share of 1 - confidence that is used, because the standard error is itself uncertain for few samples. In 900
/// generated cases the boxes then missed 0.7 of the allowed share, and at most 0.9 (1.24 in one case at 0.999).
const USED: f64 = 0.8;

/// Beyond this share of a turn the box takes all columns.
const ALL_AROUND: f64 = 0.9;

/// The errors that are not 0, in order.
type ActiveErrors = [f64; ERRORS];

/// Standard normal numbers, the same for all features. The method of Box and Muller transforms multiples of the square
/// roots of primes (Richtmyer 1951), which are more uniform than random numbers.
fn normals() -> &'static [ActiveErrors] {
    static NORMALS: OnceLock<Vec<ActiveErrors>> = OnceLock::new();
    const PRIMES: [f64; ERRORS] =
        [2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0, 37.0, 41.0, 43.0, 47.0, 53.0, 59.0, 61.0];
    NORMALS.get_or_init(|| {
        let one = |i: usize| {
            let mut few = PRIMES.map(|p| (0.5 + i as f64 * p.sqrt()).fract());
            for [x, y] in few.as_chunks_mut::<2>().0 {
                [*x, *y] = portable_normal_pair(x.max(1e-300), *y);
            }
            few
        };
        (1..=DRAWS).map(one).collect()
    })
}

/// Bounds for a strongly curved projection; `None` if errors of that probability may bring a point behind the sensor.
///
/// `k` is the number of standard deviations for linear bounds.
pub(super) fn set_bounds(
    projection: &impl Projection,
    uncertain: &FeatureErrorModel,
    rough: &[ImagePoint],
    level: &Level,
    k: f64,
) -> Option<[f64; 4]> {
    let used: Vec<usize> = uncertain.used().collect();
    let set = Set { projection, uncertain, rough, used: &used };
    let first = set.draws(&normals()[..FIRST], &set.centers(k));
    let count = if level.fail < RARE { DRAWS } else { DRAWS / 2 };
    let draws = set.draws(&normals()[..count], &set.passing(&first, level.fail));
    let out = left_out(&draws, level.fail);
    let kept = draws.iter().zip(out).filter(|(_, out)| !out).map(|(draw, _)| draw.reach);
    let nominal = set.reach(&[0.0; ERRORS]);
    let [right, left, bottom, top] = kept
        .chain(nominal)
        .fold([f64::NEG_INFINITY; 4], |all, reach| std::array::from_fn(|side| f64::max(all[side], reach[side])));
    if right == f64::INFINITY {
        return None;
    }
    // Near a pole the columns mean nothing, and samples miss some of them by chance.
    let around = projection.turn().filter(|turn| right + left > ALL_AROUND * turn);
    let Some(turn) = around else { return Some([-left, -top, right, bottom]) };
    // A feature that may surround the axis may also lie on it.
    let pole = |row: f64| projection.pole_near(row).unwrap_or(row);
    Some([-left, pole(-top).min(-top), turn - left, pole(bottom).max(bottom)])
}

/// Projects samples of the errors of one feature.
struct Set<'a, P> {
    projection: &'a P,
    uncertain: &'a FeatureErrorModel,
    rough: &'a [ImagePoint],
    /// Indices of the errors that are not 0.
    used: &'a [usize],
}

/// Errors, how far they move a feature towards each side, and the weight relative to the normal distribution.
#[derive(Clone, Copy)]
struct Draw {
    few: ActiveErrors,
    reach: [f64; 4],
    weight: f64,
}

impl<P: Projection> Set<'_, P> {
    /// The distance by which errors move the feature towards each side; `None` if they move it behind the sensor.
    /// Points that leave the image elsewhere count where they would be.
    fn reach(&self, few: &ActiveErrors) -> Option<[f64; 4]> {
        let mut xi = ErrorVector::default();
        for (i, x) in self.used.iter().zip(few) {
            xi.as_flattened_mut()[*i] = *x;
        }
        let motion = self.uncertain.motion(&xi);
        let mut reach = [f64::NEG_INFINITY; 4];
        let (mut before, mut last) = (None, None);
        for rough in self.rough {
            let p = motion.place(&rough.point);
            if !(self.projection.clearance(p) > GRAZING * rough.clearance) {
                return None;
            }
            // Near a pole a segment may be highest anywhere between its points, and it may pass on the other side. All
            // its points together span less than half a turn.
            let is_next = rough.point.shares[1] > 0.0;
            let before = before.replace(p).filter(|_| is_next);
            let highest = before.and_then(|before| self.projection.culmination(before, p));
            if let Some([_, row]) = highest.and_then(|p| self.projection.project(p)) {
                (reach[2], reach[3]) = (reach[2].max(row), reach[3].max(-row));
            }
            let Some(at) = self.projection.project(p) else { continue };
            let near = last.filter(|_| is_next).unwrap_or(rough.at[0]);
            let at = [unwrapped(self.projection, at[0], near), at[1]];
            last = Some(at[0]);
            for (reach, Side { axis: c, sign }) in reach.iter_mut().zip(SIDES) {
                *reach = reach.max(sign * at[c]);
            }
        }
        Some(reach)
    }

    /// Errors of length `k` that move the feature far towards the sides. Candidates are the derivatives and each single
    /// error, because a turn moves a point straight ahead up or down in second order only. For each side, returns the
    /// farthest and, if it is nearly as far, the farthest in a different direction.
    fn centers(&self, k: f64) -> Vec<ActiveErrors> {
        let n = self.used.len();
        let mut candidates: Vec<ActiveErrors> = Vec::new();
        for rough in self.rough {
            let seen = PointDerivatives::new(self.uncertain, rough);
            for (slopes, sigma) in seen.slopes.iter().zip(seen.sigma) {
                if sigma > 0.0 {
                    let along = |i: usize| self.used.get(i).map_or(0.0, |i| k / sigma * slopes.as_flattened()[*i]);
                    candidates.push(std::array::from_fn(along));
                }
            }
        }
        candidates.extend((0..n).map(|axis| std::array::from_fn(|i| if i == axis { k } else { 0.0 })));
        let both: Vec<ActiveErrors> = candidates.iter().flat_map(|c| [*c, c.map(|x| -x)]).collect();
        let reached: Vec<(ActiveErrors, [f64; 4])> = both.iter().filter_map(|c| Some((*c, self.reach(c)?))).collect();
        let Some(nominal) = self.reach(&[0.0; ERRORS]) else { return Vec::new() };
        let mut centers: Vec<ActiveErrors> = Vec::with_capacity(CENTERS);
        for side in 0..SIDES.len() {
            let farthest = |some: &mut dyn Iterator<Item = &(ActiveErrors, [f64; 4])>| {
                some.max_by(|a, b| a.1[side].total_cmp(&b.1[side])).copied()
            };
            let Some((first, most)) = farthest(&mut reached.iter()) else { continue };
            let second = farthest(&mut reached.iter().filter(|(other, _)| dot(other, &first, n) < 0.3 * k * k));
            let nearly = second.filter(|(_, reach)| reach[side] - nominal[side] > 0.5 * (most[side] - nominal[side]));
            for center in [Some(first), nearly.map(|s| s.0)].into_iter().flatten() {
                // One error may serve several sides.
                if !centers.iter().any(|known| dot(known, &center, n) > 0.95 * k * k) {
                    centers.push(center);
                }
            }
        }
        centers
    }

    /// Mean of the errors that pass each side, from a set of samples. A side gets a second mean if many of its errors
    /// point in the opposite direction.
    fn passing(&self, draws: &[Draw], fail: f64) -> Vec<ActiveErrors> {
        let n = self.used.len();
        let mut centers = Vec::with_capacity(CENTERS);
        let mut order = Vec::new();
        for side in 0..SIDES.len() {
            let (mut beyond, mut count, mut first) = (0.0, 0, None);
            let mut sums = [([0.0; ERRORS], 0.0); 2];
            farthest_first(draws, side, &mut order, |i| {
                let Draw { few, reach, weight } = &draws[i];
                if reach[side] < f64::INFINITY {
                    let opposite = usize::from(dot(few, first.get_or_insert(few), n) < 0.0);
                    let (sum, of) = &mut sums[opposite];
                    (0..n).for_each(|i| sum[i] += weight * few[i]);
                    (beyond, *of, count) = (beyond + weight, *of + weight, count + 1);
                }
                count < AT_LEAST || beyond <= fail * draws.len() as f64
            });
            for (sum, weight) in sums {
                if weight > 0.2 * beyond {
                    centers.push(sum.map(|x| x / weight));
                }
            }
        }
        centers
    }

    /// Makes samples from normal numbers. A sample behind the sensor passes every side.
    fn draws(&self, normals: &[ActiveErrors], centers: &[ActiveErrors]) -> Vec<Draw> {
        let n = self.used.len();
        let own = if centers.is_empty() { 1.0 - WIDE } else { NORMAL };
        let each = (1.0 - own - WIDE) / centers.len().max(1) as f64;
        let halves: Vec<f64> = centers.iter().map(|c| 0.5 * dot(c, c, n)).collect();
        let (thin, flat) = (WIDE * WIDTH.powi(-(n as i32)), 0.5 * (1.0 - 1.0 / (WIDTH * WIDTH)));
        let one = |(i, z): (usize, &ActiveErrors)| {
            let share = (i as f64 * 0.754_877_666_246_692_7).fract() - own;
            let center = if share < WIDE { None } else { centers.get(((share - WIDE) / each) as usize) };
            let few = match center {
                Some(center) => std::array::from_fn(|i| z[i] + center[i]),
                None if share >= 0.0 => z.map(|x| WIDTH * x),
                None => *z,
            };
            let around = |(c, half): (&ActiveErrors, &f64)| each * (dot(c, &few, n) - half).exp();
            let wide = thin * (flat * dot(&few, &few, n)).exp();
            let density = own + wide + centers.iter().zip(&halves).map(around).sum::<f64>();
            Draw { few, reach: self.reach(&few).unwrap_or([f64::INFINITY; 4]), weight: 1.0 / density }
        };
        normals.iter().enumerate().map(one).collect()
    }
}

/// Discards samples from the outside in, so that the others have the confidence.
fn left_out(draws: &[Draw], fail: f64) -> Vec<bool> {
    let most = USED * fail * draws.len() as f64;
    // For each sample, the weight of the samples at least as far towards a side; the minimum over the sides.
    let mut rarest = vec![f64::INFINITY; draws.len()];
    let mut order = Vec::new();
    for side in 0..SIDES.len() {
        let mut beyond = 0.0;
        farthest_first(draws, side, &mut order, |i| {
            beyond += draws[i].weight;
            rarest[i] = beyond.min(rarest[i]);
            beyond <= most
        });
    }
    order.clear();
    order.extend(rarest.into_iter().zip(0..).filter(|(beyond, _)| *beyond <= most));
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let (mut sum, mut squares) = (0.0, 0.0);
    let mut out = vec![false; draws.len()];
    for (_, i) in order {
        let weight = draws[i].weight;
        (sum, squares) = (sum + weight, squares + weight * weight);
        if sum + STANDARD_ERRORS * f64::sqrt(squares) > most {
            break;
        }
        out[i] = true;
    }
    out
}

/// Visits samples in the order of their reach towards a side, farthest first, until `visit` returns false.
fn farthest_first(draws: &[Draw], side: usize, order: &mut Vec<(f64, usize)>, mut visit: impl FnMut(usize) -> bool) {
    order.clear();
    order.extend(draws.iter().map(|d| d.reach[side]).zip(0..));
    let by_reach = |a: &(f64, usize), b: &(f64, usize)| b.0.total_cmp(&a.0);
    // Rarely are more than these visited, so the rest is not sorted.
    let mut rest = &mut order[..];
    while !rest.is_empty() {
        let some = rest.len().min(128);
        if some < rest.len() {
            rest.select_nth_unstable_by(some, by_reach);
        }
        let (first, more) = rest.split_at_mut(some);
        first.sort_unstable_by(by_reach);
        if !first.iter().all(|(_, i)| visit(*i)) {
            return;
        }
        rest = more;
    }
}

/// Scalar product of the first `n` entries.
fn dot(a: &ActiveErrors, b: &ActiveErrors, n: usize) -> f64 {
    (0..n).map(|i| a[i] * b[i]).sum()
}
