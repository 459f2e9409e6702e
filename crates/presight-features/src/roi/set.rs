//! Bounds where projection bends: a set of errors of the stated probability, propagated draw by draw.
//!
//! Neither a derivative nor second-order terms bound what a large turn does: a point may move towards a side and back again.
//! So errors are drawn, always the same ones, and each goes through the projection as it is. Draws that pass a side are rare,
//! so they are made where they are expected: some from the normal distribution itself, some from a wider one, and the rest
//! around places where errors pass the sides, which first draws have found. Each weighs as much as the normal distribution has
//! there beside the mixture that it was drawn from (importance sampling from a defensive mixture: Hesterberg 1995,
//! Technometrics 37). The first part bounds the weights: expecting wrongly makes the estimate uncertain and the box
//! larger, not the box wrong.
//!
//! Draws are left out from the outside, as rare ones on one side as on the others, for as long as their probability, with
//! twice its standard error, is within what the confidence leaves; the box is that of the others.

use super::errors::{ERRORS, ErrorVector, FeatureErrorModel};
use super::exceedance::Level;
use super::image_point::{ImagePoint, PointDerivatives, unwrapped};
use super::{GRAZING, Projection, SIDES};
use std::sync::OnceLock;

/// Most draws.
const DRAWS: usize = 2048;

/// Of a probability below this all draws are made, above it half of them.
const RARE: f64 = 5e-3;

/// Draws that find where others are to be made.
const FIRST: usize = 512;

/// Fewest of these of which a place is the mean.
const AT_LEAST: usize = 12;

/// The share of them that is drawn from the normal distribution itself.
const NORMAL: f64 = 0.2;

/// The share that is drawn from a wider one, for what nothing else expects.
const WIDE: f64 = 0.3;

/// How many times as wide that is.
const WIDTH: f64 = 1.6;

/// Most places that the others are drawn around: two for each side.
const CENTERS: usize = 8;

/// Standard errors by which the share of draws left out is taken for greater than it is.
const STANDARD_ERRORS: f64 = 2.0;

/// The part of what the confidence leaves that is made use of: so few draws hardly know their own standard error. Boxes of
/// 900 generated cases then missed 0.7 of what they may, and at most 0.9 (1.24 of one at 0.999).
const USED: f64 = 0.8;

/// Beyond this share of a turn all columns are taken.
const MOST_OF_A_TURN: f64 = 0.9;

/// Errors that are not nothing, in turn.
type ActiveErrors = [f64; ERRORS];

/// Standard normal numbers, the same for all features, by Box and Muller from multiples of the square roots of primes
/// (Richtmyer 1951), which are spread more evenly than random numbers.
fn normals() -> &'static [ActiveErrors] {
    static NORMALS: OnceLock<Vec<ActiveErrors>> = OnceLock::new();
    const PRIMES: [f64; ERRORS] =
        [2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0, 37.0, 41.0, 43.0, 47.0, 53.0, 59.0, 61.0];
    NORMALS.get_or_init(|| {
        let one = |i: usize| {
            let mut few = PRIMES.map(|p| (0.5 + i as f64 * p.sqrt()).fract());
            for [x, y] in few.as_chunks_mut::<2>().0 {
                let length = (-2.0 * libm::log(x.max(1e-300))).sqrt();
                let angle = std::f64::consts::TAU * *y;
                (*x, *y) = (length * libm::cos(angle), length * libm::sin(angle));
            }
            few
        };
        (1..=DRAWS).map(one).collect()
    })
}

/// Bounds where projection bends; `None` if errors of that probability may bring a point behind the sensor.
///
/// `k` is the number of standard deviations at which linear bounds would stand.
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
    // Round a pole columns say nothing, and where a few are left out is chance.
    let around = projection.turn().filter(|turn| right + left > MOST_OF_A_TURN * turn);
    let Some(turn) = around else { return Some([-left, -top, right, bottom]) };
    // What may lie all around the axis may lie on it.
    let pole = |row: f64| projection.pole_near(row).unwrap_or(row);
    Some([-left, pole(-top).min(-top), turn - left, pole(bottom).max(bottom)])
}

/// What is asked of all errors.
struct Set<'a, P> {
    projection: &'a P,
    uncertain: &'a FeatureErrorModel,
    rough: &'a [ImagePoint],
    /// Numbers of the errors that are not nothing.
    used: &'a [usize],
}

/// Errors, how far towards each side they bring a feature, and how many draws of the normal distribution they stand for.
#[derive(Clone, Copy)]
struct Draw {
    few: ActiveErrors,
    reach: [f64; 4],
    weight: f64,
}

impl<P: Projection> Set<'_, P> {
    /// How far towards each side errors bring the feature; `None` if they bring it behind the sensor. What leaves the image
    /// elsewhere need not be found in it.
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
            // Near a pole a segment may be highest anywhere between points of it, and may pass on the other side: it goes round by
            // less than half a turn, all of its points together.
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
            for (reach, (c, sign)) in reach.iter_mut().zip(SIDES) {
                *reach = reach.max(sign * at[c]);
            }
        }
        Some(reach)
    }

    /// Errors of length `k` that move the feature far towards the sides: along the derivatives, and along each error, for a turn moves what
    /// is straight ahead up or down by the second order only. Of each side the farthest, and the farthest on the other
    /// side of none, if that is nearly as far.
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
                // What one side has serves another, too.
                if !centers.iter().any(|known| dot(known, &center, n) > 0.95 * k * k) {
                    centers.push(center);
                }
            }
        }
        centers
    }

    /// Where errors that pass a side lie on average, by some draws: for each side one place, and another if many lie on the
    /// other side of none.
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

    /// Draws by normal numbers; those behind the sensor reach beyond every side.
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

/// Which draws are left out, from the outside, so that what is left has the confidence.
fn left_out(draws: &[Draw], fail: f64) -> Vec<bool> {
    let most = USED * fail * draws.len() as f64;
    // By draw: the weight of those at least as far towards a side, where that is least.
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

/// Visits draws, those that reach farthest towards a side first, until told to stop.
fn farthest_first(draws: &[Draw], side: usize, order: &mut Vec<(f64, usize)>, mut visit: impl FnMut(usize) -> bool) {
    order.clear();
    order.extend(draws.iter().map(|d| d.reach[side]).zip(0..));
    let by_reach = |a: &(f64, usize), b: &(f64, usize)| b.0.total_cmp(&a.0);
    // Hardly ever more than these are asked for.
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

/// Of the first so many.
fn dot(a: &ActiveErrors, b: &ActiveErrors, n: usize) -> f64 {
    (0..n).map(|i| a[i] * b[i]).sum()
}
