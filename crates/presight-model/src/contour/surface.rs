//! Smooth surfaces: polygons of one object, connected over edges with limited angles.

use super::edges::MeshEdges;
use crate::geometry::Aabb;
use glam::DVec3;

/// Cosine of the largest angle between normals of a flat surface.
const FLAT: f64 = 0.999_847_695; // 1 degree

/// No second facet.
pub(super) const NONE: u32 = u32::MAX;

/// Marks the polygons of an object that have been reached.
pub(super) struct Reached(Vec<bool>);

impl Reached {
    pub fn new(edges: &MeshEdges) -> Self {
        Self(vec![false; edges.normals.len()])
    }

    /// Returns true if a polygon has been reached.
    pub fn holds(&self, polygon: u32) -> bool {
        self.0[polygon as usize]
    }

    /// Clears the marks of some polygons.
    pub fn forget(&mut self, polygons: &[u32]) {
        polygons.iter().for_each(|polygon| self.0[*polygon as usize] = false);
    }
}

/// The polygons connected with one of them, ascending. None of them may have been reached before.
pub(super) fn connected(edges: &MeshEdges, from: u32, crease: f64, reached: &mut Reached) -> Vec<u32> {
    if edges.normals[from as usize].is_none() {
        return Vec::new();
    }
    reached.0[from as usize] = true;
    let mut all = vec![from];
    let mut next = 0;
    while let Some(polygon) = all.get(next).copied() {
        next += 1;
        for edge in edges.edges_of(polygon) {
            if edges.fold(*edge, crease).is_none() {
                continue;
            }
            for other in edges.around(*edge) {
                if !std::mem::replace(&mut reached.0[*other as usize], true) {
                    all.push(*other);
                }
            }
        }
    }
    all.sort_unstable();
    all
}

/// Returns true if all polygons are parallel.
pub(super) fn is_flat(edges: &MeshEdges, polygons: &[u32]) -> bool {
    let normal = |polygon: &u32| edges.normals[*polygon as usize];
    let mut normals = polygons.iter().filter_map(normal);
    let Some(first) = normals.next() else { return true };
    normals.all(|n| n.dot(first).abs() >= FLAT)
}

#[derive(Clone, Copy, Debug)]
struct Facet {
    normal: DVec3,
    at: DVec3,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct SurfaceEdge {
    /// Indices of its points.
    pub ends: [u32; 2],
    /// The facets on both sides; the second is [`NONE`] for an edge that is visible from everywhere.
    facets: [u32; 2],
    flips: bool,
    /// The range in `slots` of the polygons around it.
    slots: (u32, u32),
}

/// A smooth surface in its object's frame.
#[derive(Debug)]
pub struct Surface {
    /// Index of the object that has its polygons.
    pub object: u32,
    pub(super) points: Vec<DVec3>,
    facets: Vec<Facet>,
    pub(super) edges: Vec<SurfaceEdge>,
    slots: Vec<u32>,
    /// Corners of its bounding box, in the frame of the contour.
    pub hull: [DVec3; 8],
}

impl Surface {
    /// The surface of some polygons, ascending. For each edge that it does not cross smoothly, `keeps` decides from the
    /// edge, the slot and the direction of a polygon there whether the edge counts.
    pub(super) fn new(
        edges: &MeshEdges,
        object: u32,
        first_slot: u32,
        polygons: &[u32],
        crease: f64,
        mut keeps: impl FnMut([DVec3; 2], u32, DVec3) -> bool,
    ) -> Self {
        let mut all: Vec<u32> = polygons.iter().flat_map(|p| edges.edges_of(*p)).copied().collect();
        all.sort_unstable();
        all.dedup();
        let local = |polygon: u32| polygons.binary_search(&polygon).ok();
        let mut surface = Self {
            object,
            points: Vec::new(),
            facets: Vec::with_capacity(polygons.len()),
            edges: Vec::with_capacity(all.len()),
            slots: Vec::with_capacity(2 * all.len()),
            hull: [DVec3::ZERO; 8],
        };
        let facet = |polygon: &u32| {
            let at = edges.edges_of(*polygon).first().map(|edge| edges.edges[*edge as usize].ends[0]);
            let at = at.map_or(DVec3::ZERO, |corner| edges.positions[corner as usize]);
            Facet { normal: edges.normals[*polygon as usize].unwrap_or(DVec3::ZERO), at }
        };
        surface.facets.extend(polygons.iter().map(facet));
        let mut corners: Vec<u32> = all.iter().flat_map(|edge| edges.edges[*edge as usize].ends).collect();
        corners.sort_unstable();
        corners.dedup();
        surface.points = corners.iter().map(|corner| edges.positions[*corner as usize]).collect();
        let bounds = Aabb::of(surface.points.iter().copied());
        surface.hull = std::array::from_fn(|i| {
            DVec3::select(glam::BVec3::new(i & 1 == 1, i & 2 == 2, i & 4 == 4), bounds.max, bounds.min)
        });
        let number = |corner: u32| corners.partition_point(|c| *c < corner) as u32;
        for edge in all {
            let ends = edges.edges[edge as usize].ends;
            let smooth = edges.fold(edge, crease).and_then(|fold| {
                let [Some(a), Some(b)] = fold.sides.map(local) else { return None };
                Some(([a as u32, b as u32], fold.flips))
            });
            let (facets, flips) = match smooth {
                Some(smooth) => smooth,
                None => {
                    let Some((own, at)) = edges.around(edge).iter().find_map(|p| Some((*p, local(*p)?))) else {
                        continue;
                    };
                    let Some((_, wing)) = edges.wing(edge, own) else { continue };
                    if !keeps(ends.map(|end| edges.positions[end as usize]), first_slot + own, wing) {
                        continue;
                    }
                    ([at as u32, NONE], false)
                }
            };
            let first = surface.slots.len() as u32;
            surface.slots.extend(edges.around(edge).iter().map(|polygon| first_slot + polygon));
            let slots = (first, surface.slots.len() as u32);
            surface.edges.push(SurfaceEdge { ends: ends.map(number), facets, flips, slots });
        }
        surface
    }

    pub(super) fn slots_of(&self, edge: &SurfaceEdge) -> &[u32] {
        &self.slots[edge.slots.0 as usize..edge.slots.1 as usize]
    }

    /// By facet: true if a viewpoint (the object's frame) is in front of it or in its plane.
    pub(super) fn fronts(&self, from: DVec3) -> Vec<bool> {
        self.facets.iter().map(|facet| facet.normal.dot(from - facet.at) >= 0.0).collect()
    }

    /// Returns true if front and back meet at an edge, or the edge is visible from everywhere.
    pub(super) fn shows(&self, edge: &SurfaceEdge, fronts: &[bool]) -> bool {
        let [a, b] = edge.facets;
        b == NONE || (fronts[a as usize] != fronts[b as usize]) != edge.flips
    }
}
