//! Queries to the model of an environment: objects in a place, the nearest surface, docks, uncertain features, and
//! paths on free floor.

mod clip;
mod distance;
mod docks;
mod floor;
mod objects;
mod options;
mod path;
mod uncertain;

pub use distance::{NearestSurface, surface_distance};
pub use docks::{Dock, docks};
pub use objects::{ObjectFound, Place, objects_in};
pub use options::PathOptions;
pub use path::{FloorPath, find_path};
pub use uncertain::{
    UncertainFeature, UncertainObject, UncertainOptions, UncertaintyReason, uncertain_features, uncertain_objects,
};
