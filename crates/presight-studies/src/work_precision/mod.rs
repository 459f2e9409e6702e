//! Error against run time: every path that the product has from a scene to an image, and every knob that trades the one
//! for the other, against one named truth.
//!
//! | truth | of |
//! |---|---|
//! | the reference's images | ids, ranges, silhouettes |
//! | a ray through space to every sample of every feature | visible fractions |
//! | draws of the errors of pose and feature, projected one by one | how often a region of interest misses its feature |
//!
//! Which paths there are is in `paths`, how a user takes them in `how`; how images are told apart in `errors`; features are in
//! `features`, regions of interest in `regions`; times, taken by turns, in `timing`; what to take of all that in `advice`.

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
use presight::World;
use presight::geometry::Pose;
use presight::plan::{CountName, ImageRequest, Omission, StageName};
use presight::sensor::{Camera, Distortion, Geometry, Sensor, SensorSpec};
use presight::verify::Precision;
use presight::{Error, Result};
use serde::Serialize;
use std::time::Duration;

/// How much is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// All paths take their turns so often, each with its share of runs.
    pub rounds: usize,
    /// Each path is run at least so often at a pose; runs that warm it up are not counted.
    pub least_runs: usize,
    /// And at most so often.
    pub most_runs: usize,
    /// In between it is run until this much time is spent.
    pub patience: Duration,
    /// Features looked at, per sensor and pose.
    pub features: usize,
    /// Draws of the errors for each region of interest.
    pub draws: usize,
}

impl Effort {
    /// A study in well under a minute on two cores.
    pub const QUICK: Self = Self {
        rounds: 7,
        least_runs: 2,
        most_runs: 21,
        patience: Duration::from_millis(250),
        features: 40,
        draws: 1_000,
    };
    /// A study to rely on.
    pub const FULL: Self = Self {
        rounds: 20,
        least_runs: 5,
        most_runs: 200,
        patience: Duration::from_secs(2),
        features: 200,
        draws: 10_000,
    };
}

/// A scene and the poses that sensors take in it.
#[derive(Clone, Debug)]
pub struct Scene {
    /// As it was named.
    pub name: String,
    /// What it holds.
    pub world: World,
    /// Of the sensor in the world, body axes; errors are the worst over them, times of all of them.
    pub poses: Vec<Pose>,
}

/// What is to be measured.
#[derive(Clone, Debug)]
pub struct Study {
    /// Where.
    pub scenes: Vec<Scene>,
    /// With which sensors.
    pub sensors: Vec<Sensor>,
    /// How thoroughly.
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
    /// Which path of this engine.
    pub variant: String,
    /// What kind of error: see [`to_html`]'s table.
    pub error_kind: &'static str,
    /// The error, in the unit of its kind; the worst over all poses.
    pub error: f64,
    /// What it may be at most, where that is known; of ranges at the pixel of the greatest error, and so of none where
    /// nothing differs.
    pub bound: Option<f64>,
    /// Median time of the path, milliseconds.
    pub median_ms: f64,
    /// A quarter and three quarters of the runs took at most so long, milliseconds.
    pub quartiles_ms: [f64; 2],
    /// 95 of 100 runs took at most so long, milliseconds.
    pub p95_ms: f64,
    /// No other path to the same is both as fast and as exact.
    pub pareto: bool,
    /// Runs that were timed.
    pub runs: usize,
    /// What a user gets who asks for nothing else.
    pub default: bool,
    /// How a user takes it.
    #[serde(skip)]
    how: String,
    /// In charts: whose mark it bears.
    #[serde(skip)]
    family: String,
    /// In charts: the text beside it.
    #[serde(skip)]
    label: String,
}

/// Milliseconds of a stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageTime {
    /// Its name.
    pub stage: StageName,
    /// The middle one.
    pub median_ms: f64,
    /// 95 of 100 runs took at most so long.
    pub p95_ms: f64,
}

/// How to take a path, times of its stages, and what it left out.
#[derive(Clone, Debug, Serialize)]
pub struct PathNotes {
    /// `reference`, `cpu` or `gpu`.
    pub engine: String,
    /// Which path of this engine.
    pub variant: String,
    /// Flags of `presight predict`, keys of the sensor's file, or the library.
    pub how: String,
    /// What a user gets who asks for nothing else.
    pub default: bool,
    /// Runs that were timed.
    pub runs: usize,
    /// Times by stage, in order.
    pub stages: Vec<StageTime>,
    /// Counts of the last run.
    pub counts: Vec<(CountName, u64)>,
    /// What was not needed in the last run, and why.
    pub left_out: Vec<Omission>,
}

/// What was found of one scene and sensor.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    /// Scene.
    pub scene: String,
    /// Sensor.
    pub sensor: String,
    /// Columns and rows.
    pub size: (u32, u32),
    /// Share of the truth's pixels that show something.
    pub seen_share: f64,
    /// Features that errors of features are of, over all poses.
    pub features: usize,
    /// What to take, in a few sentences made of the rows.
    pub advice: String,
    /// Errors and times.
    pub rows: Vec<Row>,
    /// Stages and what was left out.
    pub notes: Vec<PathNotes>,
    /// Paths that could not be measured, and why.
    pub not_measured: Vec<String>,
    /// The range image of the first pose, a PNG file.
    #[serde(skip)]
    pub preview: Vec<u8>,
}

/// What a study found.
#[derive(Clone, Debug, Serialize)]
pub struct Findings {
    /// Scene by scene, sensor by sensor.
    pub findings: Vec<Finding>,
    /// Adapter and driver, or why there is none.
    pub adapter: String,
}

impl Findings {
    /// Paths that are to be exact and show pixels that no rounding explains.
    pub fn faults(&self) -> usize {
        let rows = self.findings.iter().flat_map(|f| &f.rows);
        rows.filter(|r| r.error_kind == FAULT_SHARE && r.error > 0.0).count()
    }
}

/// The kind of error that only paths have that are to be exact.
const FAULT_SHARE: &str = "fault_share";

/// Images that every path makes.
fn request() -> ImageRequest {
    ImageRequest::default()
}

/// The sensor of full studies that needs a ray table: a fisheye of 180 degrees.
///
/// # Errors
/// None for these constants; the sensor's own check.
pub fn fisheye() -> Result<Sensor> {
    let distortion = Distortion::Equidistant([0.0; 4]);
    let camera = Camera { width: 512, height: 512, fx: 163.0, fy: 163.0, cx: 255.5, cy: 255.5, distortion };
    Sensor::new(SensorSpec::new("fisheye", "video", Geometry::Camera(camera)))
}

impl Study {
    /// How often [`Study::run`] tells its progress, at most.
    pub fn steps(&self) -> usize {
        let measured = self.sensors.len() * self.scenes.len();
        let poses: usize = self.sensors.len() * self.scenes.iter().map(|s| s.poses.len()).sum::<usize>();
        // The truth and features; every path, and all of them by turns at each pose: images, features, regions of interest.
        2 * measured + poses * (Path::all(true).len() + 3 * self.effort.rounds)
    }

    /// Measures everything. `progress` is told what comes next.
    ///
    /// # Errors
    /// Those of predictions, of generating features, and of an image that cannot be drawn.
    pub fn run(&self, mut progress: impl FnMut(&str)) -> Result<Findings> {
        let mut engines = Engines::open()?;
        let mut findings = Vec::new();
        for scene in &self.scenes {
            if scene.poses.is_empty() {
                return Err(Error::invalid("there is no pose", "give at least one").in_file(&scene.name));
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

/// The arithmetic by which an engine is judged.
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
