//! Regions of surfels on planes: grown, adapted to each other, and merged while the cost is low.

use super::moments::Moments;
use crate::geometry::Flat;
use crate::surfels::{NEAR, Noise, SIMILAR, Surface, Surfel};
use rayon::prelude::*;
use std::cmp::Ordering;
use std::collections::{BTreeSet, BinaryHeap};

/// Standard deviation of a surfel from its plane, in sizes of the surfel.
pub(crate) const SPREAD: f64 = 0.3;
/// Deviation of a normal with the same weight: 1 - cosine.
const NORMAL_SPREAD: f64 = 0.06;
/// Cost of deviating normals in a merge, in squares of the minimum size of surfels.
const NORMAL_COST: f64 = 0.15;
/// Negligible cost of a merge, in squares of the minimum size of surfels.
const NEGLIGIBLE: f64 = 0.03;
/// Maximum error of a plane that the noise hides, in standard deviations of a range.
const HIDDEN: f64 = 3.0;
/// Cost of a merge, in variances of the surfels, that 99 of 100 merges do not exceed if only noise separates the two
/// planes: chi squared with the three degrees of freedom of a plane.
const BY_CHANCE: f64 = 11.34;
/// Numbers of adaptation rounds before and after the merge.
const ROUNDS: [usize; 2] = [4, 5];

/// Surfels with their planes.
pub(crate) struct Regions {
    /// By surfel: the index of its plane.
    pub labels: Vec<u32>,
    pub planes: Vec<Flat>,
}

impl Regions {
    /// At most `max` planes, and fewer where noise hides the cost of a merge. `min_size` is the minimum size of
    /// surfels, metres.
    pub fn new(surface: &Surface, (min_size, noise): (f64, Noise), max: usize) -> Self {
        let mut regions = grown(surface);
        regions.adapt(surface, ROUNDS[0]);
        regions.merge(surface, min_size, max, &FreeCost::new(min_size, noise));
        regions.adapt(surface, ROUNDS[1]);
        regions
    }

    /// By plane: the indices of its surfels.
    pub fn members(&self) -> Vec<Vec<u32>> {
        let mut members = vec![Vec::new(); self.planes.len()];
        for (label, surfel) in self.labels.iter().zip(0..) {
            members[*label as usize].push(surfel);
        }
        members
    }

    /// Moves each surfel to the best of its neighbours' planes, then fits the planes again.
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
    fn merge(&mut self, surface: &Surface, min_size: f64, max: usize, free: &FreeCost) {
        // The uncertainty of a surfel grows with its size.
        let weight = |s: &Surfel| (min_size / s.size).powi(2);
        let mut merger = Merger::new(moments(surface, &self.labels, self.planes.len(), weight), min_size);
        for (i, label) in self.labels.iter().enumerate() {
            for n in surface.neighbours(i) {
                merger.connect(*label, self.labels[*n as usize]);
            }
        }
        let number = merger.run(max, free);
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

/// Regions grown from seeds, the flattest surfels first.
fn grown(surface: &Surface) -> Regions {
    let surfels = &surface.surfels;
    let flatness = |i: usize| {
        let near = surface.neighbours(i);
        let similarity: f64 = near.iter().map(|n| surfels[*n as usize].normal.dot(surfels[i].normal)).sum();
        similarity / near.len().max(1) as f64 * near.len().min(20) as f64
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
            let fits = plane.above(s.at).abs() < NEAR * s.size && s.normal.dot(plane.normal) > SIMILAR;
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

/// The cost of a merge that noise alone explains, square metres.
struct FreeCost {
    constant: f64,
    /// For each surfel of the smaller region.
    per_surfel: f64,
}

impl FreeCost {
    /// A plane through an arc of n surfels with the sagitta e costs n e^2 4 / 45, and planes through its halves cost a
    /// sixteenth of that. The merge of the halves costs the difference, e^2 / 6 for each surfel of a half.
    fn new(min_size: f64, noise: Noise) -> Self {
        let e = HIDDEN * noise.range;
        Self {
            constant: (NEGLIGIBLE * min_size * min_size).max(BY_CHANCE * noise.place.powi(2)),
            per_surfel: e * e / 6.0,
        }
    }
}

/// A possible merge of two regions, with their versions at the time of the offer.
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
    /// The cheapest offer is the greatest, because heaps return the greatest first.
    fn cmp(&self, other: &Self) -> Ordering {
        other.price.total_cmp(&self.price).then(other.pair.cmp(&self.pair))
    }
}

struct Merger {
    moments: Vec<Moments>,
    costs: Vec<f64>,
    /// By region: the adjacent regions.
    adjacent: Vec<BTreeSet<u32>>,
    versions: Vec<u32>,
    /// By region: the region that took it in, or itself.
    into: Vec<u32>,
    offers: BinaryHeap<Offer>,
    /// Cost of the spread of normals, square metres.
    normals: f64,
}

impl Merger {
    fn new(moments: Vec<Moments>, min_size: f64) -> Self {
        let (count, normals) = (moments.len(), NORMAL_COST * min_size * min_size);
        let costs = moments.iter().map(|m| m.cost(normals)).collect();
        let (adjacent, versions) = (vec![BTreeSet::new(); count], vec![0; count]);
        let into = (0..count as u32).collect();
        Self { moments, costs, adjacent, versions, into, offers: BinaryHeap::new(), normals }
    }

    fn connect(&mut self, a: u32, b: u32) {
        if a != b {
            self.adjacent[a as usize].insert(b);
            self.adjacent[b as usize].insert(a);
        }
    }

    fn offer(&mut self, a: u32, b: u32) {
        let (p, q) = (a.min(b), a.max(b));
        let [i, j] = [p as usize, q as usize];
        let price = self.moments[i].with(&self.moments[j]).cost(self.normals) - self.costs[i] - self.costs[j];
        self.offers.push(Offer { price, pair: [p, q], versions: [self.versions[i], self.versions[j]] });
    }

    /// Merges until at most `max` regions are left and no merge is free. Returns the new index of each region,
    /// `u32::MAX` for a region without surfels.
    fn run(mut self, max: usize, free: &FreeCost) -> Vec<u32> {
        let mut left = self.moments.iter().filter(|m| m.count > 0.0).count();
        for a in 0..self.moments.len() as u32 {
            let later: Vec<u32> = self.adjacent[a as usize].range(a + 1..).copied().collect();
            later.into_iter().for_each(|b| self.offer(a, b));
        }
        while let Some(Offer { price, pair: [p, q], versions }) = self.offers.pop() {
            let [i, j] = [p as usize, q as usize];
            if self.into[i] != p || self.into[j] != q || versions != [self.versions[i], self.versions[j]] {
                continue;
            }
            let smaller = self.moments[i].weight.min(self.moments[j].weight);
            if left > max || price <= free.constant + free.per_surfel * smaller {
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
        for r in std::mem::take(&mut self.adjacent[j]) {
            self.adjacent[r as usize].remove(&q);
            if r != p {
                self.connect(p, r);
            }
        }
        let adjacent: Vec<u32> = self.adjacent[i].iter().copied().collect();
        adjacent.into_iter().for_each(|r| self.offer(p, r));
    }

    fn numbered(&self) -> Vec<u32> {
        let mut number = vec![u32::MAX; self.into.len()];
        let mut count = 0;
        // A region is merged into one with a lower index.
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
