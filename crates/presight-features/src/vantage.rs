//! A sensor at a pose in one version of the world.

use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;

/// A sensor at a pose (body axes) in a world.
#[derive(Clone, Copy, Debug)]
pub struct Vantage<'a> {
    /// One version of the world.
    pub world: &'a World,
    /// The sensor.
    pub sensor: &'a Sensor,
    /// The sensor's pose, body axes.
    pub world_from_sensor: &'a Pose,
}
