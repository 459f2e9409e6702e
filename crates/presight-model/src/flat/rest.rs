//! The part of a surface that is not on planes.

use super::FlatSurfaces;
use super::facets::Facets;
use super::fit::{Fit, Frame, PLANE};
use crate::contour::MeshEdges;
use crate::geometry::Aabb;
use glam::DVec3;

/// Separates smooth surfaces from noisy planes.
pub struct FlatRest<'a> {
    facets: Facets<'a>,
    /// By polygon: true if it lies on a plane.
    on_plane: Vec<bool>,
    tolerance: f64,
    /// By polygon: true while it belongs to the current surface and has not been reached.
    open: Vec<bool>,
}

impl<'a> FlatRest<'a> {
    /// `flat` holds the planes of the object with these edges.
    pub fn new(edges: &'a MeshEdges, flat: &FlatSurfaces) -> Self {
        let count = edges.polygon_count();
        let mut on_plane = vec![false; count];
        flat.surfaces.iter().flat_map(|s| &s.polygons).for_each(|p| on_plane[*p as usize] = true);
        Self { facets: Facets::new(edges), on_plane, tolerance: flat.tolerance, open: vec![false; count] }
    }

    /// Returns true if a connected part of some polygons, of at least `least` metres, is neither on a plane nor flat
    /// within the tolerance.
    pub fn is_curved(&mut self, polygons: &[u32], least: f64) -> bool {
        polygons.iter().for_each(|p| self.open[*p as usize] = !self.on_plane[*p as usize]);
        let mut is_curved = false;
        for polygon in polygons {
            if !std::mem::take(&mut self.open[*polygon as usize]) {
                continue;
            }
            let (mut part, mut next) = (vec![*polygon], 0);
            while let Some(polygon) = part.get(next).copied() {
                next += 1;
                let beside = self.facets.beside(polygon);
                part.extend(beside.filter(|other| std::mem::take(&mut self.open[*other as usize])));
            }
            is_curved = is_curved || self.rises(&part, least);
        }
        is_curved
    }

    /// Returns true if some polygons extend over `least` metres, and not between two planes twice the tolerance apart.
    fn rises(&self, part: &[u32], least: f64) -> bool {
        let corners = || part.iter().flat_map(|p| self.facets.corners_of(*p)).map(|c| self.facets.position(c));
        let bounds = Aabb::of(corners());
        let Some(normal) = self.facets.normal(part.iter().copied()).filter(|_| bounds.size() >= least) else {
            return false;
        };
        let frame = Frame::new(bounds.center(), normal, bounds.size());
        let Some(c) = Fit::<PLANE>::of(corners().map(|p| (frame.place(p), 1.0))).solve() else { return false };
        let (normal, _) = frame.plane(c);
        let height = |p: DVec3| normal.dot(p);
        let (low, high) =
            corners().map(height).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
        high - low > 2.0 * self.tolerance
    }
}
