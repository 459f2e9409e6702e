//! The vertices of each cluster, stored contiguously and each only once. A triangle mesh has half as many vertices as
//! triangles, and six times as many corners as vertices.

use super::mesh::polygon::{Cluster, PolygonRecord};
use glam::Vec3;

/// Vertices that are processed together.
const TOGETHER: usize = 8;

/// Maximum number of vertices of a cluster: local indices are one byte.
pub const MAX_VERTICES: usize = 256;

/// Eight positions, by axis.
pub type Positions = [[f32; TOGETHER]; 3];

/// The vertices of a mesh by cluster.
#[derive(Clone, Debug, Default)]
pub struct ClusterVertices {
    /// For each cluster, the start of its positions, then the total. A cluster with too many vertices has no positions.
    starts: Vec<u32>,
    /// Padded with the last vertex of the cluster.
    positions: Vec<Positions>,
    /// For each corner of the mesh, the index of its vertex within the cluster.
    locals: Vec<u8>,
    /// For each cluster, the largest diagonal of a polygon's bounding box.
    widest: Vec<f32>,
}

impl ClusterVertices {
    pub fn new(vertices: &[Vec3], corners: &[u32], polygons: &[PolygonRecord], clusters: &[Cluster]) -> Self {
        let mut made = Self {
            starts: vec![0],
            positions: Vec::new(),
            locals: vec![0; corners.len()],
            widest: Vec::with_capacity(clusters.len()),
        };
        // For each vertex: the last cluster in which it occurred, and its index there.
        let mut met = vec![(u32::MAX, 0u8); vertices.len()];
        let mut own: Vec<Vec3> = Vec::with_capacity(MAX_VERTICES);
        for (number, cluster) in (0u32..).zip(clusters) {
            own.clear();
            let (first, last) = (cluster.first as usize, (cluster.first + cluster.count) as usize - 1);
            let begin = polygons[first].first_corner as usize;
            let end = polygons[last].first_corner as usize + usize::from(polygons[last].corner_count);
            for (local, &vertex) in made.locals[begin..end].iter_mut().zip(&corners[begin..end]) {
                let vertex = vertex as usize;
                if met[vertex].0 != number {
                    met[vertex] = (number, own.len() as u8);
                    own.push(vertices[vertex]);
                }
                *local = met[vertex].1;
            }
            if own.len() <= MAX_VERTICES {
                made.positions.extend(own.chunks(TOGETHER).map(|some| {
                    let at = |i: usize| some[i.min(some.len() - 1)];
                    [0, 1, 2].map(|axis| std::array::from_fn(|i| at(i)[axis]))
                }));
            }
            made.starts.push(made.positions.len() as u32);
            let sizes = polygons[first..=last].iter().map(|polygon| {
                let (min, max) = polygon.extent(corners, vertices);
                (max - min).length()
            });
            made.widest.push(sizes.fold(0.0, f32::max).next_up());
        }
        made
    }

    /// Upper bound of the distance between two corners of a polygon of the cluster.
    pub fn widest(&self, cluster: usize) -> f64 {
        f64::from(self.widest[cluster])
    }

    /// The vertices of a cluster; empty if it has too many.
    pub fn of(&self, cluster: usize) -> &[Positions] {
        &self.positions[self.starts[cluster] as usize..self.starts[cluster + 1] as usize]
    }

    /// The vertices of a polygon, as indices within its cluster.
    #[inline(always)]
    pub fn locals(&self, polygon: &PolygonRecord) -> &[u8] {
        let first = polygon.first_corner as usize;
        &self.locals[first..first + usize::from(polygon.corner_count)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Mesh, Polygon, PolygonOrder};

    /// A sheet of 40 x 40 squares, two triangles each.
    fn sheet() -> Mesh {
        let vertices = (0..41 * 41).map(|i| Vec3::new((i % 41) as f32, (i / 41) as f32, 0.0)).collect();
        let square = |i: u32| {
            let at = i / 40 * 41 + i % 40;
            [[at, at + 1, at + 42], [at, at + 42, at + 41]].map(|corners| Polygon::new(corners.to_vec(), 0))
        };
        Mesh::new("sheet", vertices, (0..1600).flat_map(square).collect(), PolygonOrder::Spatial).unwrap()
    }

    #[test]
    fn corners_are_where_they_were() {
        let mesh = sheet();
        let by_cluster = mesh.cluster_vertices();
        for (number, cluster) in mesh.clusters().iter().enumerate() {
            let positions = by_cluster.of(number);
            assert!(positions.len() * TOGETHER <= 64, "{} vertices", positions.len() * TOGETHER);
            for polygon in cluster.first..cluster.first + cluster.count {
                let record = &mesh.polygons()[polygon as usize];
                for (local, corner) in by_cluster.locals(record).iter().zip(mesh.corner_indices(polygon)) {
                    let eight = &positions[usize::from(*local) / TOGETHER];
                    let at = [0, 1, 2].map(|axis| eight[axis][usize::from(*local) % TOGETHER]);
                    assert_eq!(at, mesh.vertices()[*corner as usize].to_array());
                }
            }
        }
    }

    #[test]
    fn clusters_of_very_many_vertices_have_none() {
        // 32 polygons of 16 corners each, none shared.
        let corner = |i: u32| {
            let angle = f64::from(i % 16) * std::f64::consts::TAU / 16.0;
            Vec3::new(angle.cos() as f32, angle.sin() as f32, (i / 16) as f32)
        };
        let polygons = (0..32).map(|p| Polygon::new((16 * p..16 * p + 16).collect(), 0)).collect();
        let mesh = Mesh::new("pile", (0..512).map(corner).collect(), polygons, PolygonOrder::Spatial).unwrap();
        assert!(mesh.cluster_vertices().of(0).is_empty());
    }
}
