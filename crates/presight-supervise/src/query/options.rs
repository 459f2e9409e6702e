//! Options of a path search.

presight_model::options! {
    /// The robot of a path search.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct PathOptions {
        /// Radius of the robot seen from above, metres.
        radius: f64 = 0.4, with_radius;
        /// Distance between neighbouring positions, metres.
        step: f64 = 0.05, with_step;
        /// Height above the floor from which surfaces are obstacles, metres.
        clearance: f64 = 0.06, with_clearance;
        /// Height of the robot, metres.
        height: f64 = 1.8, with_height;
    }
}
