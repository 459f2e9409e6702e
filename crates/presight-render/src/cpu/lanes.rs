//! Corners, planes and edges of several polygons of a mesh at the same time: eight for the raster, one for a tile. The
//! results for a polygon do not depend on the number of lanes.

use super::instance::RayInstance;
use presight_model::environment::{PolygonRecord, Positions};
use presight_model::limits::MAX_CORNERS;

/// Three coordinates of a point of each polygon.
type Points<const LANES: usize> = [[f64; LANES]; 3];

/// Number of positions that clusters keep together.
const TOGETHER: usize = size_of::<Positions>() / size_of::<[f32; 3]>();

/// Minimum distance of the sensor from a polygon's plane, relative to the polygon's farthest corner, at which the
/// polygon's depths and edges are right to 1e-11 of that corner's distance.
pub(super) const CLEAR: f64 = 1e-4;

/// The polygons in the lanes. Room for corners is kept between loads: clearing it costs more than filling it.
pub(super) struct PolygonLanes<const LANES: usize> {
    /// Maximum number of corners among the lanes.
    count: usize,
    pub corner_counts: [u32; LANES],
    /// By corner, in the frame of the rays. After its last corner a polygon repeats its first.
    corners: [Points<LANES>; MAX_CORNERS],
    /// Corners in the mesh frame, relative to the sensor's centre.
    from_center: [Points<LANES>; MAX_CORNERS],
    /// Vertex indices in the mesh.
    indices: [[u32; LANES]; MAX_CORNERS],
    normals: Points<LANES>,
    /// Distance of the plane from the sensor, along the mesh normal. Its sign is the side.
    pub distance: [f64; LANES],
    /// True if the distance does not exceed its rounding: the edges span no cone.
    pub edge_on: [bool; LANES],
    /// True if the sensor is clear of the plane, so that the drawn polygon agrees with its corners.
    pub clear: [bool; LANES],
    /// Inverse depth of a ray s is m . s.
    pub m: Points<LANES>,
    /// Planes through the centre and the edge from corner to corner, inside positive.
    pub edges: [Points<LANES>; MAX_CORNERS],
    /// The edges as bounds of t on a line: `t = p c0 + q c1`.
    pub bounds: [[[f64; LANES]; 2]; MAX_CORNERS],
}

impl<const LANES: usize> PolygonLanes<LANES> {
    pub fn new() -> Self {
        let (points, zero) = ([[[0.0; LANES]; 3]; MAX_CORNERS], [0.0; LANES]);
        Self {
            count: 0,
            corner_counts: [0; LANES],
            corners: points,
            from_center: points,
            indices: [[0; LANES]; MAX_CORNERS],
            normals: [zero; 3],
            distance: zero,
            edge_on: [false; LANES],
            clear: [false; LANES],
            m: [zero; 3],
            edges: points,
            bounds: [[zero; 2]; MAX_CORNERS],
        }
    }

    /// Loads up to [`LANES`] polygons; further lanes repeat the last. If `cluster` is given, it has the positions of
    /// the cluster to which all of them belong, which are in the cache.
    #[inline(always)]
    pub fn load(&mut self, at: &RayInstance<'_>, polygons: &[u32], cluster: Option<&[Positions]>) {
        let (vertices, all_corners) = (at.mesh.vertices(), at.mesh.all_corners());
        let cluster = cluster.map(|positions| (positions, at.mesh.cluster_vertices()));
        let records = Self::records(at, polygons);
        self.corner_counts = records.map(|record| u32::from(record.corner_count));
        self.count = self.corner_counts.iter().max().map_or(0, |&m| m as usize);
        let (m, center) = (at.ray_from_mesh, at.center);
        for i in 0..self.count {
            let (from_center, corner) = (&mut self.from_center[i], &mut self.corners[i]);
            for l in 0..LANES {
                let own = if i < self.corner_counts[l] as usize { i } else { 0 };
                let [x, y, z] = match cluster {
                    Some((positions, by_cluster)) => {
                        let local = usize::from(by_cluster.locals(records[l])[own]);
                        let eight = &positions[local / TOGETHER];
                        [eight[0][local % TOGETHER], eight[1][local % TOGETHER], eight[2][local % TOGETHER]]
                    }
                    None => vertices[records[l].corners(all_corners)[own] as usize].to_array(),
                };
                (from_center[0][l], from_center[1][l], from_center[2][l]) = (f64::from(x), f64::from(y), f64::from(z));
            }
            for l in 0..LANES {
                let (x, y, z) =
                    (from_center[0][l] - center.x, from_center[1][l] - center.y, from_center[2][l] - center.z);
                (from_center[0][l], from_center[1][l], from_center[2][l]) = (x, y, z);
                corner[0][l] = m.x_axis.x * x + m.y_axis.x * y + m.z_axis.x * z;
                corner[1][l] = m.x_axis.y * x + m.y_axis.y * y + m.z_axis.y * z;
                corner[2][l] = m.x_axis.z * x + m.y_axis.z * y + m.z_axis.z * z;
            }
        }
    }

    /// Record of each lane's polygon.
    #[inline(always)]
    fn records<'a>(at: &RayInstance<'a>, polygons: &[u32]) -> [&'a PolygonRecord; LANES] {
        let records = at.mesh.polygons();
        std::array::from_fn(|l| &records[polygons[l.min(polygons.len() - 1)] as usize])
    }

    /// Corners in the frame of the rays.
    pub fn corners(&self) -> &[Points<LANES>] {
        &self.corners[..self.count]
    }

    /// Measures the distance of the sensor from each plane, at the nearest corner. It must exceed the distances of the
    /// corners from the plane; otherwise the side is not proven.
    #[inline(always)]
    pub fn measure(&mut self, at: &RayInstance<'_>, polygons: &[u32]) {
        for l in 0..LANES {
            let normal = at.mesh.planes()[polygons[l.min(polygons.len() - 1)] as usize].normal;
            (self.normals[0][l], self.normals[1][l], self.normals[2][l]) = (normal.x, normal.y, normal.z);
        }
        let n = &self.normals;
        let (mut least, mut most) = ([f64::INFINITY; LANES], [f64::NEG_INFINITY; LANES]);
        let (mut near, mut far, mut reach) = ([f64::INFINITY; LANES], [0.0; LANES], [0.0; LANES]);
        for p in &self.from_center[..self.count] {
            for l in 0..LANES {
                let [x, y, z] = [p[0][l], p[1][l], p[2][l]];
                let off = n[0][l] * x + n[1][l] * y + n[2][l] * z;
                let square = x * x + y * y + z * z;
                least[l] = if off < least[l] { off } else { least[l] };
                most[l] = if off > most[l] { off } else { most[l] };
                far[l] = if square > far[l] { square } else { far[l] };
                let nearer = square < near[l];
                near[l] = if nearer { square } else { near[l] };
                self.distance[l] = if nearer { off } else { self.distance[l] };
                reach[l] = if nearer { x.abs() + y.abs() + z.abs() } else { reach[l] };
            }
        }
        for l in 0..LANES {
            let spread = if self.corner_counts[l] > 3 { most[l] - least[l] } else { 0.0 };
            self.edge_on[l] = self.distance[l].abs() <= 16.0 * f64::EPSILON * reach[l] + spread;
            self.clear[l] = self.distance[l] * self.distance[l] > CLEAR * CLEAR * far[l];
        }
    }

    /// Fills `m` of the measured polygons.
    #[inline(always)]
    pub fn set_up_planes(&mut self, at: &RayInstance<'_>) {
        let (n, m) = (&self.normals, at.m_from_normal);
        for l in 0..LANES {
            let d = self.distance[l];
            let [x, y, z] = [n[0][l], n[1][l], n[2][l]];
            self.m[0][l] = (m.x_axis.x * x + m.y_axis.x * y + m.z_axis.x * z) / d;
            self.m[1][l] = (m.x_axis.y * x + m.y_axis.y * y + m.z_axis.y * z) / d;
            self.m[2][l] = (m.x_axis.z * x + m.y_axis.z * y + m.z_axis.z * z) / d;
        }
    }

    /// Fills `edges` of the polygons that were measured.
    ///
    /// Edges are computed from the lower vertex index to the higher, sign afterwards, so that neighbours get exactly
    /// opposite planes and no ray falls between them.
    #[inline(always)]
    pub fn set_up_edges(&mut self, at: &RayInstance<'_>, polygons: &[u32]) {
        let (records, all_corners) = (Self::records(at, polygons), at.mesh.all_corners());
        for (i, indices) in self.indices[..self.count].iter_mut().enumerate() {
            for l in 0..LANES {
                let own = if i < self.corner_counts[l] as usize { i } else { 0 };
                indices[l] = records[l].corners(all_corners)[own];
            }
        }
        let mut outward = [0.0; LANES];
        for l in 0..LANES {
            outward[l] = if (self.distance[l] > 0.0) == at.mirrored { -1.0 } else { 1.0 };
        }
        for k in 0..self.count {
            let next = if k + 1 == self.count { 0 } else { k + 1 };
            let (p, q) = (&self.corners[k], &self.corners[next]);
            let (i, j) = (&self.indices[k], &self.indices[next]);
            let edge = &mut self.edges[k];
            for l in 0..LANES {
                let rising = i[l] < j[l];
                let pick = |axis: usize| if rising { (p[axis][l], q[axis][l]) } else { (q[axis][l], p[axis][l]) };
                let [(ax, bx), (ay, by), (az, bz)] = [pick(0), pick(1), pick(2)];
                let sign = if rising { outward[l] } else { -outward[l] };
                let (dx, dy, dz) = (bx - ax, by - ay, bz - az);
                edge[0][l] = (ay * dz - dy * az) * sign;
                edge[1][l] = (az * dx - dz * ax) * sign;
                edge[2][l] = (ax * dy - dx * ay) * sign;
            }
        }
    }

    /// Fills `bounds` from `edges`.
    #[inline(always)]
    pub fn bound(&mut self) {
        for (e, bound) in self.edges[..self.count].iter().zip(&mut self.bounds) {
            for l in 0..LANES {
                bound[0][l] = -e[0][l] / e[2][l];
                bound[1][l] = -e[1][l] / e[2][l];
            }
        }
    }
}
