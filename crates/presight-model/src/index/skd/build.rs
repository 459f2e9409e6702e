//! Builds a tree, or rebuilds a part of one: orders entries by halving, then links nodes and buckets.

use super::{Bucket, Entry, LEAF, NOWHERE, Node, Skd};
use crate::index::SplitAxis;
use crate::index::boxes::{Box32, Boxes8};
use crate::threads::parallel_or_here;
use std::sync::atomic::{AtomicU8, Ordering};

/// Smaller tasks are not worth running in parallel.
const PARALLEL: usize = 8192;

impl<const K: usize> Skd<K> {
    /// Rebuilds the whole tree from entries.
    pub(super) fn fill(&mut self, entries: &mut [Entry]) {
        self.nodes.clear();
        self.buckets.clear();
        self.boxes.clear();
        self.ids.clear();
        self.free_nodes.clear();
        self.free_buckets.clear();
        self.count = entries.len();
        self.reach = Box32::EMPTY;
        self.root = NOWHERE;
        if !entries.is_empty() {
            let leaves = leaves_of(entries.len(), self.capacity());
            self.nodes.reserve_exact(leaves - 1);
            self.buckets.reserve_exact(leaves);
            self.boxes.reserve_exact(leaves * self.width);
            self.ids.reserve_exact(leaves * self.capacity());
            (self.root, self.reach) = self.subtree(entries, NOWHERE, self.capacity());
        }
    }

    /// Builds a subtree of entries, with at most `capacity` in a bucket. Returns its reference and its box.
    pub(super) fn subtree(&mut self, entries: &mut [Entry], parent: u32, capacity: usize) -> (u32, Box32) {
        let levels = (usize::BITS - entries.len().div_ceil(capacity).leading_zeros() + 1) as usize;
        let axes: Vec<AtomicU8> = (0..1usize << levels).map(|_| AtomicU8::new(0)).collect();
        let split = self.params.split_axis;
        if entries.len() >= 2 * PARALLEL {
            parallel_or_here(|| order::<K>(entries, capacity, 1, split, &axes));
        } else {
            order::<K>(entries, capacity, 1, split, &axes);
        }
        self.link(entries, parent, 1, capacity, &axes)
    }

    /// Makes nodes and buckets of ordered entries.
    fn link(
        &mut self,
        entries: &[Entry],
        parent: u32,
        place: usize,
        capacity: usize,
        axes: &[AtomicU8],
    ) -> (u32, Box32) {
        if entries.len() <= capacity {
            return self.new_bucket(entries, parent);
        }
        let axis = axes[place].load(Ordering::Relaxed);
        let (low, high) = entries.split_at(entries.len() / 2);
        let split = high[0].b.middle(usize::from(axis));
        let node = Node {
            split,
            low_max: 0.0,
            high_min: 0.0,
            low: NOWHERE,
            high: NOWHERE,
            parent,
            built: entries.len() as u32,
            changes: 0,
            axis,
            small: false,
        };
        let index = match self.free_nodes.pop() {
            Some(index) => {
                self.nodes[index as usize] = node;
                index
            }
            None => {
                self.nodes.push(node);
                self.nodes.len() as u32 - 1
            }
        };
        let (low, low_box) = self.link(low, index, 2 * place, capacity, axes);
        let (high, high_box) = self.link(high, index, 2 * place + 1, capacity, axes);
        let whole = low_box.union(&high_box);
        let node = &mut self.nodes[index as usize];
        (node.low, node.high) = (low, high);
        (node.low_max, node.high_min) = (low_box.max[usize::from(axis)], high_box.min[usize::from(axis)]);
        node.small = (0..K).all(|k| f64::from(whole.max[k]) - f64::from(whole.min[k]) <= self.params.min_cell);
        (index, whole)
    }

    pub(super) fn new_bucket(&mut self, entries: &[Entry], parent: u32) -> (u32, Box32) {
        let bucket = Bucket { bounds: Box32::EMPTY, parent, count: 0 };
        let index = match self.free_buckets.pop() {
            Some(index) => {
                self.buckets[index as usize] = bucket;
                index
            }
            None => {
                self.buckets.push(bucket);
                self.boxes.extend(std::iter::repeat_n(Boxes8::EMPTY, self.width));
                self.ids.extend(std::iter::repeat_n(NOWHERE, self.capacity()));
                self.buckets.len() as u32 - 1
            }
        };
        for entry in entries {
            self.put(index, entry);
        }
        (index | LEAF, self.buckets[index as usize].bounds)
    }
}

/// Orders entries by recursive halving until they fit a bucket, and records the axis of each split by heap position (1
/// is the root, 2 and 3 its halves, ..).
fn order<const K: usize>(entries: &mut [Entry], capacity: usize, place: usize, split: SplitAxis, axes: &[AtomicU8]) {
    if entries.len() <= capacity {
        // By rising id, so that neighbours of a mesh stay together.
        entries.sort_unstable_by_key(|e| e.id);
        return;
    }
    let axis = match split {
        SplitAxis::Alternating => place.ilog2() as usize % K,
        SplitAxis::Longest => {
            let mut range = [(f32::INFINITY, f32::NEG_INFINITY); K];
            for e in entries.iter() {
                for (k, range) in range.iter_mut().enumerate() {
                    let m = e.b.middle(k);
                    *range = (range.0.min(m), range.1.max(m));
                }
            }
            let spread = |k: usize| range[k].1 - range[k].0;
            (1..K).fold(0, |best, k| if spread(k) > spread(best) { k } else { best })
        }
    };
    axes[place].store(axis as u8, Ordering::Relaxed);
    let middle = entries.len() / 2;
    entries.select_nth_unstable_by(middle, |a, b| a.b.middle(axis).total_cmp(&b.b.middle(axis)).then(a.id.cmp(&b.id)));
    let (low, high) = entries.split_at_mut(middle);
    if low.len() >= PARALLEL {
        rayon::join(
            || order::<K>(low, capacity, 2 * place, split, axes),
            || order::<K>(high, capacity, 2 * place + 1, split, axes),
        );
    } else {
        order::<K>(low, capacity, 2 * place, split, axes);
        order::<K>(high, capacity, 2 * place + 1, split, axes);
    }
}

/// Number of buckets that halving makes of `count` entries.
fn leaves_of(count: usize, capacity: usize) -> usize {
    if count <= capacity {
        return 1;
    }
    let half = count / 2;
    // Both halves differ by at most one entry.
    if count.is_multiple_of(2) {
        2 * leaves_of(half, capacity)
    } else {
        leaves_of(half, capacity) + leaves_of(half + 1, capacity)
    }
}
