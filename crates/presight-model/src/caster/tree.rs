//! A tree of boxes for rays and for nearest points.

use crate::geometry::Aabb;
use crate::index::boxes::Box32;
use glam::DVec3;
use std::ops::Range;

/// A binary tree of bounding boxes over a list of items. The items of each node are consecutive.
#[derive(Clone, Debug, Default)]
pub(super) struct BoxTree {
    nodes: Vec<Node>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Box32,
    /// First item of a leaf, or the second child of an inner node. The first child is the next node.
    at: u32,
    /// Number of items of a leaf; 0 for an inner node.
    count: u32,
}

/// Maximum number of nodes that wait during a walk: one a level, and one more. A tree that halves 2^32 items has 33
/// levels.
const STACK: usize = 34;

impl BoxTree {
    /// Sorts the items into leaves of at most `max_leaf` by halving them at the median of `center` along the longest
    /// axis of their box.
    pub fn new<T>(
        items: &mut [T],
        max_leaf: usize,
        bounds: &impl Fn(&T) -> Aabb,
        center: &impl Fn(&T, usize) -> f64,
    ) -> Self {
        let mut tree = Self::default();
        if !items.is_empty() {
            tree.grow(items, 0, max_leaf, bounds, center);
        }
        tree
    }

    fn grow<T>(
        &mut self,
        items: &mut [T],
        first: usize,
        max_leaf: usize,
        bounds: &impl Fn(&T) -> Aabb,
        center: &impl Fn(&T, usize) -> f64,
    ) {
        let all = items.iter().fold(Aabb::EMPTY, |all, item| all.union(bounds(item)));
        let (node, count) = (self.nodes.len(), items.len());
        self.nodes.push(Node { bounds: Box32::around(&all, DVec3::ZERO), at: first as u32, count: count as u32 });
        if count <= max_leaf {
            return;
        }
        let size = all.half_extent();
        let axis = (0..3).max_by(|a, b| size[*a].total_cmp(&size[*b])).unwrap_or(0);
        let half = count / 2;
        items.select_nth_unstable_by(half, |a, b| center(a, axis).total_cmp(&center(b, axis)));
        let (low, high) = items.split_at_mut(half);
        self.grow(low, first, max_leaf, bounds, center);
        (self.nodes[node].at, self.nodes[node].count) = (self.nodes.len() as u32, 0);
        self.grow(high, first + half, max_leaf, bounds, center);
    }

    /// Visits the leaves that a ray meets within `range`. A visit may shorten the range.
    pub fn along_ray(&self, origin: DVec3, ray: DVec3, range: f64, visit: impl FnMut(Range<usize>, &mut f64)) {
        let inverse = ray.recip();
        let meets = |bounds: &Aabb, range: f64| {
            let (a, b) = ((bounds.min - origin) * inverse, (bounds.max - origin) * inverse);
            // `min` and `max` ignore NaN, the result for a ray in a side of a box.
            let near = a.x.min(b.x).max(a.y.min(b.y)).max(a.z.min(b.z)).max(0.0);
            let far = a.x.max(b.x).min(a.y.max(b.y)).min(a.z.max(b.z));
            near <= far && near < range
        };
        self.walk(range, meets, visit);
    }

    /// Visits the leaves with a box within a squared distance of a point. A visit may shorten the distance.
    pub fn around_point(&self, p: DVec3, distance_squared: f64, visit: impl FnMut(Range<usize>, &mut f64)) {
        self.walk(distance_squared, |bounds, limit| bounds.distance_squared(p) < limit, visit);
    }

    fn walk(&self, mut limit: f64, meets: impl Fn(&Aabb, f64) -> bool, mut visit: impl FnMut(Range<usize>, &mut f64)) {
        let wide = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
        let mut stack = [0u32; STACK];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let at = stack[depth] as usize;
            let node = &self.nodes[at];
            if !meets(&Aabb { min: wide(node.bounds.min), max: wide(node.bounds.max) }, limit) {
                continue;
            }
            if node.count > 0 {
                let first = node.at as usize;
                visit(first..first + node.count as usize, &mut limit);
            } else {
                (stack[depth], stack[depth + 1]) = (node.at, at as u32 + 1);
                depth += 2;
            }
        }
    }
}
