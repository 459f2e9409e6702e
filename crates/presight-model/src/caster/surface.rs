//! The polygons of one object: the first one on a ray, and the nearest point.

use super::tree::BoxTree;
use crate::environment::Mesh;
use crate::geometry::Aabb;
use glam::{DAffine3, DVec3};

/// Maximum number of polygons in a leaf.
const LEAF: usize = 4;
/// A point this far outside an edge, metres, still lies on the polygon, so that there is no crack between neighbours.
const CRACK: f64 = 1e-9;

/// Polygons in the frame of their object, metres.
#[derive(Debug)]
pub(super) struct Surface {
    tree: BoxTree,
    faces: Vec<Face>,
    corners: Vec<DVec3>,
}

#[derive(Clone, Copy, Debug)]
struct Face {
    /// Index of the polygon in its mesh.
    polygon: u32,
    normal: DVec3,
    offset: f64,
    first_corner: u32,
    corner_count: u32,
    one_sided: bool,
}

impl Face {
    fn corners<'a>(&self, all: &'a [DVec3]) -> &'a [DVec3] {
        &all[self.first_corner as usize..][..self.corner_count as usize]
    }
}

/// The first intersection of a ray with a surface, in the frame of the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Intersection {
    /// Metres along a unit ray.
    pub range: f64,
    /// Index of the polygon in its mesh.
    pub polygon: u32,
    /// Unit normal of its front.
    pub normal: DVec3,
}

/// The point of an object's surface that is nearest to another point, in the frame of the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePoint {
    /// Metres.
    pub point: DVec3,
    /// Unit normal of the polygon's front.
    pub normal: DVec3,
    /// Squared distance from the other point, square metres.
    pub distance_squared: f64,
}

impl Surface {
    /// The polygons of a mesh for which `sides` returns a value: true if the polygon is visible from its front only.
    pub fn new(mesh: &Mesh, object_from_mesh: DAffine3, sides: impl Fn(u32) -> Option<bool>) -> Self {
        let mirrors = object_from_mesh.matrix3.determinant() < 0.0;
        let (mut corners, mut faces) = (Vec::new(), Vec::new());
        for polygon in 0..mesh.polygon_count() as u32 {
            let Some(one_sided) = sides(polygon) else { continue };
            let first = corners.len();
            corners.extend(mesh.corners_of(polygon).map(|p| object_from_mesh.transform_point3(p)));
            if mirrors {
                corners[first + 1..].reverse();
            }
            let own = &corners[first..];
            let twice = (1..own.len() - 1).map(|k| (own[k] - own[0]).cross(own[k + 1] - own[0]));
            let normal = twice.sum::<DVec3>().normalize_or_zero();
            if normal == DVec3::ZERO {
                corners.truncate(first);
                continue;
            }
            let (offset, corner_count) = (normal.dot(own[0]), own.len() as u32);
            faces.push(Face { polygon, normal, offset, first_corner: first as u32, corner_count, one_sided });
        }
        let bounds = |face: &Face| {
            let tight = Aabb::of(face.corners(&corners).iter().copied());
            Aabb { min: tight.min - CRACK, max: tight.max + CRACK }
        };
        let center = |face: &Face, axis: usize| {
            let own = face.corners(&corners);
            own.iter().map(|p| p[axis]).sum::<f64>() / own.len() as f64
        };
        let tree = BoxTree::new(&mut faces, LEAF, &bounds, &center);
        Self { tree, faces, corners }
    }

    /// True if it has no polygon.
    pub fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    /// The first intersection of the ray from `origin` along the unit `ray` within `max_range` metres.
    pub fn cast(&self, origin: DVec3, ray: DVec3, max_range: f64) -> Option<Intersection> {
        let mut first = None;
        self.tree.along_ray(origin, ray, max_range, |leaf, nearest| {
            for face in &self.faces[leaf] {
                let slope = face.normal.dot(ray);
                let range = (face.offset - face.normal.dot(origin)) / slope;
                if range > 0.0
                    && range < *nearest
                    && !(face.one_sided && slope > 0.0)
                    && self.contains(face, origin + range * ray)
                {
                    *nearest = range;
                    first = Some(Intersection { range, polygon: face.polygon, normal: face.normal });
                }
            }
        });
        first
    }

    /// True if a point in the plane of a polygon lies on the polygon.
    fn contains(&self, face: &Face, p: DVec3) -> bool {
        let corners = face.corners(&self.corners);
        let after = |k: usize| corners[if k + 1 < corners.len() { k + 1 } else { 0 }];
        let inside = |(k, a): (usize, &DVec3)| {
            let edge = after(k) - a;
            edge.cross(p - a).dot(face.normal) >= -CRACK * edge.length()
        };
        corners.iter().enumerate().all(inside)
    }

    /// The nearest point to `p`, if its squared distance is less than `max_squared`.
    pub fn nearest(&self, p: DVec3, max_squared: f64) -> Option<SurfacePoint> {
        let mut nearest = None;
        self.tree.around_point(p, max_squared, |leaf, least| {
            for face in &self.faces[leaf] {
                let point = self.nearest_on(face, p);
                let distance_squared = point.distance_squared(p);
                if distance_squared < *least {
                    *least = distance_squared;
                    nearest = Some(SurfacePoint { point, normal: face.normal, distance_squared });
                }
            }
        });
        nearest
    }

    fn nearest_on(&self, face: &Face, p: DVec3) -> DVec3 {
        let on_plane = p - (face.normal.dot(p) - face.offset) * face.normal;
        if self.contains(face, on_plane) {
            return on_plane;
        }
        let corners = face.corners(&self.corners);
        let on_edge = |k: usize| {
            let (a, b) = (corners[k], corners[(k + 1) % corners.len()]);
            a + ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0) * (b - a)
        };
        let nearer = |a: DVec3, b: DVec3| if b.distance_squared(p) < a.distance_squared(p) { b } else { a };
        (1..corners.len()).map(on_edge).fold(on_edge(0), nearer)
    }
}
