//! The facets of an object, with the data for estimates of noise and planes.

use crate::contour::MeshEdges;
use glam::DVec3;

pub(super) struct Facets<'a> {
    pub edges: &'a MeshEdges,
    /// Square metres, by polygon; 0 if the class does not see it.
    pub areas: Vec<f64>,
    /// A third of the areas around each corner.
    pub corner_areas: Vec<f64>,
    /// By corner: where its edges begin in `edges_at`.
    starts: Vec<u32>,
    edges_at: Vec<u32>,
}

impl<'a> Facets<'a> {
    pub fn new(edges: &'a MeshEdges) -> Self {
        let mut areas = vec![0.0; edges.normals.len()];
        let mut corner_areas = vec![0.0; edges.positions.len()];
        for (polygon, normal) in edges.normals.iter().enumerate() {
            let Some(normal) = normal else { continue };
            for edge in edges.edges_of(polygon as u32) {
                let ends = edges.edges[*edge as usize].ends;
                let [a, b] = ends.map(|end| edges.positions[end as usize] - edges.centers[polygon]);
                let area = 0.5 * normal.dot(a.cross(b)).abs();
                areas[polygon] += area;
                ends.iter().for_each(|end| corner_areas[*end as usize] += 0.5 * area);
            }
        }
        let mut starts = vec![0u32; edges.positions.len() + 1];
        let ends =
            || edges.edges.iter().enumerate().flat_map(|(k, edge)| edge.ends.map(|end| (end as usize, k as u32)));
        ends().for_each(|(end, _)| starts[end + 1] += 1);
        for k in 1..starts.len() {
            starts[k] += starts[k - 1];
        }
        let (mut next, mut edges_at) = (starts.clone(), vec![0; 2 * edges.edges.len()]);
        for (end, edge) in ends() {
            edges_at[next[end] as usize] = edge;
            next[end] += 1;
        }
        Self { edges, areas, corner_areas, starts, edges_at }
    }

    pub fn position(&self, corner: u32) -> DVec3 {
        self.edges.positions[corner as usize]
    }

    /// The edges that end at a corner.
    pub fn edges_at(&self, corner: u32) -> &[u32] {
        &self.edges_at[self.starts[corner as usize] as usize..self.starts[corner as usize + 1] as usize]
    }

    /// The corners that share an edge with a corner.
    pub fn corners_beside(&self, corner: u32) -> impl Iterator<Item = u32> + '_ {
        self.edges_at(corner).iter().map(move |edge| {
            let [a, b] = self.edges.edges[*edge as usize].ends;
            if a == corner { b } else { a }
        })
    }

    /// Corners of a polygon, each twice.
    pub fn corners_of(&self, polygon: u32) -> impl Iterator<Item = u32> + '_ {
        self.edges.edges_of(polygon).iter().flat_map(|edge| self.edges.edges[*edge as usize].ends)
    }

    /// The polygons that share an edge with a polygon.
    pub fn beside(&self, polygon: u32) -> impl Iterator<Item = u32> + '_ {
        let around = self.edges.edges_of(polygon).iter().flat_map(|edge| self.edges.around(*edge));
        around.copied().filter(move |other| *other != polygon)
    }

    /// The mean normal of some polygons by area, on the side of the first one.
    pub fn normal(&self, polygons: impl Iterator<Item = u32>) -> Option<DVec3> {
        let mut sum = DVec3::ZERO;
        for polygon in polygons {
            let Some(normal) = self.edges.normals[polygon as usize] else { continue };
            let side = if sum.dot(normal) < 0.0 { -1.0 } else { 1.0 };
            sum += normal * (side * self.areas[polygon as usize]);
        }
        sum.try_normalize()
    }
}
