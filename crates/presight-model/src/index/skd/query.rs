//! Queries of a spatial-kD tree.

use super::{LEAF, NOWHERE, Node, Skd};
use crate::index::boxes::{Box32, LANES, Shift};
use crate::index::shapes::Shape;
use crate::index::{QueryResult, Region, Traversal};

impl<const K: usize> Traversal for Skd<K> {
    #[inline(always)]
    fn walk<S: Shape>(&self, shape: &S, region: &Region, found: &mut QueryResult) {
        let shift = &self.shift(region);
        found.stack.clear();
        if self.root != NOWHERE {
            found.stack.push((self.root, self.reach));
        }
        while let Some((at, b)) = found.stack.pop() {
            found.visited += 1;
            if at & LEAF != 0 {
                self.leaf((at & !LEAF) as usize, shape, shift, found);
                continue;
            }
            let here = shift.apply(&b);
            if !shape.meets(&here) {
                continue;
            }
            if shape.covers(&here) {
                self.take(at, found);
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.small {
                // Below the minimum cell size, test only the boxes.
                self.leaves_below(at, shape, shift, found);
                continue;
            }
            let (low, high) = Self::halves(node, &b);
            found.stack.push((node.high, high));
            found.stack.push((node.low, low));
        }
    }
}

impl<const K: usize> Skd<K> {
    /// The boxes of a node's children, within its own box.
    #[inline(always)]
    pub(super) fn halves(node: &Node, b: &Box32) -> (Box32, Box32) {
        let (mut low, mut high) = (*b, *b);
        let axis = usize::from(node.axis);
        low.max[axis] = low.max[axis].min(node.low_max);
        high.min[axis] = high.min[axis].max(node.high_min);
        (low, high)
    }

    /// Collects all ids below a reference without testing them.
    #[inline(always)]
    fn take(&self, from: u32, found: &mut QueryResult) {
        let floor = found.stack.len();
        found.stack.push((from, Box32::EMPTY));
        while found.stack.len() > floor {
            let Some((at, _)) = found.stack.pop() else { break };
            if at & LEAF == 0 {
                let node = &self.nodes[at as usize];
                found.stack.push((node.high, Box32::EMPTY));
                found.stack.push((node.low, Box32::EMPTY));
            } else {
                let bucket = (at & !LEAF) as usize;
                let first = bucket * self.capacity();
                found.ids.extend_from_slice(&self.ids[first..first + self.buckets[bucket].count as usize]);
            }
        }
    }

    fn shift(&self, region: &Region) -> Shift {
        Shift::new(self.origin, region.origin(), &self.reach, K)
    }

    fn leaves_below<S: Shape>(&self, from: u32, shape: &S, shift: &Shift, found: &mut QueryResult) {
        let mut stack = vec![from];
        while let Some(at) = stack.pop() {
            if at & LEAF == 0 {
                let node = &self.nodes[at as usize];
                stack.extend([node.high, node.low]);
            } else {
                self.filter((at & !LEAF) as usize, shape, shift, found);
            }
        }
    }

    #[inline(always)]
    fn leaf<S: Shape>(&self, bucket: usize, shape: &S, shift: &Shift, found: &mut QueryResult) {
        let bounds = shift.apply(&self.buckets[bucket].bounds);
        if !shape.meets(&bounds) {
            return;
        }
        if shape.covers(&bounds) {
            self.take(bucket as u32 | LEAF, found);
        } else {
            self.filter(bucket, shape, shift, found);
        }
    }

    #[inline(always)]
    fn filter<S: Shape>(&self, bucket: usize, shape: &S, shift: &Shift, found: &mut QueryResult) {
        if !self.params.filter {
            self.take(bucket as u32 | LEAF, found);
            return;
        }
        let count = self.buckets[bucket].count as usize;
        found.tested += count;
        let ids = &self.ids[bucket * self.capacity()..][..count];
        let boxes = &self.boxes[bucket * self.width..][..self.width];
        for (ids, boxes) in ids.chunks(LANES).zip(boxes) {
            // Lanes beyond the count are empty boxes, but an infinite region would still accept them.
            let mut met = boxes.meet(shape, shift) & ((1 << ids.len()) - 1);
            while met != 0 {
                found.ids.push(ids[met.trailing_zeros() as usize]);
                met &= met - 1;
            }
        }
    }
}
