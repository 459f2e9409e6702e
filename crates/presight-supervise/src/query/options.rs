//! Options of a path search.

use presight_model::floor::Mobility;

presight_model::options! {
    /// The robot of a path search.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct PathOptions {
        /// Radius of the robot seen from above, metres.
        radius: f64 = 0.4, with_radius;
        /// Distance between neighbouring positions, metres.
        step: f64 = 0.05, with_step;
        /// Height above the floor from which surfaces are obstacles, and maximum height of a step of the floor, metres.
        clearance: f64 = 0.06, with_clearance;
        /// Height of the robot, metres.
        height: f64 = Mobility::default().height, with_height;
        /// Maximum slope of the floor, degrees.
        slope_deg: f64 = Mobility::default().slope_deg, with_slope_deg;
    }
}

impl PathOptions {
    /// What the robot drives over and under.
    pub(super) fn mobility(&self) -> Mobility {
        Mobility::default().with_step(self.clearance).with_height(self.height).with_slope_deg(self.slope_deg)
    }
}
