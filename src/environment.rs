//! The model: objects with meshes, poses and materials, in groups.
//!
//! Scenes are read from glTF models, scripts and stores ([`crate::Scene`]), or built from these types. A
//! [`crate::World`] adds the spatial index; a [`crate::Change`] makes its next version.
#![doc = include_str!("../docs/scene-scripts.md")]

#[doc(inline)]
pub use presight_model::environment::{
    Appearance, ContentHash, DEFAULT_TOLERANCE, Environment, Mark, MarkKind, Material, Mesh, NewObject, Object,
    Polygon, PolygonOrder,
};
#[doc(inline)]
pub use presight_model::geometry::Aabb;
#[doc(inline)]
pub use presight_model::index::IndexKind;
