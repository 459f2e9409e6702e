//! The results of a study.

use super::approximations::ApproximationCost;
use presight_render::plan::{CountName, Omission, StageName};
use serde::Serialize;

/// One error of one path: a line of `work_precision.csv`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Scene.
    pub scene: String,
    /// Sensor.
    pub sensor: String,
    /// `reference`, `cpu` or `gpu`.
    pub engine: String,
    /// The path of this engine.
    pub variant: String,
    /// The kind of error: see the table of [`to_html`](super::to_html).
    pub error_kind: &'static str,
    /// The error, in the unit of its kind; the worst over all poses.
    pub error: f64,
    /// The bound of the error, if known. For `range_m` it is the bound at the pixel of the largest error, and `None` if
    /// all ranges are equal.
    pub bound: Option<f64>,
    /// Median time of the path, milliseconds.
    pub median_ms: f64,
    /// First and third quartile of the times, milliseconds.
    pub quartiles_ms: [f64; 2],
    /// 95th percentile of the times, milliseconds.
    pub p95_ms: f64,
    /// True on the Pareto front: no other path is at least as fast and as exact, and better in one of them.
    pub pareto: bool,
    /// Number of timed runs.
    pub runs: usize,
    /// True for the path that a user gets by default.
    pub default: bool,
    /// The median of each turn, milliseconds; NaN if it had no time for this path. Turns of one number of paths that
    /// were timed together are neighbours in time.
    #[serde(skip)]
    pub(super) turns_ms: Vec<f64>,
    /// For features: the error of each, in the same order for all paths.
    #[serde(skip)]
    pub(super) errors: Vec<f64>,
    /// Flags or settings that select the path.
    #[serde(skip)]
    pub(super) how: String,
    /// The series in charts.
    #[serde(skip)]
    pub(super) family: String,
    /// The label in charts.
    #[serde(skip)]
    pub(super) label: String,
}

/// Times of a stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageTime {
    /// The stage.
    pub stage: StageName,
    /// Median, milliseconds.
    pub median_ms: f64,
    /// 95th percentile, milliseconds.
    pub p95_ms: f64,
}

/// How to select a path, the times of its stages, and the stages that it skipped.
#[derive(Clone, Debug, Serialize)]
pub struct PathNotes {
    /// `reference`, `cpu` or `gpu`.
    pub engine: String,
    /// The path of this engine.
    pub variant: String,
    /// Flags of `presight predict`, keys of the sensor file, or library calls.
    pub how: String,
    /// True for the path that a user gets by default.
    pub default: bool,
    /// Number of timed runs.
    pub runs: usize,
    /// Times by stage, in order.
    pub stages: Vec<StageTime>,
    /// Counts of the last run.
    pub counts: Vec<(CountName, u64)>,
    /// Stages and images skipped in the last run, and why.
    pub left_out: Vec<Omission>,
}

/// The results of one scene and sensor.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// Scene.
    pub scene: String,
    /// Sensor.
    pub sensor: String,
    /// Columns and rows.
    pub size: (u32, u32),
    /// Fraction of pixels in the true images that show a polygon.
    pub seen_share: f64,
    /// Number of features measured, over all poses.
    pub features: usize,
    /// Recommended paths, in a few sentences derived from the rows.
    pub advice: String,
    /// Errors and times.
    pub rows: Vec<Row>,
    /// Settings and stages of each path.
    pub notes: Vec<PathNotes>,
    /// Paths that could not be measured, and why.
    pub not_measured: Vec<String>,
    /// The range image of the first pose, a PNG file.
    #[serde(skip)]
    pub preview: Vec<u8>,
}

/// The results of a study.
#[derive(Clone, Debug, Serialize)]
pub struct Findings {
    /// Results by scene, then by sensor.
    pub findings: Vec<Finding>,
    /// The cost of predicting lidars as simpler ones, by scene, then by sensor.
    pub approximations: Vec<ApproximationCost>,
    /// Adapter and driver, or why there is none.
    pub adapter: String,
}

impl Findings {
    /// The number of exact paths with pixels that rounding does not explain.
    pub fn faults(&self) -> usize {
        let rows = self.findings.iter().flat_map(|f| &f.rows);
        rows.filter(|r| r.error_kind == FAULT_SHARE && r.error > 0.0).count()
    }
}

/// The kind of error that only exact paths have.
pub(super) const FAULT_SHARE: &str = "fault_share";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_of_paths_that_are_to_be_exact() {
        let row = |error_kind, error| Row {
            scene: String::new(),
            sensor: String::new(),
            engine: "cpu".into(),
            variant: String::new(),
            error_kind,
            error,
            bound: None,
            median_ms: 1.0,
            quartiles_ms: [1.0; 2],
            p95_ms: 1.0,
            pareto: false,
            runs: 1,
            default: false,
            turns_ms: Vec::new(),
            errors: Vec::new(),
            how: String::new(),
            family: String::new(),
            label: String::new(),
        };
        let finding = |rows| Finding {
            scene: String::new(),
            sensor: String::new(),
            size: (1, 1),
            seen_share: 1.0,
            features: 0,
            advice: String::new(),
            rows,
            notes: Vec::new(),
            not_measured: Vec::new(),
            preview: Vec::new(),
        };
        let faults = |rows| {
            Findings { findings: vec![finding(rows)], approximations: Vec::new(), adapter: String::new() }.faults()
        };
        assert_eq!(faults(vec![row(FAULT_SHARE, 0.0), row("id_mismatch", 0.3)]), 0);
        assert_eq!(faults(vec![row(FAULT_SHARE, 1e-6), row(FAULT_SHARE, 0.0)]), 1);
    }
}
