//! Error against run time of every path from a scene to an image, and of every setting that trades error for run time.
//!
//! | truth | used for |
//! |---|---|
//! | images of the reference engine | ids, ranges, silhouettes |
//! | a ray to every sample of every feature | visible fractions |
//! | projected random samples of the errors of pose and feature | how often a region of interest misses its feature |
//!
//! `paths` lists the paths, and `how` describes their flags. `errors` compares images, `features` features, and
//! `regions` regions of interest. `timing` measures times, and `advice` recommends paths.

mod advice;
mod errors;
mod features;
mod how;
mod one;
mod pareto;
mod paths;
mod regions;
mod show;
mod tables;
mod timing;
mod views;

pub use show::{to_csv, to_html, to_json};

use one::SceneStudy;
use paths::{Engines, Path};
use presight_model::error::{Error, Result};
use presight_model::geometry::Pose;
use presight_model::sensor::{Camera, Distortion, Geometry, Sensor, SensorSpec};
use presight_model::world::World;
use presight_render::plan::{CountName, ImageRequest, Omission, StageName};
use presight_render::verify::Precision;
use serde::Serialize;
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

/// A work-precision study.
#[derive(Clone, Debug)]
pub struct Study {
    /// The scenes.
    pub scenes: Vec<Scene>,
    /// The sensors.
    pub sensors: Vec<Sensor>,
    /// The amount of measurement.
    pub effort: Effort,
}

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
    /// The kind of error: see the table of [`to_html`].
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
    turns_ms: Vec<f64>,
    /// For features: the error of each, in the same order for all paths.
    #[serde(skip)]
    errors: Vec<f64>,
    /// Flags or settings that select the path.
    #[serde(skip)]
    how: String,
    /// The series in charts.
    #[serde(skip)]
    family: String,
    /// The label in charts.
    #[serde(skip)]
    label: String,
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
const FAULT_SHARE: &str = "fault_share";

/// The images that every path predicts.
fn request() -> ImageRequest {
    ImageRequest::default()
}

/// A sensor for full studies that needs a ray table: a fisheye of 180 degrees.
///
/// # Errors
/// None in practice; as [`Sensor::new`].
pub fn fisheye() -> Result<Sensor> {
    let distortion = Distortion::Equidistant([0.0; 4]);
    let camera = Camera { width: 512, height: 512, fx: 163.0, fy: 163.0, cx: 255.5, cy: 255.5, distortion };
    Sensor::new(SensorSpec::new("fisheye", "video", Geometry::Camera(camera)))
}

impl Study {
    /// The maximum number of progress reports of [`Study::run`].
    pub fn steps(&self) -> usize {
        let measured = self.sensors.len() * self.scenes.len();
        let poses: usize = self.sensors.len() * self.scenes.iter().map(|s| s.poses.len()).sum::<usize>();
        // Per measurement one for the truth and one for features. Per pose one for each path, and the rounds of images,
        // features and regions of interest.
        2 * measured + poses * (Path::all(true).len() + 3 * self.effort.rounds)
    }

    /// Runs the study. Calls `progress` with the name of each step.
    ///
    /// # Errors
    /// Errors from predictions, from generating features, and from drawing the preview.
    pub fn run(&self, mut progress: impl FnMut(&str)) -> Result<Findings> {
        let mut engines = Engines::open()?;
        let mut findings = Vec::new();
        for scene in &self.scenes {
            if scene.poses.is_empty() {
                return Err(Error::invalid("there are no poses", "give at least one").in_file(&scene.name));
            }
            for sensor in &self.sensors {
                let mut one =
                    SceneStudy { scene, sensor, effort: &self.effort, engines: &mut engines, not_measured: Vec::new() };
                let finding = one.run(&mut progress);
                findings
                    .push(finding.map_err(|e| e.at(format!("sensor {:?}", sensor.spec().name)).in_file(&scene.name))?);
            }
        }
        Ok(Findings { findings, adapter: engines.adapter() })
    }
}

/// The precision whose bounds apply to an engine.
fn precision_of(gpu: bool) -> Precision {
    if gpu { Precision::F32 } else { Precision::F64 }
}

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
        let faults = |rows| Findings { findings: vec![finding(rows)], adapter: String::new() }.faults();
        assert_eq!(faults(vec![row(FAULT_SHARE, 0.0), row("id_mismatch", 0.3)]), 0);
        assert_eq!(faults(vec![row(FAULT_SHARE, 1e-6), row(FAULT_SHARE, 0.0)]), 1);
    }
}
