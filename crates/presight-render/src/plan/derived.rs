//! Images that are computed from other images: the echo, and the normals of surfaces.
//!
//! **Echo.** The paper estimates the intensity of an echo from the reflection angle (section 3.2): it is strongest
//! where the ray is perpendicular to the surface. Here the echo is the material's reflection factor times
//! cos_incidence. There is no range law, because that depends on the sensor's amplifier and lobe.
//!
//! **Normal.** All pixels of a polygon have its normal, found by their ids and rotated into body axes in f64. It points
//! to the sensor's side of the plane.
//!
//! All engines share this step and run it last. It only needs images that they draw anyway.

use super::{FramePlan, IdScheme, Images, Instance, Output, Outputs, PolygonsOfIds, StageName, Stats};
use glam::{DMat3, DVec3};
use presight_model::clock::Instant;
use presight_model::environment::Mesh;
use presight_model::error::Result;
use presight_model::memory;
use std::collections::HashMap;

impl FramePlan {
    /// The images that engines fill: the requested ones, and those needed to derive others.
    pub fn drawn(&self) -> Outputs {
        let asked = self.request.outputs;
        let mut drawn = asked.without(Output::Echo).without(Output::Normal);
        if asked.has(Output::Echo) {
            drawn = drawn.with(Output::CosIncidence);
        }
        if asked.has(Output::Normal) || self.reflects_by_material() {
            drawn = drawn.with(Output::PolygonId).with(Output::ObjectId);
        }
        drawn
    }

    /// The ids that engines draw. Normals need model ids, because several polygons may have the same source.
    pub fn drawn_ids(&self) -> IdScheme {
        if self.request.outputs.has(Output::Normal) { IdScheme::Model } else { self.request.ids }
    }

    /// Derives images from others, then empties images that were drawn only for that. Every engine ends with this step,
    /// on images that hold [`FramePlan::drawn`]. Without `echo` and `normal` it costs nothing.
    ///
    /// # Errors
    /// [`presight_model::ErrorKind::System`] if there is no memory for the derived images.
    pub fn finish(&self, images: &mut Images) -> Result<()> {
        self.derive(images, |_, _| {})
    }

    /// Same as [`FramePlan::finish`], and also records its time and the bytes of all images.
    pub fn finish_noting(&self, images: &mut Images, stats: &mut Stats) -> Result<()> {
        self.derive(images, |name, start| stats.stage(name, start))?;
        stats.work.image_bytes = images.bytes();
        Ok(())
    }

    /// Derives each image in turn; calls `made` with its stage and start time.
    fn derive(&self, images: &mut Images, mut made: impl FnMut(StageName, Instant)) -> Result<()> {
        let asked = self.request.outputs;
        if asked.has(Output::Echo) {
            let start = Instant::now();
            self.add_echo(images)?;
            made(StageName::Echo, start);
        }
        if asked.has(Output::Normal) {
            let start = Instant::now();
            self.add_normals(images)?;
            made(StageName::Normal, start);
        }
        if self.drawn_ids() != self.request.ids && asked.has(Output::PolygonId) {
            self.rename_polygons(images);
        }
        if self.drawn() != asked {
            images.keep(asked);
        }
        Ok(())
    }

    /// Replaces the drawn ids by the requested ones.
    fn rename_polygons(&self, images: &mut Images) {
        let mut polygons = PolygonsOfIds::new(self.environment(), self.drawn_ids());
        for (id, object) in images.polygon_id.iter_mut().zip(&images.object_id) {
            if let Some((object, polygon)) = polygons.find(*object, *id) {
                *id = self.request.ids.id_of(&self.environment().objects()[object as usize], polygon);
            }
        }
    }

    fn add_echo(&self, images: &mut Images) -> Result<()> {
        let mut echo = std::mem::take(&mut images.echo);
        echo.clear();
        memory::reserve(&mut echo, images.cos_incidence.len())?;
        // Computed in f64, so that the product is rounded once. NaN stays NaN.
        let product = |cos: &f32, reflection: f64| (f64::from(*cos) * reflection) as f32;
        if let Some(reflection) = self.common_reflection() {
            echo.extend(images.cos_incidence.iter().map(|cos| product(cos, reflection)));
        } else {
            let mut factors = Factors::new(self);
            let ids = images.object_id.iter().zip(&images.polygon_id);
            let of_pixel = |(cos, (object, polygon)): (&f32, (&u32, &u32))| product(cos, factors.of(*object, *polygon));
            echo.extend(images.cos_incidence.iter().zip(ids).map(of_pixel));
        }
        images.echo = echo;
        Ok(())
    }

    fn add_normals(&self, images: &mut Images) -> Result<()> {
        let mut normals = std::mem::take(&mut images.normal);
        normals.clear();
        memory::reserve(&mut normals, images.polygon_id.len())?;
        let mut of_polygons = Normals::new(self);
        let mut last = ((0, 0, 0), NO_NORMAL);
        let width = images.width as usize;
        for (at, (object, polygon)) in images.object_id.iter().zip(&images.polygon_id).enumerate() {
            let bundle =
                self.bundles().map_or(0, |poses| poses.bundles().of_pixel((at % width) as u32, (at / width) as u32));
            let seen = (bundle, *object, *polygon);
            // Neighbouring pixels mostly show the same polygon.
            if seen != last.0 {
                last = (seen, of_polygons.of(bundle, *object, *polygon));
            }
            normals.push(last.1);
        }
        images.normal = normals;
        Ok(())
    }

    /// Reflection factor of a polygon's material, 0..=1.
    pub fn reflection(&self, object: u32, polygon: u32) -> f64 {
        let environment = self.environment();
        let material = environment.objects()[object as usize].mesh.material(polygon);
        environment.materials()[usize::from(material)].reflection
    }

    /// True if an echo is requested that depends on the material.
    pub(super) fn reflects_by_material(&self) -> bool {
        self.request.outputs.has(Output::Echo) && self.common_reflection().is_none()
    }

    /// The reflection factor of all materials, if they share one; ids are not needed then.
    fn common_reflection(&self) -> Option<f64> {
        let mut factors = self.environment().materials().iter().map(|m| m.reflection);
        let first = factors.next().unwrap_or(1.0);
        factors.all(|r| r == first).then_some(first)
    }
}

const NO_NORMAL: [f32; 3] = [f32::NAN; 3];

/// Normals looked up by a pixel's ids.
struct Normals<'a> {
    plan: &'a FramePlan,
    polygons: PolygonsOfIds<'a>,
    body_from_image: DMat3,
    /// By bundle and object index.
    instances: HashMap<(u32, u32), Instance>,
    /// By bundle, object_id and polygon_id.
    known: HashMap<(u32, u32, u32), [f32; 3]>,
}

impl<'a> Normals<'a> {
    fn new(plan: &'a FramePlan) -> Self {
        let polygons = PolygonsOfIds::new(plan.environment(), plan.drawn_ids());
        let body_from_image = plan.sensor.body_from_image();
        Self { plan, polygons, body_from_image, instances: HashMap::new(), known: HashMap::new() }
    }

    /// The normal for a bundle, an object_id and a polygon_id.
    fn of(&mut self, bundle: u32, object_id: u32, polygon_id: u32) -> [f32; 3] {
        let seen = (bundle, object_id, polygon_id);
        if let Some(normal) = self.known.get(&seen) {
            return *normal;
        }
        let normal = self.polygons.find(object_id, polygon_id).map_or(NO_NORMAL, |(object, polygon)| {
            let plan = self.plan;
            let pose = plan.bundles().map_or(&plan.world_from_sensor, |poses| &poses.poses()[bundle as usize]);
            let instance = self.instances.entry((bundle, object)).or_insert_with(|| plan.instance_from(pose, object));
            let mesh = &self.plan.environment().objects()[object as usize].mesh;
            (self.body_from_image * facing_normal(instance, mesh, polygon)).as_vec3().to_array()
        });
        self.known.insert(seen, normal);
        normal
    }
}

/// The unit normal of a polygon on the sensor's side, in the image frame.
fn facing_normal(instance: &Instance, mesh: &Mesh, polygon: u32) -> DVec3 {
    let normal = (instance.normal_from_mesh * mesh.plane(polygon).normal).normalize();
    let from_sensor = mesh.corners_of(polygon).map(|p| p - instance.center_in_mesh);
    // The nearest corner decides the side with the least rounding, as in the engines.
    let nearest = from_sensor.min_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
    let distance = nearest.map_or(0.0, |corner| normal.dot(instance.image_from_mesh * corner));
    if distance > 0.0 { -normal } else { normal }
}

/// Reflection factors looked up by a pixel's ids.
struct Factors<'a> {
    plan: &'a FramePlan,
    polygons: PolygonsOfIds<'a>,
    /// The last object, with its factor if its materials share one: neighbouring pixels mostly show the same object.
    last: Option<(u32, Option<f64>)>,
}

impl<'a> Factors<'a> {
    fn new(plan: &'a FramePlan) -> Self {
        Self { plan, polygons: PolygonsOfIds::new(plan.environment(), plan.drawn_ids()), last: None }
    }

    /// The factor for a pixel's ids. Arbitrary without a hit, because the cosine is NaN then.
    fn of(&mut self, object_id: u32, polygon_id: u32) -> f64 {
        let Some(object) = object_id.checked_sub(1) else { return 1.0 };
        let of_all = match self.last {
            Some((last, of_all)) if last == object => of_all,
            _ => {
                let of_all = self.of_all(object);
                self.last = Some((object, of_all));
                of_all
            }
        };
        of_all.unwrap_or_else(|| {
            let polygon = self.polygons.find(object_id, polygon_id);
            polygon.map_or(1.0, |(object, polygon)| self.plan.reflection(object, polygon))
        })
    }

    fn of_all(&self, object: u32) -> Option<f64> {
        let environment = self.plan.environment();
        let materials = environment.objects()[object as usize].mesh.materials();
        let mut factors = materials.iter().map(|m| environment.materials()[usize::from(*m)].reflection);
        let first = factors.next()?;
        factors.all(|r| r == first).then_some(first)
    }
}
