//! The planes of polygons by slot, computed at their first use.

use glam::DVec3;
use presight_model::geometry::{InObject, Plane, PoseCovariance, plane_of_polygon};
use presight_model::matrix::Matrix;
use presight_model::world::World;
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// A polygon as estimates use it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// World frame.
    pub plane: Plane,
    /// Index of the object.
    pub object: u32,
    /// Number of the group of polygons that share an error with this one: those of one object in nearly one plane.
    pub group: u32,
}

/// The stored error of an object's pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectError {
    /// Origin of the object's frame in the world, metres.
    pub origin: DVec3,
    /// Covariance of the object's pose, world axes.
    pub covariance: Matrix,
}

impl ObjectError {
    /// Derivative of a plane's offset by the object's pose, at a point x on the plane with normal n:
    /// `[n, (x - origin) cross n]`. All arguments have the same axes.
    pub fn gradient(origin: DVec3, point: DVec3, normal: DVec3) -> [f64; 6] {
        let turned = (point - origin).cross(normal);
        [normal.x, normal.y, normal.z, turned.x, turned.y, turned.z]
    }
}

/// Errors of objects, by index of the object.
pub(crate) type ObjectErrors = Arc<BTreeMap<u32, ObjectError>>;

/// Normals are grouped by steps of 1 / 4 in each coordinate, about 15 degrees.
const NORMAL_STEPS: f64 = 4.0;
/// Planes are grouped by steps of this offset, metres: two sides of one wall share its error, two walls do not.
const OFFSET_STEP: f64 = 0.25;

/// The surfaces of one version of a world.
#[derive(Debug, Default)]
pub struct Surfaces {
    stamp: Option<u64>,
    of_slot: Vec<Option<Surface>>,
    groups: HashMap<(u32, [i32; 4]), u32>,
    /// By class of sensors.
    errors: HashMap<String, ObjectErrors>,
}

impl Surfaces {
    /// Forgets the surfaces of another version.
    pub fn follow(&mut self, world: &World) {
        if self.stamp != Some(world.stamp()) {
            *self = Self { stamp: Some(world.stamp()), ..Self::default() };
            self.of_slot.resize(world.environment().slot_count() as usize, None);
        }
    }

    /// The errors of objects' poses stored in the feature layer of a class of sensors.
    pub(crate) fn object_errors(&mut self, world: &World, class: &str) -> ObjectErrors {
        if let Some(known) = self.errors.get(class) {
            return known.clone();
        }
        let environment = world.environment();
        let listed = environment.layer(class).map_or(&[][..], |layer| &layer.pose_covariances);
        let error = |(name, own): &(String, PoseCovariance<InObject>)| {
            // An absent object has no visible surface.
            let index = environment.index_of(name).ok()?;
            let pose = &environment.objects()[index as usize].world_from_object;
            let covariance = *own.in_world(pose).as_rows();
            Some((index, ObjectError { origin: pose.translation, covariance }))
        };
        let errors: ObjectErrors = Arc::new(listed.iter().filter_map(error).collect());
        self.errors.insert(class.to_owned(), errors.clone());
        errors
    }

    /// Computes the surface of a polygon id, which is the number of its slot plus 1, unless it is known. An id of 0
    /// means no polygon.
    pub fn see(&mut self, world: &World, id: u32) {
        if let Some(slot) = id.checked_sub(1)
            && self.seen(slot).is_none()
        {
            self.of(world, slot);
        }
    }

    /// The surface of a slot, if it is known.
    pub fn seen(&self, slot: u32) -> Option<&Surface> {
        self.of_slot.get(slot as usize)?.as_ref()
    }

    /// The surface of a slot; `None` for an empty slot and for a polygon without a plane.
    pub fn of(&mut self, world: &World, slot: u32) -> Option<Surface> {
        if let Some(known) = *self.of_slot.get(slot as usize)? {
            return Some(known);
        }
        let environment = world.environment();
        let (object, polygon) = environment.locate(slot)?;
        let corners = environment.objects()[object as usize].polygon_in_world(polygon);
        let plane = plane_of_polygon(&corners)?;
        let steps = |x: f64, step: f64| (x / step).round() as i32;
        // Both sides of a wall that was modelled by one sheet are one surface: the normal's sign does not count.
        let turned = if plane.normal.to_array().into_iter().find(|x| x.abs() > 0.3).is_some_and(|x| x < 0.0) {
            -1.0
        } else {
            1.0
        };
        let n = turned * plane.normal * NORMAL_STEPS;
        let key = [steps(n.x, 1.0), steps(n.y, 1.0), steps(n.z, 1.0), steps(turned * plane.offset, OFFSET_STEP)];
        let next = self.groups.len() as u32;
        let group = *self.groups.entry((object, key)).or_insert(next);
        let surface = Surface { plane, object, group };
        self.of_slot[slot as usize] = Some(surface);
        Some(surface)
    }
}
