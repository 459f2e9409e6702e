//! How an environment is explored.

use presight_model::threads::Threads;

presight_model::options! {
    /// How an environment is explored.
    #[derive(Clone, Debug)]
    pub struct ExploreOptions {
        /// Maximum number of polygons.
        polygons: usize = 2000, with_polygons;
        /// Size of the smallest distinguished pieces of surface, metres; `None` for the size that the noise of the
        /// ranges, the spacing of points and the number of views support, at least 2 cm.
        detail: Option<f64> = None, with_detail;
        /// Height of the walls from level scans of one row, metres.
        wall_height: f64 = 2.5, with_wall_height;
        /// Height of the floor below these walls, metres.
        floor: f64 = 0.0, with_floor;
        /// Maximum distance from a known wall at which the wall explains a beam, metres.
        wall_tolerance: f64 = 0.1, with_wall_tolerance;
        /// Threads for all computations.
        threads: Threads = Threads::default(), with_threads;
    }
}
