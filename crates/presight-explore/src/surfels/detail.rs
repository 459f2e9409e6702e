//! The size of the smallest pieces of surface that measurements distinguish: by the noise of the ranges, the distance of neighbouring
//! points, and how often a place was seen.

use crate::evidence::Margins;
use crate::observe::{View, Views, oriented};
use glam::{DVec3, Vec3};
use presight_model::statistics::{median, tail};
use std::collections::HashMap;

/// Side of the smallest pieces by default, metres.
pub(crate) const SMALLEST: f64 = 0.02;
/// The largest, metres.
const LARGEST: f64 = 1.0;
/// Views that the noise is estimated from.
const VIEWS: usize = 16;
/// Share of the cells of a surface that may be missed by chance: each is a hole.
const MISSED: f64 = 1e-4;
/// Normal deviate of what surfels may be off by: one in a hundred is off by more.
const DEVIATE: f64 = 2.58;
/// Pixels in a cube: it stays empty with a chance of e^-4, 2 %.
const FILLED: f64 = 4.0;
/// Errors of normals that planes bear, radians: 25 degrees.
const TILT: f64 = 0.44;
/// Pixels from which the noise of a range is estimated.
const LEAST_PIXELS: usize = 200;
/// Steps of ranges, per doubling.
const STEPS: f64 = 2.0;

/// While a region grows: largest distance of a surfel from the plane, in sizes of the surfel.
pub(crate) const NEAR: f64 = 0.25;

/// Sides of the smallest pieces of surface.
#[derive(Clone, Debug)]
pub(crate) struct Detail {
    /// At the best ranges, metres.
    pub least: f64,
    /// Standard deviations of the smallest pieces and of their ranges.
    pub noise: Noise,
    /// By range, rising.
    by_range: Vec<Reach>,
    /// True if the side is given, and grows with the distance of pixels alone.
    is_given: bool,
}

/// Standard deviations that the ranges show, metres. What a sensor states may be more than it has.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Noise {
    /// That of a range, the median over the pixels.
    pub range: f64,
    /// That of the place of a piece of surface, the mean of its pixels.
    pub place: f64,
}

/// Ranges up to `far`, metres: the side that their noise asks for.
#[derive(Clone, Copy, Debug)]
struct Reach {
    far: f64,
    side: f64,
    noise: Noise,
    /// Number of ranges that say so.
    pixels: usize,
}

impl Detail {
    /// Side of the pieces that the views distinguish, or the given side, metres.
    pub fn of(views: &Views, given: Option<f64>) -> Self {
        let sample = views.some(VIEWS);
        let mut spread: HashMap<i32, Vec<f64>> = HashMap::new();
        let mut footprints = Footprints::default();
        for view in sample.all() {
            let apart = apart(view);
            for pixel in view.inner_pixels() {
                let range = f64::from(view.ranges[pixel]);
                // Steps are not noise, and most residuals of a rough place are steps.
                if let Some(off) = off_line(view, [pixel - 1, pixel, pixel + 1]).filter(|off| *off < 0.1 * range) {
                    spread.entry((STEPS * range.log2()).floor() as i32).or_default().push(off);
                }
                footprints.add(view, pixel, apart);
            }
        }
        let seen = footprints.views() * views.all().len() as f64 / sample.all().len().max(1) as f64;
        let none =
            Self { least: given.unwrap_or(SMALLEST), noise: Noise::default(), by_range: Vec::new(), is_given: true };
        let Some(first) = sample.all().first() else { return none };
        let (stated, apart) = (first.sensor().spec().noise, apart(first));
        let mut bins: Vec<i32> = spread.keys().copied().collect();
        bins.sort_unstable();
        let mut by_range = Vec::new();
        for bin in bins {
            let off = spread.entry(bin).or_default();
            if off.len() < LEAST_PIXELS {
                continue;
            }
            let far = (f64::from(bin + 1) / STEPS).exp2();
            // The second difference of three independent ranges, the outer two at half weight; the median of its absolute
            // values is 0.6745 standard deviations.
            let estimated = median(off).unwrap_or(0.0) / 0.6745 / 1.5f64.sqrt();
            let sigma = estimated.max(stated.range_sigma + stated.range_sigma_quadratic * far * far);
            let (apart, seen) = (apart.map(|a| a * far), seen.max(1.0));
            let side = given.unwrap_or_else(|| side(sigma, apart, seen));
            let noise = Noise { range: estimated, place: of_mean(estimated, side, apart, seen) };
            by_range.push(Reach { far, side, noise, pixels: off.len() });
        }
        if by_range.is_empty() {
            return none;
        }
        let least = by_range.iter().map(|reach| reach.side).fold(LARGEST, f64::min);
        let noise = usual(by_range.iter().filter(|reach| reach.side == least));
        Self { least, noise, by_range, is_given: given.is_some() }
    }

    /// False if the noise leaves no piece of surface: leaves and dust.
    pub fn serves(&self) -> bool {
        self.least < LARGEST
    }

    fn at(&self, range: f64) -> Option<&Reach> {
        self.by_range.iter().find(|reach| range <= reach.far).or(self.by_range.last())
    }

    /// How often the least side is doubled at a range where neighbouring pixels are this far apart, metres.
    pub fn level(&self, range: f64, apart: f64) -> u8 {
        let known = self.at(range).filter(|_| !self.is_given);
        let side = known.map_or(self.least, |reach| reach.side).max(0.5 * apart);
        // Not one more because of rounding.
        (side / self.least - 1e-9).log2().ceil().clamp(0.0, 12.0) as u8
    }
}

/// The smallest side that serves for ranges with this noise, pixels this far apart across and along, and places that are seen in so
/// many views, metres.
fn side(sigma: f64, apart: [f64; 2], views: f64) -> f64 {
    let [across, along] = apart;
    let serves = |side: f64| {
        let pixels = views * side * side / (across * along);
        let sigma_of_mean = of_mean(sigma, side, apart, views);
        // Normals come from pixels two apart.
        let tilt = sigma_of_mean / (std::f64::consts::SQRT_2 * across.min(along));
        pixels >= FILLED
            && missed(sigma, side, views) < MISSED
            && DEVIATE * sigma_of_mean < NEAR * side
            && DEVIATE * tilt < TILT
    };
    let steps = (0..).map(|k| SMALLEST * (0.25 * f64::from(k)).exp2()).take_while(|side| *side < LARGEST);
    steps.into_iter().find(|side| serves(*side)).unwrap_or(LARGEST)
}

/// Standard deviation of the mean of the pixels in a cube of this side, metres.
fn of_mean(sigma: f64, side: f64, [across, along]: [f64; 2], views: f64) -> f64 {
    sigma / (views * side * side / (across * along)).max(1.0).sqrt()
}

/// The median over the pixels.
fn usual<'a>(reaches: impl Iterator<Item = &'a Reach>) -> Noise {
    let mut sorted: Vec<&Reach> = reaches.collect();
    sorted.sort_by(|a, b| a.noise.range.total_cmp(&b.noise.range));
    let mut left = sorted.iter().map(|reach| reach.pixels).sum::<usize>() / 2;
    let middle = sorted.iter().find(|reach| {
        let is_in = left < reach.pixels;
        left = left.saturating_sub(reach.pixels);
        is_in
    });
    middle.map_or(Noise::default(), |reach| reach.noise)
}

/// Share of the cells of a surface at which passes outweigh hits, or at which too few rays end.
fn missed(sigma: f64, side: f64, views: f64) -> f64 {
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
fn apart(view: &View) -> [f64; 2] {
    let middle = view.height() / 2 * view.width() + view.width() / 2;
    let along = view.in_body(middle).distance(view.in_body(middle.saturating_sub(view.width())));
    [view.pitch(), if along > 0.0 && along < 1.0 { along } else { view.pitch() }]
}

/// How far the middle one of three points is from the line through the others, along its ray, metres. On a plane the inverse of the
/// range is a linear function of the ray, whatever the angles between the rays.
fn off_line(view: &View, pixels: [usize; 3]) -> Option<f64> {
    let ranges = pixels.map(|i| f64::from(view.ranges[i]));
    let [p, q, r] = pixels.map(|i| view.ray_in_image(i));
    let (pr, pq, qr) = (p.dot(r), p.dot(q), q.dot(r));
    let rest = 1.0 - pr * pr;
    let inverse = (pq - pr * qr) / rest / ranges[0] + (qr - pr * pq) / rest / ranges[2];
    let off = (ranges[1] - 1.0 / inverse).abs();
    off.is_finite().then_some(off)
}

/// Areas that pixels cover, by cubes.
#[derive(Default)]
struct Footprints {
    /// Side of a cube, metres: eight pixels at the first range.
    cube: f64,
    /// Area and pixels.
    areas: HashMap<[i32; 3], (f64, u32)>,
}

impl Footprints {
    fn add(&mut self, view: &View, pixel: usize, [across, along]: [f64; 2]) {
        let Some((p, _, cosine)): Option<(Vec3, Vec3, f32)> = oriented(view, pixel) else { return };
        let range = f64::from(view.ranges[pixel]);
        if self.cube == 0.0 {
            self.cube = (8.0 * range * across.max(along)).max(0.1);
        }
        let at: DVec3 = view.origin() + view.turned(p);
        let cube = (at / self.cube).floor().to_array().map(|c| c as i32);
        let (area, pixels) = self.areas.entry(cube).or_default();
        *area += range * range * across * along / f64::from(cosine);
        *pixels += 1;
    }

    /// In how many views a pixel's place is seen: the median. A surface through a cube has about the area of one of its sides.
    fn views(&self) -> f64 {
        let mut cubes: Vec<(f64, u32)> = self.areas.values().copied().collect();
        cubes.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = cubes.iter().map(|(_, pixels)| *pixels).sum::<u32>() / 2;
        let mut sum = 0;
        let middle = cubes.iter().find(|(_, pixels)| {
            sum += pixels;
            sum >= half
        });
        middle.map_or(1.0, |(area, _)| area / (self.cube * self.cube))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: one view misses a cell if a ray is off by more than a quarter of the side, 3.89 standard deviations for 1 in 10,000:
    /// sides of 15.6 of them at least, in steps of a fourth of a doubling. Many views bear more, down to what fills the cubes.
    #[test]
    fn more_noise_asks_for_larger_pieces_and_more_views_for_smaller_ones() {
        let one = side(0.01, [0.005; 2], 1.0);
        assert!((0.1556..0.1556 * 1.2).contains(&one), "{one}");
        let many = side(0.01, [0.005; 2], 50.0);
        assert!(many < 0.5 * one && many >= SMALLEST, "{many}");
        assert_eq!(side(0.001, [0.005; 2], 4.0), SMALLEST);
        // Two pixels a side: four fill a cube.
        assert!((side(0.0, [0.05; 2], 1.0) / 0.1 - 1.0).abs() < 0.2);
        assert_eq!(side(10.0, [0.005; 2], 1.0), LARGEST);
    }
}
