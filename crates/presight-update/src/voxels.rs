//! What stands where the model has nothing: voxels that measured points hit and that rays passed through, by view.

use glam::DVec3;
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
}

impl Voxel {
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
/// use glam::DVec3;
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

    /// Adds one view: the points that nothing explains, world frame, and whether a ray passed through the mean of a voxel's
    /// points. Voxels with a point are not tested. Returns the voxels that are hit for the first time: views of before
    /// may have passed through them ([`Voxels::add_passes`]).
    pub fn add(&mut self, points: &[DVec3], passed: impl Fn(DVec3) -> bool) -> Vec<[i32; 3]> {
        let (mut hit, mut new) = (BTreeSet::new(), Vec::new());
        for p in points.iter().filter(|p| p.is_finite()) {
            let key = self.key(*p);
            if self.all.len() >= MOST && !self.all.contains_key(&key) {
                continue;
            }
            let voxel = self.all.entry(key).or_default();
            (voxel.sum, voxel.points) = (voxel.sum + *p, voxel.points.saturating_add(1));
            if hit.insert(key) {
                if voxel.hits == 0 {
                    new.push(key);
                }
                voxel.hits = voxel.hits.saturating_add(1);
            }
        }
        for (_, voxel) in self.all.iter_mut().filter(|(key, _)| !hit.contains(*key)) {
            if passed(voxel.mean()) {
                voxel.passes = voxel.passes.saturating_add(1);
            }
        }
        new
    }

    /// The mean of the points in a voxel, metres; `None` if it has none.
    pub fn mean(&self, key: [i32; 3]) -> Option<DVec3> {
        self.all.get(&key).map(Voxel::mean)
    }

    /// Counts views of before the first hit that passed through a voxel.
    pub fn add_passes(&mut self, key: [i32; 3], passes: u32) {
        if let Some(voxel) = self.all.get_mut(&key) {
            voxel.passes = voxel.passes.saturating_add(passes);
        }
    }

    /// Puts a voxel back that was stored.
    pub fn restore(&mut self, key: [i32; 3], hits: u32, passes: u32, mean: DVec3) {
        self.all.insert(key, Voxel { hits, passes, sum: mean, points: 1 });
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
