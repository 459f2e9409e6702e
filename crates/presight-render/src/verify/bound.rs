//! How far two right engines may be apart: the error bounds, derived.
//!
//! A polygon has corners p_k in its mesh, the sensor's centre is c there, M turns the mesh frame into the image frame:
//! v_k = M (p_k - c). Its unit normal is n = N n_mesh / |N n_mesh| with N the inverse transpose of M, its plane is
//! n . x = d, and along the unit ray u one over the range is k = n . u / d. `eps` is the unit roundoff of the
//! engine's arithmetic (2^-24 for f32, 2^-53 for f64) *plus* that of the reference (2^-53); |M| is the Frobenius norm.
//!
//! **Distance.** p - c is rounded once where c is one number, twice where it is two f32 (c = high + low, which itself
//! is off by eps^2 |c|). M and the three products and sums of each component add 4 more: v_k is off by
//! 6 eps |M| |p_k - c| + eps^2 |M| |c|. n is rounded in the mesh, in N, in the product and when it is normalized:
//! `off_n` = 6 eps |N| / |N n_mesh|. d = n . v of the nearest corner has 3 roundings of its own:
//! `off_d` = 12 eps |M| min|p - c| (1 + |N| / |N n_mesh|) covers all of it: the term c2 min|v_k| / |d|. In f32 that is a
//! thousandth of d where d is a thousandth of |v|, as over a large floor. So polygons flatter than `SET_UP_FINELY` around
//! the sensor are set up in f64 by every compute engine, and eps here is 2^-53 for them; n / d is then rounded once more on its way
//! to f32, which is one of the 6 eps of the ray and the product below.
//!
//! **Plane.** What is not the engine's arithmetic but the polygon's own: corners off the common plane by up to
//! `deviation` (merging and f32 vertices allow some, and another engine may take another corner for d, or cut the
//! polygon into triangles: twice that), the centre c, which the plan itself can only round to 2^-53 |c|, and the
//! plane's tilt when it is worked out from rounded corners: 2^-53 |p - c| size / thickness (slivers).
//!
//! **Range.** With `off` the sum of the distance's and the plane's error, k' = (n . u + a) / (d + b), |a| <= off_n +
//! 6 eps for the ray and the product, |b| <= off, so |k' - k| <= (|a| + |k| off) / (|d| - off) exactly: relative to k
//! that is the c1 eps / |n . u| + c2 eps min|v_k| / |d| + off_plane / |d| of the design, and it stays finite where a
//! ray grazes the plane. If off >= |d| nothing is known about the range. Division, square root and the last
//! rounding add [`Precision::output_ulps`] ulp of the result. depth_z is the range times u.z: the same relative bound.
//! cos_incidence is |n . u|: |a|, the tilt's angle, and the output's ulps.
//!
//! **Side.** The sign of d is proven only if |d| exceeds its error; an engine that cannot prove it leaves the polygon
//! out. So where |d| <= 4 off_d + 2 deviation a polygon may be missing, though never where |d| is clear.
//!
//! **Edge.** e = v_a x w, w = M (p_b - p_a), and h = |e| / |w| is the distance of the edge's line from the sensor. v_a and
//! w being off by their roundings, and 4 more in the product, |e' - e| <= 10 eps |M| (|p_a - c| |w| + |v_a| |p_b - p_a|)
//! ... <= 24 eps |M| |p_a - c| |M| |p_b - p_a|; against |e| = h |w| that is an angle of the order of
//! eps |v_a| / h: long edges that pass close by are the worst, and f32 vertices cannot do better. To that come
//! the centre's rounding over h, a recomputation from corners that were rounded on their own (2^-53 only:
//! (|v_a| + |v_b|) / (|w| h) times |v|), the ray's own rounding, 8 eps, and the span's: a stated part of the
//! angle between neighbouring rays ([`Precision::pixel_fraction`]).
//!
//! **Dent.** A corner may turn inwards by as much as [`Mesh::new`](crate::Mesh::new) lets pass. The cone of such a polygon is
//! the part within all its edges' planes, which cuts off what lies beyond the sides of the dent: no farther from an edge's
//! plane than the corner that is farthest beyond it.

use crate::reference::{Edge, Face, UNIT_ROUNDOFF};
use glam::DVec3;
use presight_model::geometry::Aabb;

/// The arithmetic of an engine, which decides how far from the reference it may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub enum Precision {
    /// f64 throughout, f32 output: the reference and the CPU engine.
    F64,
    /// f32 corners relative to the sensor, spans or ray tables in f32: the GPU engine, however it rasterizes.
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

    /// Edges may be off by this part of the angle between neighbouring rays, on top of all rounding.
    pub fn pixel_fraction(self) -> f64 {
        match self {
            Self::F64 => (-20f64).exp2(),
            Self::F32 => (-12f64).exp2(),
        }
    }

    /// Rounding of an output on its way to f32, both images together, in its units in the last place: half an ulp
    /// each for f64; WGSL allows 2.5 for a division and 4.5 for a square root.
    pub fn output_ulps(self) -> f64 {
        match self {
            Self::F64 => 1.0,
            Self::F32 => 8.0,
        }
    }

    /// Ranges may be compared with each other and with the limits when they are rounded already: by this factor.
    #[doc(hidden)]
    pub fn limit_slack(self) -> f64 {
        1.0 + self.output_ulps() * f64::from(f32::EPSILON)
    }
}

/// Plane distance over that of the nearest corner, in the mesh's frame, below which compute engines in f32 set up polygons
/// in f64 if the sensor is no farther from their box than the box is large.
pub const SET_UP_FINELY: f64 = 2e-3;

/// True of polygons that they surely do.
pub fn is_set_up_finely(face: &Face) -> bool {
    // From the sensor.
    let around = || face.relative.iter().fold(Aabb::EMPTY, |b, p| b.with(*p));
    let is_near = |b: Aabb| b.distance_squared(DVec3::ZERO) <= (0.999 * b.size()).powi(2);
    face.flatness <= SET_UP_FINELY && is_near(around())
}

/// The error bounds of a polygon's plane, and what they are made of.
#[derive(Clone, Copy, Debug)]
pub struct PlaneBound {
    /// Error of n . u.
    pub cosine: f64,
    /// Error of d, metres: arithmetic and plane.
    pub distance: f64,
    /// An engine need not have proven the side that the sensor is on.
    may_be_edge_on: bool,
    /// What the centre's own rounding adds, metres.
    centre: f64,
    /// What the plane's own tilt adds at its farthest corner, metres.
    tilt: f64,
}

impl PlaneBound {
    /// Works them out; `centre_in_mesh` is c.
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
    /// Radians by edge, for the ray too but without the span's share; infinite where the edge's line meets the centre.
    pub edges: Vec<f64>,
    /// Error of n . u.
    cosine: f64,
    /// Error of cos_incidence: that, and the plane's tilt.
    pub shown_cosine: f64,
    /// Error of d, metres: arithmetic and plane.
    distance: f64,
    /// An engine need not have proven the side that the sensor is on.
    pub may_be_edge_on: bool,
}

impl FaceBound {
    /// Works the bounds out; `centre_in_mesh` is c.
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

    /// Error of one over the range along a unit ray, 1/m; infinite where nothing is known.
    pub fn inverse_range(&self, face: &Face, ray: DVec3) -> f64 {
        let known = face.distance.abs() - self.distance;
        let inverse = face.inverse_range(ray).abs();
        if known > 0.0 { (self.cosine + inverse * self.distance) / known } else { f64::INFINITY }
    }

    /// How far inside the cone the ray is, in units of the edges' bounds: at least 1 is inside for every engine,
    /// below -1 is outside for every engine. `span` is the span's share, radians.
    pub fn inside(&self, face: &Face, ray: DVec3, span: f64) -> f64 {
        let of_edge = |(edge, bound): (&Edge, &f64)| {
            let length = edge.plane.length();
            if length > 0.0 && bound.is_finite() { edge.plane.dot(ray) / length / (bound + span) } else { 0.0 }
        };
        face.edges.iter().zip(&self.edges).map(of_edge).fold(f64::INFINITY, f64::min)
    }

    /// The widest an outline may grow, radians.
    pub fn widest(&self) -> f64 {
        self.edges.iter().copied().fold(0.0, f64::max)
    }
}

/// See "Dent" above; radians, 0 but for rounding where the polygon is convex.
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
