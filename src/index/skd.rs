//! Spatial-kD tree: ids by centroid; nodes hold the hyperplane and how far the ids of each side reach over it (Ooi,
//! Sacks-Davis and McDonell, "Spatial indexing by binary decomposition and spatial bounding", 1987/1991).

use super::boxes::{Box32, Boxes8, LANES, Shift};
use super::region::{Shape, Visit};
use super::{Found, NodeView, Params, Region, SpatialIndex, SplitAxis};
use crate::geometry::Aabb;
use glam::DVec3;
use std::collections::BinaryHeap;
use std::sync::atomic::{AtomicU8, Ordering};

/// A spatial-kD tree over the first `K` axes.
///
/// Leaves are buckets of boxes, tested eight at a time. A subtree in which as many changes were made as it had entries
/// when it was built is built anew, so that the whole stays near what a fresh build would be.
#[derive(Clone, Debug)]
pub struct Skd<const K: usize> {
    params: Params,
    origin: DVec3,
    /// Holds every box since the last full build.
    reach: Box32,
    root: u32,
    count: usize,
    nodes: Vec<Node>,
    buckets: Vec<Bucket>,
    /// `width` groups of eight lanes a bucket, and the id in each lane.
    boxes: Vec<Boxes8>,
    ids: Vec<u32>,
    /// Lane of each id, or NOWHERE.
    places: Vec<u32>,
    free_nodes: Vec<u32>,
    free_buckets: Vec<u32>,
    /// Groups of lanes of a bucket.
    width: usize,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    /// Hyperplane: twice a centroid's coordinate; below goes low.
    split: f32,
    /// How far the low side reaches up, and the high side down.
    low_max: f32,
    high_min: f32,
    low: u32,
    high: u32,
    parent: u32,
    /// Entries below, when it was built, and changes since.
    built: u32,
    changes: u32,
    axis: u8,
    /// No larger than the least cell: its children are not tested.
    small: bool,
}

#[derive(Clone, Copy, Debug)]
struct Bucket {
    bounds: Box32,
    parent: u32,
    count: u32,
}

/// An entry while a subtree is built.
#[derive(Clone, Copy)]
struct Entry {
    b: Box32,
    id: u32,
}

const NOWHERE: u32 = u32::MAX;
/// Marks a child that is a bucket.
const LEAF: u32 = 1 << 31;
/// Below this a task of its own costs more than it saves.
const PARALLEL: usize = 8192;

impl<const K: usize> Skd<K> {
    /// Builds a tree; of an id given twice the last box counts.
    pub fn build(params: Params, boxes: &[(u32, Aabb)]) -> Self {
        let whole = boxes.iter().fold(Aabb::EMPTY, |all, (_, b)| all.union(*b));
        let width = params.cell_polygons.clamp(1, 1 << 16).div_ceil(LANES);
        let mut tree = Self {
            params,
            origin: if whole.is_empty() { DVec3::ZERO } else { whole.center() },
            reach: Box32::EMPTY,
            root: NOWHERE,
            count: 0,
            nodes: Vec::new(),
            buckets: Vec::new(),
            boxes: Vec::new(),
            ids: Vec::new(),
            places: Vec::new(),
            free_nodes: Vec::new(),
            free_buckets: Vec::new(),
            width,
        };
        let mut entries: Vec<Entry> =
            boxes.iter().map(|(id, b)| Entry { b: Box32::around(b, tree.origin), id: *id }).collect();
        let ids = entries.iter().map(|e| e.id as usize + 1).max().unwrap_or(0);
        tree.places = vec![NOWHERE; ids];
        // The last of equal ids wins: earlier ones are dropped before anything is built.
        for (i, e) in entries.iter().enumerate() {
            tree.places[e.id as usize] = i as u32;
        }
        let mut i = 0;
        let places = &tree.places;
        entries.retain(|e| {
            i += 1;
            places[e.id as usize] == i - 1
        });
        tree.fill(&mut entries);
        tree
    }

    fn capacity(&self) -> usize {
        self.width * LANES
    }

    /// Makes everything anew from entries.
    fn fill(&mut self, entries: &mut [Entry]) {
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
            (self.root, self.reach) = self.subtree(entries, NOWHERE);
        }
    }

    /// Builds a subtree of entries; the answer is its reference and its box.
    fn subtree(&mut self, entries: &mut [Entry], parent: u32) -> (u32, Box32) {
        let levels = (usize::BITS - entries.len().div_ceil(self.capacity()).leading_zeros() + 1) as usize;
        let axes: Vec<AtomicU8> = (0..1usize << levels).map(|_| AtomicU8::new(0)).collect();
        order::<K>(entries, self.capacity(), 1, self.params.split_axis, &axes);
        self.link(entries, parent, 1, &axes)
    }

    /// Makes nodes and buckets of ordered entries.
    fn link(&mut self, entries: &[Entry], parent: u32, place: usize, axes: &[AtomicU8]) -> (u32, Box32) {
        if entries.len() <= self.capacity() {
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
        let (low, low_box) = self.link(low, index, 2 * place, axes);
        let (high, high_box) = self.link(high, index, 2 * place + 1, axes);
        let whole = low_box.union(&high_box);
        let node = &mut self.nodes[index as usize];
        (node.low, node.high) = (low, high);
        (node.low_max, node.high_min) = (low_box.max[usize::from(axis)], high_box.min[usize::from(axis)]);
        node.small = (0..K).all(|k| f64::from(whole.max[k]) - f64::from(whole.min[k]) <= self.params.least_cell);
        (index, whole)
    }

    fn new_bucket(&mut self, entries: &[Entry], parent: u32) -> (u32, Box32) {
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

    /// Adds an entry to a bucket that has room.
    fn put(&mut self, bucket: u32, entry: &Entry) {
        let capacity = self.capacity();
        let b = &mut self.buckets[bucket as usize];
        let lane = b.count as usize;
        debug_assert!(lane < capacity);
        b.count += 1;
        b.bounds = b.bounds.union(&entry.b);
        let at = bucket as usize * capacity + lane;
        self.ids[at] = entry.id;
        self.boxes[at / LANES].set(at % LANES, &entry.b);
        if self.places.len() <= entry.id as usize {
            self.places.resize(entry.id as usize + 1, NOWHERE);
        }
        self.places[entry.id as usize] = at as u32;
    }

    fn entry(&self, at: usize) -> Entry {
        Entry { b: self.boxes[at / LANES].get(at % LANES), id: self.ids[at] }
    }

    /// Entries below a reference, appended; what held them is freed.
    fn unlink(&mut self, from: u32, entries: &mut Vec<Entry>) {
        let mut stack = vec![from];
        while let Some(at) = stack.pop() {
            if at & LEAF == 0 {
                let node = self.nodes[at as usize];
                stack.extend([node.high, node.low]);
                self.free_nodes.push(at);
            } else {
                let bucket = at & !LEAF;
                let first = bucket as usize * self.capacity();
                let count = self.buckets[bucket as usize].count as usize;
                entries.extend((first..first + count).map(|i| self.entry(i)));
                self.buckets[bucket as usize].count = 0;
                self.free_buckets.push(bucket);
            }
        }
    }

    /// Notes a change below `parent` on the way to the root, and builds the highest worn-out subtree anew.
    fn wear(&mut self, parent: u32) {
        let mut worn = None;
        let mut at = parent;
        while at != NOWHERE {
            let node = &mut self.nodes[at as usize];
            node.changes += 1;
            if node.changes > node.built {
                worn = Some(at);
            }
            at = node.parent;
        }
        if let Some(at) = worn {
            self.renew(at);
        }
    }

    /// Builds the subtree at a reference anew and tightens what its parent knows of it.
    fn renew(&mut self, at: u32) {
        let parent =
            if at & LEAF == 0 { self.nodes[at as usize].parent } else { self.buckets[(at & !LEAF) as usize].parent };
        let mut entries = Vec::new();
        self.unlink(at, &mut entries);
        if parent == NOWHERE {
            self.fill(&mut entries);
            return;
        }
        if entries.is_empty() {
            self.drop_child(parent, at);
            return;
        }
        let (new, bounds) = self.subtree(&mut entries, parent);
        let node = &mut self.nodes[parent as usize];
        let axis = usize::from(node.axis);
        if node.low == at {
            (node.low, node.low_max) = (new, bounds.max[axis]);
        } else {
            (node.high, node.high_min) = (new, bounds.min[axis]);
        }
    }

    /// Takes a child out that holds nothing: its sibling moves up in its parent's place.
    fn drop_child(&mut self, parent: u32, child: u32) {
        let node = self.nodes[parent as usize];
        let sibling = if node.low == child { node.high } else { node.low };
        let above = node.parent;
        if sibling & LEAF == 0 {
            self.nodes[sibling as usize].parent = above;
        } else {
            self.buckets[(sibling & !LEAF) as usize].parent = above;
        }
        self.free_nodes.push(parent);
        if above == NOWHERE {
            self.root = sibling;
            return;
        }
        let up = &mut self.nodes[above as usize];
        if up.low == parent {
            up.low = sibling;
        } else {
            up.high = sibling;
        }
    }

    /// The bucket for a box; nodes on the way are widened.
    fn descend(&mut self, b: &Box32) -> u32 {
        let mut at = self.root;
        while at & LEAF == 0 {
            let node = &mut self.nodes[at as usize];
            let axis = usize::from(node.axis);
            if b.middle(axis) < node.split {
                node.low_max = node.low_max.max(b.max[axis]);
                at = node.low;
            } else {
                node.high_min = node.high_min.min(b.min[axis]);
                at = node.high;
            }
        }
        at & !LEAF
    }

    /// Splits a full bucket in two to make room.
    fn split(&mut self, bucket: u32) {
        let parent = self.buckets[bucket as usize].parent;
        let first = bucket as usize * self.capacity();
        let mut entries: Vec<Entry> = (first..first + self.capacity()).map(|i| self.entry(i)).collect();
        self.buckets[bucket as usize].count = 0;
        self.free_buckets.push(bucket);
        let axes = [const { AtomicU8::new(0) }; 4];
        // As if there were one too many: two halves.
        order::<K>(&mut entries, self.capacity() - 1, 1, self.params.split_axis, &axes);
        let axis = axes[1].load(Ordering::Relaxed);
        let (low, high) = entries.split_at(entries.len() / 2);
        let node = Node {
            split: high[0].b.middle(usize::from(axis)),
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
        let index = self.free_nodes.pop().unwrap_or_else(|| {
            self.nodes.push(node);
            self.nodes.len() as u32 - 1
        });
        let (low, low_box) = self.new_bucket(low, index);
        let (high, high_box) = self.new_bucket(high, index);
        let k = usize::from(axis);
        self.nodes[index as usize] = Node { low, high, low_max: low_box.max[k], high_min: high_box.min[k], ..node };
        if parent == NOWHERE {
            self.root = index;
        } else {
            let up = &mut self.nodes[parent as usize];
            if up.low == bucket | LEAF {
                up.low = index;
            } else {
                up.high = index;
            }
        }
    }

    fn shift(&self, region: &Region) -> Shift {
        Shift::new(self.origin, region.origin(), &self.reach, K)
    }

    fn in_world(&self, b: &Box32) -> Aabb {
        let wide = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
        // Outward by the rounding of the sum.
        let (min, max) = (wide(b.min) + self.origin, wide(b.max) + self.origin);
        let slack = f64::EPSILON * (min.abs().max(max.abs()) + self.origin.abs());
        Aabb { min: min - slack, max: max + slack }
    }

    /// The boxes of a node's children within its own.
    #[inline(always)]
    fn halves(node: &Node, b: &Box32) -> (Box32, Box32) {
        let (mut low, mut high) = (*b, *b);
        let axis = usize::from(node.axis);
        low.max[axis] = low.max[axis].min(node.low_max);
        high.min[axis] = high.min[axis].max(node.high_min);
        (low, high)
    }

    /// Ids of everything below a reference, without a test.
    #[inline(always)]
    fn take(&self, from: u32, found: &mut Found) {
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

    #[inline(always)]
    fn walk<S: Shape>(&self, shape: &S, shift: &Shift, found: &mut Found) {
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
                // Below the least cell: no more cells, only what they hold.
                self.leaves_below(at, shape, shift, found);
                continue;
            }
            let (low, high) = Self::halves(node, &b);
            found.stack.push((node.high, high));
            found.stack.push((node.low, low));
        }
    }

    fn leaves_below<S: Shape>(&self, from: u32, shape: &S, shift: &Shift, found: &mut Found) {
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
    fn leaf<S: Shape>(&self, bucket: usize, shape: &S, shift: &Shift, found: &mut Found) {
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
    fn filter<S: Shape>(&self, bucket: usize, shape: &S, shift: &Shift, found: &mut Found) {
        if !self.params.filter {
            self.take(bucket as u32 | LEAF, found);
            return;
        }
        let count = self.buckets[bucket].count as usize;
        found.tested += count;
        let ids = &self.ids[bucket * self.capacity()..][..count];
        let boxes = &self.boxes[bucket * self.width..][..self.width];
        for (ids, boxes) in ids.chunks(LANES).zip(boxes) {
            // Lanes beyond the count are empty, but an infinite region knows no difference.
            let mut met = boxes.meet(shape, shift) & ((1 << ids.len()) - 1);
            while met != 0 {
                found.ids.push(ids[met.trailing_zeros() as usize]);
                met &= met - 1;
            }
        }
    }
}

/// Sorts entries into halves of halves until they fit a bucket, and notes the axis of each split at its place (1 is the
/// root, 2 and 3 its halves, ..).
fn order<const K: usize>(entries: &mut [Entry], capacity: usize, place: usize, split: SplitAxis, axes: &[AtomicU8]) {
    if entries.len() <= capacity {
        // Rising ids: neighbours of a mesh stay together.
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

/// Buckets that halving makes of so many entries.
fn leaves_of(count: usize, capacity: usize) -> usize {
    if count <= capacity {
        return 1;
    }
    let half = count / 2;
    // Both halves differ by at most one: the same depth but at a boundary.
    if count % 2 == 0 {
        2 * leaves_of(half, capacity)
    } else {
        leaves_of(half, capacity) + leaves_of(half + 1, capacity)
    }
}

struct Query<'a, const K: usize> {
    tree: &'a Skd<K>,
    shift: Shift,
    found: &'a mut Found,
}

impl<const K: usize> Visit for Query<'_, K> {
    type Out = ();

    fn visit<S: Shape>(self, shape: &S) {
        struct Walk<'a, S, const K: usize>(&'a S, Query<'a, K>);
        impl<S: Shape, const K: usize> pulp::WithSimd for Walk<'_, S, K> {
            type Output = ();

            #[inline(always)]
            fn with_simd<D: pulp::Simd>(self, _: D) {
                self.1.tree.walk(self.0, &self.1.shift, self.1.found);
            }
        }
        pulp::Arch::new().dispatch(Walk(shape, Query { tree: self.tree, shift: self.shift, found: self.found }));
    }
}

struct NearestFirst<'a, 'v, const K: usize> {
    tree: &'a Skd<K>,
    shift: Shift,
    visit: &'v mut dyn FnMut(NodeView<'_>) -> bool,
}

/// A node in the queue; the heap's greatest is the nearest.
struct Near(f64, u32, Box32);

impl PartialEq for Near {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}
impl Eq for Near {}
impl PartialOrd for Near {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Near {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        other.0.total_cmp(&self.0).then(other.1.cmp(&self.1))
    }
}

impl<const K: usize> Visit for NearestFirst<'_, '_, K> {
    type Out = ();

    fn visit<S: Shape>(self, shape: &S) {
        let tree = self.tree;
        let near = |at: u32, b: Box32| {
            let b = if at & LEAF == 0 { b } else { tree.buckets[(at & !LEAF) as usize].bounds };
            let here = self.shift.apply(&b);
            shape.meets(&here).then(|| Near(here.distance_squared(DVec3::ZERO).sqrt(), at, b))
        };
        let mut queue = BinaryHeap::new();
        if tree.root != NOWHERE {
            queue.extend(near(tree.root, tree.reach));
        }
        while let Some(Near(distance, at, b)) = queue.pop() {
            let bounds = tree.in_world(&b);
            if at & LEAF != 0 {
                let bucket = (at & !LEAF) as usize;
                let ids = &tree.ids[bucket * tree.capacity()..][..tree.buckets[bucket].count as usize];
                (self.visit)(NodeView { bounds, distance, ids });
            } else if (self.visit)(NodeView { bounds, distance, ids: &[] }) {
                let node = &tree.nodes[at as usize];
                let (low, high) = Skd::<K>::halves(node, &b);
                queue.extend(near(node.low, low));
                queue.extend(near(node.high, high));
            }
        }
    }
}

impl<const K: usize> SpatialIndex for Skd<K> {
    fn len(&self) -> usize {
        self.count
    }

    fn bounds_of(&self, id: u32) -> Option<Aabb> {
        let at = *self.places.get(id as usize)?;
        (at != NOWHERE).then(|| self.in_world(&self.entry(at as usize).b))
    }

    fn insert(&mut self, id: u32, bounds: &Aabb) {
        self.remove(id);
        if self.count == 0 {
            self.origin = bounds.center();
        }
        let entry = Entry { b: Box32::around(bounds, self.origin), id };
        self.count += 1;
        self.reach = self.reach.union(&entry.b);
        if self.root == NOWHERE {
            self.root = self.new_bucket(&[entry], NOWHERE).0;
            return;
        }
        let mut bucket = self.descend(&entry.b);
        if self.buckets[bucket as usize].count as usize == self.capacity() {
            self.split(bucket);
            bucket = self.descend(&entry.b);
        }
        self.put(bucket, &entry);
        self.wear(self.buckets[bucket as usize].parent);
    }

    fn remove(&mut self, id: u32) -> bool {
        let Some(at) = self.places.get(id as usize).copied().filter(|at| *at != NOWHERE) else {
            return false;
        };
        let at = at as usize;
        self.places[id as usize] = NOWHERE;
        self.count -= 1;
        let bucket = at / self.capacity();
        let first = bucket * self.capacity();
        let last = first + self.buckets[bucket].count as usize - 1;
        let moved = self.entry(last);
        self.ids[last] = NOWHERE;
        if last != at {
            self.ids[at] = moved.id;
            self.boxes[at / LANES].set(at % LANES, &moved.b);
            self.places[moved.id as usize] = at as u32;
        }
        self.buckets[bucket].count -= 1;
        let count = self.buckets[bucket].count as usize;
        self.buckets[bucket].bounds = (first..first + count).fold(Box32::EMPTY, |all, i| all.union(&self.entry(i).b));
        let parent = self.buckets[bucket].parent;
        if count == 0 {
            self.free_buckets.push(bucket as u32);
            if parent == NOWHERE {
                self.fill(&mut []);
                return true;
            }
            let above = self.nodes[parent as usize].parent;
            self.drop_child(parent, bucket as u32 | LEAF);
            self.wear(above);
        } else {
            self.wear(parent);
        }
        true
    }

    fn query(&self, region: &Region, found: &mut Found) {
        region.with(Query { tree: self, shift: self.shift(region), found });
    }

    fn nearest_first(&self, region: &Region, visit: &mut dyn FnMut(NodeView<'_>) -> bool) {
        region.with(NearestFirst { tree: self, shift: self.shift(region), visit });
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
            + self.nodes.capacity() * size_of::<Node>()
            + self.buckets.capacity() * size_of::<Bucket>()
            + self.boxes.capacity() * size_of::<Boxes8>()
            + (self.ids.capacity() + self.places.capacity()) * size_of::<u32>()
            + (self.free_nodes.capacity() + self.free_buckets.capacity()) * size_of::<u32>()
    }

    fn boxed_clone(&self) -> Box<dyn SpatialIndex> {
        Box::new(self.clone())
    }

    fn assert_well_formed(&self) {
        let mut stack = Vec::new();
        if self.root != NOWHERE {
            stack.push((self.root, NOWHERE, self.reach));
        }
        let (mut nodes, mut buckets, mut count) = (0, 0, 0);
        while let Some((at, parent, within)) = stack.pop() {
            if at & LEAF == 0 {
                let node = &self.nodes[at as usize];
                assert_eq!(node.parent, parent);
                assert!(usize::from(node.axis) < K && node.changes <= node.built);
                let (low, high) = Self::halves(node, &within);
                stack.extend([(node.low, at, low), (node.high, at, high)]);
                nodes += 1;
                continue;
            }
            let bucket = self.buckets[(at & !LEAF) as usize];
            assert_eq!(bucket.parent, parent);
            assert!(bucket.count > 0 && bucket.count as usize <= self.capacity());
            let first = (at & !LEAF) as usize * self.capacity();
            let mut union = Box32::EMPTY;
            for i in first..first + bucket.count as usize {
                let entry = self.entry(i);
                assert_eq!(self.places[entry.id as usize] as usize, i);
                assert!(within.holds(&entry.b), "a box reaches out of its node");
                union = union.union(&entry.b);
            }
            assert_eq!(union, bucket.bounds);
            buckets += 1;
            count += bucket.count as usize;
        }
        assert_eq!(count, self.count);
        assert_eq!(self.places.iter().filter(|p| **p != NOWHERE).count(), self.count);
        assert_eq!(nodes + self.free_nodes.len(), self.nodes.len(), "nodes leak");
        assert_eq!(buckets + self.free_buckets.len(), self.buckets.len(), "buckets leak");
    }
}
