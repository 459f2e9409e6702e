//! Contours: the silhouettes of smooth surfaces.
//!
//! A layer names a surface by a point on it and by the angle under which its facets fold ([`crate::environment::FeatureShape::Contour`]).
//! Its facets are found when the layer is placed, never stored. Its edges are set up once for a version of the world
//! ([`ContourSet`]). At each pose those edges count where a facet with the sensor before it meets one with the sensor behind it,
//! and those where the surface ends, unless another surface goes on there smoothly, or a segment of the layer lies there. They
//! form curves ([`Curve`]), and each piece of a curve is hidden as a segment is that lies on the polygons around it.
//!
//! Nothing depends on windings: two facets lie on the same side of the plane through sensor and edge, or on different ones.

mod curves;
mod edges;
mod known;
mod place;
mod surface;

use crate::environment::{Appearance, Environment};
pub use curves::Curve;
pub use known::ContourSet;
pub use place::{ContourFinder, SmoothSurface, surfaces};
pub use surface::Surface;

/// By material, whether a sensor class sees it.
fn seen_materials(environment: &Environment, class: &str) -> Vec<bool> {
    environment.materials().iter().map(|m| m.appearance(class) != Appearance::Invisible).collect()
}
