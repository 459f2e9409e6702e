//! Contours: the silhouettes of smooth surfaces.
//!
//! A layer defines a surface by a point on it and by the largest angle between neighbouring facets
//! ([`crate::environment::FeatureShape::Contour`]). The facets are found when the layer is placed, and never stored.
//! The edges are set up once per version of the world ([`ContourSet`]). At each pose the silhouette has the edges
//! between a facet that faces the sensor and one that faces away, and the edges where the surface ends (unless another
//! surface continues it smoothly, or a segment of the layer lies there). They form curves ([`Curve`]). Each piece of a
//! curve is tested like a segment on the polygons around it.
//!
//! Windings do not matter: only whether two facets are on the same side of the plane through sensor and edge.

mod curves;
mod edges;
mod known;
mod place;
mod surface;

use crate::environment::{Appearance, Environment};
pub use curves::Curve;
pub use edges::MeshEdges;
pub use known::ContourSet;
pub use place::{ContourFinder, SmoothSurface, surfaces};
pub use surface::Surface;

/// By material: true if a sensor class sees it.
fn seen_materials(environment: &Environment, class: &str) -> Vec<bool> {
    environment.materials().iter().map(|m| m.appearance(class) != Appearance::Invisible).collect()
}
