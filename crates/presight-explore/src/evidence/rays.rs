//! Hits and passes: how often rays ended on cells of a plane, and how often they went on behind it.

use crate::geometry::Flat;
use crate::observe::{View, Views};
use glam::{DVec2, DVec3, Vec3};
use presight_model::sensor::Geometry;

/// Rays that are flatter than this say little: cosine of incidence.
const LEAST_COSINE: f32 = 0.15;
/// Nearer rays than this weigh no more, metres.
const NEAREST: f32 = 0.3;

/// Places whose ranges are looked up together, so that their ways from memory overlap.
const TOGETHER: usize = 64;

/// What rays say about a cell: sums of weights, cosine of incidence over range.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Evidence {
    /// Rays that ended on the plane.
    pub hit: f32,
    /// Rays that went through it.
    pub pass: f32,
    /// Number of rays that ended on it.
    pub hits: u32,
    /// Number of rays that went through it.
    pub passes: u32,
}

impl Evidence {
    /// Adds a ray that ended so far behind the plane, metres.
    #[inline]
    fn add(&mut self, behind: f32, weight: f32, margins: Margins) {
        if behind.abs() < margins.hit {
            self.hit += weight;
            self.hits += 1;
        } else if behind > margins.pass {
            self.pass += weight;
            self.passes += 1;
        }
    }

    /// From -1 (all rays went through) to 1 (all ended there). A single ray says nothing against others that went through.
    pub fn value(&self) -> f32 {
        let is_alone = self.hits == 0 || self.hits == 1 && self.passes > 0;
        if is_alone { -0.7 } else { (self.hit - self.pass) / (self.hit + self.pass) }
    }
}

/// Within how far of a plane a ray ends on it, and beyond how far it went through it, metres. Wider, and planes stick
/// out at convex edges.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Margins {
    pub hit: f32,
    pub pass: f32,
}

impl Margins {
    /// For cells of this size, metres.
    pub fn of_cell(cell: f64) -> Self {
        Self { hit: 0.5 * cell as f32, pass: cell as f32 }
    }
}

/// Planes that part places of another plane at their common line. Pixels may be farther apart than places: a ray that ended on one side
/// of the line says nothing about a surface on the other side.
#[derive(Default)]
pub(crate) struct Fences {
    pub planes: Vec<Flat>,
    /// For each place the numbers of planes near it, and its side: 1 before the plane, -1 behind it. Empty without fences.
    pub of: Vec<Vec<(u32, f32)>>,
    /// Rays that end this near to a fence end on it, metres.
    pub margin: f32,
}

impl Fences {
    /// False if a point of the image frame is not on the side of the place. `fences` are normals and heights of the origin in that frame.
    #[inline]
    fn admit(&self, place: usize, p: Vec3, fences: &[(Vec3, f32)]) -> bool {
        let Some(own) = self.of.get(place) else { return true };
        own.iter().all(|(k, side)| {
            let (normal, above) = fences[*k as usize];
            side * (normal.dot(p) + above) > self.margin
        })
    }
}

/// Evidence for each of the places in a plane.
pub(crate) fn evidence(
    views: &Views,
    plane: &Flat,
    places: &[DVec2],
    fences: &Fences,
    margins: Margins,
) -> Vec<Evidence> {
    let mut evidence = vec![Evidence::default(); places.len()];
    let Some(ball) = Ball::around(plane, places) else { return evidence };
    let places: Vec<(f32, f32)> = places.iter().map(|q| (q.x as f32, q.y as f32)).collect();
    for view in views.all() {
        if ball.may_be_seen(view) {
            add(view, plane, &places, fences, margins, &mut evidence);
        }
    }
    evidence
}

fn add(view: &View, plane: &Flat, places: &[(f32, f32)], fences: &Fences, margins: Margins, evidence: &mut [Evidence]) {
    let in_image = |f: &Flat| (view.direction_to_image(f.normal).as_vec3(), f.above(view.origin()) as f32);
    let parting: Vec<(Vec3, f32)> = fences.planes.iter().map(in_image).collect();
    let centre = view.to_image(plane.centre).as_vec3();
    let [x, y] = plane.axes().map(|a| view.direction_to_image(a).as_vec3());
    let normal = view.direction_to_image(plane.normal).as_vec3();
    // Negative if the sensor is on the back.
    let side = -normal.dot(centre).signum();
    let at = |(u, v): (f32, f32)| centre + x * u + y * v;
    let mut seen = [(0, f32::NAN); TOGETHER];
    for (start, evidence) in (0..).step_by(TOGETHER).zip(evidence.chunks_mut(TOGETHER)) {
        let places = &places[start..start + evidence.len()];
        for (seen, place) in seen.iter_mut().zip(places) {
            *seen = view.pixel_towards(at(*place)).map_or((0, f32::NAN), |pixel| (pixel, view.ranges[pixel]));
        }
        for (k, (evidence, (pixel, measured))) in evidence.iter_mut().zip(&seen).enumerate() {
            if measured.is_nan() {
                continue;
            }
            let ray = view.unit_ray(*pixel);
            let falling = normal.dot(ray);
            let cosine = falling.abs();
            if cosine < LEAST_COSINE {
                continue;
            }
            // The measured point counts, because the ray of the pixel does not lead exactly to the cell.
            let behind = side * (normal.dot(centre) - measured * falling);
            if behind.abs() < margins.hit && !fences.admit(start + k, ray * measured, &parting) {
                continue;
            }
            evidence.add(behind, cosine / at(places[k]).length().max(NEAREST), margins);
        }
    }
}

/// Evidence for a place with a normal, both relative to the base of the views.
pub(crate) fn evidence_at(views: &Views, place: DVec3, normal: DVec3, margins: Margins) -> Evidence {
    let mut evidence = Evidence::default();
    for view in views.all() {
        let p = view.to_image(place).as_vec3();
        let Some((ray, measured)) = view.towards(p) else { continue };
        let normal = view.direction_to_image(normal).as_vec3();
        let (falling, distance) = (normal.dot(ray), p.length());
        if falling.abs() >= LEAST_COSINE {
            let behind = -normal.dot(p).signum() * (normal.dot(p) - measured * falling);
            evidence.add(behind, falling.abs() / distance.max(NEAREST), margins);
        }
    }
    evidence
}

/// A ball around the places.
struct Ball {
    centre: DVec3,
    radius: f64,
}

impl Ball {
    fn around(plane: &Flat, places: &[DVec2]) -> Option<Self> {
        let first = *places.first()?;
        let (least, most) = places.iter().fold((first, first), |(a, b), q| (a.min(*q), b.max(*q)));
        Some(Self { centre: plane.point(0.5 * (least + most)), radius: 0.5 * (most - least).length() })
    }

    /// False only if no place is in the image of a camera without distortion: all lie behind one of four planes through its sides.
    fn may_be_seen(&self, view: &View) -> bool {
        let is_pinhole = matches!(&view.sensor().spec().geometry, Geometry::Camera(c) if c.distortion.is_none());
        if !is_pinhole {
            return true;
        }
        let c = view.to_image(self.centre);
        let (width, height) = (view.width() as f64 - 0.5, view.height() as f64 - 0.5);
        let corners = [(-0.5, -0.5), (width, -0.5), (width, height), (-0.5, height)];
        let rays: Vec<DVec3> = corners.iter().filter_map(|(u, v)| view.sensor().ray_at(*u, *v)).collect();
        if rays.len() < 4 {
            return true;
        }
        (0..4).all(|k| c.dot(rays[k].cross(rays[(k + 1) % 4]).normalize()) > -self.radius)
    }
}
