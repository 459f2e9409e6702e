//! What stands where the model has nothing: voxels that measured points hit and that rays passed through, by view.

use glam::{DMat3, DVec3};
use std::collections::{BTreeMap, BTreeSet};

/// The counts of a voxel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Voxel {
    /// Views with a point in it.
    pub hits: u32,
    /// Views with a ray through it and no point in it.
    pub passes: u32,
    /// Sum of its points, metres, and their number.
    sum: DVec3,
    points: u32,
    /// Sums of the products of their offsets from the first one, square metres: xx, yy, zz, xy, xz, yz.
    squares: [f32; 6],
    first: DVec3,
}

/// The place of something in a voxel.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spot {
    pub mean: DVec3,
    /// The inverse of the covariance of its points.
    sharpness: DMat3,
}

/// Points of something evenly spread end at this number of standard deviations, squared.
const ENDS: f64 = 3.0;
/// Fewest points whose spread says how wide something is.
const SPREAD: u32 = 8;
/// Measured points are off by this, one standard deviation, metres.
const NOISE: f64 = 0.01;

impl Spot {
    /// Anywhere in a cube: as likely as a point of a surface falls into it, most rays this near to its middle cross it.
    pub fn cube(mean: DVec3, size: f64) -> Self {
        Self { mean, sharpness: DMat3::from_diagonal(DVec3::splat(ENDS / (0.7 * size).powi(2))) }
    }

    /// True if something is at an offset from its mean.
    pub fn holds(&self, off: DVec3) -> bool {
        off.dot(self.sharpness * off) <= ENDS
    }
}

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

    /// Where in a voxel of a size it is: as its points are spread, or anywhere in the voxel if they are few.
    pub(crate) fn spot(&self, size: f64) -> Spot {
        let mean = self.mean();
        if self.points < SPREAD {
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

/// When a voxel counts as occupied.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Occupied {
    /// Views that have to hit it.
    pub hits: u32,
    /// The largest share of passes among hits and passes.
    pub passes: f64,
}

impl Default for Occupied {
    /// Three views must hit, and at most a third of all may pass.
    fn default() -> Self {
        Self { hits: 3, passes: 1.0 / 3.0 }
    }
}

/// Voxels with hits and passes. Views are added one after the other; in each, every voxel is hit or passed at most once.
///
/// ```
/// use glam::{DMat3, DVec3};
/// use presight::update::{Occupied, Voxels};
/// let mut voxels = Voxels::new(0.1);
/// for view in 0..3 {
///     let p = DVec3::new(2.05, 0.05, 0.05 + 0.01 * f64::from(view));
///     voxels.add(&[p], |_| false);
/// }
/// let groups = voxels.groups(&Occupied::default());
/// assert_eq!(groups.len(), 1);
/// // Rays that pass in four later views say that it was somebody who left.
/// for _ in 0..4 {
///     voxels.add(&[], |_| true);
/// }
/// assert!(voxels.groups(&Occupied::default()).is_empty());
/// ```
#[derive(Clone, Debug)]
pub struct Voxels {
    size: f64,
    all: BTreeMap<[i32; 3], Voxel>,
}

/// Most voxels: beyond them new ones are left out, so that memory stays bounded.
const MOST: usize = 2_000_000;

impl Voxels {
    /// No voxels yet; `size` is their edge, metres.
    pub fn new(size: f64) -> Self {
        Self { size, all: BTreeMap::new() }
    }

    /// Their edge, metres.
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

    /// Adds one view: the points that nothing explains, world frame, and whether a ray passed through the mean of a voxel's points. Voxels with a point are not tested. Returns the voxels that are hit for the first time: views of before
    /// may have passed through them ([`Voxels::add_passes`]).
    pub fn add(&mut self, points: &[DVec3], passed: impl Fn(DVec3) -> bool) -> Vec<[i32; 3]> {
        self.add_view(points, |voxel| passed(voxel.mean()))
    }

    /// As [`Voxels::add`]; `passed` gets the voxel.
    pub(crate) fn add_view(&mut self, points: &[DVec3], passed: impl Fn(&Voxel) -> bool) -> Vec<[i32; 3]> {
        let (mut hit, mut new) = (BTreeSet::new(), Vec::new());
        for p in points.iter().filter(|p| p.is_finite()) {
            let key = self.key(*p);
            if self.all.len() >= MOST && !self.all.contains_key(&key) {
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

    /// Where something is in a voxel; `None` if it has no points.
    pub(crate) fn spot(&self, key: [i32; 3]) -> Option<Spot> {
        self.all.get(&key).map(|voxel| voxel.spot(self.size))
    }

    /// Counts views of before the first hit that passed through a voxel.
    pub fn add_passes(&mut self, key: [i32; 3], passes: u32) {
        if let Some(voxel) = self.all.get_mut(&key) {
            voxel.passes = voxel.passes.saturating_add(passes);
        }
    }

    /// Puts a voxel back that was stored.
    pub fn restore(&mut self, key: [i32; 3], hits: u32, passes: u32, mean: DVec3) {
        self.all.insert(key, Voxel { hits, passes, sum: mean, points: 1, first: mean, ..Voxel::default() });
    }

    /// Forgets voxels.
    pub fn retain(&mut self, keep: impl Fn([i32; 3], &Voxel) -> bool) {
        self.all.retain(|key, voxel| keep(*key, voxel));
    }

    /// The occupied voxels in groups, each by rising key. Between neighbours of a group lies at most one other voxel: what
    /// has gaps is seen in pieces.
    pub fn groups(&self, occupied: &Occupied) -> Vec<Vec<[i32; 3]>> {
        let counts = |v: &Voxel| {
            v.hits >= occupied.hits && f64::from(v.passes) <= occupied.passes * f64::from(v.hits + v.passes)
        };
        joined(self.all.iter().filter(|(_, v)| counts(v)).map(|(key, _)| *key), 2)
    }
}

/// Voxels in groups, each by rising key; neighbours differ by at most `reach` along each axis.
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

    /// A post of 4 cm in a voxel of 10 cm, seen from one side: points every centimetre across and along it. By hand: evenly spread points end
    /// at the root of 3 deviations, 2 cm here, and with 1 cm of noise at 3 cm. A ray 4 cm from its middle misses the post, one 2 cm from it
    /// goes through. Where few points are known, both may go through.
    #[test]
    fn a_ray_beside_a_post_does_not_pass_through_it() {
        let at = |across: i32, up: i32| DVec3::new(0.05, 0.05 + 0.01 * f64::from(across), 0.01 * f64::from(up) + 0.005);
        let post: Vec<DVec3> = (0..10).flat_map(|up| (-2..=2).map(move |across| at(across, up))).collect();
        let spot_of = |points: &[DVec3]| {
            let mut voxels = Voxels::new(0.1);
            voxels.add(points, |_| false);
            voxels.spot([0, 0, 0]).unwrap()
        };
        let (post, few) = (spot_of(&post), spot_of(&post[23..26]));
        assert!(post.mean.distance(DVec3::splat(0.05)) < 1e-12);
        for (beside, through) in [(0.02, true), (0.04, false), (-0.02, true), (-0.04, false)] {
            assert_eq!(post.holds(beside * DVec3::Y), through, "{beside}");
            assert!(few.holds(beside * DVec3::Y));
        }
        assert!(post.holds(0.045 * DVec3::Z) && !few.holds(0.08 * DVec3::Y));
    }
}
