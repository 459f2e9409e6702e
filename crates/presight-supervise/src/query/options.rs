//! Options of a path search.

/// The robot of a path search.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PathOptions {
    /// Radius of the robot seen from above, metres.
    pub radius: f64,
    /// Distance between neighbouring positions, metres.
    pub step: f64,
    /// Height above the floor from which surfaces are obstacles, metres.
    pub clearance: f64,
    /// Height of the robot, metres.
    pub height: f64,
}

impl Default for PathOptions {
    fn default() -> Self {
        Self { radius: 0.4, step: 0.05, clearance: 0.06, height: 1.8 }
    }
}

presight_model::with_options!(
    PathOptions:
    with_radius radius: f64,
    with_step step: f64,
    with_clearance clearance: f64,
    with_height height: f64,
);
