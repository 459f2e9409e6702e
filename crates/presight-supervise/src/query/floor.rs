//! Places on free floor.

use super::clip::{clipped, distance_from_above};
use super::options::PathOptions;
use glam::{DVec2, DVec3};
use presight_model::geometry::Aabb;
use presight_model::index::{QueryResult, Region};
use presight_model::world::World;
use presight_predict::free_poses::height_above;

/// Maximum height of the floor above or below its height at the start, metres. Virtual sensors use the same value.
const UNEVEN: f64 = 0.05;

/// The reason why a robot cannot stand at a place.
#[derive(Clone, Debug, PartialEq)]
pub enum Obstacle {
    /// An object within the robot's radius.
    Object(u32),
    /// An object that a sensor saw within the robot's radius.
    Seen,
    /// The floor is missing.
    NoFloor,
}

/// The floor on which a robot drives.
pub struct Floor<'a> {
    pub world: &'a World,
    pub options: &'a PathOptions,
    /// Height of the floor, metres.
    pub height: f64,
    /// Boxes around objects that sensors saw on it, world, metres.
    pub seen: &'a [Aabb],
}

impl<'a> Floor<'a> {
    /// The height of the floor below a point; `None` if there is none within reach.
    pub fn height_below(world: &World, p: DVec3) -> Option<f64> {
        let reach = world.environment().bounds().size() + 1.0;
        // Slightly above, so that a point on the floor finds it.
        let from = p + UNEVEN * DVec3::Z;
        height_above(world, from, reach, &mut QueryResult::default()).map(|height| from.z - height)
    }

    /// The obstacle at a place; `None` if a robot can stand there.
    pub fn obstacle(&self, p: DVec2, found: &mut QueryResult) -> Option<Obstacle> {
        let (radius, environment) = (self.options.radius, self.world.environment());
        let slab = Aabb {
            min: (p - radius).extend(self.height + self.options.clearance),
            max: (p + radius).extend(self.height + self.options.height),
        };
        let is_near = |b: &Aabb| {
            let off = (b.min - p.extend(0.0)).max(p.extend(0.0) - b.max).truncate().max(DVec2::ZERO);
            off.length() < radius && b.max.z >= slab.min.z && b.min.z <= slab.max.z
        };
        if self.seen.iter().any(is_near) {
            return Some(Obstacle::Seen);
        }
        let polygons = self.world.polygons_in(&Region::cuboid(&slab), found);
        for (object, polygon) in polygons.filter(|(o, p)| !environment.is_absent(*o, *p, None)) {
            let corners = environment.objects()[object as usize].polygon_in_world(polygon);
            let part = clipped(corners, &slab);
            if !part.is_empty() && distance_from_above(&part, p) < radius {
                return Some(Obstacle::Object(object));
            }
        }
        let from = p.extend(self.height + UNEVEN);
        let floor = height_above(self.world, from, 2.0 * UNEVEN, found);
        if floor.is_some() { None } else { Some(Obstacle::NoFloor) }
    }
}
