//! Queries to the model: objects in a place, the nearest surface, docks, uncertain features, and paths on free floor.

#[doc(inline)]
pub use presight_supervise::query::{
    Dock, FloorPath, NearestSurface, ObjectFound, PathOptions, Place, UncertainFeature, UncertainObject,
    UncertainOptions, UncertaintyReason, docks, find_path, objects_in, surface_distance, uncertain_features,
    uncertain_objects,
};
