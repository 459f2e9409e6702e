//! The tree of one mesh, in the mesh's own frame and shared by its instances: nodes over clusters, and a box for each
//! polygon. A mesh keeps its polygons in the order of such a tree, so that every node is one contiguous run.

use super::boxes::{Box32, Boxes8, LANES, Shift};
use super::shapes::Shape;
use crate::environment::Mesh;
use crate::geometry::Aabb;
use glam::{DVec3, Vec3};
use std::ops::Range;

/// Nodes in preorder.
#[derive(Clone, Debug)]
pub struct MeshTree {
    nodes: Vec<Node>,
    /// Boxes of the polygons, in groups of eight.
    boxes: Vec<Boxes8>,
}

/// Boxes of a mesh's polygons, in groups of eight.
pub struct PolygonBoxes(Vec<Boxes8>);

impl PolygonBoxes {
    /// Empty boxes for `polygons` polygons.
    pub fn new(polygons: usize) -> Self {
        Self(vec![Boxes8::EMPTY; polygons.div_ceil(LANES)])
    }

    /// Sets the box of a polygon.
    #[inline]
    pub fn set(&mut self, polygon: usize, (min, max): (Vec3, Vec3)) {
        self.0[polygon / LANES].set(polygon % LANES, &Box32 { min: min.to_array(), max: max.to_array() });
    }
}

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Box32,
    /// Its polygons.
    first: u32,
    count: u32,
    /// The next node outside this subtree.
    next: u32,
}

/// A cluster, or a part of one, reached by a walk.
pub(super) struct Part {
    pub first: u32,
    pub count: u32,
    /// Its box relative to the region's origin, in the mesh's axes.
    pub bounds: Aabb,
    /// True if all of it is in the region.
    pub whole: bool,
}

impl MeshTree {
    /// The tree of a mesh.
    pub fn new(mesh: &Mesh) -> Self {
        let mut boxes = PolygonBoxes::new(mesh.polygon_count());
        for (i, record) in mesh.polygons().iter().enumerate() {
            boxes.set(i, record.extent(mesh.all_corners(), mesh.vertices()));
        }
        Self::with_boxes(mesh, boxes)
    }

    /// The tree of a mesh with the given boxes of its polygons.
    pub fn with_boxes(mesh: &Mesh, PolygonBoxes(boxes): PolygonBoxes) -> Self {
        assert_eq!(boxes.len(), mesh.polygon_count().div_ceil(LANES));
        let clusters: Vec<Box32> = mesh.clusters().iter().map(|c| Box32::around(&c.bounds, DVec3::ZERO)).collect();
        let mut tree = Self { nodes: Vec::with_capacity(2 * clusters.len()), boxes };
        if !clusters.is_empty() {
            tree.link(mesh, &clusters, 0);
        }
        tree
    }

    fn link(&mut self, mesh: &Mesh, boxes: &[Box32], from: usize) {
        let clusters = &mesh.clusters()[from..from + boxes.len()];
        let (first, last) = (clusters[0], clusters[clusters.len() - 1]);
        let index = self.nodes.len();
        let bounds = boxes.iter().fold(Box32::EMPTY, |all, b| all.union(b));
        self.nodes.push(Node { bounds, first: first.first, count: last.first + last.count - first.first, next: 0 });
        if boxes.len() > 1 {
            let middle = boxes.len() / 2;
            self.link(mesh, &boxes[..middle], from);
            self.link(mesh, &boxes[middle..], from + middle);
        }
        self.nodes[index].next = self.nodes.len() as u32;
    }

    /// The next part, from node `at` on, that meets the shape: a node wholly inside it, or a leaf. In rising order.
    #[inline(always)]
    pub(super) fn next_part<S: Shape>(
        &self,
        at: &mut usize,
        shape: &S,
        shift: &Shift,
        visited: &mut usize,
    ) -> Option<Part> {
        while let Some(node) = self.nodes.get(*at) {
            *visited += 1;
            let bounds = shift.apply(&node.bounds);
            let leaf = node.next as usize == *at + 1;
            if !shape.meets(&bounds) {
                *at = node.next as usize;
                continue;
            }
            let whole = shape.covers(&bounds);
            if whole || leaf {
                *at = node.next as usize;
                return Some(Part { first: node.first, count: node.count, bounds, whole });
            }
            *at += 1;
        }
        None
    }

    /// Groups of eight polygons that overlap a part.
    pub(super) fn groups(part: &Part) -> Range<u32> {
        part.first / LANES as u32..(part.first + part.count).div_ceil(LANES as u32)
    }

    /// The polygons of a group that belong to the part and meet the shape, one bit each.
    #[inline(always)]
    pub(super) fn filter<S: Shape>(&self, group: u32, part: &Part, shape: &S, shift: &Shift) -> u32 {
        let first = i64::from(group) * LANES as i64;
        let below = (i64::from(part.first) - first).max(0) as u32;
        let above = (i64::from(part.first + part.count) - first).min(LANES as i64) as u32;
        let own = ((1u32 << above) - 1) & !((1u32 << below) - 1);
        self.boxes[group as usize].meet(shape, shift) & own
    }

    pub(super) fn bounds(&self) -> Box32 {
        self.nodes.first().map_or(Box32::EMPTY, |root| root.bounds)
    }

    /// Bytes of memory.
    pub fn bytes(&self) -> usize {
        self.nodes.capacity() * size_of::<Node>() + self.boxes.capacity() * size_of::<Boxes8>()
    }

    /// Panics unless each polygon lies within the boxes above it (tests).
    pub fn assert_well_formed(&self, mesh: &Mesh) {
        let mut clusters = mesh.clusters().iter();
        let mut end = 0;
        for (at, node) in self.nodes.iter().enumerate() {
            if node.next as usize == at + 1 {
                let cluster = clusters.next();
                assert_eq!(cluster.map(|c| (c.first, c.count)), Some((node.first, node.count)));
                assert_eq!(node.first, end, "leaves follow each other");
                end = node.first + node.count;
            }
            for polygon in node.first..node.first + node.count {
                let b = self.boxes[polygon as usize / LANES].get(polygon as usize % LANES);
                assert!(node.bounds.holds(&b), "a box reaches out of its node");
                for p in mesh.corner_indices(polygon).iter().map(|c| mesh.vertices()[*c as usize].to_array()) {
                    assert!(b.holds(&Box32 { min: p, max: p }), "a corner reaches out of its box");
                }
            }
        }
        assert!(clusters.next().is_none());
        assert_eq!(end as usize, mesh.polygon_count());
    }
}
