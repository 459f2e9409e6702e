//! Regions of surfels that lie on one plane each: grown, adapted to each other, and merged while that costs little.

use super::moments::Moments;
use crate::geometry::Flat;
use crate::surfels::{NEAR, Noise, Surface, Surfel};
use rayon::prelude::*;
use std::cmp::Ordering;
use std::collections::{BTreeSet, BinaryHeap};

/// While a region grows: least cosine between normals (25 degrees).
const ALIKE: f64 = 0.906;
/// Standard deviation of a surfel from its plane, in sizes of the surfel.
const SPREAD: f64 = 0.3;
/// Deviation of normals that weighs as much: 1 - cosine.
const NORMAL_SPREAD: f64 = 0.06;
/// What deviating normals cost in a merge, in squares of the least size of surfels.
const NORMAL_COST: f64 = 0.15;
/// A merge that costs less than this makes no difference: squares of the least size of surfels.
const CHEAP: f64 = 0.03;
/// Errors of planes that noise hides: standard deviations of a range.
const HIDDEN: f64 = 3.0;
/// One plane in place of two costs fewer variances of the surfels than this in 99 of 100 merges if noise is all that differs: chi
/// squared with the three degrees of freedom of a plane.
const BY_CHANCE: f64 = 11.34;
/// How often regions adapt to each other before and after they are merged.
const ROUNDS: [usize; 2] = [4, 5];

/// Surfels by the plane that they lie on.
pub(crate) struct Regions {
    /// The number of the plane of each surfel.
    pub labels: Vec<u32>,
    pub planes: Vec<Flat>,
}

impl Regions {
    /// At most `most` planes; fewer where noise hides what merging costs. `least` is the least size of surfels.
    pub fn new(surface: &Surface, (least, noise): (f64, Noise), most: usize) -> Self {
        let mut regions = grown(surface);
        regions.adapt(surface, ROUNDS[0]);
        regions.merge(surface, least, most, &Free::new(least, noise));
        regions.adapt(surface, ROUNDS[1]);
        regions
    }

    /// The surfels of each plane.
    pub fn members(&self) -> Vec<Vec<u32>> {
        let mut members = vec![Vec::new(); self.planes.len()];
        for (label, surfel) in self.labels.iter().zip(0..) {
            members[*label as usize].push(surfel);
        }
        members
    }

    /// Each surfel goes to the best plane of its neighbours' planes; planes follow.
    fn adapt(&mut self, surface: &Surface, rounds: usize) {
        for _ in 0..rounds {
            let (labels, planes) = (&self.labels, &self.planes);
            let best = |i: usize| {
                let s = &surface.surfels[i];
                let candidates = surface.neighbours(i).iter().map(|n| labels[*n as usize]);
                let costs = candidates.map(|l| (misfit(s, &planes[l as usize]), l));
                costs.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))).map_or(labels[i], |(_, l)| l)
            };
            self.labels = (0..surface.surfels.len()).into_par_iter().map(best).collect();
            let moments = moments(surface, &self.labels, self.planes.len(), |s| s.weight);
            for (plane, moments) in self.planes.iter_mut().zip(&moments) {
                if moments.count >= 3.0 {
                    *plane = moments.plane();
                }
            }
        }
    }

    /// Merges neighbouring regions, the cheapest pair first.
    fn merge(&mut self, surface: &Surface, least: f64, most: usize, free: &Free) {
        // The uncertainty of a surfel grows with its size.
        let weight = |s: &Surfel| (least / s.size).powi(2);
        let mut merger = Merger::new(moments(surface, &self.labels, self.planes.len(), weight), least);
        for (i, label) in self.labels.iter().enumerate() {
            for n in surface.neighbours(i) {
                merger.touch(*label, self.labels[*n as usize]);
            }
        }
        let number = merger.run(most, free);
        self.labels.iter_mut().for_each(|label| *label = number[*label as usize]);
        let count = number.iter().filter(|n| **n != u32::MAX).max().map_or(0, |n| *n as usize + 1);
        self.planes = moments(surface, &self.labels, count, |s| s.weight).iter().map(Moments::plane).collect();
    }
}

fn misfit(s: &Surfel, plane: &Flat) -> f64 {
    (plane.above(s.at) / (SPREAD * s.size)).powi(2) + (1.0 - s.normal.dot(plane.normal)) / NORMAL_SPREAD
}

fn moments(surface: &Surface, labels: &[u32], count: usize, weight: impl Fn(&Surfel) -> f64) -> Vec<Moments> {
    let mut all = vec![Moments::ZERO; count];
    for (s, label) in surface.surfels.iter().zip(labels) {
        all[*label as usize].add(s, weight(s));
    }
    all
}

/// Regions grown from the flattest surfels.
fn grown(surface: &Surface) -> Regions {
    let surfels = &surface.surfels;
    let flatness = |i: usize| {
        let near = surface.neighbours(i);
        let alike: f64 = near.iter().map(|n| surfels[*n as usize].normal.dot(surfels[i].normal)).sum();
        alike / near.len().max(1) as f64 * near.len().min(20) as f64
    };
    let flatness: Vec<f64> = (0..surfels.len()).into_par_iter().map(flatness).collect();
    let mut seeds: Vec<u32> = (0..surfels.len() as u32).collect();
    seeds.sort_by(|a, b| flatness[*b as usize].total_cmp(&flatness[*a as usize]));
    let mut labels = vec![u32::MAX; surfels.len()];
    let mut planes = Vec::new();
    for seed in seeds {
        if labels[seed as usize] == u32::MAX {
            let label = planes.len() as u32;
            planes.push(grow(surface, &mut labels, seed, label));
        }
    }
    Regions { labels, planes }
}

fn grow(surface: &Surface, labels: &mut [u32], seed: u32, label: u32) -> Flat {
    let surfels = &surface.surfels;
    let first = &surfels[seed as usize];
    let mut plane = Flat { centre: first.at, normal: first.normal };
    let mut moments = Moments::ZERO;
    moments.add(first, first.weight);
    labels[seed as usize] = label;
    let (mut front, mut fit_at) = (vec![seed], 16.0);
    while !front.is_empty() {
        let mut next = Vec::new();
        for n in front.iter().flat_map(|i| surface.neighbours(*i as usize)) {
            let s = &surfels[*n as usize];
            let fits = plane.above(s.at).abs() < NEAR * s.size && s.normal.dot(plane.normal) > ALIKE;
            if fits && labels[*n as usize] == u32::MAX {
                labels[*n as usize] = label;
                moments.add(s, s.weight);
                next.push(*n);
            }
        }
        if moments.count >= fit_at {
            plane = moments.plane();
            fit_at = 1.3 * moments.count;
        }
        front = next;
    }
    moments.plane()
}

/// What a merge may cost without a difference that noise would show, square metres.
struct Free {
    by_chance: f64,
    /// For each surfel of the smaller region.
    of_each: f64,
}

impl Free {
    /// A plane through an arc whose middle is e off its chord costs n e^2 4 / 45 for n surfels, and planes through its halves a
    /// sixteenth of that: the merge costs e^2 / 6 for each surfel of a half.
    fn new(least: f64, noise: Noise) -> Self {
        let e = HIDDEN * noise.range;
        Self { by_chance: (CHEAP * least * least).max(BY_CHANCE * noise.place.powi(2)), of_each: e * e / 6.0 }
    }
}

/// Two regions that may be merged, at the versions for which the price was worked out.
struct Offer {
    price: f64,
    pair: [u32; 2],
    versions: [u32; 2],
}

impl PartialEq for Offer {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Offer {}

impl PartialOrd for Offer {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Offer {
    /// The cheapest is the greatest: heaps give the greatest first.
    fn cmp(&self, other: &Self) -> Ordering {
        other.price.total_cmp(&self.price).then(other.pair.cmp(&self.pair))
    }
}

struct Merger {
    moments: Vec<Moments>,
    costs: Vec<f64>,
    beside: Vec<BTreeSet<u32>>,
    versions: Vec<u32>,
    into: Vec<u32>,
    offers: BinaryHeap<Offer>,
    normals: f64,
}

impl Merger {
    fn new(moments: Vec<Moments>, least: f64) -> Self {
        let (count, normals) = (moments.len(), NORMAL_COST * least * least);
        let costs = moments.iter().map(|m| m.cost(normals)).collect();
        let (beside, versions) = (vec![BTreeSet::new(); count], vec![0; count]);
        let into = (0..count as u32).collect();
        Self { moments, costs, beside, versions, into, offers: BinaryHeap::new(), normals }
    }

    fn touch(&mut self, a: u32, b: u32) {
        if a != b {
            self.beside[a as usize].insert(b);
            self.beside[b as usize].insert(a);
        }
    }

    fn offer(&mut self, a: u32, b: u32) {
        let (p, q) = (a.min(b), a.max(b));
        let [i, j] = [p as usize, q as usize];
        let price = self.moments[i].with(&self.moments[j]).cost(self.normals) - self.costs[i] - self.costs[j];
        self.offers.push(Offer { price, pair: [p, q], versions: [self.versions[i], self.versions[j]] });
    }

    /// Merges until at most `most` regions are left and no merge is free. Returns the new number of each region; `u32::MAX` for regions
    /// without surfels.
    fn run(mut self, most: usize, free: &Free) -> Vec<u32> {
        let mut left = self.moments.iter().filter(|m| m.count > 0.0).count();
        for a in 0..self.moments.len() as u32 {
            let later: Vec<u32> = self.beside[a as usize].range(a + 1..).copied().collect();
            later.into_iter().for_each(|b| self.offer(a, b));
        }
        while let Some(Offer { price, pair: [p, q], versions }) = self.offers.pop() {
            let [i, j] = [p as usize, q as usize];
            if self.into[i] != p || self.into[j] != q || versions != [self.versions[i], self.versions[j]] {
                continue;
            }
            let smaller = self.moments[i].weight.min(self.moments[j].weight);
            if left > most || price <= free.by_chance + free.of_each * smaller {
                left -= 1;
                self.unite(p, q);
            }
        }
        self.numbered()
    }

    fn unite(&mut self, p: u32, q: u32) {
        let [i, j] = [p as usize, q as usize];
        self.moments[i] = self.moments[i].with(&self.moments[j]);
        self.costs[i] = self.moments[i].cost(self.normals);
        self.versions[i] += 1;
        self.into[j] = p;
        for r in std::mem::take(&mut self.beside[j]) {
            self.beside[r as usize].remove(&q);
            if r != p {
                self.touch(p, r);
            }
        }
        let beside: Vec<u32> = self.beside[i].iter().copied().collect();
        beside.into_iter().for_each(|r| self.offer(p, r));
    }

    fn numbered(&self) -> Vec<u32> {
        let mut number = vec![u32::MAX; self.into.len()];
        let mut count = 0;
        // A region is merged into one with a lower number.
        for i in 0..self.into.len() {
            if self.into[i] as usize != i {
                number[i] = number[self.into[i] as usize];
            } else if self.moments[i].count > 0.0 {
                number[i] = count;
                count += 1;
            }
        }
        number
    }
}
