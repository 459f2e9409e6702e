//! Features in a world: which polygons they lie on, how much of each a sensor sees, and where.

mod place;

pub use place::place;

use crate::environment::Feature;

/// A feature with its place in a version of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct PlacedFeature {
    /// As the layer has it; geometry in the frame of its object.
    pub feature: Feature,
    /// Index of its object; `None` is the world.
    pub object: Option<u32>,
    /// Slots of the polygons it lies on: they never hide it.
    pub slots: Vec<u32>,
}
