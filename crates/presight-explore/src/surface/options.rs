//! How an environment is explored.

use presight_model::threads::Threads;

/// How an environment is explored.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct ExploreOptions {
    /// Most polygons.
    pub polygons: usize,
    /// Side of the smallest pieces of surface that are distinguished, metres; `None` for what the noise of the ranges, the distance of
    /// neighbouring points and the number of views allow, 2 cm at least.
    pub detail: Option<f64>,
    /// Height of walls that a level scanner of one row sees, metres.
    pub wall_height: f64,
    /// Height of the floor that these walls stand on, metres.
    pub floor: f64,
    /// A beam of such a scanner this near to a known wall is explained, metres.
    pub wall_tolerance: f64,
    /// Threads.
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
