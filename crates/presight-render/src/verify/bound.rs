//! Derivation of the error bounds: how much two correct engines may differ.
//!
//! Let p_k be a polygon's corners in the mesh frame, c the sensor's centre there, and M the transform to the image
//! frame: v_k = M (p_k - c). The unit normal is n = N n_mesh / |N n_mesh| with N the inverse transpose of M, the plane
//! is n . x = d, and the inverse range along a unit ray u is k = n . u / d. `eps` is the unit roundoff of the engine's
//! arithmetic (2^-24 for f32, 2^-53 for f64) *plus* that of the reference (2^-53); |M| is the Frobenius norm.
//!
//! **Distance.** p - c is rounded once if c is one number, twice if c is two f32 (c = high + low, which itself is off
//! by eps^2 |c|). M and the three products and sums of each component add 4 roundings: v_k is off by 6 eps |M| |p_k -
//! c| + eps^2 |M| |c|. n is rounded in the mesh, in N, in the product and by its normalization: `off_n` = 6 eps |N| /
//! |N n_mesh|. d = n . v of the nearest corner has 3 roundings of its own. In total: `off_d` = 12 eps |M|
//! min|p - c| (1 + |N| / |N n_mesh|), the term c2 min|v_k| / |d|. In f32 this reaches a thousandth of d if d is a
//! thousandth of |v|, as over a large floor. Therefore every compute engine sets up polygons flatter than
//! `SET_UP_FINELY` around the sensor in f64, and eps here is 2^-53 for them; n / d is then rounded once more to f32,
//! which is one of the 6 eps of the ray and the product below.
//!
//! **Plane.** Errors of the polygon itself, not of the engine's arithmetic: corners that deviate from the common plane
//! by up to `deviation` (allowed by merging and f32 vertices; doubled, because another engine may use another corner
//! for d or triangulate); the centre c, which the plan itself rounds to 2^-53 |c|; and the tilt of a plane computed
//! from rounded corners, 2^-53 |p - c| size / thickness (slivers).
//!
//! **Range.** Let `off` be the sum of the distance's and the plane's error. Then k' = (n . u + a) / (d + b) with |a| <=
//! off_n + 6 eps for the ray and the product, and |b| <= off, so |k' - k| <= (|a| + |k| off) / (|d| - off) exactly.
//! Relative to k this is the design's c1 eps / |n . u| + c2 eps min|v_k| / |d| + off_plane / |d|, and it stays finite
//! for a ray that grazes the plane. If off >= |d|, the range is unknown. Division, square root and the last rounding
//! add [`Precision::output_ulps`] ulp of the result. depth_z is the range times u.z: the same relative bound.
//! cos_incidence is |n . u|: |a|, the tilt's angle, and the output's ulps.
//!
//! **Side.** The sign of d is certain only if |d| exceeds its error; an engine that cannot decide it leaves the polygon
//! out. A polygon may therefore be missing if |d| <= 4 off_d + 2 deviation.
//!
//! **Edge.** e = v_a x w, w = M (p_b - p_a), and h = |e| / |w| is the distance of the edge's line from the sensor. v_a
//! and w carry their roundings, and the product 4 more: |e' - e| <= 10 eps |M| (|p_a - c| |w| + |v_a| |p_b - p_a|) ...
//! <= 24 eps |M| |p_a - c| |M| |p_b - p_a|. Relative to |e| = h |w| this is an angle of the order of eps |v_a| / h:
//! long edges that pass close to the sensor are the worst, and f32 vertices cannot do better. Added to that are the
//! centre's rounding over h, a recomputation from individually rounded corners (2^-53 only: (|v_a| + |v_b|) / (|w| h)
//! times |v|), the ray's own rounding, 8 eps, and the span's: a fixed fraction of the angle between neighbouring rays
//! ([`Precision::pixel_fraction`]).
//!
//! **Dent.** A corner may turn inwards by as much as [`Mesh::new`](presight_model::Mesh::new) accepts. The cone of such
//! a polygon is the part within all its edges' planes, which cuts off the areas beyond the sides of the dent. The cut
//! reaches no farther from an edge's plane than the corner farthest beyond it.

use crate::reference::{Edge, Face, UNIT_ROUNDOFF};
use glam::DVec3;
use presight_model::geometry::Aabb;

/// The precision of an engine's arithmetic, which determines its error bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum Precision {
    /// f64 arithmetic and f32 output: the reference and the CPU engine.
    F64,
    /// f32 corners relative to the sensor, and f32 spans or ray tables: the GPU engine with any rasterizer.
    F32,
}

impl Precision {
    /// Unit roundoff of the engine and of the reference together.
    pub fn unit_roundoff(self) -> f64 {
        match self {
            Self::F64 => 2.0 * UNIT_ROUNDOFF,
            Self::F32 => f64::from(f32::EPSILON) / 2.0 + UNIT_ROUNDOFF,
        }
    }

    /// Allowed error of edges beyond rounding, as a fraction of the angle between neighbouring rays.
    pub fn pixel_fraction(self) -> f64 {
        match self {
            Self::F64 => (-20f64).exp2(),
            Self::F32 => (-12f64).exp2(),
        }
    }

    /// Rounding of an output to f32, for both images together, in units in the last place: half an ulp each for f64;
    /// WGSL allows 2.5 for a division and 4.5 for a square root.
    pub fn output_ulps(self) -> f64 {
        match self {
            Self::F64 => 1.0,
            Self::F32 => 8.0,
        }
    }

    /// Factor for comparisons of already rounded ranges with each other and with the limits.
    pub fn limit_slack(self) -> f64 {
        1.0 + self.output_ulps() * f64::from(f32::EPSILON)
    }
}

/// Ratio of a plane's to its nearest corner's distance, in the mesh frame, below which f32 compute engines set up
/// polygons in f64, if the sensor is within one box size of their box.
pub const SET_UP_FINELY: f64 = 2e-3;

/// True if engines certainly set up this polygon in f64.
pub fn is_set_up_finely(face: &Face) -> bool {
    // Corners are relative to the sensor.
    let around = || face.relative.iter().fold(Aabb::EMPTY, |b, p| b.with(*p));
    let is_near = |b: Aabb| b.distance_squared(DVec3::ZERO) <= (0.999 * b.size()).powi(2);
    face.flatness <= SET_UP_FINELY && is_near(around())
}

/// The error bounds of a polygon's plane, with their parts.
#[derive(Clone, Copy, Debug)]
pub struct PlaneBound {
    /// Error of n . u.
    pub cosine: f64,
    /// Error of d, metres: arithmetic and plane.
    pub distance: f64,
    /// True if engines may fail to decide the sensor's side.
    may_be_edge_on: bool,
    /// Contribution of the centre's own rounding, metres.
    centre: f64,
    /// Contribution of the plane's own tilt at its farthest corner, metres.
    tilt: f64,
}

impl PlaneBound {
    /// Computes the bounds; `centre_in_mesh` is c.
    pub fn new(face: &Face, centre_in_mesh: DVec3, precision: Precision) -> Self {
        let eps = precision.unit_roundoff();
        let centre = 4.0 * face.norm * centre_in_mesh.length() * (UNIT_ROUNDOFF + eps * eps);
        let finely = precision == Precision::F32 && is_set_up_finely(face);
        let of_distance = if finely { Precision::F64.unit_roundoff() } else { eps };
        let arithmetic = 12.0 * of_distance * face.nearest * (1.0 + face.normal_condition);
        let farthest = face.relative.iter().map(|p| p.length()).fold(0.0, f64::max) * face.norm;
        let tilt = 8.0 * UNIT_ROUNDOFF * farthest * (1.0 + face.aspect);
        let deviation = face.spread();
        Self {
            cosine: 6.0 * eps * face.normal_condition + 6.0 * eps,
            distance: arithmetic + centre + tilt + 2.0 * deviation,
            may_be_edge_on: face.edge_on()
                || face.distance.abs() <= 4.0 * arithmetic + 8.0 * centre + tilt + 2.0 * deviation,
            centre,
            tilt,
        }
    }
}

/// The error bounds of one polygon.
#[derive(Clone, Debug)]
pub struct FaceBound {
    /// Angle per edge, radians, with the ray's rounding but without the span's; infinite if its line meets the centre.
    pub edges: Vec<f64>,
    /// Error of n . u.
    cosine: f64,
    /// Error of cos_incidence: `cosine` plus the plane's tilt.
    pub shown_cosine: f64,
    /// Error of d, metres: arithmetic and plane.
    distance: f64,
    /// True if engines may fail to decide the sensor's side.
    pub may_be_edge_on: bool,
}

impl FaceBound {
    /// Computes the bounds; `centre_in_mesh` is c.
    pub fn new(face: &Face, centre_in_mesh: DVec3, precision: Precision) -> Self {
        let eps = precision.unit_roundoff();
        let plane = PlaneBound::new(face, centre_in_mesh, precision);
        let size = face.corners.iter().map(|v| v.distance(face.corners[0])).fold(0.0, f64::max);
        Self {
            edges: face.edges.iter().map(|e| edge_bound(face, e, plane.centre, eps) + dent(face, e)).collect(),
            cosine: plane.cosine,
            shown_cosine: plane.cosine + plane.tilt / size,
            distance: plane.distance,
            may_be_edge_on: plane.may_be_edge_on,
        }
    }

    /// Error of the inverse range along a unit ray, 1/m; infinite if the range is unknown.
    pub fn inverse_range(&self, face: &Face, ray: DVec3) -> f64 {
        let known = face.distance.abs() - self.distance;
        let inverse = face.inverse_range(ray).abs();
        if known > 0.0 { (self.cosine + inverse * self.distance) / known } else { f64::INFINITY }
    }

    /// Distance of the ray inside the cone, in units of the edges' bounds: from 1 on it is inside for every engine,
    /// below -1 it is outside for every engine. `span` is the span's share, radians.
    pub fn inside(&self, face: &Face, ray: DVec3, span: f64) -> f64 {
        let of_edge = |(edge, bound): (&Edge, &f64)| {
            let length = edge.plane.length();
            if length > 0.0 && bound.is_finite() { edge.plane.dot(ray) / length / (bound + span) } else { 0.0 }
        };
        face.edges.iter().zip(&self.edges).map(of_edge).fold(f64::INFINITY, f64::min)
    }

    /// Maximum angle by which an outline may grow, radians.
    pub fn widest(&self) -> f64 {
        self.edges.iter().copied().fold(0.0, f64::max)
    }
}

/// See "Dent" above; radians, 0 up to rounding for a convex polygon.
fn dent(face: &Face, edge: &Edge) -> f64 {
    let beyond = |v: &DVec3| -edge.plane.dot(*v) / (edge.plane.length() * v.length());
    if face.corners.len() > 3 { face.corners.iter().map(beyond).fold(0.0, f64::max) } else { 0.0 }
}

/// See "Edge" above; radians.
fn edge_bound(face: &Face, edge: &Edge, centre: f64, eps: f64) -> f64 {
    let reach = |k: usize| face.norm * face.relative[k].length();
    let along = face.corners[edge.b].distance(face.corners[edge.a]);
    let length = face.norm * face.relative[edge.b].distance(face.relative[edge.a]);
    let plane = edge.plane.length();
    if plane == 0.0 {
        return f64::INFINITY;
    }
    let rounding = 24.0 * eps * reach(edge.a) * length / plane;
    let shifted = centre * along / plane;
    let recomputed =
        8.0 * UNIT_ROUNDOFF * (reach(edge.a) + centre).max(reach(edge.b)) * (reach(edge.a) + reach(edge.b)) / plane;
    rounding + shifted + recomputed + 8.0 * eps
}
