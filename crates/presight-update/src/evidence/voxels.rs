//! New objects: voxels with measured points that no object explains, and with rays that passed through them.

use crate::observe::spot::Spot;
use glam::{DMat3, DVec3};
use std::collections::{BTreeMap, BTreeSet};

/// The counts and the points of a voxel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Voxel {
    /// Views with a point in it.
    pub hits: u32,
    /// Views with a ray through it and no point in it.
    pub passes: u32,
    /// Sum of its points, metres.
    sum: DVec3,
    points: u32,
    /// Sums of the products of the points' offsets from the first one, square metres: xx, yy, zz, xy, xz, yz.
    squares: [f32; 6],
    first: DVec3,
}

/// Minimum number of points whose spread gives the extent of an object.
const MIN_POINTS: u32 = 8;
/// Standard deviation of measured points, metres.
const NOISE: f64 = 0.01;

impl Voxel {
    fn add(&mut self, p: DVec3) {
        if self.points == 0 {
            self.first = p;
        }
        let d = (p - self.first).as_vec3();
        let products = [d.x * d.x, d.y * d.y, d.z * d.z, d.x * d.y, d.x * d.z, d.y * d.z];
        self.squares.iter_mut().zip(products).for_each(|(sum, product)| *sum += product);
        (self.sum, self.points) = (self.sum + p, self.points.saturating_add(1));
    }

    /// The spot of its points; with few points, the whole voxel of this edge.
    pub(crate) fn spot(&self, size: f64) -> Spot {
        let mean = self.mean();
        if self.points < MIN_POINTS {
            return Spot::cube(mean, size);
        }
        let (m, n) = (mean - self.first, f64::from(self.points));
        let [xx, yy, zz, xy, xz, yz] = self.squares.map(|s| f64::from(s) / n);
        let spread = DMat3::from_cols(DVec3::new(xx, xy, xz), DVec3::new(xy, yy, yz), DVec3::new(xz, yz, zz));
        let outer = DMat3::from_cols(m.x * m, m.y * m, m.z * m);
        let covariance = spread - outer + DMat3::from_diagonal(DVec3::splat(NOISE * NOISE));
        Spot { mean, sharpness: covariance.inverse() }
    }

    /// The mean of its points, metres.
    pub fn mean(&self) -> DVec3 {
        self.sum / f64::from(self.points.max(1))
    }
}

/// The counts of an occupied voxel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OccupancyThreshold {
    /// Minimum number of views that hit it.
    pub hits: u32,
    /// Maximum share of passes among hits and passes.
    pub passes: f64,
}

impl Default for OccupancyThreshold {
    /// At least three views hit, and at most a third of all views pass.
    fn default() -> Self {
        Self { hits: 3, passes: 1.0 / 3.0 }
    }
}

/// Voxels with hits and passes. Each view hits or passes a voxel at most once.
///
/// ```
/// use glam::DVec3;
/// use presight_update::{OccupancyThreshold, Voxels};
/// let mut voxels = Voxels::new(0.1);
/// for view in 0..3 {
///     let p = DVec3::new(2.05, 0.05, 0.05 + 0.01 * f64::from(view));
///     voxels.add(&[p], |_| false);
/// }
/// let groups = voxels.groups(&OccupancyThreshold::default());
/// assert_eq!(groups.len(), 1);
/// // Rays pass in four later views: it was a person who left.
/// for _ in 0..4 {
///     voxels.add(&[], |_| true);
/// }
/// assert!(voxels.groups(&OccupancyThreshold::default()).is_empty());
/// ```
#[derive(Clone, Debug)]
pub struct Voxels {
    size: f64,
    all: BTreeMap<[i32; 3], Voxel>,
}

/// Maximum number of voxels, which bounds the memory. Further voxels are left out.
const MAX_VOXELS: usize = 2_000_000;

impl Voxels {
    /// Makes an empty set of voxels with edges of `size` metres.
    pub fn new(size: f64) -> Self {
        Self { size, all: BTreeMap::new() }
    }

    /// The edge of a voxel, metres.
    pub fn size(&self) -> f64 {
        self.size
    }

    /// The voxels by key.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = ([i32; 3], &Voxel)> {
        self.all.iter().map(|(key, voxel)| (*key, voxel))
    }

    /// The key of the voxel of a point.
    pub fn key(&self, p: DVec3) -> [i32; 3] {
        // Casts saturate: a point beyond 200,000 km falls into the last voxel.
        (p / self.size).floor().to_array().map(|x| x as i32)
    }

    /// Adds one view: its new points (world frame), and whether a ray passed through the mean of a voxel's points.
    /// Voxels with a point are not tested. Returns the voxels that are hit for the first time; earlier views may have
    /// passed through them ([`Voxels::add_passes`]).
    pub fn add(&mut self, points: &[DVec3], passed: impl Fn(DVec3) -> bool) -> Vec<[i32; 3]> {
        self.add_view(points, |voxel| passed(voxel.mean()))
    }

    /// As [`Voxels::add`]; `passed` gets the voxel.
    pub(crate) fn add_view(&mut self, points: &[DVec3], passed: impl Fn(&Voxel) -> bool) -> Vec<[i32; 3]> {
        let (mut hit, mut new) = (BTreeSet::new(), Vec::new());
        for p in points.iter().filter(|p| p.is_finite()) {
            let key = self.key(*p);
            if self.all.len() >= MAX_VOXELS && !self.all.contains_key(&key) {
                continue;
            }
            let voxel = self.all.entry(key).or_default();
            voxel.add(*p);
            if hit.insert(key) {
                if voxel.hits == 0 {
                    new.push(key);
                }
                voxel.hits = voxel.hits.saturating_add(1);
            }
        }
        for (_, voxel) in self.all.iter_mut().filter(|(key, _)| !hit.contains(*key)) {
            if passed(voxel) {
                voxel.passes = voxel.passes.saturating_add(1);
            }
        }
        new
    }

    /// The spot of a voxel's points; `None` without points.
    pub(crate) fn spot(&self, key: [i32; 3]) -> Option<Spot> {
        self.all.get(&key).map(|voxel| voxel.spot(self.size))
    }

    /// Adds views before the first hit whose rays passed through a voxel.
    pub fn add_passes(&mut self, key: [i32; 3], passes: u32) {
        if let Some(voxel) = self.all.get_mut(&key) {
            voxel.passes = voxel.passes.saturating_add(passes);
        }
    }

    /// Restores a stored voxel.
    pub fn restore(&mut self, key: [i32; 3], hits: u32, passes: u32, mean: DVec3) {
        self.all.insert(key, Voxel { hits, passes, sum: mean, points: 1, first: mean, ..Voxel::default() });
    }

    /// Keeps the voxels for which `keep` returns true.
    pub fn retain(&mut self, keep: impl Fn([i32; 3], &Voxel) -> bool) {
        self.all.retain(|key, voxel| keep(*key, voxel));
    }

    /// The occupied voxels in groups, each by rising key. At most one voxel is between neighbours of a group, because
    /// an object with gaps is seen in pieces.
    pub fn groups(&self, occupied: &OccupancyThreshold) -> Vec<Vec<[i32; 3]>> {
        let counts = |v: &Voxel| {
            v.hits >= occupied.hits && f64::from(v.passes) <= occupied.passes * f64::from(v.hits + v.passes)
        };
        joined(self.all.iter().filter(|(_, v)| counts(v)).map(|(key, _)| *key), 2)
    }
}

/// Groups of voxels, each by rising key; neighbours differ by at most `reach` along each axis.
pub(crate) fn joined(keys: impl IntoIterator<Item = [i32; 3]>, reach: i32) -> Vec<Vec<[i32; 3]>> {
    let (mut left, mut groups): (BTreeSet<[i32; 3]>, _) = (keys.into_iter().collect(), Vec::new());
    let side = 2 * reach + 1;
    while let Some(first) = left.pop_first() {
        let (mut group, mut next) = (vec![first], vec![first]);
        while let Some([x, y, z]) = next.pop() {
            for n in 0..side.pow(3) {
                let [dx, dy, dz] = [n % side, n / side % side, n / side.pow(2)].map(|d| d - reach);
                let key = [x.saturating_add(dx), y.saturating_add(dy), z.saturating_add(dz)];
                if left.remove(&key) {
                    group.push(key);
                    next.push(key);
                }
            }
        }
        group.sort_unstable();
        groups.push(group);
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A post of 4 cm in a voxel of 10 cm, seen from one side, with points every centimetre across and along it. By
    /// hand: evenly spread points reach the root of 3 deviations from their mean, 2 cm here, and 3 cm with a noise of 1
    /// cm. A ray 4 cm from its middle misses the post, a ray 2 cm from it hits. With few points both may hit.
    #[test]
    fn a_ray_that_misses_a_post_does_not_pass_through_it() {
        let at = |across: i32, up: i32| DVec3::new(0.05, 0.05 + 0.01 * f64::from(across), 0.01 * f64::from(up) + 0.005);
        let post: Vec<DVec3> = (0..10).flat_map(|up| (-2..=2).map(move |across| at(across, up))).collect();
        let spot_of = |points: &[DVec3]| {
            let mut voxels = Voxels::new(0.1);
            voxels.add(points, |_| false);
            voxels.spot([0, 0, 0]).unwrap()
        };
        let (post, few) = (spot_of(&post), spot_of(&post[23..26]));
        assert!(post.mean.distance(DVec3::splat(0.05)) < 1e-12);
        for (offset, hits) in [(0.02, true), (0.04, false), (-0.02, true), (-0.04, false)] {
            assert_eq!(post.holds(offset * DVec3::Y), hits, "{offset}");
            assert!(few.holds(offset * DVec3::Y));
        }
        assert!(post.holds(0.045 * DVec3::Z) && !few.holds(0.08 * DVec3::Y));
    }
}
