//! The reference: a simple f64 z-buffer that verifies the engines.
//!
//! Every polygon of every object is tested against every ray in a conservative cone around it. Only polygons that the
//! sensor cannot see by their material are left out. Three facts make it exact (DESIGN of the rasterizer, paper section
//! 3.2):
//! - a ray `u` is in the cone of a convex polygon if and only if `s (v_a x (v_b - v_a)) . u >= 0` for every edge, where
//!   s is the side of the polygon's plane that the sensor is on;
//! - if that side is uncertain within rounding, the polygon is edge-on: it covers no ray and is counted;
//! - the inverse range is `n . u / d`: the greatest is nearest, and the lower slot wins a tie.

mod bundle;
mod face;

use bundle::Cone;
pub use bundle::instances;
pub use bundle::{Beam, beams, cones, descend};
pub use face::Face;
pub use face::{Edge, UNIT_ROUNDOFF};

use crate::plan::{FramePlan, Images, Output};
use glam::DVec3;
use presight_model::error::Result;
use presight_model::threads::parallel_or_here;

/// Counts of [`render`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderCounts {
    /// Polygons tested.
    pub polygons: usize,
    /// Polygons whose plane passes through the sensor within f64 rounding.
    pub edge_on: usize,
}

/// The nearest polygon along a ray.
#[derive(Clone, Copy, Debug)]
struct Hit {
    inverse_range: f64,
    cos_incidence: f64,
    object: u32,
    polygon: u32,
}

/// Fills the requested images.
///
/// # Errors
/// Same as [`presight_model::Pose::check`], if the plan's pose was changed.
pub fn render(plan: &FramePlan, images: &mut Images) -> Result<RenderCounts> {
    let (width, height) = (plan.sensor.width(), plan.sensor.height());
    render_pixels(plan, images, (0..height).flat_map(|row| (0..width).map(move |column| (column, row))))
}

/// Fills the requested images at some pixels (column, row); other pixels are marked as having no ray.
///
/// # Errors
/// Same as [`render`].
pub fn render_pixels(
    plan: &FramePlan,
    images: &mut Images,
    pixels: impl Iterator<Item = (u32, u32)>,
) -> Result<RenderCounts> {
    plan.world_from_sensor.check()?;
    let (mut hits, mut counts) = (Vec::new(), RenderCounts::default());
    for (plan, pixels) in plan.by_bundle(pixels, |pixel| *pixel) {
        let (own, more) = cast(&plan, pixels.into_iter());
        hits.extend(own);
        counts = RenderCounts { polygons: counts.polygons + more.polygons, edge_on: counts.edge_on + more.edge_on };
    }
    let asked = plan.drawn();
    let outputs = if plan.sensor.is_camera() { asked } else { asked.without(Output::DepthZ) };
    images.prepare(plan.sensor.width(), plan.sensor.height(), outputs);
    no_ray(images);
    for beam in &hits {
        write(plan, images, beam);
    }
    plan.finish(images)?;
    Ok(counts)
}

/// Finds the nearest polygon for each pixel's ray.
fn cast(plan: &FramePlan, pixels: impl Iterator<Item = (u32, u32)>) -> (Vec<Beam<Option<Hit>>>, RenderCounts) {
    let mut beams = beams(&plan.sensor, pixels);
    let counts = parallel_or_here(|| cast_beams(plan, &mut beams));
    (beams, counts)
}

fn cast_beams(plan: &FramePlan, beams: &mut [Beam<Option<Hit>>]) -> RenderCounts {
    let instances = instances(plan);
    let (cones, edge_on) = cones(plan, &instances, |face, _| (!face.edge_on()).then_some(0.0));
    descend(beams, &cones, &|beams, cones| {
        let mut face = Face::default();
        for cone in cones {
            let mesh = &plan.environment().objects()[cone.object as usize].mesh;
            face.renew(&instances[cone.object as usize], mesh, cone.polygon);
            paint(plan, &face, cone, beams);
        }
    });
    RenderCounts { polygons: cones.len() + edge_on, edge_on }
}

/// Tests one polygon against a few rays.
fn paint(plan: &FramePlan, face: &Face, cone: &Cone, beams: &mut [Beam<Option<Hit>>]) {
    let objects = plan.environment().objects();
    let slot = |object: u32, polygon: u32| objects[object as usize].first_slot + polygon;
    for beam in beams.iter_mut().filter(|b| face.holds(b.ray)) {
        let inverse_range = face.inverse_range(beam.ray);
        let nearer = match beam.found {
            // Inside the cone it is positive up to rounding.
            None => inverse_range > 0.0,
            Some(hit) if inverse_range == hit.inverse_range => {
                slot(cone.object, cone.polygon) < slot(hit.object, hit.polygon)
            }
            Some(hit) => inverse_range > hit.inverse_range,
        };
        if nearer {
            let cos_incidence = face.normal.dot(beam.ray).abs();
            let (object, polygon) = (cone.object, cone.polygon);
            beam.found = Some(Hit { inverse_range, cos_incidence, object, polygon });
        }
    }
}

fn no_ray(images: &mut Images) {
    images.range.fill(f32::NAN);
    images.depth_z.fill(f32::NAN);
    images.cos_incidence.fill(f32::NAN);
    images.polygon_id.fill(0);
    images.object_id.fill(0);
}

fn write(plan: &FramePlan, images: &mut Images, beam: &Beam<Option<Hit>>) {
    let at = beam.row as usize * images.width as usize + beam.column as usize;
    let put = |image: &mut Vec<f32>, value: f64| image.get_mut(at).map(|v| *v = value as f32);
    let put_id = |image: &mut Vec<u32>, value: u32| image.get_mut(at).map(|v| *v = value);
    let spec = plan.sensor.spec();
    let measured = |hit: &Hit| hit.inverse_range.recip() + plan.sensor.range_lead();
    let within = beam.found.filter(|hit| measured(hit) <= spec.range_max);
    let Some(hit) = within else {
        put(&mut images.range, f64::INFINITY);
        put(&mut images.depth_z, f64::INFINITY);
        return;
    };
    let range = measured(&hit);
    let too_near = range < spec.range_min;
    let depth_z = range * beam.ray.dot(DVec3::Z);
    put(&mut images.range, if too_near { f64::NEG_INFINITY } else { range });
    put(&mut images.depth_z, if too_near { f64::NEG_INFINITY } else { depth_z });
    put(&mut images.cos_incidence, hit.cos_incidence);
    put_id(&mut images.polygon_id, plan.drawn_polygon_id(hit.object, hit.polygon));
    put_id(&mut images.object_id, hit.object + 1);
}
