//! The cost of a frame: unit costs learnt from measured frames, and how reliable they are.
//!
//! The paper's formula (section 3.3) gives a frame's time as a sum of counts times unit costs. [`CostModel`] learns the
//! unit costs while frames run. Let n be a frame's counts and t its measured time. The costs c minimize
//!
//! ```text
//! sum over frames of 0.98^age (1 - c . n / t)^2,    c >= 0
//! ```
//!
//! This is recursive least squares on relative errors: fast and slow frames weigh the same, and costs follow a
//! threefold change in about 200 frames. A weak pull towards pessimistic defaults decides for counts that do not vary.
//!
//! An estimate is right on average, but a deadline needs a bound. The model therefore keeps the last 200 ratios of
//! measured to estimated time. [`TimeEstimate::upper`] is the estimate times their 0.99 quantile, so that it accounts
//! for a newly busy machine after three slow frames.
//!
//! Nothing here reads a clock: the caller passes times, so recorded counts and times replay to the same numbers.

mod controller;
mod key;
mod model;
mod unit_costs;
mod ways;

pub use controller::{Controller, DeadlineFrame, FeatureGroups};
pub use key::{Forecast, Key};
pub use model::{CostModel, MAX_MODELS, TimeEstimate};
pub use unit_costs::UnitCosts;
pub use ways::WayCosts;

/// The work of a frame: every field counts one kind of work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkCounts {
    /// Runs of polygons selected.
    pub runs: u64,
    /// Polygons set up.
    pub polygons: u64,
    /// Waves drawn.
    pub waves: u64,
    /// Samples tested against a polygon's depth.
    pub samples_tested: u64,
    /// Samples that polygons wrote.
    pub samples_written: u64,
    /// Pixels resolved, all outputs together.
    pub pixels_resolved: u64,
    /// Features tested.
    pub features: u64,
    /// Samples of features.
    pub feature_samples: u64,
    /// Regions of interest made.
    pub regions: u64,
}

/// Number of kinds of work, including the frame itself.
pub const KINDS: usize = 10;

impl WorkCounts {
    /// Names of the kinds in files. The first is the frame itself, for access and set-up.
    pub const NAMES: [&'static str; KINDS] = [
        "frame",
        "run",
        "polygon",
        "wave",
        "sample_tested",
        "sample_written",
        "pixel_resolved",
        "feature",
        "feature_sample",
        "region",
    ];

    /// Counts by kind, in the order of [`WorkCounts::NAMES`].
    pub fn by_kind(&self) -> [f64; KINDS] {
        [
            1,
            self.runs,
            self.polygons,
            self.waves,
            self.samples_tested,
            self.samples_written,
            self.pixels_resolved,
            self.features,
            self.feature_samples,
            self.regions,
        ]
        .map(|n| n as f64)
    }
}
