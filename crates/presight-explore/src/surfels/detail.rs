//! The size of the smallest surfels that the measurements support, from the noise of the ranges, the spacing of points
//! and the number of views.

use super::surfel::NEAR;
use crate::evidence::Margins;
use crate::observe::{View, Views, oriented};
use glam::{DVec3, Vec3};
use presight_model::statistics::{median, tail};
use std::collections::HashMap;

/// Minimum size of a surfel, metres, and its size without measurements.
pub(crate) const MIN_SIZE: f64 = 0.02;
/// Maximum size of a surfel, metres.
const MAX_SIZE: f64 = 1.0;
/// Share of the cells of a surface that may be missed by chance. Each is a hole.
const MISS_RATE: f64 = 1e-4;
/// Normal deviate of the admissible error of a surfel, which one in a hundred exceeds.
const DEVIATE: f64 = 2.58;
/// Mean number of pixels in a cube. It stays empty with a probability of e^-4, 2 %.
const FILLED: f64 = 4.0;
/// Admissible error of a normal, radians: 25 degrees, the limit of normals on one plane.
const TILT: f64 = 0.44;
/// Minimum number of pixels for an estimate of the noise, whose standard error is then about 8 %.
const MIN_PIXELS: usize = 200;
/// Number of range bins per doubling.
const STEPS: f64 = 2.0;

/// Sizes of the smallest surfels, by range.
#[derive(Clone, Debug)]
pub(crate) struct Detail {
    /// Size at the best ranges, metres.
    pub min_size: f64,
    /// Noise of the smallest surfels.
    pub noise: Noise,
    /// Sizes by range, ascending.
    by_range: Vec<Reach>,
    /// True if the user gave the size, which then grows with the spacing of pixels alone.
    is_given: bool,
}

/// Measured standard deviations, metres. The stated noise of a sensor may exceed them.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Noise {
    /// Standard deviation of a range, the median over the pixels.
    pub range: f64,
    /// Standard deviation of the position of a surfel, the mean of its pixels.
    pub place: f64,
}

/// A range bin and the size of surfel that its noise requires.
#[derive(Clone, Copy, Debug)]
struct Reach {
    /// Upper end of the bin, metres.
    far: f64,
    /// Size of surfels, metres.
    side: f64,
    noise: Noise,
    /// Number of pixels in the estimate.
    pixels: usize,
}

impl Detail {
    /// The sizes that the views support, or the given size, metres.
    pub fn of(views: &Views, given: Option<f64>) -> Self {
        let sample = views.sample();
        let mut spread: HashMap<i32, Vec<f64>> = HashMap::new();
        let mut footprints = Footprints::default();
        for view in sample.all() {
            let pitches = pitches(view);
            for pixel in view.inner_pixels() {
                let range = f64::from(view.ranges[pixel]);
                // Residuals above a tenth of the range are steps, not noise.
                if let Some(off) = off_line(view, [pixel - 1, pixel, pixel + 1]).filter(|off| *off < 0.1 * range) {
                    spread.entry((STEPS * range.log2()).floor() as i32).or_default().push(off);
                }
                footprints.add(view, pixel, pitches);
            }
        }
        let seen = footprints.views() * views.all().len() as f64 / sample.all().len().max(1) as f64;
        let none =
            Self { min_size: given.unwrap_or(MIN_SIZE), noise: Noise::default(), by_range: Vec::new(), is_given: true };
        let Some(first) = sample.all().first() else { return none };
        let (stated, pitches) = (first.sensor().spec().noise, pitches(first));
        let mut bins: Vec<i32> = spread.keys().copied().collect();
        bins.sort_unstable();
        let mut by_range = Vec::new();
        for bin in bins {
            let off = spread.entry(bin).or_default();
            if off.len() < MIN_PIXELS {
                continue;
            }
            let far = (f64::from(bin + 1) / STEPS).exp2();
            // The residual is a range minus the mean of two others, with 1.5 times the variance of a range. The median
            // of its absolute value is 0.6745 standard deviations.
            let estimated = median(off).unwrap_or(0.0) / 0.6745 / 1.5f64.sqrt();
            let sigma = estimated.max(stated.range_sigma + stated.range_sigma_quadratic * far * far);
            let (spacing, seen) = (pitches.map(|a| a * far), seen.max(1.0));
            let side = given.unwrap_or_else(|| side(sigma, spacing, seen));
            let noise = Noise { range: estimated, place: of_mean(estimated, side, spacing, seen) };
            by_range.push(Reach { far, side, noise, pixels: off.len() });
        }
        if by_range.is_empty() {
            return none;
        }
        let min_size = by_range.iter().map(|reach| reach.side).fold(MAX_SIZE, f64::min);
        let best = by_range.iter().filter(|reach| reach.side == min_size);
        let median = weighted_median(best, |reach| reach.noise.range, |reach| reach.pixels);
        let noise = median.map_or(Noise::default(), |reach| reach.noise);
        Self { min_size, noise, by_range, is_given: given.is_some() }
    }

    /// False if no size of surfel suffices for the noise, as with foliage and dust.
    pub fn is_resolved(&self) -> bool {
        self.min_size < MAX_SIZE
    }

    fn at(&self, range: f64) -> Option<&Reach> {
        self.by_range.iter().find(|reach| range <= reach.far).or(self.by_range.last())
    }

    /// Number of doublings of the minimum size at a range with this spacing of pixels, metres.
    pub fn level(&self, range: f64, spacing: f64) -> u8 {
        let known = self.at(range).filter(|_| !self.is_given);
        let side = known.map_or(self.min_size, |reach| reach.side).max(0.5 * spacing);
        // The small offset keeps rounding errors from adding a level.
        (side / self.min_size - 1e-9).log2().ceil().clamp(0.0, 12.0) as u8
    }
}

/// The smallest sufficient size for ranges with the standard deviation `sigma`, pixels with this spacing across and
/// along, and points that appear in this many views, metres.
fn side(sigma: f64, spacing: [f64; 2], views: f64) -> f64 {
    let [across, along] = spacing;
    let suffices = |side: f64| {
        let pixels = views * side * side / (across * along);
        let sigma_of_mean = of_mean(sigma, side, spacing, views);
        // Normals come from pixels at twice the spacing.
        let tilt = sigma_of_mean / (std::f64::consts::SQRT_2 * across.min(along));
        pixels >= FILLED
            && miss_rate(sigma, side, views) < MISS_RATE
            && DEVIATE * sigma_of_mean < NEAR * side
            && DEVIATE * tilt < TILT
    };
    let steps = (0..).map(|k| MIN_SIZE * (0.25 * f64::from(k)).exp2()).take_while(|side| *side < MAX_SIZE);
    steps.into_iter().find(|side| suffices(*side)).unwrap_or(MAX_SIZE)
}

/// Standard deviation of the mean of the pixels in a cube of the given size, metres.
fn of_mean(sigma: f64, side: f64, [across, along]: [f64; 2], views: f64) -> f64 {
    sigma / (views * side * side / (across * along)).max(1.0).sqrt()
}

/// The item at the median of the weights, in the order of the keys.
fn weighted_median<T: Copy>(items: impl Iterator<Item = T>, key: fn(&T) -> f64, weight: fn(&T) -> usize) -> Option<T> {
    let mut sorted: Vec<T> = items.collect();
    sorted.sort_by(|a, b| key(a).total_cmp(&key(b)));
    let half = sorted.iter().map(weight).sum::<usize>() / 2;
    let mut sum = 0;
    sorted.into_iter().find(|item| {
        sum += weight(item);
        sum > half
    })
}

/// Share of the cells of a surface at which passes outweigh hits or too few rays end.
fn miss_rate(sigma: f64, side: f64, views: f64) -> f64 {
    if sigma == 0.0 {
        return 0.0;
    }
    let margins = Margins::of_cell(0.5 * side);
    let hit = 1.0 - 2.0 * tail(f64::from(margins.hit) / sigma);
    let pass = tail(f64::from(margins.pass) / sigma);
    if views < 2.0 {
        return 1.0 - hit;
    }
    let fewer_than_two = (1.0 - hit).powf(views) + views * hit * (1.0 - hit).powf(views - 1.0);
    let mean = hit - pass;
    let deviation = (hit + pass - mean * mean).max(1e-12).sqrt();
    fewer_than_two.max(tail(mean * views.sqrt() / deviation))
}

/// Angles between neighbouring rays across and along, radians.
fn pitches(view: &View) -> [f64; 2] {
    let middle = view.height() / 2 * view.width() + view.width() / 2;
    let along = view.in_body(middle).distance(view.in_body(middle.saturating_sub(view.width())));
    [view.pitch(), if along > 0.0 && along < 1.0 { along } else { view.pitch() }]
}

/// Distance of the middle one of three points from the line through the others, along its ray, metres. On a plane the
/// inverse of the range is a linear function of the ray, whatever the angles between the rays.
fn off_line(view: &View, pixels: [usize; 3]) -> Option<f64> {
    let ranges = pixels.map(|i| f64::from(view.ranges[i]));
    let [p, q, r] = pixels.map(|i| view.unit_ray(i).as_dvec3());
    let (pr, pq, qr) = (p.dot(r), p.dot(q), q.dot(r));
    let rest = 1.0 - pr * pr;
    let inverse = (pq - pr * qr) / rest / ranges[0] + (qr - pr * pq) / rest / ranges[2];
    let off = (ranges[1] - 1.0 / inverse).abs();
    off.is_finite().then_some(off)
}

/// Area that the pixels cover in each cube of space.
#[derive(Default)]
struct Footprints {
    /// Side of a cube, metres: eight pixels at the first range.
    cube: f64,
    /// By cube: area in square metres, and number of pixels.
    areas: HashMap<[i32; 3], (f64, u32)>,
}

impl Footprints {
    fn add(&mut self, view: &View, pixel: usize, [across, along]: [f64; 2]) {
        let Some((p, _, cosine)): Option<(Vec3, Vec3, f32)> = oriented(view, pixel) else { return };
        let range = f64::from(view.ranges[pixel]);
        if self.cube == 0.0 {
            self.cube = (8.0 * range * across.max(along)).max(0.1);
        }
        let at: DVec3 = view.origin() + view.direction_to_world(p);
        let cube = (at / self.cube).floor().to_array().map(|c| c as i32);
        let (area, pixels) = self.areas.entry(cube).or_default();
        *area += range * range * across * along / f64::from(cosine);
        *pixels += 1;
    }

    /// The median number of views of a pixel's point. The surface in a cube has about the area of one side of the cube.
    fn views(&self) -> f64 {
        let median = weighted_median(self.areas.values().copied(), |(area, _)| *area, |(_, pixels)| *pixels as usize);
        median.map_or(1.0, |(area, _)| area / (self.cube * self.cube))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One view misses a cell if a ray is off by more than a quarter of the size: 3.89 standard deviations for 1 in
    /// 10,000, so the size is at least 15.6 of them, in steps of a fourth of a doubling. Many views allow smaller
    /// sizes, until the cubes are no longer filled.
    #[test]
    fn more_noise_asks_for_larger_pieces_and_more_views_for_smaller_ones() {
        let one = side(0.01, [0.005; 2], 1.0);
        assert!((0.1556..0.1556 * 1.2).contains(&one), "{one}");
        let many = side(0.01, [0.005; 2], 50.0);
        assert!(many < 0.5 * one && many >= MIN_SIZE, "{many}");
        assert_eq!(side(0.001, [0.005; 2], 4.0), MIN_SIZE);
        // Two pixels along each side: four fill a cube.
        assert!((side(0.0, [0.05; 2], 1.0) / 0.1 - 1.0).abs() < 0.2);
        assert_eq!(side(10.0, [0.005; 2], 1.0), MAX_SIZE);
    }
}
