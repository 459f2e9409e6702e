//! One polygon as the sensor sees it, in f64.

use crate::environment::Mesh;
use crate::plan::Instance;
use glam::DVec3;

/// Half the distance between 1 and the next f64.
pub(crate) const UNIT_ROUNDOFF: f64 = f64::EPSILON / 2.0;

/// A polygon in the image frame.
#[derive(Clone, Debug)]
pub(crate) struct Face {
    /// Corners less the sensor's centre in the mesh frame, p - c.
    pub relative: Vec<DVec3>,
    /// Corners in the image frame, v = M (p - c).
    pub corners: Vec<DVec3>,
    /// Planes through the centre and the edges; edge k runs from corner k to the next.
    pub edges: Vec<Edge>,
    /// Unit normal, from the winding after the whole transform.
    pub normal: DVec3,
    /// normal . v of the nearest corner, metres; negative where the sensor is on the normal's side.
    pub distance: f64,
    /// Distance of the nearest corner before the transform, times the transform's norm: what `distance` rounds like.
    pub nearest: f64,
    /// Frobenius norm of the linear part of the transform.
    pub norm: f64,
    /// How much the normal's own transform magnifies rounding: 1.7 if it is rigid.
    pub normal_condition: f64,
    /// Longest side by thickness, in the mesh frame: how much rounding of corners tilts the plane.
    pub aspect: f64,
}

/// The plane v_a x (v_b - v_a), with a the first of the two in the order of their coordinates, so that neighbours get
/// exactly opposite planes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Edge {
    /// Turned so that the cone is where `plane . u >= 0`.
    pub plane: DVec3,
    /// Corner number of a.
    pub a: usize,
    /// Corner number of b.
    pub b: usize,
}

impl Face {
    pub fn new(instance: &Instance, mesh: &Mesh, polygon: u32) -> Self {
        let image_from_mesh = instance.image_from_mesh;
        let in_mesh: Vec<DVec3> = mesh.corners_of(polygon).collect();
        let relative: Vec<DVec3> = in_mesh.iter().map(|p| p - instance.center_in_mesh).collect();
        let corners: Vec<DVec3> = relative.iter().map(|p| image_from_mesh * p).collect();
        // The inverse transpose keeps a mirrored normal on its side; the winding turns round.
        let turned = instance.normal_from_mesh * mesh.plane(polygon).normal * image_from_mesh.determinant().signum();
        let normal = turned.normalize();
        let length = |k: usize| relative[k].length_squared();
        let nearest = (0..corners.len()).fold(0, |best, k| if length(k) < length(best) { k } else { best });
        let distance = normal.dot(corners[nearest]);
        let norm = |m: glam::DMat3| m.to_cols_array().iter().map(|x| x * x).sum::<f64>().sqrt();
        let side = |k: usize| {
            let next = (k + 1) % corners.len();
            let forward = in_mesh[k].to_array() <= in_mesh[next].to_array();
            let (a, b) = if forward { (k, next) } else { (next, k) };
            let plane = corners[a].cross(image_from_mesh * (in_mesh[b] - in_mesh[a]));
            Edge { plane: if forward == (distance >= 0.0) { plane } else { -plane }, a, b }
        };
        Self {
            edges: (0..corners.len()).map(side).collect(),
            normal,
            distance,
            nearest: length(nearest).sqrt() * norm(image_from_mesh),
            norm: norm(image_from_mesh),
            normal_condition: norm(instance.normal_from_mesh) / turned.length(),
            aspect: aspect(&in_mesh),
            relative,
            corners,
        }
    }

    /// True if the polygon's plane passes through the sensor as far as f64 can tell: it covers no ray.
    ///
    /// `distance` = n . M (p - c) carries at most 8 roundings of terms no larger than `nearest`, and a tilt of n
    /// that is as many roundings times the aspect.
    pub fn edge_on(&self) -> bool {
        // Written so that NaN is edge-on.
        let proven = self.distance.abs() > 8.0 * UNIT_ROUNDOFF * self.nearest * (1.0 + self.aspect);
        !proven
    }

    /// True if the ray lies in the cone of the polygon.
    pub fn holds(&self, ray: DVec3) -> bool {
        self.edges.iter().all(|e| e.plane.dot(ray) >= 0.0)
    }

    /// One over the range along a unit ray.
    pub fn inverse_range(&self, ray: DVec3) -> f64 {
        self.normal.dot(ray) / self.distance
    }
}

/// Longest side squared by area.
fn aspect(corners: &[DVec3]) -> f64 {
    let n = corners.len();
    let doubled_area: DVec3 = (1..n - 1).map(|k| (corners[k] - corners[0]).cross(corners[k + 1] - corners[0])).sum();
    let longest = (0..n).map(|k| corners[k].distance_squared(corners[(k + 1) % n])).fold(0.0, f64::max);
    longest / doubled_area.length()
}
