//! Merges coplanar neighbours of one material into convex polygons.
//!
//! Hertel-Mehlhorn: visits inner edges, the longest first, and drops each whose removal leaves a convex polygon.
//! "Convex" is strict, as the rasterizer needs it: no corner of the actual f32 vertices turns inwards, because the
//! half-spaces of the edges would cut area away. Afterwards a vertex is dropped if it lies straight between its two
//! neighbours in *every* polygon that uses it; dropping it in only some of them would leave a T-junction.

use super::edges::NONE;
use super::{Triangle, TriangleMesh};
use glam::{DVec3, Vec3};
use presight_model::environment::Parts;
use presight_model::geometry::Aabb;
use presight_model::union_find::UnionFind;

/// Maximum number of corners of a merged polygon. A higher limit would merge a few more fans, but slow every
/// engine's worst case.
const MERGED_CORNERS: usize = 8;

/// Maximum angle, radians, between a source triangle and its merged polygon. It keeps the reflection angle of details
/// much smaller than the mesh, which the tolerance on distances alone would flatten.
const MAX_TILT: f64 = 1e-3;

/// A corner whose sine is below this is straight, even if it turns inwards.
const STRAIGHT: f64 = 1e-12;

/// Merging edges and dropping vertices alternate until nothing changes, at most this many times.
const ROUNDS: usize = 3;

/// The result of merging a mesh.
pub(crate) struct MergeResult {
    pub parts: Parts,
    /// Merges of two polygons into one.
    pub merges: u64,
    /// Maximum distance of a source vertex from the plane of its polygon, metres in the mesh frame.
    pub largest_deviation: f64,
}

/// Makes each triangle a polygon.
pub(crate) fn unmerged(mesh: &TriangleMesh) -> MergeResult {
    let mut parts = Parts::default();
    for t in &mesh.triangles {
        parts.push(&t.corners, t.material, t.source, &mesh.vertices);
    }
    MergeResult { parts, merges: 0, largest_deviation: 0.0 }
}

/// Merges neighbours while all vertices stay within `tolerance` times the mesh's size of their polygon's plane.
pub(crate) fn merge(mesh: &TriangleMesh, twins: Vec<u32>, tolerance: f64) -> MergeResult {
    let size = Aabb::of(mesh.vertices.iter().map(|v| v.as_dvec3())).size();
    let mut outlines = Outlines::new(mesh, twins, tolerance * size);
    let mut merges = 0;
    for _ in 0..ROUNDS {
        let merged = outlines.merge_all();
        merges += merged;
        if merged == 0 || outlines.drop_straight_vertices() == 0 {
            break;
        }
    }
    outlines.finish(merges)
}

/// A polygon being merged, stored at its lowest triangle.
#[derive(Clone, Copy)]
struct Face {
    /// Twice the area, along the normal. Its sum over merges is precise enough.
    doubled_area: DVec3,
    /// Any half-edge of the outline.
    first: u32,
    corners: u32,
    /// Maximum distance of a corner from the plane.
    flatness: f64,
    /// Bound on the distance of source vertices that are no longer corners; negative infinity if there are none.
    hidden: f64,
    /// Bound on the angle of the source triangles to the normal.
    tilt: f64,
}

/// The outlines of all polygons as linked half-edges; a half-edge starts at its `start` vertex and ends where its
/// `next` starts.
struct Outlines<'a> {
    vertices: &'a [Vec3],
    triangles: &'a [Triangle],
    start: Vec<u32>,
    next: Vec<u32>,
    prev: Vec<u32>,
    twins: Vec<u32>,
    /// The triangles of each polygon; the root is the lowest of them.
    polygons: UnionFind,
    faces: Vec<Face>,
    tolerance: f64,
}

/// The outline that a merge would give.
struct Union {
    half_edges: [u32; MERGED_CORNERS],
    points: [DVec3; MERGED_CORNERS],
    count: usize,
}

/// The run of edges that two polygons share, as half-edges of the first and of the second polygon.
struct SharedEdges {
    first_a: u32,
    last_a: u32,
    first_b: u32,
    last_b: u32,
    length: u32,
}

impl<'a> Outlines<'a> {
    fn new(mesh: &'a TriangleMesh, twins: Vec<u32>, tolerance: f64) -> Self {
        let triangles = &mesh.triangles;
        let count = triangles.len() as u32;
        let face = |(t, triangle): (u32, &Triangle)| {
            let [a, b, c] = mesh.positions(triangle.corners);
            let (doubled_area, hidden) = ((b - a).cross(c - a), f64::NEG_INFINITY);
            Face { doubled_area, first: 3 * t, corners: 3, flatness: 0.0, hidden, tilt: 0.0 }
        };
        Self {
            vertices: &mesh.vertices,
            triangles,
            start: triangles.iter().flat_map(|t| t.corners).collect(),
            next: (0..count).flat_map(|t| [3 * t + 1, 3 * t + 2, 3 * t]).collect(),
            prev: (0..count).flat_map(|t| [3 * t + 2, 3 * t, 3 * t + 1]).collect(),
            twins,
            polygons: UnionFind::new(triangles.len()),
            faces: (0..count).zip(triangles).map(face).collect(),
            tolerance,
        }
    }

    fn point(&self, half_edge: u32) -> DVec3 {
        self.vertices[self.start[half_edge as usize] as usize].as_dvec3()
    }

    fn find(&mut self, half_edge: u32) -> u32 {
        self.polygons.root(half_edge / 3)
    }

    /// Inner edges between coplanar faces of one material, roughly the longest first.
    fn candidates(&mut self) -> Vec<u32> {
        let mut found: Vec<(u32, u16)> = Vec::new();
        for h in 0..self.twins.len() as u32 {
            let twin = self.twins[h as usize];
            if twin == NONE || twin < h {
                continue;
            }
            let (a, b) = (self.find(h), self.find(twin));
            if a == b || self.triangles[a as usize].material != self.triangles[b as usize].material {
                continue;
            }
            let (m, n) = (self.faces[a as usize].doubled_area, self.faces[b as usize].doubled_area);
            let (dot, both) = (m.dot(n), m.length_squared() * n.length_squared());
            // cos^2 of twice the largest tilt; the exact test follows with the merged normal.
            if dot > 0.0 && dot * dot >= (1.0 - 4.0 * MAX_TILT * MAX_TILT) * both {
                let length = (self.point(self.next[h as usize]) - self.point(h)).length_squared() as f32;
                found.push((h, length_class(length)));
            }
        }
        // Counting sort by descending length class takes linear time; the order within a class does not matter.
        let mut starts = vec![0u32; usize::from(LENGTH_CLASSES) + 1];
        for &(_, class) in &found {
            starts[usize::from(LENGTH_CLASSES - class)] += 1;
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut sorted = vec![0; found.len()];
        for (h, class) in found {
            let at = &mut starts[usize::from(LENGTH_CLASSES - 1 - class)];
            sorted[*at as usize] = h;
            *at += 1;
        }
        sorted
    }

    fn merge_all(&mut self) -> u64 {
        let candidates = self.candidates();
        candidates.into_iter().map(|h| u64::from(self.try_merge(h))).sum()
    }

    /// Removes the edges shared over `half_edge`, if the union of its two polygons is flat and convex.
    fn try_merge(&mut self, half_edge: u32) -> bool {
        let twin = self.twins[half_edge as usize];
        let (a, b) = (self.find(half_edge), self.find(twin));
        if a == b {
            return false;
        }
        let (face_a, face_b) = (self.faces[a as usize], self.faces[b as usize]);
        let Some(shared) = self.shared(half_edge, face_a.corners.min(face_b.corners)) else { return false };
        let corners = face_a.corners + face_b.corners - 2 * shared.length;
        if corners < 3 || corners as usize > MERGED_CORNERS {
            return false;
        }
        let union = self.union(&shared);
        debug_assert_eq!(union.count, corners as usize);
        let doubled_area = face_a.doubled_area + face_b.doubled_area;
        let normal = doubled_area.normalize();
        if !is_convex(&union.points[..union.count], normal) {
            return false;
        }
        let tilt = [face_a, face_b].map(|f| f.tilt + f.doubled_area.normalize().cross(normal).length());
        let tilt = tilt[0].max(tilt[1]);
        let (flatness, hidden) = self.deviations(&shared, &union, normal, &face_a, &face_b);
        // False for NaN, which refuses the merge.
        let flat = tilt <= MAX_TILT && flatness.max(hidden) <= self.tolerance;
        if !flat {
            return false;
        }
        self.link(&shared);
        self.polygons.join(a, b);
        let first = union.half_edges[0];
        self.faces[a.min(b) as usize] = Face { doubled_area, first, corners, flatness, hidden, tilt };
        true
    }

    /// Extends one shared edge to the whole run of edges that the same two polygons share.
    fn shared(&self, half_edge: u32, limit: u32) -> Option<SharedEdges> {
        let twin = self.twins[half_edge as usize];
        let mut s = SharedEdges { first_a: half_edge, last_a: half_edge, first_b: twin, last_b: twin, length: 1 };
        let (next, prev) = (&self.next, &self.prev);
        while self.twins[prev[s.first_a as usize] as usize] == next[s.last_b as usize] && s.length < limit {
            s.first_a = prev[s.first_a as usize];
            s.last_b = next[s.last_b as usize];
            s.length += 1;
        }
        while self.twins[next[s.last_a as usize] as usize] == prev[s.first_b as usize] && s.length < limit {
            s.last_a = next[s.last_a as usize];
            s.first_b = prev[s.first_b as usize];
            s.length += 1;
        }
        (s.length < limit).then_some(s)
    }

    /// The outline without the shared run; its size must be within the limit.
    fn union(&self, shared: &SharedEdges) -> Union {
        let mut union = Union { half_edges: [NONE; MERGED_CORNERS], points: [DVec3::ZERO; MERGED_CORNERS], count: 0 };
        for (after, until) in [(shared.last_a, shared.first_a), (shared.last_b, shared.first_b)] {
            let mut h = self.next[after as usize];
            while h != until && union.count < MERGED_CORNERS {
                union.half_edges[union.count] = h;
                union.points[union.count] = self.point(h);
                union.count += 1;
                h = self.next[h as usize];
            }
        }
        union
    }

    /// Maximum distance of a corner of the union from its plane, and a bound for the vertices inside.
    fn deviations(&self, shared: &SharedEdges, union: &Union, normal: DVec3, a: &Face, b: &Face) -> (f64, f64) {
        let points = &union.points[..union.count];
        let origin = points[0];
        let offset = points.iter().map(|&p| (p - origin).dot(normal)).sum::<f64>() / union.count as f64;
        let off = |p: DVec3| ((p - origin).dot(normal) - offset).abs();
        let flatness = points.iter().map(|&p| off(p)).fold(0.0, f64::max);
        // Corners between the shared edges, which become inner points.
        let mut hidden = f64::NEG_INFINITY;
        let mut h = shared.first_a;
        while h != shared.last_a {
            h = self.next[h as usize];
            hidden = hidden.max(off(self.point(h)));
        }
        let flatness_all = flatness.max(hidden);
        for face in [a, b] {
            if face.hidden >= 0.0 {
                // A hidden vertex is within `hidden` of its old polygon's plane. That plane is within `flatness` of the
                // old corners, and these are within `flatness_all` of the new plane.
                hidden = hidden.max(face.hidden + face.flatness + flatness_all);
            }
        }
        (flatness, hidden)
    }

    fn link(&mut self, s: &SharedEdges) {
        for (before, after) in [
            (self.prev[s.first_a as usize], self.next[s.last_b as usize]),
            (self.prev[s.first_b as usize], self.next[s.last_a as usize]),
        ] {
            self.next[before as usize] = after;
            self.prev[after as usize] = before;
        }
    }

    /// Drops vertices that are straight between the same two neighbours in all polygons that use them.
    fn drop_straight_vertices(&mut self) -> u64 {
        let (starts, uses) = self.uses();
        let mut dropped = 0;
        for v in 0..self.vertices.len() {
            let uses = &uses[starts[v] as usize..starts[v + 1] as usize];
            if !uses.is_empty() && self.is_straight_everywhere(uses) {
                self.drop_uses(uses);
                dropped += 1;
            }
        }
        dropped
    }

    /// For each vertex, the outline half-edges that start there: starts of the lists, and the lists.
    fn uses(&self) -> (Vec<u32>, Vec<u32>) {
        let mut starts = vec![0u32; self.vertices.len() + 1];
        self.for_each_outline_edge(|h| starts[self.start[h as usize] as usize + 1] += 1);
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut next = starts.clone();
        let mut uses = vec![0; starts.last().map_or(0, |&n| n as usize)];
        self.for_each_outline_edge(|h| {
            let at = &mut next[self.start[h as usize] as usize];
            uses[*at as usize] = h;
            *at += 1;
        });
        (starts, uses)
    }

    fn for_each_outline_edge(&self, mut visit: impl FnMut(u32)) {
        for (t, face) in self.faces.iter().enumerate() {
            if !self.polygons.is_root(t as u32) {
                continue;
            }
            let mut h = face.first;
            for _ in 0..face.corners {
                visit(h);
                h = self.next[h as usize];
            }
        }
    }

    fn is_straight_everywhere(&mut self, uses: &[u32]) -> bool {
        let mut neighbours = None;
        for &h in uses {
            let (before, after) = (self.prev[h as usize], self.next[h as usize]);
            let (u, w) = (self.start[before as usize], self.start[after as usize]);
            let pair = (u.min(w), u.max(w));
            let same = *neighbours.get_or_insert(pair) == pair;
            let (p, v, q) = (self.point(before), self.point(h), self.point(after));
            let (arriving, leaving) = (v - p, q - v);
            let bend = arriving.cross(leaving).length_squared();
            let limit = STRAIGHT * STRAIGHT * arriving.length_squared() * leaving.length_squared();
            let straight = bend <= limit && arriving.dot(leaving) > 0.0;
            let root = self.find(h);
            if !(same && straight && self.faces[root as usize].corners > 3) {
                return false;
            }
        }
        true
    }

    fn drop_uses(&mut self, uses: &[u32]) {
        let arriving: Vec<u32> = uses.iter().map(|&h| self.prev[h as usize]).collect();
        // Two polygons on either side stay neighbours over the longer edge.
        let neighbours = match (uses, arriving.as_slice()) {
            (&[g, h], &[to_g, to_h]) => {
                (self.twins[g as usize] == to_h && self.twins[h as usize] == to_g).then_some((to_g, to_h))
            }
            _ => None,
        };
        for (&h, &before) in uses.iter().zip(&arriving) {
            let after = self.next[h as usize];
            self.next[before as usize] = after;
            self.prev[after as usize] = before;
            self.twins[h as usize] = NONE;
            self.twins[before as usize] = NONE;
            let root = self.find(h);
            let face = &mut self.faces[root as usize];
            face.first = before;
            face.corners -= 1;
            // Apart from rounding, it is as close to the plane as the two corners that it lies between.
            face.hidden = face.hidden.max(face.flatness);
        }
        if let Some((g, h)) = neighbours {
            self.twins[g as usize] = h;
            self.twins[h as usize] = g;
        }
    }

    fn finish(mut self, merges: u64) -> MergeResult {
        let mut parts = Parts::default();
        let mut polygon_of = vec![NONE; self.triangles.len()];
        let mut outline = Vec::with_capacity(MERGED_CORNERS);
        for (t, triangle) in self.triangles.iter().enumerate() {
            if !self.polygons.is_root(t as u32) {
                continue;
            }
            let face = self.faces[t];
            outline.clear();
            let mut h = face.first;
            for _ in 0..face.corners {
                outline.push(self.start[h as usize]);
                h = self.next[h as usize];
            }
            debug_assert_eq!(h, face.first, "an outline must close");
            polygon_of[t] = parts.records.len() as u32;
            parts.push(&outline, triangle.material, triangle.source, self.vertices);
        }
        let mut largest_deviation = 0.0f64;
        if merges > 0 {
            for t in 0..self.triangles.len() {
                let root = self.find(3 * t as u32) as usize;
                let plane = parts.planes[polygon_of[root] as usize];
                for corner in self.triangles[t].corners {
                    let p = self.vertices[corner as usize].as_dvec3();
                    largest_deviation = largest_deviation.max((plane.normal.dot(p) - plane.offset).abs());
                }
            }
        }
        MergeResult { parts, merges, largest_deviation }
    }
}

const LENGTH_CLASSES: u16 = 1 << 12;

/// A class that rises with a squared length, in steps of 1/32 to 1/16: the float's exponent and first mantissa bits.
fn length_class(squared: f32) -> u16 {
    ((squared.to_bits() >> 19) as u16).min(LENGTH_CLASSES - 1)
}

/// True if no corner turns inwards, seen against the normal, and no side folds back on the one before.
fn is_convex(points: &[DVec3], normal: DVec3) -> bool {
    let n = points.len();
    (0..n).all(|k| {
        let before = points[if k == 0 { n - 1 } else { k - 1 }];
        let after = points[if k + 1 == n { 0 } else { k + 1 }];
        let (arriving, leaving) = (points[k] - before, after - points[k]);
        let turn = arriving.cross(leaving).dot(normal);
        let straight_squared = STRAIGHT * STRAIGHT * arriving.length_squared() * leaving.length_squared();
        if turn * turn > straight_squared { turn > 0.0 } else { arriving.dot(leaving) > 0.0 }
    })
}

#[cfg(test)]
#[path = "merge_tests.rs"]
mod tests;
