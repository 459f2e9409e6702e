//! The scenes and the effort of a study.

use presight_model::geometry::Pose;
use presight_model::world::World;
use std::time::Duration;

/// The amount of measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Rounds in which the paths take turns; each path has an equal part of its runs in each round.
    pub rounds: usize,
    /// Minimum runs of each path at a pose, without warm-up runs.
    pub min_runs: usize,
    /// Maximum runs of each path at a pose.
    pub max_runs: usize,
    /// Above the minimum, a path is run until this much time is spent.
    pub patience: Duration,
    /// Maximum number of features per sensor and pose.
    pub features: usize,
    /// Random samples of the errors for each region of interest.
    pub draws: usize,
}

impl Effort {
    /// A study of less than a minute on two cores.
    pub const QUICK: Self =
        Self { rounds: 9, min_runs: 2, max_runs: 21, patience: Duration::from_millis(250), features: 40, draws: 1_000 };
    /// A study with reliable times.
    pub const FULL: Self =
        Self { rounds: 20, min_runs: 5, max_runs: 200, patience: Duration::from_secs(2), features: 200, draws: 10_000 };
}

/// A scene with the poses of sensors.
#[derive(Clone, Debug)]
pub struct Scene {
    /// The name as given.
    pub name: String,
    /// The world.
    pub world: World,
    /// Poses of the sensor in the world, body axes. Errors are the worst over all poses, times include all poses.
    pub poses: Vec<Pose>,
}
