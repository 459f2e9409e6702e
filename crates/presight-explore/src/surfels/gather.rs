//! Surfels of views: means of the pixels of all views in small cubes.

use super::detail::Detail;
use super::surfel::Surfel;
use crate::evidence::{Margins, evidence_at};
use crate::observe::{View, Views, oriented};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;

/// Number of views that one task reduces. It is fixed, so that the sums have the same bits with any number of threads.
const BATCH: usize = 16;
/// Number of views for each pixel that a cube must hold; four pixels suffice in any case.
const VIEWS_FOR_ONE: u32 = 25;
/// Maximum number of views that test whether a surfel is permanent.
const MAX_VIEWS: usize = 32;
#[derive(Clone, Copy, Default)]
struct Sum {
    at: DVec3,
    normal: DVec3,
    weight: f64,
    count: u32,
}

impl Sum {
    fn add(&mut self, other: &Self) {
        self.at += other.at;
        self.normal += other.normal;
        self.weight += other.weight;
        self.count += other.count;
    }
}

/// Index of a cube; direction and size level in one number.
type Key = ([i32; 3], u8);

/// The surfels of views, in a fixed order. `detail` sets the sizes of the cubes. `is_used` selects pixels by the
/// indices of view and pixel.
pub(crate) fn surfels(views: &Views, detail: &Detail, is_used: impl Fn(usize, usize) -> bool + Sync) -> Vec<Surfel> {
    let mut sums: HashMap<Key, Sum> = HashMap::new();
    let numbered: Vec<(usize, &View)> = views.all().iter().enumerate().collect();
    for wave in numbered.chunks(BATCH * 8) {
        let parts: Vec<HashMap<Key, Sum>> =
            wave.par_chunks(BATCH).map(|part| part_of(part, detail, &is_used)).collect();
        for (key, sum) in parts.iter().flatten() {
            sums.entry(*key).or_default().add(sum);
        }
    }
    // A pixel or two of many views are noise, or a passer-by.
    let enough = (views.all().len() as u32 / VIEWS_FOR_ONE).clamp(1, 4);
    let mut kept: Vec<(Key, Sum)> = sums.into_iter().filter(|(_, sum)| sum.count >= enough).collect();
    kept.sort_by_key(|(key, _)| *key);
    let surfel = |(key, sum): &(Key, Sum)| Surfel {
        at: sum.at / sum.weight,
        normal: sum.normal.normalize_or(DVec3::Z),
        weight: sum.weight,
        size: detail.min_size * f64::from(1u32 << (key.1 / 6)),
    };
    kept.iter().map(surfel).collect()
}

/// The surfels that rays did not pass through. Passers-by leave many others, which would use up planes.
pub(crate) fn permanent(views: &Views, surfels: Vec<Surfel>) -> Vec<Surfel> {
    let seen = views.some(MAX_VIEWS);
    // The margins of a cell of an outline.
    let margins = |s: &Surfel| Margins::of_cell(0.5 * s.size);
    let is_passed = |s: &Surfel| {
        let seen = evidence_at(&seen, s.at, s.normal, margins(s));
        seen.passes > 0 && seen.value() <= 0.0
    };
    surfels.into_par_iter().filter(|s| !is_passed(s)).collect()
}

fn part_of(part: &[(usize, &View)], detail: &Detail, is_used: &impl Fn(usize, usize) -> bool) -> HashMap<Key, Sum> {
    let mut sums: HashMap<Key, Sum> = HashMap::new();
    for (number, view) in part {
        let (width, height) = (view.width(), view.height());
        for row in 1..height.saturating_sub(1) {
            for pixel in row * width + 1..(row + 1) * width - 1 {
                let Some((p, n, cosine)) = oriented(view, pixel).filter(|_| is_used(*number, pixel)) else {
                    continue;
                };
                let (at, normal) = (view.origin() + view.direction_to_world(p), view.direction_to_world(n));
                let range = f64::from(view.ranges[pixel]);
                let level = detail.level(range, range * view.pitch());
                let size = detail.min_size * f64::from(1u32 << level);
                let cube = (at / size).floor().to_array().map(|c| c as i32);
                let weight = f64::from(cosine * cosine) / range;
                let sum = Sum { at: at * weight, normal: normal * weight, weight, count: 1 };
                sums.entry((cube, level * 6 + direction(normal))).or_default().add(&sum);
            }
        }
    }
    sums
}

/// The signed axis nearest to a normal: 0 to 5.
fn direction(normal: DVec3) -> u8 {
    let a = normal.abs();
    let axis = if a.x >= a.y && a.x >= a.z {
        0
    } else if a.y >= a.z {
        1
    } else {
        2
    };
    2 * axis as u8 + u8::from(normal[axis] > 0.0)
}
