//! The surfaces that pixels show, in f64 and in the sensor's frame.

use super::View;
use glam::{DMat3, DVec3};
use presight_model::environment::Object;
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, plane_of_polygon};
use presight_model::sensor::Sensor;
use presight_render::plan::{Output, PolygonsOfIds};
use std::collections::HashMap;

/// Cosine of the maximum angle between normals of one plane: half a degree.
pub const PARALLEL: f64 = 0.999_961_923_064_171_3;
/// Maximum distance between two surfaces of one plane, or between two pieces of one line, metres.
pub const COPLANAR: f64 = 1e-3;
/// Maximum tilt of a floor from horizontal, and of a wall from vertical, radians (2 degrees).
pub const TILT: f64 = 2.0 * std::f64::consts::PI / 180.0;

/// The plane of a visible polygon.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisiblePlane {
    pub object: u32,
    /// Unit normal in the sensor's body axes, on the sensor's side.
    pub normal: DVec3,
    /// Metres from the sensor to the plane, at least 0: `normal . p = -distance` for its points p.
    pub distance: f64,
    /// Lowest and highest z of the polygon relative to the sensor, along the world's z axis, metres.
    pub heights: [f64; 2],
}

/// A view prepared for the reductions.
pub struct Pixels<'a> {
    pub sensor: &'a Sensor,
    pub range: &'a [f32],
    /// Empty if the ids are unknown.
    pub polygon_id: &'a [u32],
    object_id: &'a [u32],
    objects: &'a [Object],
    pub robot_from_sensor: Pose,
    pub world_from_sensor: Pose,
    /// The world's z axis in the sensor's body axes.
    pub up: DVec3,
    body_from_image: DMat3,
    polygons: Option<PolygonsOfIds<'a>>,
    surfaces: HashMap<(u32, u32), Option<VisiblePlane>>,
    /// The last lookup, because neighbouring pixels mostly show the same polygon.
    last: Option<(u32, Option<VisiblePlane>)>,
    view: View<'a>,
}

impl<'a> Pixels<'a> {
    /// Prepares a view that has ranges.
    pub fn new(view: &View<'a>) -> Result<Self> {
        let (sensor, ids) = (view.sensor, view.ids);
        let pixels = sensor.width() as usize * sensor.height() as usize;
        let images = [
            (Output::Range, Some(view.range.len())),
            (Output::PolygonId, ids.map(|ids| ids.polygon_id.len())),
            (Output::ObjectId, ids.map(|ids| ids.object_id.len())),
        ];
        if let Some((output, _)) = images.into_iter().find(|(_, len)| len.is_some_and(|len| len != pixels)) {
            let what = format!("there is no {} image of {pixels} pixels", output.name());
            return Err(Error::invalid(what, "predict it with this sensor"));
        }
        Ok(Self {
            sensor,
            range: view.range,
            polygon_id: ids.map_or(&[], |ids| ids.polygon_id),
            object_id: ids.map_or(&[], |ids| ids.object_id),
            objects: ids.map_or(&[], |ids| ids.environment.objects()),
            robot_from_sensor: sensor.spec().mount,
            world_from_sensor: view.pose.world_from_sensor(),
            up: view.pose.world_from_sensor().rotation.conjugate() * DVec3::Z,
            body_from_image: sensor.body_from_image(),
            polygons: ids.map(|ids| PolygonsOfIds::new(ids.environment, ids.scheme)),
            surfaces: HashMap::new(),
            last: None,
            view: *view,
        })
    }

    /// Prepares a view that has ranges and ids.
    pub fn with_ids(view: &View<'a>) -> Result<Self> {
        if view.ids.is_none() {
            let what = "the view has no ids for its pixels";
            return Err(Error::invalid(
                what,
                "give polygon_id and object_id of the prediction at this pose (View::with_ids)",
            ));
        }
        Self::new(view)
    }

    /// Number of pixels.
    pub fn count(&self) -> usize {
        self.range.len()
    }

    /// Index of a pixel in the images.
    pub fn at(&self, column: u32, row: u32) -> usize {
        row as usize * self.sensor.width() as usize + column as usize
    }

    /// Unit ray of a pixel, body axes.
    pub fn ray(&self, column: u32, row: u32) -> Option<DVec3> {
        self.sensor.ray(column, row).map(|ray| self.body_from_image * ray)
    }

    /// Unit ray at continuous pixel coordinates, body axes.
    pub fn ray_at(&self, u: f64, v: f64) -> Option<DVec3> {
        self.sensor.ray_at(u, v).map(|ray| self.body_from_image * ray)
    }

    /// The surface that a pixel measures; `None` without a hit within the sensor's range limits.
    pub fn surface(&mut self, column: u32, row: u32) -> Option<VisiblePlane> {
        let at = self.at(column, row);
        if self.polygon_id.is_empty() || !self.range[at].is_finite() {
            return None;
        }
        let (object_id, polygon_id) = (self.object_id[at], self.polygon_id[at]);
        if let Some((_, surface)) = self.last.filter(|(id, _)| *id == polygon_id) {
            return surface;
        }
        let key = self.polygons.as_mut()?.find(object_id, polygon_id);
        let surface = key.and_then(|key| {
            if let Some(known) = self.surfaces.get(&key) {
                return *known;
            }
            let made = self.make(key.0, key.1);
            self.surfaces.insert(key, made);
            made
        });
        self.last = Some((polygon_id, surface));
        surface
    }

    fn make(&self, object: u32, polygon: u32) -> Option<VisiblePlane> {
        let slot = self.objects[object as usize].first_slot + polygon;
        let sensor_from_world = self.world_from_sensor.rotation.conjugate();
        // The sensor's position is subtracted first, so that no digits are lost at 5,000,000 m from the origin.
        let corners: Vec<DVec3> = self.view.ids?.environment.polygon_in_world(slot)?;
        let relative: Vec<DVec3> = corners.iter().map(|p| *p - self.world_from_sensor.translation).collect();
        let heights = relative.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], p| [l.min(p.z), h.max(p.z)]);
        let plane = plane_of_polygon(&relative)?;
        let side = if plane.offset > 0.0 { -1.0 } else { 1.0 };
        let normal = sensor_from_world * (side * plane.normal);
        Some(VisiblePlane { object, normal, distance: plane.offset.abs(), heights })
    }

    /// The point of its surface that a pixel shows, body axes, exact in f64.
    pub fn hit(&self, column: u32, row: u32, surface: &VisiblePlane) -> Option<DVec3> {
        let ray = self.ray(column, row)?;
        let range = -surface.distance / surface.normal.dot(ray);
        range.is_finite().then(|| ray * range)
    }

    /// The point that a pixel measures, body axes, and the index of its object. With ids, the point is exact in f64 on
    /// the polygon. Without ids, it has the precision of the range and no object.
    pub fn measured(&mut self, column: u32, row: u32) -> Option<(DVec3, Option<u32>)> {
        if self.polygons.is_some() {
            let surface = self.surface(column, row)?;
            return Some((self.hit(column, row, &surface)?, Some(surface.object)));
        }
        let range = self.range[self.at(column, row)];
        let ray = self.ray(column, row).filter(|_| range.is_finite())?;
        Some((ray * f64::from(range), None))
    }

    /// Transforms a point from the sensor's body axes to the robot's frame.
    pub fn in_robot(&self, p_in_sensor: DVec3) -> [f64; 3] {
        self.robot_from_sensor.transform_point(p_in_sensor).to_array()
    }

    /// Rotates a direction from the sensor's body axes to the robot's frame.
    pub fn turned_to_robot(&self, direction: DVec3) -> [f64; 3] {
        (self.robot_from_sensor.rotation * direction).to_array()
    }

    pub fn name(&self, object: u32) -> String {
        self.objects[object as usize].name.clone()
    }
}
