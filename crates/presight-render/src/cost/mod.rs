//! What a frame costs: unit costs learnt from frames, and how far to trust them.
//!
//! The paper's formula (section 3.3) gives the time of a frame as a sum of counts times unit costs. [`CostModel`] learns the unit costs
//! while frames are made. Let n be a frame's counts and t its measured time. The costs c minimize
//!
//! ```text
//! sum over frames of 0.98^age (1 - c . n / t)^2,    c >= 0
//! ```
//!
//! which is recursive least squares on relative errors: a fast frame weighs as much as a slow one, and costs that
//! have tripled are followed within some 200 frames. A weak pull towards careful defaults decides about counts that do not vary.
//!
//! An estimate is right on average; a deadline needs more. Beside the costs stand the last 200 ratios of measured over estimated
//! time. [`TimeEstimate::upper`] is the estimate times their 0.99 quantile, so that a machine that gets busy is planned for
//! after three slow frames.
//!
//! Nothing here reads a clock: times come from the caller, so that recorded counts and times replay to the same numbers.

mod controller;
mod key;
mod model;
mod unit_costs;

pub use controller::{Controller, DeadlineFrame};
pub use key::{Forecast, Key};
pub use model::{CostModel, MAX_MODELS, TimeEstimate};
pub use unit_costs::UnitCosts;

/// What a frame consists of: every field counts one kind of work.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkCounts {
    /// Runs of polygons selected.
    pub runs: u64,
    /// Polygons set up.
    pub polygons: u64,
    /// Waves drawn.
    pub waves: u64,
    /// Samples that were tested against a polygon's depth.
    pub samples_tested: u64,
    /// Samples written by a polygon.
    pub samples_written: u64,
    /// Pixels resolved, all outputs together.
    pub pixels_resolved: u64,
    /// Features looked at.
    pub features: u64,
    /// Samples of features.
    pub feature_samples: u64,
    /// Regions of interest made.
    pub regions: u64,
}

/// Kinds of work, the frame itself among them.
pub const KINDS: usize = 10;

impl WorkCounts {
    /// Kinds of work as files name them; the first is the frame itself, which costs access and set-up.
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
