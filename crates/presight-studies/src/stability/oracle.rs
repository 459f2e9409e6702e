//! The truth: the exact view of a sensor, computed with a hundred digits from the given numbers of scene, pose and
//! sensor. For studies only; no prediction uses it.
//!
//! Quaternions are normalized exactly. The plane of a polygon has Newell's normal of the exact corners and goes through
//! the nearest corner, as in the engines. A ray meets a polygon if it lies in the cone of its corners.

use super::big::{Big, Vector};
use super::lens::Exact;
use super::truth::{PolygonOnRay, Truth};
use glam::DVec3;
use presight_model::environment::Object;
use presight_model::sensor::{Angles, Geometry};
use presight_render::plan::FramePlan;
use presight_render::reference::{Face, instances};
use presight_render::verify::FaceBound;
use presight_render::verify::Precision;

/// An exact polygon relative to the sensor, with the product's error bounds.
pub(super) struct ExactFace {
    pub polygon_id: u32,
    pub object_id: u32,
    /// The product's f64 setup of the polygon.
    pub face: Face,
    bounds: [FaceBound; 2],
    /// Inward unit normals of the planes through the sensor and the edges; edge k runs from corner k to the next.
    edges: Vec<Vector>,
    /// True if edges k - 1 and k meet in a reflex corner.
    inward: Vec<bool>,
    normal: Vector,
    distance: Big,
}

/// The scene of a plan, exact.
pub(super) struct Oracle<'a> {
    plan: &'a FramePlan,
    pub faces: Vec<ExactFace>,
    /// Cosine and sine by column and by row, of scanners.
    turns: [Vec<(Big, Big)>; 2],
    lens: Option<Exact>,
}

impl<'a> Oracle<'a> {
    /// Covers all objects, and treats all of them as opaque.
    pub fn new(plan: &'a FramePlan) -> Self {
        let centre = Vector::new(plan.world_from_sensor.translation);
        let instances = instances(plan);
        let mut faces = Vec::new();
        for (object, instance) in plan.environment().objects().iter().zip(&instances) {
            for polygon in 0..object.mesh.polygon_count() as u32 {
                let corners: Vec<Vector> =
                    object.mesh.corners_of(polygon).map(|p| &in_world(object, p) - &centre).collect();
                let face = Face::new(instance, &object.mesh, polygon);
                let bounds = [Precision::F64, Precision::F32]
                    .map(|precision| FaceBound::new(&face, instance.center_in_mesh, precision));
                let ids = (plan.polygon_id(instance.object, polygon), instance.object + 1);
                faces.push(ExactFace::new(&corners, ids, face, bounds));
            }
        }
        let geometry = &plan.sensor.spec().geometry;
        let turns = match geometry {
            Geometry::Scanner(s) => [turns_of(&s.azimuth, false), turns_of(&s.elevation, true)],
            _ => [Vec::new(), Vec::new()],
        };
        let lens = match geometry {
            Geometry::Camera(camera) if !camera.distortion.is_none() => Some(Exact::new(&camera.distortion)),
            _ => None,
        };
        Self { plan, faces, turns, lens }
    }

    /// The truth at a pixel.
    pub fn look(&self, column: u32, row: u32) -> Truth {
        let ray = match self.ray(column, row) {
            Ok(ray) => ray,
            Err(truth) => return truth,
        };
        Truth::Ray(self.faces.iter().map(|face| face.along(&ray)).collect())
    }

    /// The unit ray of a pixel, world axes.
    fn ray(&self, column: u32, row: u32) -> Result<Vector, Truth> {
        let body = match &self.plan.sensor.spec().geometry {
            Geometry::Camera(camera) => {
                let normalized = |i: u32, c: f64, f: f64| &(&Big::new(f64::from(i)) - &Big::new(c)) / &Big::new(f);
                let (x, y) = (normalized(column, camera.cx, camera.fx), normalized(row, camera.cy, camera.fy));
                let Vector([x, y, z]) = match &self.lens {
                    None => Vector([x, y, Big::new(1.0)]),
                    Some(lens) => lens.inverse(&x, &y, self.plan.sensor.ray(column, row))?,
                };
                let Vector([x, y, z]) = Vector([x, y, z]).turned(self.plan.sensor.spec().optical_from_image);
                Vector([z, -&x, -&y])
            }
            Geometry::Scanner(_) => {
                let [(az_cos, az_sin), (el_cos, el_sin)] =
                    [&self.turns[0][column as usize], &self.turns[1][row as usize]];
                Vector([el_cos * az_cos, el_cos * az_sin, el_sin.clone()])
            }
            Geometry::Rays(table) => {
                let direction = table.directions()[(row * table.width() + column) as usize];
                if !direction.is_finite() {
                    return Err(Truth::NoRay);
                }
                Vector::new(direction)
            }
        };
        Ok(body.turned(self.plan.world_from_sensor.rotation).normalized())
    }
}

impl ExactFace {
    fn new(corners: &[Vector], (polygon_id, object_id): (u32, u32), face: Face, bounds: [FaceBound; 2]) -> Self {
        let n = corners.len();
        let sides: Vec<Vector> = (0..n).map(|k| &corners[(k + 1) % n] - &corners[k]).collect();
        let from_first = |k: usize| &corners[k] - &corners[0];
        let zero = Vector::new(DVec3::ZERO);
        let normal = (1..n - 1).fold(zero, |sum, k| &sum + &from_first(k).cross(&from_first(k + 1))).normalized();
        let squares: Vec<Big> = corners.iter().map(|v| v.dot(v)).collect();
        let nearest = (0..n).fold(0, |best, k| if squares[k] < squares[best] { k } else { best });
        let distance = normal.dot(&corners[nearest]);
        let side = Big::new(if distance.is_negative() { -1.0 } else { 1.0 });
        let edges = (0..n).map(|k| corners[k].cross(&sides[k]).normalized().scaled(&side)).collect();
        let inward = (0..n).map(|k| sides[(k + n - 1) % n].cross(&sides[k]).dot(&normal).is_negative()).collect();
        Self { polygon_id, object_id, face, bounds, edges, inward, normal, distance }
    }

    /// The error bounds of an engine with this precision.
    pub fn bound(&self, precision: Precision) -> &FaceBound {
        &self.bounds[usize::from(precision != Precision::F64)]
    }

    fn along(&self, ray: &Vector) -> PolygonOnRay {
        let cos = self.normal.dot(ray);
        // No ray meets a plane through the sensor.
        let inverse_range = if self.distance.is_zero() { 0.0 } else { (&cos / &self.distance).to_f64() };
        let covers = |e: &Vector| if self.distance.is_zero() { -1.0 } else { e.dot(ray).to_f64() };
        PolygonOnRay {
            margins: self.edges.iter().map(covers).collect(),
            inverse_range,
            cos_incidence: cos.abs().to_f64(),
        }
    }

    /// Distance of a ray from the outline, in units of an engine's bounds: at least 1 is certainly inside, below -1
    /// surely outside. `span` is the error of the engine's spans, radians.
    pub fn inside(&self, sight: &PolygonOnRay, precision: Precision, span: f64) -> f64 {
        let bounds = &self.bound(precision).edges;
        self.least(|k| if bounds[k].is_finite() { sight.margins[k] / (bounds[k] + span) } else { 0.0 })
    }

    /// Returns true if a ray meets the polygon.
    pub fn is_met(&self, sight: &PolygonOnRay) -> bool {
        sight.inverse_range > 0.0 && self.least(|k| sight.margins[k]) >= 0.0
    }

    /// The minimum of a value over all edges.
    fn least(&self, share: impl Fn(usize) -> f64) -> f64 {
        let n = self.edges.len();
        (0..n).fold(f64::INFINITY, |least, k| {
            // At a reflex corner it suffices to be inside one of the two edges.
            let mut own = share(k);
            if self.inward[k] {
                own = own.max(share((k + n - 1) % n));
            }
            if self.inward[(k + 1) % n] {
                own = own.max(share((k + 1) % n));
            }
            least.min(own)
        })
    }
}

/// A point of an object's mesh in the world.
fn in_world(object: &Object, p: DVec3) -> Vector {
    let m = object.object_from_mesh;
    let p = Vector::new(p);
    let part = |axis: DVec3, k: usize| Vector::new(axis).scaled(&p.0[k]);
    let linear = &(&part(m.matrix3.x_axis, 0) + &part(m.matrix3.y_axis, 1)) + &part(m.matrix3.z_axis, 2);
    let in_object = &linear + &Vector::new(m.translation);
    &in_object.turned(object.world_from_object.rotation) + &Vector::new(object.world_from_object.translation)
}

/// Cosine and sine of `start + i * step`, exact; rows are sorted by falling elevation.
fn turns_of(angles: &Angles, falling: bool) -> Vec<(Big, Big)> {
    let degrees = |i: usize| match angles {
        Angles::Uniform { start_deg, step_deg, .. } => {
            &Big::new(*start_deg) + &(&Big::new(i as f64) * &Big::new(*step_deg))
        }
        Angles::Listed(all) => Big::new(all[i]),
    };
    let mut all: Vec<Big> = (0..angles.len()).map(degrees).collect();
    if falling {
        all.sort_by(|a, b| b.partial_cmp(a).unwrap_or(std::cmp::Ordering::Equal));
    }
    let turn = |a: &Big| {
        let (sin, cos) = a.sin_cos_deg();
        (cos, sin)
    };
    all.iter().map(turn).collect()
}
