//! Questions to the model of an environment: objects in a place, the nearest surface, docks, uncertain features, and a
//! way on free floor.

mod clip;
mod distance;
mod docks;
mod floor;
mod objects;
mod path;
mod uncertain;

pub use distance::{NearestSurface, surface_distance};
pub use docks::{Dock, docks};
pub use objects::{ObjectFound, Place, objects_in};
pub use path::{FloorPath, PathOptions, find_path};
pub use uncertain::{
    UncertainFeature, UncertainObject, UncertainOptions, Uncertainty, uncertain_features, uncertain_objects,
};
