//! Places on free floor.

use super::clip::clipped;
use super::options::PathOptions;
use glam::{DVec2, DVec3};
use presight_model::floor::{Footing, Mobility, distance_from_above, height_below};
use presight_model::geometry::Aabb;
use presight_model::index::{QueryResult, Region};
use presight_model::world::World;

/// Height above a point from which the floor below it is searched, metres, so that a point on the floor finds it.
const ABOVE: f64 = 0.05;

/// The reason why a robot cannot stand at a place.
#[derive(Clone, Debug, PartialEq)]
pub enum Obstacle {
    /// An object within the robot's radius.
    Object(u32),
    /// An object that a sensor saw within the robot's radius.
    Seen,
    /// The floor ends within the robot's radius.
    NoFloor,
}

/// The floor on which a robot drives.
pub struct Floor<'a> {
    world: &'a World,
    options: &'a PathOptions,
    mobility: Mobility,
    /// Boxes around objects that sensors saw on it, world, metres.
    seen: &'a [Aabb],
}

impl<'a> Floor<'a> {
    pub fn new(world: &'a World, options: &'a PathOptions, seen: &'a [Aabb]) -> Self {
        Self { world, options, mobility: options.mobility(), seen }
    }

    /// The height of the floor below a point; `None` if there is none.
    pub fn height_below(&self, p: DVec3) -> Option<f64> {
        let reach = self.world.environment().bounds().size() + 1.0;
        height_below(self.world, p + ABOVE * DVec3::Z, reach, &self.mobility, &mut QueryResult::default())
    }

    /// Maximum change of the height of the floor over a distance, metres.
    pub fn change(&self, distance: f64) -> f64 {
        self.mobility.step + self.mobility.rise(distance)
    }

    /// Radius of the robot, metres.
    pub fn radius(&self) -> f64 {
        self.options.radius
    }

    /// Name of an object.
    pub fn name(&self, object: u32) -> &str {
        &self.world.environment().objects()[object as usize].name
    }

    /// Height of the floor at a place, at about the height of `p`, if a robot can stand there.
    pub fn stand(&self, p: DVec3, found: &mut QueryResult) -> Result<f64, Obstacle> {
        let (radius, place) = (self.options.radius, p.truncate());
        let footing = Footing::at(self.world, p, radius, &self.mobility, found);
        if let Some(obstacle) = self.obstacle(place, footing.as_ref(), p.z, found) {
            return Err(obstacle);
        }
        footing.filter(|footing| footing.edge >= radius).map(|footing| footing.height).ok_or(Obstacle::NoFloor)
    }

    /// What stands within the robot's radius above the floor; without a floor, above `height`.
    fn obstacle(&self, p: DVec2, footing: Option<&Footing>, height: f64, found: &mut QueryResult) -> Option<Obstacle> {
        let PathOptions { radius, clearance, height: robot, .. } = *self.options;
        let (floor, lowest) = footing.map_or((height, height), |footing| (footing.height, footing.lowest));
        let slab = Aabb { min: (p - radius).extend(lowest + clearance), max: (p + radius).extend(floor + robot) };
        let is_near = |b: &Aabb| {
            let off = (b.min - p.extend(0.0)).max(p.extend(0.0) - b.max).truncate().max(DVec2::ZERO);
            off.length() < radius && b.max.z >= slab.min.z && b.min.z <= slab.max.z
        };
        if self.seen.iter().any(is_near) {
            return Some(Obstacle::Seen);
        }
        let environment = self.world.environment();
        for (object, polygon) in self.world.polygons_in(&Region::cuboid(&slab), None, found) {
            let corners = environment.objects()[object as usize].polygon_in_world(polygon);
            let part: Vec<DVec3> = clipped(corners, &slab).into_iter().map(|c| c - p.extend(0.0)).collect();
            let outline: Vec<DVec2> = part.iter().map(|c| c.truncate()).collect();
            if !part.is_empty()
                && distance_from_above(&outline, DVec2::ZERO) < radius
                && footing.is_none_or(|footing| footing.is_below(&part, clearance))
            {
                return Some(Obstacle::Object(object));
            }
        }
        None
    }
}
