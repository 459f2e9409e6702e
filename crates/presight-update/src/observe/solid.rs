//! A mesh in the frame of its object, with a tree of boxes: the first polygon on a ray, and the surface nearest to a point.

use glam::{DAffine3, DVec3, Vec3};
use presight_model::environment::{Mesh, Object};

/// Most polygons of a leaf.
const LEAF: usize = 4;
/// A point so far outside of an edge, metres, still lies on the polygon: neighbours leave no crack.
const CRACK: f64 = 1e-9;

/// The polygons of one object in its own frame, metres.
#[derive(Debug, Default)]
pub(crate) struct Solid {
    nodes: Vec<Node>,
    polygons: Vec<Face>,
    corners: Vec<DVec3>,
}

/// A polygon.
#[derive(Clone, Copy, Debug)]
struct Face {
    number: u32,
    normal: DVec3,
    offset: f64,
    first: u32,
    count: u32,
    one_sided: bool,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    min: Vec3,
    max: Vec3,
    /// First polygon of a leaf, or the right child; the left one follows.
    at: u32,
    /// Polygons of a leaf; 0 for others.
    count: u32,
}

/// Where a ray meets a polygon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Meeting {
    /// Metres along a unit ray.
    pub range: f64,
    /// The number of the polygon in its mesh.
    pub polygon: u32,
    /// Unit normal of its front.
    pub normal: DVec3,
}

/// The point of a surface that is nearest to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Foot {
    pub point: DVec3,
    /// Unit normal of the polygon.
    pub normal: DVec3,
    /// Squared metres.
    pub distance_squared: f64,
}

impl Solid {
    /// The polygons of an object that `keep` by number; it says also which are seen from their front only.
    pub fn new(object: &Object, keep: impl Fn(u32) -> Option<bool>) -> Self {
        Self::of(&object.mesh, object.object_from_mesh, keep)
    }

    /// As [`Solid::new`], of a mesh.
    pub fn of(mesh: &Mesh, object_from_mesh: DAffine3, keep: impl Fn(u32) -> Option<bool>) -> Self {
        let (mut solid, mirrors) = (Self::default(), object_from_mesh.matrix3.determinant() < 0.0);
        for number in 0..mesh.polygon_count() as u32 {
            let Some(one_sided) = keep(number) else { continue };
            let first = solid.corners.len();
            solid.corners.extend(mesh.corners_of(number).map(|p| object_from_mesh.transform_point3(p)));
            if mirrors {
                solid.corners[first + 1..].reverse();
            }
            let corners = &solid.corners[first..];
            let twice = (1..corners.len() - 1).map(|k| (corners[k] - corners[0]).cross(corners[k + 1] - corners[0]));
            let normal = twice.sum::<DVec3>().normalize_or_zero();
            if normal == DVec3::ZERO {
                solid.corners.truncate(first);
                continue;
            }
            let (offset, count) = (normal.dot(corners[0]), corners.len() as u32);
            solid.polygons.push(Face { number, normal, offset, first: first as u32, count, one_sided });
        }
        let count = solid.polygons.len();
        if count > 0 {
            solid.grow(0, count);
        }
        solid
    }

    /// True if it has no polygon.
    pub fn is_empty(&self) -> bool {
        self.polygons.is_empty()
    }

    fn bounds(&self, from: usize, to: usize) -> (DVec3, DVec3) {
        let of = |f: &Face| &self.corners[f.first as usize..(f.first + f.count) as usize];
        let all = self.polygons[from..to].iter().flat_map(of);
        all.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(min, max), p| (min.min(*p), max.max(*p)))
    }

    fn grow(&mut self, from: usize, to: usize) {
        let (min, max) = self.bounds(from, to);
        let out = |v: DVec3, up: bool| {
            let round = |x: f64| if up { (x as f32).next_up() } else { (x as f32).next_down() };
            Vec3::new(round(v.x), round(v.y), round(v.z))
        };
        let node = self.nodes.len();
        self.nodes.push(Node { min: out(min, false), max: out(max, true), at: from as u32, count: (to - from) as u32 });
        if to - from <= LEAF {
            return;
        }
        let size = max - min;
        let axis = (0..3).max_by(|a, b| size[*a].total_cmp(&size[*b])).unwrap_or(0);
        let corners = &self.corners;
        let middle = |f: &Face| {
            let own = &corners[f.first as usize..(f.first + f.count) as usize];
            own.iter().map(|p| p[axis]).sum::<f64>() / own.len() as f64
        };
        let half = (to - from) / 2;
        self.polygons[from..to].select_nth_unstable_by(half, |a, b| middle(a).total_cmp(&middle(b)));
        self.grow(from, from + half);
        (self.nodes[node].at, self.nodes[node].count) = (self.nodes.len() as u32, 0);
        self.grow(from + half, to);
    }

    /// Visits the polygons of all leaves whose box `meets`. `meets` may get stricter on the way.
    fn walk(&self, mut meets: impl FnMut(&Node) -> bool, mut visit: impl FnMut(&Face)) {
        // `meets` and `visit` share the best result so far through a cell of the caller.
        let mut stack = [0u32; 64];
        let mut depth = usize::from(!self.nodes.is_empty());
        while depth > 0 {
            depth -= 1;
            let at = stack[depth] as usize;
            let node = &self.nodes[at];
            if !meets(node) {
                continue;
            }
            if node.count > 0 {
                let first = node.at as usize;
                self.polygons[first..first + node.count as usize].iter().for_each(&mut visit);
            } else {
                (stack[depth], stack[depth + 1]) = (node.at, at as u32 + 1);
                depth += 2;
            }
        }
    }

    /// What a ray from `origin` along the unit `ray` meets first within `reach` metres, in the object's frame.
    pub fn cast(&self, origin: DVec3, ray: DVec3, reach: f64) -> Option<Meeting> {
        let (inverse, best) = (ray.recip(), std::cell::Cell::new((reach, None)));
        let meets = |node: &Node| {
            let (a, b) = ((node.min.as_dvec3() - origin) * inverse, (node.max.as_dvec3() - origin) * inverse);
            // NaN, where a ray runs in the side of a box, is ignored by min and max.
            let near = a.x.min(b.x).max(a.y.min(b.y)).max(a.z.min(b.z)).max(0.0);
            let far = a.x.max(b.x).min(a.y.max(b.y)).min(a.z.max(b.z));
            near <= far && near < best.get().0
        };
        self.walk(meets, |face| {
            let slope = face.normal.dot(ray);
            let range = (face.offset - face.normal.dot(origin)) / slope;
            if range > 0.0
                && range < best.get().0
                && !(face.one_sided && slope > 0.0)
                && self.holds(face, origin + range * ray)
            {
                best.set((range, Some(Meeting { range, polygon: face.number, normal: face.normal })));
            }
        });
        best.get().1
    }

    /// True if a point on the plane of a polygon lies on it.
    fn holds(&self, face: &Face, p: DVec3) -> bool {
        let corners = &self.corners[face.first as usize..(face.first + face.count) as usize];
        let after = |k: usize| corners[if k + 1 < corners.len() { k + 1 } else { 0 }];
        let inside = |(k, a): (usize, &DVec3)| {
            let edge = after(k) - a;
            edge.cross(p - a).dot(face.normal) >= -CRACK * edge.length()
        };
        corners.iter().enumerate().all(inside)
    }

    /// The point of the surface that is nearest to `p`, if one is within `reach` metres, in the object's frame.
    pub fn nearest(&self, p: DVec3, reach: f64) -> Option<Foot> {
        let best = std::cell::Cell::new((reach * reach, None));
        let apart =
            |node: &Node| (node.min.as_dvec3() - p).max(p - node.max.as_dvec3()).max(DVec3::ZERO).length_squared();
        self.walk(
            |node| apart(node) < best.get().0,
            |face| {
                let foot = self.foot(face, p);
                let distance_squared = foot.distance_squared(p);
                if distance_squared < best.get().0 {
                    best.set((distance_squared, Some(Foot { point: foot, normal: face.normal, distance_squared })));
                }
            },
        );
        best.get().1
    }

    fn foot(&self, face: &Face, p: DVec3) -> DVec3 {
        let on_plane = p - (face.normal.dot(p) - face.offset) * face.normal;
        if self.holds(face, on_plane) {
            return on_plane;
        }
        let corners = &self.corners[face.first as usize..(face.first + face.count) as usize];
        let on_edge = |k: usize| {
            let (a, b) = (corners[k], corners[(k + 1) % corners.len()]);
            a + ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0) * (b - a)
        };
        let nearer = |a: DVec3, b: DVec3| if b.distance_squared(p) < a.distance_squared(p) { b } else { a };
        (1..corners.len()).map(on_edge).fold(on_edge(0), nearer)
    }
}
