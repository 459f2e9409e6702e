//! What one reading says of a pose: the log-odds against a reading of nowhere in particular.
//!
//! A reading is the map's surface, something unknown before it, something where a surface is gone, or anything. Each of
//! the four is set against how often the places of this map have such a range at all ([`MapRanges`]): the odds are 1 in
//! the mean over these, so 0 is the level of "nothing of this map", and a reading before an unknown thing, or where the
//! map says nothing, costs next to nothing.

use super::likelihood::PoseLikelihood;
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::measured::{Frame, RangeNoise};
use presight_model::world::World;
use presight_predict::predict::Predictor;

/// Share of the readings that are of the map, in a map that is out of date. These four come from the prototype's drives
/// with up to 40 % of the objects gone and 40 % moved; for what a shop or an office changes in a week, any shares between
/// .4 and .8 of the map distinguish the same places.
const HIT: f64 = 0.6;
/// Share of those before something unknown.
const NEARER: f64 = 0.2;
/// Share of those through something that is gone.
const FARTHER: f64 = 0.1;
/// Share of all others.
const ANY: f64 = 0.1;
/// Width of a bin of ranges, metres: about the deviation by which places are distinguished.
const BIN: f64 = 0.05;
/// Most bins; a sensor that reaches farther has wider ones.
const MOST_BINS: usize = 10_000;
/// Part of the ranges that is taken as spread evenly: no range is impossible.
const EVEN: f64 = 0.05;
/// Least probability of no range, and of a range before or behind another.
const LEAST: (f64, f64) = (1e-3, 0.02);
/// Most odds of a beam that reaches nothing, as predicted: beams into the open all depend on each other.
const MOST_OPEN: f64 = 3.0;
/// Least cosine of incidence.
const FLATTEST: f64 = 0.1;

/// How often the places of a map have which range.
#[derive(Clone, Debug)]
pub(super) struct MapRanges {
    bin: f64,
    /// By bin, 1 / metre.
    density: Vec<f64>,
    /// Probability of a range in a bin or before it.
    below: Vec<f64>,
    /// Probability of no range.
    none: f64,
}

impl MapRanges {
    /// From predicted ranges; NaN and -inf do not count. All finite ones are at most `reach`, metres.
    pub fn new(ranges: impl Iterator<Item = f32>, reach: f64) -> Self {
        let bin = BIN.max(reach / MOST_BINS as f64);
        let count = (reach / bin) as usize + 1;
        let (mut bins, mut all, mut open) = (vec![0.0; count], 0.0, 0.0);
        for r in ranges.filter(|r| *r > 0.0) {
            all += 1.0;
            if r.is_finite() { bins[((f64::from(r) / bin) as usize).min(count - 1)] += 1.0 } else { open += 1.0 }
        }
        let none = (open / f64::max(all, 1.0)).clamp(LEAST.0, 1.0 - LEAST.0);
        // Neighbouring bins share a quarter: what one place more or less would change.
        let at = |i: usize, k: usize| bins[(i + k).saturating_sub(1).min(count - 1)];
        let smooth: Vec<f64> = (0..count).map(|i| 0.25 * at(i, 0) + 0.5 * at(i, 1) + 0.25 * at(i, 2)).collect();
        let sum = smooth.iter().sum::<f64>();
        let share = |x: f64| if sum > 0.0 { (1.0 - EVEN) * x / sum + EVEN / count as f64 } else { 1.0 / count as f64 };
        let shares = smooth.into_iter().map(|x| (1.0 - none) * share(x));
        let mut before = 0.0;
        let (mut density, mut below) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for share in shares {
            before += share;
            density.push(share / bin);
            below.push(before);
        }
        Self { bin, density, below, none }
    }

    fn at(&self, range: f64) -> usize {
        ((range / self.bin) as usize).min(self.density.len() - 1)
    }

    /// Log-odds of a reading where the range `predicted` is expected, with the variances of a surface that is where the map
    /// has it and of one that was moved a little, square metres; 0 for a reading without evidence.
    pub fn log_odds(&self, measured: f64, predicted: f64, variances: [f64; 2]) -> f64 {
        let unknown = |x: f64| x.is_nan() || x == f64::NEG_INFINITY;
        if unknown(measured) || unknown(predicted) {
            return 0.0;
        }
        let below = if predicted.is_finite() { self.below[self.at(predicted)] } else { 1.0 - self.none };
        let below = below.clamp(LEAST.1, 1.0 - LEAST.1);
        let odds = match (measured.is_finite(), predicted.is_finite()) {
            (true, true) => {
                let off = measured - predicted;
                let normal = |v: f64| (-0.5 * off * off / v).exp() / (std::f64::consts::TAU * v).sqrt();
                let hit = variances.into_iter().map(normal).sum::<f64>() / variances.len() as f64;
                let other = if off < 0.0 { NEARER / below } else { FARTHER / (1.0 - below) };
                HIT * hit / self.density[self.at(measured)] + other
            }
            (true, false) => NEARER / below,
            (false, true) => FARTHER / (1.0 - below),
            (false, false) => HIT * (1.0 / self.none).min(MOST_OPEN),
        };
        (ANY + odds).ln()
    }
}

/// What one frame of a sensor says of poses of the robot, by pixels that are spread over its image.
#[derive(Clone, Debug)]
pub(super) struct FrameEvidence {
    pixels: PoseLikelihood,
    noise: RangeNoise,
}

/// Predicted ranges and cosines of incidence.
pub(super) type View = [Vec<f32>; 2];

impl FrameEvidence {
    /// For the frames of a sensor.
    ///
    /// # Errors
    /// Those of [`PoseLikelihood::of_image`].
    pub fn new(pixels: PoseLikelihood, frame: &Frame) -> Self {
        Self { pixels, noise: RangeNoise::of(frame.sensor()) }
    }

    /// How the pixels are chosen.
    pub fn pixels(&self) -> &PoseLikelihood {
        &self.pixels
    }

    /// What the pixels should measure at poses of the robot.
    ///
    /// # Errors
    /// Those of [`Predictor::range_views`].
    pub fn views(&self, predictor: &mut Predictor, world: &World, robot: &[Pose]) -> Result<Vec<View>> {
        let poses = self.pixels.of_sensor(robot.iter().copied());
        predictor.range_views(world, self.pixels.scanner(), &poses)
    }

    /// Log-odds of readings in views, with surfaces that are off by one of these deviations or the other, metres.
    pub fn of_views(&self, map: &MapRanges, readings: &[f32], views: &[View], sigmas: [f64; 2]) -> Vec<f64> {
        views.iter().map(|view| self.of_readings(map, readings, view, sigmas).sum()).collect()
    }

    /// Log-odds of each reading in a view.
    pub fn of_readings<'a>(
        &'a self,
        map: &'a MapRanges,
        readings: &'a [f32],
        view: &'a View,
        sigmas: [f64; 2],
    ) -> impl Iterator<Item = f64> + 'a {
        let one = move |((z, r), c): ((&f32, &f32), &f32)| {
            let (z, r, c) = (f64::from(*z), f64::from(*r), f64::from(c.abs()).max(FLATTEST));
            let along = self.noise.range_sigma(if r.is_finite() { r } else { 0.0 });
            let across = r * self.noise.angle;
            let per_cos = 1.0 / (c * c);
            let own = along * along + across * across * (per_cos - 1.0);
            map.log_odds(z, r, sigmas.map(|sigma| own + sigma * sigma * per_cos))
        };
        readings.iter().zip(&view[0]).zip(&view[1]).map(one)
    }
}

impl FrameEvidence {
    /// Log-odds of some beams at headings of places, place by place, from views all round that begin behind heading 0. The
    /// counts of beams, headings and bins of ranges are `by`; surfaces are off by `sigma`, metres.
    pub fn of_headings(
        &self,
        map: &MapRanges,
        readings: &[f32],
        round: &[View],
        sigma: f64,
        by: (usize, usize, usize),
    ) -> Vec<f64> {
        let (beams, headings, bins) = by;
        let scanner = self.pixels.scanner();
        let reach = scanner.spec().range_max;
        let (width, step) = (round.first().map_or(1, |view| view[0].len()), reach / bins as f64);
        let told = |z: f32| !z.is_nan() && z != f32::NEG_INFINITY;
        let every = readings.len().div_ceil(beams).max(1);
        let seen: Vec<usize> = (0..readings.len()).step_by(every).filter(|k| told(readings[*k])).collect();
        let column = |k: &usize| {
            let ray = scanner.ray(*k as u32, 0)?;
            let turn = (ray.y.atan2(ray.x) / std::f64::consts::TAU + 0.5).rem_euclid(1.0);
            Some((turn * width as f64).round() as usize % width)
        };
        // By range: the last bin is that of no range.
        let of_range = |k: &usize, bin: usize| {
            let r = if bin < bins { (bin as f64 + 0.5) * step } else { f64::INFINITY };
            let turned = if r.is_finite() { r * std::f64::consts::TAU / headings as f64 } else { 0.0 };
            let variance = sigma * sigma + (turned * turned + step * step) / 12.0;
            map.log_odds(f64::from(readings[*k]), r, [variance; 2]) as f32
        };
        let table: Vec<f32> = seen.iter().flat_map(|k| (0..=bins).map(move |bin| of_range(k, bin))).collect();
        let columns: Vec<usize> = seen.iter().map(|k| column(k).unwrap_or(0)).collect();
        let bin = |r: &f32| if r.is_finite() { ((f64::from(*r) / step) as usize).min(bins - 1) } else { bins };
        let weigh = |view: &View| {
            // Twice round, so that no heading goes beyond the end.
            let view: Vec<usize> = view[0].iter().chain(&view[0]).map(bin).collect();
            let of = |heading: usize| {
                let turned = heading * width / headings;
                let looked_up = columns.iter().enumerate().map(|(k, c)| table[k * (bins + 1) + view[c + turned]]);
                f64::from(looked_up.sum::<f32>())
            };
            (0..headings).map(of).collect::<Vec<f64>>()
        };
        round.iter().flat_map(weigh).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ranges that are spread evenly over 10 m have a density of 0.1 / m. At a wall 4 m ahead with s = 6 cm a reading of
    /// 4 m has a density of 1 / (0.06 sqrt(2 pi)) = 6.649 / m, so the odds are .1 + .6 x 66.49 + .1 / .6; one of 2 m is
    /// before it (.1 + .2 / .4), one of 8 m behind it (.1 + .1 / .6).
    #[test]
    fn a_reading_has_the_odds_that_are_worked_out_by_hand() {
        let map = MapRanges::new((0..100_000).map(|i| (i as f32 + 0.5) * 1e-4), 10.0);
        for (z, odds) in [(4.0, 0.1 + 0.6 * 66.49 + 0.1 / 0.6), (2.0, 0.1 + 0.2 / 0.4), (8.0, 0.1 + 0.1 / 0.6)] {
            let found = map.log_odds(z, 4.0, [0.06 * 0.06; 2]);
            assert!((found - f64::ln(odds)).abs() < 0.02, "{z} m: {found} instead of {}", f64::ln(odds));
        }
        for nothing in [f64::NAN, f64::NEG_INFINITY] {
            assert_eq!(map.log_odds(nothing, 4.0, [0.01; 2]), 0.0);
            assert_eq!(map.log_odds(4.0, nothing, [0.01; 2]), 0.0);
        }
    }

    /// Whatever is predicted: over the ranges of the map's own places the odds are 1 in the mean.
    #[test]
    fn nowhere_in_particular_is_the_level_of_nothing() {
        let places = || (0..20_000).map(|i| 2.0 + 3.0 * ((i as f32 * 0.618_034).fract()).powi(2));
        let map = MapRanges::new(places(), 10.0);
        for predicted in [2.5, 3.3, 4.5] {
            let sum: f64 = places().map(|z| map.log_odds(f64::from(z), predicted, [0.01; 2]).exp()).sum();
            assert!((sum / 20_000.0 - 1.0).abs() < 0.06, "{predicted} m: {}", sum / 20_000.0);
        }
    }
}
