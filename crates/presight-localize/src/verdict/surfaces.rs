//! The planes of polygons by slot, worked out when first seen.

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
    /// Number of the polygons that share an error with this one: polygons of one object that lie about in one plane.
    pub group: u32,
}

/// What is stored of how far off an object may be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectError {
    /// Where the object's frame is, world frame, metres.
    pub origin: DVec3,
    /// Covariance of the object's pose, world axes.
    pub covariance: Matrix,
}

impl ObjectError {
    /// How a plane's offset changes with the object's pose, at a point x of it with normal n: `[n, (x - origin) cross n]`; all of it
    /// along the same axes.
    pub fn gradient(origin: DVec3, point: DVec3, normal: DVec3) -> [f64; 6] {
        let turned = (point - origin).cross(normal);
        [normal.x, normal.y, normal.z, turned.x, turned.y, turned.z]
    }
}

/// Errors of objects, by index of the object.
pub(crate) type ObjectErrors = Arc<BTreeMap<u32, ObjectError>>;

/// Normals that differ by less than about 15 degrees are of one group.
const NORMAL_STEPS: f64 = 4.0;
/// Planes of one direction whose offsets differ by less are of one group, metres.
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

    /// The stored errors of objects' poses, as the feature layer of a class of sensors has them.
    pub(crate) fn object_errors(&mut self, world: &World, class: &str) -> ObjectErrors {
        if let Some(known) = self.errors.get(class) {
            return known.clone();
        }
        let environment = world.environment();
        let listed = environment.layer(class).map_or(&[][..], |layer| &layer.pose_covariances);
        let error = |(name, own): &(String, PoseCovariance<InObject>)| {
            // Of an object that is gone nothing is seen.
            let index = environment.index_of(name).ok()?;
            let pose = &environment.objects()[index as usize].world_from_object;
            let covariance = *own.in_world(pose).as_rows();
            Some((index, ObjectError { origin: pose.translation, covariance }))
        };
        let errors: ObjectErrors = Arc::new(listed.iter().filter_map(error).collect());
        self.errors.insert(class.to_owned(), errors.clone());
        errors
    }

    /// Works out the surface of an id, the number of its slot plus 1, unless it is known; 0 is no polygon's.
    pub fn see(&mut self, world: &World, id: u32) {
        if let Some(slot) = id.checked_sub(1)
            && self.seen(slot).is_none()
        {
            self.of(world, slot);
        }
    }

    /// The surface of a slot, if it was worked out.
    pub fn seen(&self, slot: u32) -> Option<&Surface> {
        self.of_slot.get(slot as usize)?.as_ref()
    }

    /// The surface of a slot; `None` if nothing has it, or if its polygon has no plane.
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
