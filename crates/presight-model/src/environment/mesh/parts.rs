//! The parts of a mesh before it is checked.

use super::check::canonical_plane;
use super::polygon::PolygonRecord;
use crate::geometry::Plane;
use glam::{DVec3, Vec3};

/// Polygons without an order yet: records and planes over one list of corners.
#[derive(Debug, Default)]
pub struct Parts {
    /// Vertex indices, polygon by polygon.
    pub corners: Vec<u32>,
    /// The polygons.
    pub records: Vec<PolygonRecord>,
    /// The plane of each polygon.
    pub planes: Vec<Plane>,
}

impl Parts {
    /// Appends a polygon; its plane is worked out here.
    pub fn push(&mut self, corners: &[u32], material: u16, source: u32, vertices: &[Vec3]) {
        // Triangles without area never came here, and merging only adds area.
        let plane = canonical_plane(corners.len(), |k| vertices[corners[k] as usize].as_dvec3());
        debug_assert!(plane.is_some(), "polygon without area");
        let first_corner = self.corners.len() as u32;
        self.records.push(PolygonRecord { first_corner, source, material, corner_count: corners.len() as u8 });
        self.corners.extend_from_slice(corners);
        self.planes.push(plane.unwrap_or(Plane { normal: DVec3::Z, offset: 0.0 }));
    }
}
