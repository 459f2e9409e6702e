//! Polygons of a mesh, and the clusters that hold them.

use crate::geometry::Aabb;
use glam::Vec3;

/// A planar convex polygon, for [`Mesh::new`](super::Mesh::new).
#[derive(Clone, Debug, PartialEq)]
pub struct Polygon {
    /// Vertex indices in winding order, at least 3.
    pub corners: Vec<u32>,
    /// Index of the material in the environment.
    pub material: u16,
    /// Number of the (first) source triangle within the object.
    pub source: u32,
}

impl Polygon {
    /// A polygon that is its own source.
    pub fn new(corners: Vec<u32>, material: u16) -> Self {
        Self { corners, material, source: 0 }
    }
}

/// The order in which a mesh stores its polygons.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PolygonOrder {
    /// Neighbours together, so that clusters have small boxes. Use this except for comparisons.
    Spatial,
    /// The given order, so that slots rise with source numbers.
    Given,
}

/// A stored polygon: the position of its corners in the corner list, and its attributes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PolygonRecord {
    /// Position of its first corner in the corner list.
    pub first_corner: u32,
    /// Number of its first source triangle within the object.
    pub source: u32,
    /// Material index.
    pub material: u16,
    /// Number of its corners.
    pub corner_count: u8,
}

impl PolygonRecord {
    /// The polygon's corners, out of the corners of the mesh.
    #[inline]
    pub fn corners(self, all: &[u32]) -> &[u32] {
        let first = self.first_corner as usize;
        &all[first..first + usize::from(self.corner_count)]
    }

    /// Minimum and maximum coordinates of its corners.
    #[inline]
    pub fn extent(self, all: &[u32], vertices: &[Vec3]) -> (Vec3, Vec3) {
        let own = self.corners(all);
        // Nearly all polygons have three or four corners: avoids a mispredicted branch between the two.
        let fourth = own[3.min(own.len() - 1)];
        let at = |corner: u32| vertices[corner as usize];
        let (a, b, c, d) = (at(own[0]), at(own[1]), at(own[2]), at(fourth));
        let mut extent = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
        if own.len() > 4 {
            for &corner in &own[4..] {
                extent = (extent.0.min(at(corner)), extent.1.max(at(corner)));
            }
        }
        extent
    }

    pub(super) fn bounds(self, all: &[u32], vertices: &[Vec3]) -> Aabb {
        let (min, max) = self.extent(all, vertices);
        Aabb { min: min.as_dvec3(), max: max.as_dvec3() }
    }
}

/// A contiguous run of a mesh's polygons with its box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cluster {
    /// First polygon.
    pub first: u32,
    /// Number of polygons, at most [`crate::limits::CLUSTER_POLYGONS`].
    pub count: u32,
    /// Bounds in the mesh frame.
    pub bounds: Aabb,
}
