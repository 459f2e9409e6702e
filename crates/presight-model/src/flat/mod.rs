//! Planes in scanned models, whose facets noise keeps from being parallel.
//!
//! The tolerance follows from the mesh's own noise: the standard deviation of its corners from planes through
//! neighbourhoods as large as the smallest plane (`noise`). Planes grow from the flattest neighbourhoods over all
//! facets within the tolerance (`grow`). A designed mesh has no noise and no such planes: its planes are exact.

mod facets;
mod fit;
mod grow;
mod noise;
mod rest;

use crate::contour::MeshEdges;
use crate::geometry::Plane;
use facets::Facets;
pub use grow::FRINGE;
pub use rest::FlatRest;

/// Standard deviations of noise in the tolerance of a plane; normal noise exceeds it at one corner in 370.
pub const DEVIATIONS: f64 = 3.0;

/// Planes of an object within a tolerance.
#[derive(Debug, Default)]
pub struct FlatSurfaces {
    /// Maximum distance of facets from their plane, metres; 0 for a designed mesh.
    pub tolerance: f64,
    /// Planes in the order in which they were found, the flattest first.
    pub surfaces: Vec<FlatSurface>,
}

/// A plane and the polygons on it, in the object's frame.
#[derive(Debug)]
pub struct FlatSurface {
    /// The plane.
    pub plane: Plane,
    /// The polygons on it, ascending. They may be four thirds of the tolerance from the plane.
    pub polygons: Vec<u32>,
    /// Area of the polygons within the tolerance, square metres.
    pub area: f64,
}

/// Conditions on planes.
#[derive(Clone, Copy, Debug)]
pub struct FlatOptions {
    /// The tolerance in metres; `None` for the noise of the mesh, times [`DEVIATIONS`].
    pub tolerance: Option<f64>,
    /// Maximum standard deviation of noise, metres.
    pub max_noise: f64,
    /// Minimum area of a plane, square metres.
    pub min_area: f64,
}

impl FlatSurfaces {
    /// The planes of an object. A designed mesh has none, unless a tolerance is given.
    pub fn new(edges: &MeshEdges, options: &FlatOptions) -> Self {
        let none = Self::default();
        if options.tolerance == Some(0.0) {
            return none;
        }
        let facets = Facets::new(edges);
        if facets.areas.iter().sum::<f64>() < options.min_area {
            return none;
        }
        if options.tolerance.is_none() && (noise::is_exact(&facets) || !noise::is_noisy(&facets)) {
            return none;
        }
        // A square of the minimum area reaches this far from its middle.
        let seeds = noise::seeds(&facets, 0.5 * options.min_area.sqrt());
        let measured = || DEVIATIONS * noise::typical(&seeds).min(options.max_noise);
        let tolerance = options.tolerance.unwrap_or_else(measured);
        if !(tolerance > 0.0) {
            return none;
        }
        Self { tolerance, surfaces: grow::planes(&facets, &seeds, tolerance, options.min_area) }
    }
}
