//! The vertices of each cluster side by side, each once: a mesh of triangles has half as many vertices as triangles, and six times as many
//! corners as vertices.

use super::mesh::{Cluster, PolygonRecord};
use glam::Vec3;

/// Vertices that are looked at together.
const TOGETHER: usize = 8;

/// Most vertices of a cluster that are numbered.
const MOST: usize = 256;

/// Eight positions, by axis.
pub type Positions = [[f32; TOGETHER]; 3];

/// The vertices of a mesh by cluster.
#[derive(Clone, Debug, Default)]
pub struct ClusterVertices {
    /// By cluster, where its positions begin, and the end of all. A cluster of too many vertices has none.
    starts: Vec<u32>,
    /// Past the last vertex of a cluster it is repeated.
    positions: Vec<Positions>,
    /// By corner of the mesh, its vertex, counted from the first one of its cluster.
    locals: Vec<u8>,
    /// By cluster: two corners of a polygon are no farther apart.
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
        // By vertex: the cluster that it was last met in, and its number there.
        let mut met = vec![(u32::MAX, 0u8); vertices.len()];
        let mut own: Vec<Vec3> = Vec::with_capacity(MOST);
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
            if own.len() <= MOST {
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

    /// Two corners of a polygon of a cluster are no farther apart.
    pub fn widest(&self, cluster: usize) -> f64 {
        f64::from(self.widest[cluster])
    }

    /// Of a cluster; none if it has too many.
    pub fn of(&self, cluster: usize) -> &[Positions] {
        &self.positions[self.starts[cluster] as usize..self.starts[cluster + 1] as usize]
    }

    /// The vertices of a polygon, counted from the first one of its cluster.
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
