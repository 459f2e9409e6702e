//! Hits and passes: rays that ended on the cells of a plane, and rays that passed through them.

use crate::geometry::{Flat, bounds};
use crate::observe::{View, Views};
use glam::{DVec2, DVec3, Vec3};
use presight_model::sensor::Geometry;

/// Minimum cosine of incidence: the end of a more grazing ray is uncertain along the normal by more than the size of a
/// cell.
const MIN_COSINE: f32 = 0.15;
/// Range below which the weight of a ray grows no further, metres.
const NEAREST: f32 = 0.3;

/// Number of places whose ranges are looked up in one batch, so that the memory accesses overlap.
const BATCH: usize = 64;

/// Hits and passes of a cell. The weight of a ray is its cosine of incidence over its range.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Evidence {
    /// Weight of the rays that ended on the plane.
    pub hit: f32,
    /// Weight of the rays that passed through it.
    pub pass: f32,
    /// Number of rays that ended on it.
    pub hits: u32,
    /// Number of rays that passed through it.
    pub passes: u32,
}

impl Evidence {
    /// Adds a ray that ended at the distance `behind` behind the plane, metres.
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

    /// Balance of hits and passes, from -1 (all rays passed) to 1 (all rays ended there). A single hit does not
    /// outweigh passes.
    pub fn value(&self) -> f32 {
        let is_alone = self.hits == 0 || self.hits == 1 && self.passes > 0;
        if is_alone { -0.7 } else { (self.hit - self.pass) / (self.hit + self.pass) }
    }
}

/// Distances from a plane, metres: a ray that ends within `hit` ended on the plane, a ray that ends more than `pass`
/// behind passed through it. With wider margins planes would stick out at convex edges.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Margins {
    pub hit: f32,
    pub pass: f32,
}

impl Margins {
    /// Margins for cells of this size, metres.
    pub fn of_cell(cell: f64) -> Self {
        Self { hit: 0.5 * cell as f32, pass: cell as f32 }
    }
}

/// Neighbouring planes that divide a plane along their common lines. Pixels may be farther apart than cells, so a ray
/// that ended on one side of such a line supports no cell on the other side.
#[derive(Default)]
pub(crate) struct Fences {
    pub planes: Vec<Flat>,
    /// By place: the indices of the planes near it, with its side (1 in front, -1 behind). Empty without fences.
    pub of: Vec<Vec<(u32, f32)>>,
    /// A ray that ends within this distance of a fence ended on the fence, metres.
    pub margin: f32,
}

impl Fences {
    /// False if a point lies on the other side of a fence than the place. Point and fences are in the image frame:
    /// `fences` holds normals, and the heights of the frame's origin above the planes.
    #[inline]
    fn admit(&self, place: usize, p: Vec3, fences: &[(Vec3, f32)]) -> bool {
        let Some(own) = self.of.get(place) else { return true };
        own.iter().all(|(k, side)| {
            let (normal, above) = fences[*k as usize];
            side * (normal.dot(p) + above) > self.margin
        })
    }
}

/// Evidence of all views for places in a plane.
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
    // Negative if the sensor is behind the plane.
    let side = -normal.dot(centre).signum();
    let at = |(u, v): (f32, f32)| centre + x * u + y * v;
    let mut seen = [(0, f32::NAN); BATCH];
    for (start, evidence) in (0..).step_by(BATCH).zip(evidence.chunks_mut(BATCH)) {
        let places = &places[start..start + evidence.len()];
        for (seen, place) in seen.iter_mut().zip(places) {
            *seen = view.pixel_towards(at(*place)).map_or((0, f32::NAN), |pixel| (pixel, view.ranges[pixel]));
        }
        for (k, (evidence, (pixel, measured))) in evidence.iter_mut().zip(&seen).enumerate() {
            if measured.is_nan() {
                continue;
            }
            let ray = view.unit_ray(*pixel);
            let slope = normal.dot(ray);
            let cosine = slope.abs();
            if cosine < MIN_COSINE {
                continue;
            }
            // Measured along the normal at the point itself, because the pixel's ray does not pass exactly through the
            // cell.
            let behind = side * (normal.dot(centre) - measured * slope);
            if behind.abs() < margins.hit && !fences.admit(start + k, ray * measured, &parting) {
                continue;
            }
            evidence.add(behind, cosine / at(places[k]).length().max(NEAREST), margins);
        }
    }
}

/// Evidence of all views for one place with a normal, relative to the base of the views.
pub(crate) fn evidence_at(views: &Views, place: DVec3, normal: DVec3, margins: Margins) -> Evidence {
    let mut evidence = Evidence::default();
    for view in views.all() {
        let p = view.to_image(place).as_vec3();
        let Some((ray, measured)) = view.towards(p) else { continue };
        let normal = view.direction_to_image(normal).as_vec3();
        let (slope, distance) = (normal.dot(ray), p.length());
        if slope.abs() >= MIN_COSINE {
            let behind = -normal.dot(p).signum() * (normal.dot(p) - measured * slope);
            evidence.add(behind, slope.abs() / distance.max(NEAREST), margins);
        }
    }
    evidence
}

/// A ball that encloses places.
struct Ball {
    centre: DVec3,
    radius: f64,
}

impl Ball {
    fn around(plane: &Flat, places: &[DVec2]) -> Option<Self> {
        let (min, max) = bounds(places.iter().copied());
        (!places.is_empty())
            .then(|| Self { centre: plane.point(0.5 * (min + max)), radius: 0.5 * (max - min).length() })
    }

    /// False only if no place can be in the image of a camera without distortion: the ball lies behind one of the four
    /// planes through the image's borders.
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
