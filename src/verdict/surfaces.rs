//! The planes of polygons by slot, worked out when first seen.

use crate::geometry::{Plane, plane_of_polygon};
use crate::world::World;
use std::collections::HashMap;

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
}

impl Surfaces {
    /// Forgets the surfaces of another version.
    pub fn follow(&mut self, world: &World) {
        if self.stamp != Some(world.stamp()) {
            *self = Self { stamp: Some(world.stamp()), ..Self::default() };
            self.of_slot.resize(world.environment().slot_count() as usize, None);
        }
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
