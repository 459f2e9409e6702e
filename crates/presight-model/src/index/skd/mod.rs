//! Spatial-kD tree: ids by centroid. Each node holds a hyperplane and how far the ids of each side extend across it
//! (Ooi, Sacks-Davis and McDonell, "Spatial indexing by binary decomposition and spatial bounding", 1987/1991).

mod build;
mod query;

use super::boxes::{Box32, Boxes8, LANES};
use super::{LEAF, Params, QueryResult, Region, SpatialIndex, Traversal};
use crate::geometry::Aabb;
use glam::DVec3;

/// A spatial-kD tree over the first `K` axes. Boxes are kept in f32, rounded outward.
///
/// Leaves are buckets of boxes, tested eight at a time. A subtree is rebuilt after as many changes as it had entries
/// when built, so the tree stays close to a fresh build.
#[derive(Clone, Debug)]
pub struct Skd<const K: usize> {
    params: Params,
    origin: DVec3,
    /// Contains every box since the last full build.
    reach: Box32,
    root: u32,
    count: usize,
    nodes: Vec<Node>,
    buckets: Vec<Bucket>,
    /// `width` groups of eight lanes per bucket, and the id in each lane.
    boxes: Vec<Boxes8>,
    ids: Vec<u32>,
    /// Lane of each id, or NOWHERE.
    places: Vec<u32>,
    free_nodes: Vec<u32>,
    free_buckets: Vec<u32>,
    /// Groups of lanes per bucket.
    width: usize,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    /// Hyperplane: twice a centroid's coordinate; smaller values are on the low side.
    split: f32,
    /// Upper end of the low side's boxes, and lower end of the high side's.
    low_max: f32,
    high_min: f32,
    low: u32,
    high: u32,
    parent: u32,
    /// Number of entries below when it was built, and changes since.
    built: u32,
    changes: u32,
    axis: u8,
    /// No larger than the minimum cell, so its children are not tested.
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
impl<const K: usize> Skd<K> {
    /// Builds a tree. If an id occurs twice, its last box is used.
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
        // The last of equal ids is kept; earlier ones are dropped before building.
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

    /// Appends the entries below a reference and frees its nodes and buckets.
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

    /// Counts a change on the path from `parent` to the root, and rebuilds the highest worn-out subtree.
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

    /// Rebuilds the subtree at a reference and tightens the bound in its parent.
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
        let (new, bounds) = self.subtree(&mut entries, parent, self.capacity());
        let node = &mut self.nodes[parent as usize];
        let axis = usize::from(node.axis);
        if node.low == at {
            (node.low, node.low_max) = (new, bounds.max[axis]);
        } else {
            (node.high, node.high_min) = (new, bounds.min[axis]);
        }
    }

    /// Removes an empty child: its sibling takes its parent's place.
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

    /// The bucket for a box. Widens the nodes above it.
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
        // A capacity lower by one forces two halves.
        let (new, _) = self.subtree(&mut entries, parent, self.capacity() - 1);
        if parent == NOWHERE {
            self.root = new;
            return;
        }
        let up = &mut self.nodes[parent as usize];
        if up.low == bucket | LEAF {
            up.low = new;
        } else {
            up.high = new;
        }
    }
}

impl<const K: usize> SpatialIndex for Skd<K> {
    fn name(&self) -> &'static str {
        if K == 2 { "s2d" } else { "s3d" }
    }

    fn rebuilt(&self, boxes: &[(u32, Aabb)]) -> Box<dyn SpatialIndex> {
        Box::new(Self::build(self.params, boxes))
    }

    fn len(&self) -> usize {
        self.count
    }

    fn bounds_of(&self, id: u32) -> Option<Aabb> {
        let at = *self.places.get(id as usize)?;
        (at != NOWHERE).then(|| self.entry(at as usize).b.in_world(self.origin))
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

    fn query(&self, region: &Region, found: &mut QueryResult) {
        self.traverse(region, found);
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
