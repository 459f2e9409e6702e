//! The world cut at one height: everything that a level one-row scanner can meet, as segments in a tree.

use crate::plan::facings;
use glam::{DVec2, DVec3};
use presight_model::environment::Object;
use presight_model::geometry::Aabb;
use presight_model::index::{QueryResult, Region};
use presight_model::world::World;

/// Relative tolerance for corners on their plane: far below f32 rounding of ranges, far above f64 rounding.
const PLANE: f64 = 1e-10;

/// Maximum number of segments in a leaf.
const LEAF: usize = 2;

/// Maximum depth of optimized splits; deeper nodes are halved.
const MOST_DEPTH: usize = 40;

/// One version of the world at one height, for one sensor class.
#[derive(Debug, Default)]
pub struct RowCut {
    /// Where polygons cross the height.
    pub segments: Vec<Segment>,
    /// The root is first; a node's left child follows it.
    pub nodes: Vec<Node>,
    /// World positions, each with the offset of the plane through it.
    pub corners: Vec<(DVec3, f64)>,
}

/// Intersection of a polygon with the height.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    pub a: DVec2,
    pub b: DVec2,
    /// Horizontal part of the polygon's unit normal.
    pub normal: DVec2,
    /// The polygon's plane at this height is `normal . p = offset`.
    pub offset: f64,
    /// For a polygon that is not exactly planar: its range in [`RowCut::corners`]. As in images, its plane passes
    /// through the corner nearest to the scanner.
    pub corners: (u32, u32),
    /// Visible only from the normal's side.
    pub one_sided: bool,
}

/// A bounding box of segments.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    pub min: DVec2,
    pub max: DVec2,
    /// First segment of a leaf, or the right child.
    pub at: u32,
    /// Number of segments of a leaf; 0 for an inner node.
    pub count: u32,
}

impl RowCut {
    /// Cuts all polygons that are opaque to the class.
    pub fn new(world: &World, class: &str, height: f64) -> Self {
        let environment = world.environment();
        let facings: Vec<_> = facings(environment, class).collect();
        let bounds = environment.bounds();
        let mut cut = Self::default();
        if bounds.is_empty() || !(bounds.min.z <= height && height <= bounds.max.z) {
            return cut;
        }
        let slice = Aabb { min: bounds.min.with_z(height), max: bounds.max.with_z(height) };
        let (mut found, mut runs) = (QueryResult::default(), Vec::new());
        world.index().select(environment, &Region::cuboid(&slice), &mut found, &mut runs);
        for objects in runs.chunk_by(|a, b| a.object == b.object) {
            let object = &environment.objects()[objects[0].object as usize];
            let world_from_mesh = object.world_from_mesh();
            let normal_from_mesh = world_from_mesh.matrix3.inverse().transpose();
            let Some(absent) = environment.absent_parts(objects[0].object, class) else { continue };
            let is_absent = |polygon| environment.lies_in(objects[0].object, polygon, &absent);
            for polygon in objects.iter().flat_map(|run| run.first..run.first + run.count).filter(|p| !is_absent(*p)) {
                let facing = facings[usize::from(object.mesh.material(polygon))];
                let ends = if facing.opaque { cross(object, polygon, height) } else { None };
                let Some([a, b]) = ends else { continue };
                let normal = (normal_from_mesh * object.mesh.plane(polygon).normal).normalize();
                let first = cut.corners.len();
                let corners = object.mesh.corners_of(polygon).map(|p| world_from_mesh.transform_point3(p));
                cut.corners.extend(corners.map(|p| (p, normal.dot(p) - normal.z * height)));
                let offset = cut.corners[first].1;
                let spread = cut.corners[first..].iter().map(|(_, o)| (o - offset).abs()).fold(0.0, f64::max);
                if spread <= PLANE * (1.0 + offset.abs()) {
                    cut.corners.truncate(first);
                }
                let corners = (first as u32, cut.corners.len() as u32);
                let segment = Segment { a, b, normal: normal.truncate(), offset, corners, one_sided: facing.one_sided };
                // Horizontal polygons are edge-on to the row.
                if segment.normal != DVec2::ZERO {
                    cut.segments.push(segment);
                }
            }
        }
        let mut segments = std::mem::take(&mut cut.segments);
        cut.grow(&mut segments);
        cut.segments = segments;
        cut
    }

    fn grow(&mut self, segments: &mut [Segment]) {
        if !segments.is_empty() {
            self.grow_from(segments, 0, 0);
        }
    }

    /// Sorts segments into a tree; `placed` counts the segments in earlier leaves.
    fn grow_from(&mut self, segments: &mut [Segment], placed: usize, depth: usize) {
        let (mut min, mut max) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for s in &*segments {
            (min, max) = (min.min(s.a.min(s.b)), max.max(s.a.max(s.b)));
        }
        let node = self.nodes.len();
        self.nodes.push(Node { min, max, at: placed as u32, count: segments.len() as u32 });
        if segments.len() <= LEAF {
            return;
        }
        let at = if depth < MOST_DEPTH { best_split(segments) } else { segments.len() / 2 };
        let (left, right) = segments.split_at_mut(at);
        self.grow_from(left, placed, depth + 1);
        let right_child = self.nodes.len() as u32;
        self.grow_from(right, placed + at, depth + 1);
        (self.nodes[node].at, self.nodes[node].count) = (right_child, 0);
    }
}

/// Sorts segments along the best axis and returns the best split: it minimizes the perimeters of both boxes, weighted
/// by their segments. The number of beams that see a box is proportional to its perimeter.
fn best_split(segments: &mut [Segment]) -> usize {
    let key = |s: &Segment, axis: usize| s.a[axis] + s.b[axis];
    let sides = |(min, max): (DVec2, DVec2)| (max - min).element_sum();
    let hold = |(min, max): (DVec2, DVec2), s: &Segment| (min.min(s.a.min(s.b)), max.max(s.a.max(s.b)));
    let nothing = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    let (mut best, mut rest) = ((f64::INFINITY, 0, segments.len() / 2), vec![0.0; segments.len()]);
    for axis in 0..2 {
        segments.sort_unstable_by(|a, b| key(a, axis).total_cmp(&key(b, axis)));
        let mut held = nothing;
        for (i, s) in segments.iter().enumerate().rev() {
            held = hold(held, s);
            rest[i] = sides(held) * (segments.len() - i) as f64;
        }
        held = nothing;
        for (i, s) in segments.iter().enumerate().take(segments.len() - 1) {
            held = hold(held, s);
            let cost = sides(held) * (i + 1) as f64 + rest[i + 1];
            if cost < best.0 {
                best = (cost, axis, i + 1);
            }
        }
    }
    if best.1 == 0 {
        segments.sort_unstable_by(|a, b| key(a, 0).total_cmp(&key(b, 0)));
    }
    best.2
}

/// Endpoints of a convex polygon's intersection with a height, if it has a positive length.
fn cross(object: &Object, polygon: u32, height: f64) -> Option<[DVec2; 2]> {
    let world_from_mesh = object.world_from_mesh();
    let mut points = object.mesh.corners_of(polygon).map(|p| world_from_mesh.transform_point3(p));
    let first = points.next()?;
    let (mut ends, mut last) = (Ends::default(), first);
    for p in points.chain([first]) {
        ends.add_side(last, p, height);
        last = p;
    }
    ends.0.filter(|[a, b]| a != b)
}

/// The two most distant points so far.
#[derive(Default)]
struct Ends(Option<[DVec2; 2]>);

impl Ends {
    fn add_side(&mut self, from: DVec3, to: DVec3, height: f64) {
        let (below, above) = (from.z - height, to.z - height);
        if below == 0.0 {
            self.add(from.truncate());
        } else if (below < 0.0) != (above < 0.0) && above != 0.0 {
            // The end that is first in a fixed order is the origin, so that neighbours compute the same point.
            let (p, q) = if from.to_array() <= to.to_array() { (from, to) } else { (to, from) };
            let t = (height - p.z) / (q.z - p.z);
            self.add((p + (q - p) * t).truncate());
        }
    }

    fn add(&mut self, p: DVec2) {
        let Some([a, b]) = self.0 else {
            self.0 = Some([p, p]);
            return;
        };
        let apart = a.distance_squared(b);
        let (from_a, from_b) = (p.distance_squared(a), p.distance_squared(b));
        if from_a > apart && from_a >= from_b {
            self.0 = Some([a, p]);
        } else if from_b > apart {
            self.0 = Some([p, b]);
        }
    }
}
