//! Surfels: points of surfaces with normals, averaged over the pixels of all views that fall into one small cube.

use crate::detail::Detail;
use crate::evidence::{Margins, evidence_at};
use crate::view::{View, Views};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use rstar::RTree;
use rstar::primitives::GeomWithData;
use std::collections::HashMap;

/// Largest second difference of 1 / range between neighbouring pixels, 1 / m. On a plane 1 / range is linear, so that
/// larger ones are steps. The disparity of depth cameras is noisy by less.
const STEP: f32 = 0.02;
/// Least cosine of incidence: normals and distances of flatter rays are of little worth.
pub(crate) const LEAST_COSINE: f32 = 0.1;
/// Views that are reduced together. Fixed, so that sums have the same bits with any number of threads.
const TOGETHER: usize = 16;
/// A cube must hold one pixel for each 25 views, at most four.
const VIEWS_FOR_ONE: u32 = 25;
/// Views, evenly taken, that say whether a surfel lasts.
const MOST_VIEWS: usize = 32;
/// Radius of a neighbourhood, in sizes.
const REACH: f64 = 1.8;
/// Least cosine between the normals of neighbours.
const LEAST_ALIKE: f64 = 0.6;

/// A small piece of a surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surfel {
    /// Relative to the base of the views, metres.
    pub at: DVec3,
    /// Unit, towards the sensor.
    pub normal: DVec3,
    /// Sum of the weights of its pixels.
    pub weight: f64,
    /// Side of its cube, metres.
    pub size: f64,
}

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

/// Cube, and direction and level of size in one number.
type Key = ([i32; 3], u8);

/// The surfels of views, in a fixed order. `detail` says how large the cubes are. `is_used` says which pixels count.
pub(crate) fn surfels(views: &Views, detail: &Detail, is_used: impl Fn(usize, usize) -> bool + Sync) -> Vec<Surfel> {
    let mut sums: HashMap<Key, Sum> = HashMap::new();
    let numbered: Vec<(usize, &View)> = views.all().iter().enumerate().collect();
    for wave in numbered.chunks(TOGETHER * 8) {
        let parts: Vec<HashMap<Key, Sum>> =
            wave.par_chunks(TOGETHER).map(|part| part_of(part, detail, &is_used)).collect();
        for (key, sum) in parts.iter().flatten() {
            sums.entry(*key).or_default().add(sum);
        }
    }
    // What a pixel or two of many views show is noise, or somebody who walked by.
    let enough = (views.all().len() as u32 / VIEWS_FOR_ONE).clamp(1, 4);
    let mut kept: Vec<(Key, Sum)> = sums.into_iter().filter(|(_, sum)| sum.count >= enough).collect();
    kept.sort_by_key(|(key, _)| *key);
    let surfel = |(key, sum): &(Key, Sum)| Surfel {
        at: sum.at / sum.weight,
        normal: sum.normal.normalize_or(DVec3::Z),
        weight: sum.weight,
        size: detail.least * f64::from(1u32 << (key.1 / 6)),
    };
    kept.iter().map(surfel).collect()
}

/// The surfels that rays did not go through. Who walks by leaves many, which would take planes from what stays.
pub(crate) fn lasting(views: &Views, surfels: Vec<Surfel>) -> Vec<Surfel> {
    let seen = views.some(MOST_VIEWS);
    // As a cell of an outline.
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
                let (at, normal) = (view.origin() + view.turned(p), view.turned(n));
                let range = f64::from(view.ranges[pixel]);
                let level = detail.level(range, range * view.pitch());
                let size = detail.least * f64::from(1u32 << level);
                let cube = (at / size).floor().to_array().map(|c| c as i32);
                let weight = f64::from(cosine * cosine) / range;
                let sum = Sum { at: at * weight, normal: normal * weight, weight, count: 1 };
                sums.entry((cube, level * 6 + direction(normal))).or_default().add(&sum);
            }
        }
    }
    sums
}

/// The axis that a normal is nearest to, with its sign: 0 to 5.
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

/// Point, unit normal towards the sensor and cosine of incidence of a pixel, in the image frame. `None` at steps.
pub(crate) fn oriented(view: &View, pixel: usize) -> Option<(Vec3, Vec3, f32)> {
    let width = view.width();
    let [left, right, above, below] = [pixel - 1, pixel + 1, pixel - width, pixel + width];
    let inverse = |i: usize| 1.0 / view.ranges[i];
    let here = 2.0 * inverse(pixel);
    let is_flat = |a: usize, b: usize| (inverse(a) + inverse(b) - here).abs() < STEP;
    // False where a range is NaN.
    if !(is_flat(left, right) && is_flat(above, below)) {
        return None;
    }
    let across = view.in_image(right) - view.in_image(left);
    let down = view.in_image(below) - view.in_image(above);
    let normal = down.cross(across).try_normalize()?;
    let p = view.in_image(pixel);
    let cosine = normal.dot(p) / p.length();
    let normal = if cosine > 0.0 { -normal } else { normal };
    (cosine.abs() > LEAST_COSINE).then_some((p, normal, cosine.abs()))
}

/// Surfels with their neighbours.
pub(crate) struct Surface {
    pub surfels: Vec<Surfel>,
    /// Where the neighbours of each surfel start in `neighbours`; one more than there are surfels.
    first: Vec<u32>,
    neighbours: Vec<u32>,
    tree: RTree<GeomWithData<[f64; 3], u32>>,
}

impl Surface {
    pub fn new(surfels: Vec<Surfel>) -> Self {
        let points = surfels.iter().zip(0..).map(|(s, i)| GeomWithData::new(s.at.to_array(), i)).collect();
        let tree = RTree::bulk_load(points);
        let lists = surfels.par_iter().map(|s| beside(&tree, &surfels, s)).collect();
        Self::of(surfels, tree, lists)
    }

    /// Surfels whose neighbours are known.
    pub fn with_neighbours(surfels: Vec<Surfel>, lists: Vec<Vec<u32>>) -> Self {
        Self::of(surfels, RTree::new(), lists)
    }

    fn of(surfels: Vec<Surfel>, tree: RTree<GeomWithData<[f64; 3], u32>>, lists: Vec<Vec<u32>>) -> Self {
        let mut first = vec![0];
        first.extend(lists.iter().scan(0, |sum, list| {
            *sum += list.len() as u32;
            Some(*sum)
        }));
        Self { surfels, first, neighbours: lists.concat(), tree }
    }

    /// Numbers of the surfels around a surfel, itself among them.
    pub fn neighbours(&self, surfel: usize) -> &[u32] {
        &self.neighbours[self.first[surfel] as usize..self.first[surfel + 1] as usize]
    }

    /// Numbers of the surfels within a distance of a point.
    pub fn near(&self, p: DVec3, distance: f64) -> impl Iterator<Item = u32> + '_ {
        self.tree.locate_within_distance(p.to_array(), distance * distance).map(|found| found.data)
    }
}

fn beside(tree: &RTree<GeomWithData<[f64; 3], u32>>, surfels: &[Surfel], s: &Surfel) -> Vec<u32> {
    let reach = (REACH * s.size).powi(2);
    let near = tree.locate_within_distance(s.at.to_array(), reach).map(|found| found.data);
    let mut list: Vec<u32> = near.filter(|i| surfels[*i as usize].normal.dot(s.normal) > LEAST_ALIKE).collect();
    list.sort_unstable();
    list
}
