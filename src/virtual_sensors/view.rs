//! What pixels show, in f64, in the sensor's frame.

use super::Input;
use crate::environment::Object;
use crate::error::{Error, Result};
use crate::geometry::{Pose, plane_of_polygon};
use crate::plan::{Images, Output, Outputs, PolygonsOfIds};
use crate::sensor::Sensor;
use glam::{DMat3, DVec3};
use std::collections::HashMap;

/// Cosine of the angle that normals of one plane may differ by: half a degree.
pub const PARALLEL: f64 = 0.999_961_923_064_171_3;

/// The plane of a polygon as the sensor has it in front of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    pub object: u32,
    /// Unit normal in the sensor's body axes, on the sensor's side.
    pub normal: DVec3,
    /// Metres from the sensor to the plane, at least 0: `normal . p = -distance` for its points p.
    pub distance: f64,
    /// Least and greatest height of the polygon above the sensor, along the world's z, metres.
    pub heights: [f64; 2],
}

/// A prediction as reductions look at it.
pub struct View<'a> {
    pub sensor: &'a Sensor,
    pub images: &'a Images,
    pub objects: &'a [Object],
    pub robot_from_sensor: Pose,
    pub world_from_sensor: Pose,
    /// The world's z axis in the sensor's body axes.
    pub up: DVec3,
    body_from_image: DMat3,
    input: Input<'a>,
    polygons: PolygonsOfIds<'a>,
    surfaces: HashMap<(u32, u32), Option<Surface>>,
    /// Neighbouring pixels mostly show the same polygon.
    last: Option<(u32, Option<Surface>)>,
}

impl<'a> View<'a> {
    /// Of a prediction that has those images.
    pub fn new(input: &Input<'a>, needed: Outputs) -> Result<Self> {
        let prediction = input.prediction;
        let (sensor, images) = (&prediction.sensor, &prediction.images);
        let pixels = sensor.width() as usize * sensor.height() as usize;
        for output in needed.iter() {
            let len = images.floats(output).map(<[f32]>::len).or(images.ids(output).map(<[u32]>::len));
            if len != Some(pixels) || (images.width, images.height) != (sensor.width(), sensor.height()) {
                let what = format!("there is no {} image of {pixels} pixels", output.name());
                return Err(Error::invalid(what, "predict it with this sensor"));
            }
        }
        Ok(Self {
            sensor,
            images,
            objects: input.environment.objects(),
            robot_from_sensor: sensor.spec().mount,
            world_from_sensor: prediction.world_from_sensor,
            up: prediction.world_from_sensor.rotation.conjugate() * DVec3::Z,
            body_from_image: sensor.body_from_image(),
            input: *input,
            polygons: PolygonsOfIds::new(input.environment, input.ids),
            surfaces: HashMap::new(),
            last: None,
        })
    }

    /// Number of a pixel in the images.
    pub fn at(&self, column: u32, row: u32) -> usize {
        row as usize * self.images.width as usize + column as usize
    }

    /// Unit ray of a pixel, body axes.
    pub fn ray(&self, column: u32, row: u32) -> Option<DVec3> {
        self.sensor.ray(column, row).map(|ray| self.body_from_image * ray)
    }

    /// Unit ray at continuous pixel coordinates, body axes.
    pub fn ray_at(&self, u: f64, v: f64) -> Option<DVec3> {
        self.sensor.ray_at(u, v).map(|ray| self.body_from_image * ray)
    }

    /// The surface that a pixel measures: something seen, within the sensor's range limits.
    pub fn surface(&mut self, column: u32, row: u32) -> Option<Surface> {
        let at = self.at(column, row);
        if !self.images.range[at].is_finite() {
            return None;
        }
        let (object_id, polygon_id) = (self.images.object_id[at], self.images.polygon_id[at]);
        if let Some((_, surface)) = self.last.filter(|(id, _)| *id == polygon_id) {
            return surface;
        }
        let surface = self.polygons.find(object_id, polygon_id).and_then(|key| {
            if let Some(known) = self.surfaces.get(&key) {
                return *known;
            }
            let made = self.make(key);
            self.surfaces.insert(key, made);
            made
        });
        self.last = Some((polygon_id, surface));
        surface
    }

    fn make(&self, (object, polygon): (u32, u32)) -> Option<Surface> {
        let slot = self.objects[object as usize].first_slot + polygon;
        let sensor_from_world = self.world_from_sensor.rotation.conjugate();
        // Differences to the sensor come first: at 5,000,000 m from the origin no digit is lost.
        let corners: Vec<DVec3> = self.input.environment.polygon_in_world(slot)?;
        let relative: Vec<DVec3> = corners.iter().map(|p| *p - self.world_from_sensor.translation).collect();
        let heights = relative.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], p| [l.min(p.z), h.max(p.z)]);
        let plane = plane_of_polygon(&relative)?;
        let side = if plane.offset > 0.0 { -1.0 } else { 1.0 };
        let normal = sensor_from_world * (side * plane.normal);
        Some(Surface { object, normal, distance: plane.offset.abs(), heights })
    }

    /// The place that a pixel shows of its surface, body axes, exact in f64.
    pub fn hit(&self, column: u32, row: u32, surface: &Surface) -> Option<DVec3> {
        let ray = self.ray(column, row)?;
        let range = -surface.distance / surface.normal.dot(ray);
        range.is_finite().then(|| ray * range)
    }

    /// A point of the sensor's body axes in the robot's frame.
    pub fn in_robot(&self, p_in_sensor: DVec3) -> [f64; 3] {
        self.robot_from_sensor.transform_point(p_in_sensor).to_array()
    }

    /// A direction of the sensor's body axes in the robot's frame.
    pub fn turned_to_robot(&self, direction: DVec3) -> [f64; 3] {
        (self.robot_from_sensor.rotation * direction).to_array()
    }

    /// The full path of an object.
    pub fn name(&self, object: u32) -> String {
        self.objects[object as usize].name.clone()
    }
}

/// The images that tell what is seen where.
pub fn of_surfaces() -> Outputs {
    Outputs::of(&[Output::Range, Output::PolygonId, Output::ObjectId])
}
