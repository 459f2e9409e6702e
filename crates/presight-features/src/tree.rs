//! Bounding-box trees over the features of a layer, one per object in its frame. They stay valid when objects move.

use super::PlacedFeature;
use super::visible::workspaces::WorkspaceMemory;
use glam::DVec3;
use presight_model::contour::ContourSet;
use presight_model::environment::Environment;
use presight_model::error::{Error, Result};
use presight_model::geometry::Aabb;
use std::ops::Range;

/// Maximum number of features in a leaf.
const LEAF: usize = 8;

/// Features sorted by position, and by the polygons on which they lie.
#[derive(Debug)]
pub struct FeatureTree {
    /// The features of each object, and of the world.
    pub groups: Vec<Group>,
    /// All nodes.
    pub nodes: Vec<Node>,
    /// Feature indices. The features of a node are consecutive.
    pub order: Vec<u32>,
    /// Pairs of a polygon's slot and a position in `order` of a feature on it, sorted.
    carried: Vec<(u32, u32)>,
    /// Time of the newest confirmation, UTC seconds.
    pub newest: f64,
    /// Working memory of predictions.
    pub(crate) memory: WorkspaceMemory,
}

/// The features of one object, or of the world.
#[derive(Clone, Copy, Debug)]
pub struct Group {
    pub object: Option<u32>,
    pub root: u32,
}

/// Bounding box of some features, in the frame of their object.
#[derive(Clone, Debug)]
pub struct Node {
    pub bounds: Aabb,
    /// Range in `order`.
    pub some: Range<u32>,
    /// The second child; the first is the next node. `None` for a leaf.
    pub second: Option<u32>,
}

impl FeatureTree {
    /// Builds the trees. The contours must be prepared.
    pub fn new(placed: &[PlacedFeature], contours: &ContourSet) -> Self {
        let bounds = |(i, p): (usize, &PlacedFeature)| match contours.get(i) {
            Some(surface) => Aabb::of(surface.hull),
            None => Aabb::of(p.feature.shape.points().iter().copied()),
        };
        let boxes: Vec<Aabb> = placed.iter().enumerate().map(bounds).collect();
        let mut order: Vec<u32> = (0..placed.len() as u32).collect();
        order.sort_by_key(|i| placed[*i as usize].object);
        let (mut groups, mut nodes) = (Vec::new(), Vec::new());
        let mut start = 0;
        while start < order.len() {
            let object = placed[order[start] as usize].object;
            let end = start + order[start..].partition_point(|i| placed[*i as usize].object == object);
            groups.push(Group { object, root: nodes.len() as u32 });
            split(&boxes, &mut order[start..end], start as u32, &mut nodes);
            start = end;
        }
        let on = |(at, i): (u32, &u32)| placed[*i as usize].slots.iter().map(move |slot| (*slot, at));
        let mut carried: Vec<(u32, u32)> = (0..).zip(&order).flat_map(on).collect();
        carried.sort_unstable();
        Self { groups, nodes, order, carried, newest: newest(placed), memory: WorkspaceMemory::default() }
    }

    /// Returns true if a feature in this range of `order` lies on the polygon of a slot.
    pub fn carries(&self, slot: u32, some: &Range<u32>) -> bool {
        let first = self.carried.partition_point(|at| *at < (slot, some.start));
        self.carried.get(first).is_some_and(|at| *at < (slot, some.end))
    }
}

/// Time of the newest confirmation, UTC seconds.
pub(super) fn newest(placed: &[PlacedFeature]) -> f64 {
    placed.iter().map(|p| p.feature.existence.confirmed).fold(f64::NEG_INFINITY, f64::max)
}

/// Appends a node and its subtree.
fn split(boxes: &[Aabb], order: &mut [u32], first: u32, nodes: &mut Vec<Node>) {
    let bounds = order.iter().fold(Aabb::EMPTY, |sum, i| sum.union(boxes[*i as usize]));
    let at = nodes.len();
    nodes.push(Node { bounds, some: first..first + order.len() as u32, second: None });
    if order.len() <= LEAF {
        return;
    }
    let center = |i: &u32| boxes[*i as usize].center();
    let centers = Aabb::of(order.iter().map(center));
    let size = centers.max - centers.min;
    let axis = (0..3).fold(0, |best, k| if size[k] > size[best] { k } else { best });
    let half = order.len() / 2;
    order.select_nth_unstable_by(half, |a, b| center(a)[axis].total_cmp(&center(b)[axis]).then(a.cmp(b)));
    let (low, high) = order.split_at_mut(half);
    split(boxes, low, first, nodes);
    nodes[at].second = Some(nodes.len() as u32);
    split(boxes, high, first + half as u32, nodes);
}

/// Checks that the objects and polygons of features exist.
///
/// # Errors
/// [`presight_model::ErrorKind::Invalid`] naming the first feature whose object or polygon does not exist.
pub fn check_placed(environment: &Environment, placed: &[PlacedFeature]) -> Result<()> {
    let objects = environment.objects().len();
    for p in placed {
        let slot = p.slots.iter().find(|slot| environment.locate(**slot).is_none());
        if p.object.is_some_and(|o| o as usize >= objects) || slot.is_some() {
            let what = format!("object {:?} or slot {slot:?} does not exist", p.object);
            let e = Error::invalid(what, "place the features in this world");
            return Err(e.at(format!("feature {}", p.feature.id)));
        }
    }
    Ok(())
}

impl Node {
    /// Centre and half size, enlarged by `rounding` for inexact feature positions.
    pub fn middle(&self, rounding: f64) -> [DVec3; 2] {
        [self.bounds.center(), self.bounds.half_extent() + rounding]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;
    use presight_model::environment::{Existence, Feature, FeatureShape, Properties};

    fn point(id: u32, at: DVec3, object: Option<u32>) -> PlacedFeature {
        let shape = FeatureShape::Point { at, covariance: DMat3::ZERO };
        let (existence, properties) = (Existence::default(), Properties::default());
        let feature = Feature { id, name: None, object: None, shape, existence, properties };
        PlacedFeature { feature: feature.into(), object, slots: vec![id % 5] }
    }

    #[test]
    fn every_feature_is_in_one_leaf_and_in_all_boxes_above_it() {
        // Features in one place, in a line, and spread out; on the world and on two objects.
        let at = |i: u32| match i % 3 {
            0 => DVec3::ONE,
            1 => DVec3::X * f64::from(i),
            _ => DVec3::new(f64::from(i * 7 % 101), f64::from(i * 31 % 97), f64::from(i)),
        };
        let object = |i: u32| [None, Some(0), Some(4)][i as usize * 3 / 500];
        let placed: Vec<PlacedFeature> = (0..500).map(|i| point(i, at(i), object(i))).collect();
        let tree = FeatureTree::new(&placed, &ContourSet::default());
        let mut order = tree.order.clone();
        order.sort_unstable();
        assert_eq!(order, (0..500).collect::<Vec<_>>());
        assert_eq!(tree.groups.iter().map(|g| g.object).collect::<Vec<_>>(), [None, Some(0), Some(4)]);
        let mut leaves = 0;
        for (k, node) in tree.nodes.iter().enumerate() {
            let of = |i: &u32| placed[tree.order[*i as usize] as usize].feature.shape.points()[0];
            assert!(node.some.clone().map(|i| of(&i)).all(|p| node.bounds.union(Aabb::of([p])) == node.bounds));
            match node.second {
                None => leaves += node.some.len(),
                Some(second) => {
                    let (a, b) = (&tree.nodes[k + 1].some, &tree.nodes[second as usize].some);
                    assert_eq!((a.start, a.end, b.end), (node.some.start, b.start, node.some.end));
                }
            }
            for slot in 0..6 {
                let carries = node.some.clone().any(|i| tree.order[i as usize] % 5 == slot);
                assert_eq!(tree.carries(slot, &node.some), carries);
            }
        }
        assert_eq!(leaves, 500);
        assert!(FeatureTree::new(&[], &ContourSet::default()).groups.is_empty());
    }
}
