//! One polygon as the sensor sees it, in f64.

use crate::plan::Instance;
use glam::DVec3;
use presight_model::environment::Mesh;

/// Half the distance between 1 and the next f64.
pub const UNIT_ROUNDOFF: f64 = f64::EPSILON / 2.0;

/// A polygon in the image frame.
#[derive(Clone, Debug, Default)]
pub struct Face {
    /// Corners in the mesh frame, p.
    pub in_mesh: Vec<DVec3>,
    /// Corners relative to the sensor's centre in the mesh frame, p - c.
    pub relative: Vec<DVec3>,
    /// Corners in the image frame, v = M (p - c).
    pub corners: Vec<DVec3>,
    /// Planes through the centre and the edges; edge k runs from corner k to the next.
    pub edges: Vec<Edge>,
    /// Unit normal, transformed by the inverse transpose. A mirrored polygon keeps its front.
    pub normal: DVec3,
    /// normal . v of the nearest corner, metres; negative if the sensor is on the normal's side.
    pub distance: f64,
    /// Distance of the nearest corner in the mesh frame times `norm`; the rounding of `distance` is proportional to it.
    pub nearest: f64,
    /// Frobenius norm of the linear part of the transform.
    pub norm: f64,
    /// Amplification of rounding by the normal's transform: 1.7 for a rigid transform.
    pub normal_condition: f64,
    /// Ratio of the plane's to the nearest corner's distance in the mesh frame: small if seen edge-on.
    pub flatness: f64,
    /// Squared longest side over twice the area, in the mesh frame: how strongly rounded corners tilt the plane.
    pub aspect: f64,
}

/// The plane v_a x (v_b - v_a), where a has the smaller coordinates (lexicographic), so that neighbours compute exactly
/// opposite planes.
#[derive(Clone, Copy, Debug)]
pub struct Edge {
    /// Signed so that the cone satisfies `plane . u >= 0`.
    pub plane: DVec3,
    /// Corner number of a.
    pub a: usize,
    /// Corner number of b.
    pub b: usize,
}

impl Face {
    /// Computes the face of a polygon in an instance's mesh.
    pub fn new(instance: &Instance, mesh: &Mesh, polygon: u32) -> Self {
        let mut face = Self::default();
        face.renew(instance, mesh, polygon);
        face
    }

    /// Computes another polygon's face in the same memory.
    pub fn renew(&mut self, instance: &Instance, mesh: &Mesh, polygon: u32) {
        let image_from_mesh = instance.image_from_mesh;
        let Self { in_mesh, relative, corners, edges, .. } = self;
        in_mesh.clear();
        relative.clear();
        corners.clear();
        edges.clear();
        in_mesh.extend(mesh.corners_of(polygon));
        relative.extend(in_mesh.iter().map(|p| p - instance.center_in_mesh));
        corners.extend(relative.iter().map(|p| image_from_mesh * *p));
        let turned = instance.normal_from_mesh * mesh.plane(polygon).normal;
        // A mirror keeps the normal's side and reverses the winding.
        let mirrored = instance.mirrors;
        self.normal = turned.normalize();
        let length = |k: usize| relative[k].length_squared();
        let nearest = (0..corners.len()).fold(0, |best, k| if length(k) < length(best) { k } else { best });
        self.distance = self.normal.dot(corners[nearest]);
        let distance = self.distance;
        edges.extend((0..corners.len()).map(|k| {
            let next = (k + 1) % corners.len();
            let forward = in_mesh[k].to_array() <= in_mesh[next].to_array();
            let (a, b) = if forward { (k, next) } else { (next, k) };
            let plane = corners[a].cross(image_from_mesh * (in_mesh[b] - in_mesh[a]));
            Edge { plane: if forward == ((distance >= 0.0) != mirrored) { plane } else { -plane }, a, b }
        }));
        let [norm, normal_norm] = instance.norms;
        self.norm = norm;
        self.nearest = length(nearest).sqrt() * self.norm;
        self.normal_condition = normal_norm / turned.length();
        self.flatness = self.distance.abs() * turned.length() / length(nearest).sqrt();
        self.aspect = aspect(in_mesh);
    }

    /// True if the polygon is edge-on: its plane passes through the sensor within f64 rounding and the deviation of its
    /// corners, so it covers no ray.
    ///
    /// `distance` = n . M (p - c) carries at most 8 roundings of terms no larger than `nearest`, plus a tilt of n by as
    /// many roundings times the aspect. If corners deviate from their plane by more than the sensor's distance, the
    /// edges do not span a cone and would contain rays far from the polygon.
    pub fn edge_on(&self) -> bool {
        let rounding = 8.0 * UNIT_ROUNDOFF * self.nearest * (1.0 + self.aspect);
        // NaN is treated as edge-on.
        let proven = self.distance.abs() > rounding + if self.corners.len() > 3 { self.spread() } else { 0.0 };
        !proven
    }

    /// Extent of the corners along the normal, metres: 0 up to rounding if they are coplanar.
    pub fn spread(&self) -> f64 {
        let along = |most: f64, v: &DVec3| most.max(self.normal.dot(*v) - self.distance);
        let against = |most: f64, v: &DVec3| most.max(self.distance - self.normal.dot(*v));
        self.corners.iter().fold(0.0, along) + self.corners.iter().fold(0.0, against)
    }

    /// True if the ray is in the cone of the polygon.
    pub fn holds(&self, ray: DVec3) -> bool {
        self.edges.iter().all(|e| e.plane.dot(ray) >= 0.0)
    }

    /// Inverse range along a unit ray.
    pub fn inverse_range(&self, ray: DVec3) -> f64 {
        self.normal.dot(ray) / self.distance
    }
}

/// Squared longest side over twice the area.
fn aspect(corners: &[DVec3]) -> f64 {
    let n = corners.len();
    let doubled_area: DVec3 = (1..n - 1).map(|k| (corners[k] - corners[0]).cross(corners[k + 1] - corners[0])).sum();
    let longest = (0..n).map(|k| corners[k].distance_squared(corners[(k + 1) % n])).fold(0.0, f64::max);
    longest / doubled_area.length()
}
