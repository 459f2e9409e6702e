//! How an environment is explored.

use presight_model::threads::Threads;

/// How an environment is explored.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ExploreOptions {
    /// Maximum number of polygons.
    pub polygons: usize,
    /// Size of the smallest distinguished pieces of surface, metres; `None` for the size that the noise of the ranges,
    /// the spacing of points and the number of views support, at least 2 cm.
    pub detail: Option<f64>,
    /// Height of the walls from level scans of one row, metres.
    pub wall_height: f64,
    /// Height of the floor below these walls, metres.
    pub floor: f64,
    /// Maximum distance from a known wall at which the wall explains a beam, metres.
    pub wall_tolerance: f64,
    /// Threads for all computations.
    pub threads: Threads,
}

impl Default for ExploreOptions {
    fn default() -> Self {
        Self {
            polygons: 2000,
            detail: None,
            wall_height: 2.5,
            floor: 0.0,
            wall_tolerance: 0.1,
            threads: Threads::default(),
        }
    }
}

presight_model::with_options!(
    ExploreOptions:
    with_polygons polygons: usize,
    with_detail detail: Option<f64>,
    with_wall_height wall_height: f64,
    with_floor floor: f64,
    with_wall_tolerance wall_tolerance: f64,
    with_threads threads: Threads,
);
