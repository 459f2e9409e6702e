//! Meshes: convex polygons over shared vertices, in their own frame, stored once for all instances.

mod check;
mod order;
mod parts;
pub(super) mod polygon;

pub use check::canonical_plane;
pub use parts::Parts;
pub use polygon::{Cluster, Polygon, PolygonOrder, PolygonRecord};

use super::cluster_vertices::ClusterVertices;
use crate::error::{Error, Result};
use crate::geometry::{Aabb, Plane};
use crate::index::RayTree;
use crate::limits;
use check::{check_polygon, check_records, check_vertices};
use glam::{DMat3, DVec3, Vec3};
use order::{cuts_of, spatial_sequence};
use std::sync::{Arc, OnceLock};

/// Polygons over shared f32 vertices in the mesh's own frame, metres.
///
/// The f32 positions *are* the model: every engine starts from the same bits.
#[derive(Clone, Debug)]
pub struct Mesh {
    name: String,
    vertices: Vec<Vec3>,
    corners: Vec<u32>,
    polygons: Vec<PolygonRecord>,
    planes: Vec<Plane>,
    clusters: Vec<Cluster>,
    bounds: Aabb,
    /// Material indices in use, rising.
    materials: Vec<u16>,
    /// Built when the CPU engine first draws the mesh.
    by_cluster: OnceLock<ClusterVertices>,
    /// Built when rays first want it, and shared by clones.
    ray_tree: OnceLock<Arc<RayTree>>,
}

impl Mesh {
    /// Checks and stores polygons.
    ///
    /// ```
    /// use presight::environment::{Mesh, Polygon, PolygonOrder};
    /// use glam::Vec3;
    /// let square = vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y];
    /// let mesh = Mesh::new("tile", square, vec![Polygon::new(vec![0, 1, 2, 3], 0)], PolygonOrder::Spatial)?;
    /// assert_eq!(mesh.polygon_count(), 1);
    /// # Ok::<(), presight::Error>(())
    /// ```
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`], naming the polygon: fewer than 3 or over 64 corners, an index out of range, NaN
    /// or infinity, no area, not planar, not convex.
    pub fn new(
        name: impl Into<String>,
        vertices: Vec<Vec3>,
        polygons: Vec<Polygon>,
        order: PolygonOrder,
    ) -> Result<Self> {
        let name = name.into();
        check_vertices(&vertices).map_err(|e| e.at(format!("mesh {name:?}")))?;
        let extent = Aabb::of(vertices.iter().map(|v| v.as_dvec3())).size();
        let mut planes = Vec::with_capacity(polygons.len());
        for (i, polygon) in polygons.iter().enumerate() {
            let plane = check_polygon(polygon, &vertices, extent)
                .map_err(|e| e.at(format!("polygon {i}")).at(format!("mesh {name:?}")))?;
            planes.push(plane);
        }
        let mut corners = Vec::with_capacity(polygons.iter().map(|p| p.corners.len()).sum());
        let mut records = Vec::with_capacity(polygons.len());
        for polygon in &polygons {
            records.push(PolygonRecord {
                first_corner: corners.len() as u32,
                source: polygon.source,
                material: polygon.material,
                corner_count: polygon.corners.len() as u8,
            });
            corners.extend_from_slice(&polygon.corners);
        }
        Ok(Self::assemble(name, vertices, &Parts { corners, records, planes }, order))
    }

    /// A mesh without polygons.
    pub fn empty(name: &str) -> Self {
        Self::assemble(name.to_owned(), Vec::new(), &Parts::default(), PolygonOrder::Given)
    }

    /// Like [`Mesh::new`], for parts that have been checked already. Keeps only used vertices, in the order of use.
    #[doc(hidden)]
    pub fn from_parts(name: String, vertices: Vec<Vec3>, parts: &Parts, order: PolygonOrder) -> Self {
        let mut mesh = Self::assemble(name, vertices, parts, order);
        let mut moved = vec![u32::MAX; mesh.vertices.len()];
        let mut kept = Vec::with_capacity(mesh.vertices.len());
        for corner in &mut mesh.corners {
            let to = &mut moved[*corner as usize];
            if *to == u32::MAX {
                *to = kept.len() as u32;
                kept.push(mesh.vertices[*corner as usize]);
            }
            *corner = *to;
        }
        mesh.vertices = kept;
        mesh
    }

    fn assemble(name: String, vertices: Vec<Vec3>, parts: &Parts, order: PolygonOrder) -> Self {
        let Parts { corners, records, planes } = parts;
        assert_eq!(records.len(), planes.len());
        let boxes: Vec<Aabb> = records.iter().map(|r| r.bounds(corners, &vertices)).collect();
        let count = records.len();
        let sequence: Vec<u32> = match order {
            PolygonOrder::Spatial => spatial_sequence(&boxes),
            PolygonOrder::Given => (0..count as u32).collect(),
        };
        let mut cuts = cuts_of(count, order);
        let mut mesh = Self {
            name,
            vertices,
            corners: Vec::with_capacity(corners.len()),
            polygons: Vec::with_capacity(count),
            planes: sequence.iter().map(|&i| planes[i as usize]).collect(),
            clusters: Vec::with_capacity(cuts.len()),
            bounds: boxes.iter().fold(Aabb::EMPTY, |a, b| a.union(*b)),
            materials: materials_of(records),
            by_cluster: OnceLock::new(),
            ray_tree: OnceLock::new(),
        };
        for &i in &sequence {
            let record = records[i as usize];
            mesh.polygons.push(PolygonRecord { first_corner: mesh.corners.len() as u32, ..record });
            mesh.corners.extend_from_slice(record.corners(corners));
        }
        cuts.push(count);
        for pair in cuts.windows(2) {
            let bounds = sequence[pair[0]..pair[1]].iter().fold(Aabb::EMPTY, |b, &i| b.union(boxes[i as usize]));
            mesh.clusters.push(Cluster { first: pair[0] as u32, count: (pair[1] - pair[0]) as u32, bounds });
        }
        mesh
    }

    /// Rebuilds a stored mesh: polygons in the stored order, and their planes if known. Calls `visit` with the extent
    /// of each polygon, because an index needs the extents too.
    ///
    /// # Errors
    /// [`crate::ErrorKind::Invalid`], naming the polygon or vertex: not finite, out of range, no area. Planarity and
    /// convexity were checked when the mesh was made.
    #[doc(hidden)]
    pub fn restored(
        name: String,
        vertices: Vec<Vec3>,
        corners: Vec<u32>,
        polygons: Vec<PolygonRecord>,
        planes: Option<Vec<Plane>>,
        order: PolygonOrder,
        mut visit: impl FnMut(usize, (Vec3, Vec3)),
    ) -> Result<Self> {
        check_vertices(&vertices)?;
        let greatest = corners.iter().copied().fold(0, u32::max);
        if greatest as usize >= vertices.len() && !corners.is_empty() {
            return Err(Error::invalid(format!("vertex {greatest} of {}", vertices.len()), ""));
        }
        check_records(&polygons, corners.len())?;
        let plane_of = |(i, record): (usize, &PolygonRecord)| {
            let own = record.corners(&corners);
            let plane = canonical_plane(own.len(), |k| vertices[own[k] as usize].as_dvec3());
            plane.ok_or_else(|| Error::invalid("it has no area", "").at(format!("polygon {i}")))
        };
        let planes = match planes {
            Some(planes) => planes,
            None => polygons.iter().enumerate().map(plane_of).collect::<Result<_>>()?,
        };
        let sound = |p: &Plane| (p.normal.length_squared() - 1.0).abs() <= 1e-6 && p.offset.is_finite();
        // No early exit: the loop would not be unrolled otherwise.
        if planes.len() != polygons.len() || !planes.iter().fold(true, |all, plane| all & sound(plane)) {
            return Err(Error::invalid("planes without a normal, or not one for each polygon", ""));
        }
        let mut cuts = cuts_of(polygons.len(), order);
        cuts.push(polygons.len());
        let cluster = |pair: &[usize]| {
            let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
            for i in pair[0]..pair[1] {
                let extent = polygons[i].extent(&corners, &vertices);
                (min, max) = (min.min(extent.0), max.max(extent.1));
                visit(i, extent);
            }
            let bounds = Aabb { min: min.as_dvec3(), max: max.as_dvec3() };
            Cluster { first: pair[0] as u32, count: (pair[1] - pair[0]) as u32, bounds }
        };
        let clusters: Vec<Cluster> = cuts.windows(2).map(cluster).collect();
        let bounds = clusters.iter().fold(Aabb::EMPTY, |b, c| b.union(c.bounds));
        let materials = materials_of(&polygons);
        let (by_cluster, ray_tree) = (OnceLock::new(), OnceLock::new());
        Ok(Self { name, vertices, corners, polygons, planes, clusters, bounds, materials, by_cluster, ray_tree })
    }

    /// A mesh of the same polygons with other materials.
    pub fn with_materials(&self, material: impl Fn(u16) -> u16) -> Self {
        let mut mesh = self.clone();
        mesh.polygons.iter_mut().for_each(|p| p.material = material(p.material));
        mesh.materials = materials_of(&mesh.polygons);
        mesh
    }

    /// A mesh of the same polygons, transformed and with other materials, rounded to f32 once. A mirror reverses the
    /// windings, so that fronts stay fronts, as in a mirrored object.
    ///
    /// # Errors
    /// Those of [`Mesh::new`]: rounding may flatten tiny polygons.
    pub fn transformed(&self, turn: DMat3, material: impl Fn(u16) -> u16) -> Result<Self> {
        let vertices = self.vertices.iter().map(|v| (turn * v.as_dvec3()).as_vec3()).collect();
        let mirrors = turn.determinant() < 0.0;
        let polygon = |p: &PolygonRecord| {
            let mut corners = p.corners(&self.corners).to_vec();
            if mirrors {
                corners[1..].reverse();
            }
            Polygon { corners, material: material(p.material), source: p.source }
        };
        let polygons = self.polygons.iter().map(polygon).collect();
        Self::new(self.name.clone(), vertices, polygons, PolygonOrder::Spatial)
    }

    /// The order, as far as the clusters show it: [`PolygonOrder::Given`] if both orders would have the same clusters.
    pub fn order(&self) -> PolygonOrder {
        let even = self.clusters.iter().enumerate().all(|(i, c)| c.first as usize == i * limits::CLUSTER_POLYGONS);
        if even { PolygonOrder::Given } else { PolygonOrder::Spatial }
    }

    /// Name in the source file; need not be unique.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Positions, metres, mesh frame.
    pub fn vertices(&self) -> &[Vec3] {
        &self.vertices
    }

    /// Number of polygons.
    #[inline]
    pub fn polygon_count(&self) -> usize {
        self.polygons.len()
    }

    /// Vertex indices of a polygon, in winding order.
    #[inline]
    pub fn corner_indices(&self, polygon: u32) -> &[u32] {
        self.polygons[polygon as usize].corners(&self.corners)
    }

    /// Corner positions of a polygon, in winding order, f64.
    #[inline]
    pub fn corners_of(&self, polygon: u32) -> impl ExactSizeIterator<Item = DVec3> + '_ {
        self.corner_indices(polygon).iter().map(|&c| self.vertices[c as usize].as_dvec3())
    }

    /// The plane of a polygon in the mesh frame.
    #[doc(hidden)]
    pub fn plane(&self, polygon: u32) -> Plane {
        self.planes[polygon as usize]
    }

    /// Material index of a polygon.
    pub fn material(&self, polygon: u32) -> u16 {
        self.polygons[polygon as usize].material
    }

    /// Number of the polygon's first source triangle within the object.
    pub fn source(&self, polygon: u32) -> u32 {
        self.polygons[polygon as usize].source
    }

    /// Runs of neighbouring polygons, in order; together they hold all polygons.
    #[doc(hidden)]
    pub fn clusters(&self) -> &[Cluster] {
        &self.clusters
    }

    /// Bounds of all polygons in the mesh frame.
    pub fn bounds(&self) -> Aabb {
        self.bounds
    }

    /// All polygons.
    #[doc(hidden)]
    pub fn polygons(&self) -> &[PolygonRecord] {
        &self.polygons
    }

    /// The vertex indices of all corners, polygon by polygon.
    pub fn all_corners(&self) -> &[u32] {
        &self.corners
    }

    /// The cluster that holds a polygon, and its index. Clusters have similar sizes, so a linear guess is nearly right.
    #[inline(always)]
    #[doc(hidden)]
    pub fn cluster_of(&self, polygon: u32) -> (usize, &Cluster) {
        let clusters = &self.clusters;
        let mut i = (u64::from(polygon) * clusters.len() as u64 / self.polygons.len() as u64) as usize;
        while clusters[i].first > polygon {
            i -= 1;
        }
        while i + 1 < clusters.len() && clusters[i + 1].first <= polygon {
            i += 1;
        }
        (i, &clusters[i])
    }

    /// Built on the first call.
    #[doc(hidden)]
    pub fn cluster_vertices(&self) -> &ClusterVertices {
        let made = || ClusterVertices::new(&self.vertices, &self.corners, &self.polygons, &self.clusters);
        self.by_cluster.get_or_init(made)
    }

    /// The tree of its triangles for rays, if it is built.
    #[inline]
    #[doc(hidden)]
    pub fn known_ray_tree(&self) -> Option<&RayTree> {
        self.ray_tree.get().map(|tree| &**tree)
    }

    /// Built on the first call, some 0.6 us a triangle on one thread; by all threads of a pool if called on one of
    /// them.
    ///
    /// # Errors
    /// [`crate::ErrorKind::System`] if there is no memory for it.
    #[doc(hidden)]
    pub fn ray_tree(&self) -> Result<&RayTree> {
        // Not within the cell: a thread that takes other tasks while it waits may come here again.
        if self.ray_tree.get().is_none() {
            let _ = self.ray_tree.set(Arc::new(RayTree::new(self)?));
        }
        Ok(self.ray_tree.get().expect("it was set"))
    }

    /// The plane of each polygon, in the frame of the mesh.
    #[doc(hidden)]
    pub fn planes(&self) -> &[Plane] {
        &self.planes
    }

    /// Material indices in use, rising.
    pub fn materials(&self) -> &[u16] {
        &self.materials
    }
}

fn materials_of(records: &[PolygonRecord]) -> Vec<u16> {
    let mut materials: Vec<u16> = Vec::new();
    // Neighbours usually share a material.
    for run in records.chunk_by(|a, b| a.material == b.material) {
        if !materials.contains(&run[0].material) {
            materials.push(run[0].material);
        }
    }
    materials.sort_unstable();
    materials
}
