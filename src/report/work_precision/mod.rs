//! Error against run time: every path that the product has from a scene to an image, and every knob that trades the one
//! for the other, against one named truth.
//!
//! | truth | of |
//! |---|---|
//! | the reference's images | ids, ranges, silhouettes |
//! | a ray through space to every sample of every feature | visible fractions |
//! | draws of the errors of pose and feature, projected one by one | how often a region of interest misses its feature |
//!
//! Which paths there are is in `paths`; how images are told apart in `errors`; features in `features`; times in `timing`.

mod advice;
mod errors;
mod features;
mod pareto;
mod paths;
mod show;
mod timing;
mod views;

pub use show::{to_csv, to_html, to_json};

use crate::compare::Precision;
use crate::error::{Error, Result};
use crate::geometry::Pose;
use crate::io::png;
use crate::plan::{FramePlan, Images, LeftOut, Output, Request};
use crate::reference;
use crate::sensor::{Camera, Distortion, Geometry, Sensor, SensorSpec};
use crate::world::World;
use errors::ImageErrors;
use paths::{Engines, Path};
use serde::Serialize;
use std::time::Duration;
use timing::Timing;

/// How much is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Effort {
    /// Each path is run at least so often at a pose, after one run that is not counted.
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
    pub const QUICK: Self =
        Self { least_runs: 2, most_runs: 21, patience: Duration::from_millis(250), features: 40, draws: 1_000 };
    /// A study to rely on.
    pub const FULL: Self =
        Self { least_runs: 5, most_runs: 201, patience: Duration::from_secs(2), features: 200, draws: 10_000 };
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
    /// What it may be at most, where that is known.
    pub bound: Option<f64>,
    /// Median time of the path, milliseconds.
    pub median_ms: f64,
    /// 95 of 100 runs took at most so long, milliseconds.
    pub p95_ms: f64,
    /// No other path to the same is both as fast and as exact.
    pub pareto: bool,
    /// Runs that were timed.
    pub runs: usize,
    /// In charts: whose mark it bears.
    #[serde(skip)]
    family: String,
    /// In charts: the text beside it.
    #[serde(skip)]
    label: String,
}

/// Median milliseconds of a path's stages, and what it left out.
#[derive(Clone, Debug, Serialize)]
pub struct PathNotes {
    /// `reference`, `cpu` or `gpu`.
    pub engine: String,
    /// Which path of this engine.
    pub variant: String,
    /// Median milliseconds by stage, in order.
    pub stages_ms: Vec<(String, f64)>,
    /// Counts of the last run.
    pub counts: Vec<(String, u64)>,
    /// What was not needed in the last run, and why.
    pub left_out: Vec<LeftOut>,
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
    /// What to take, in a sentence or two made of the rows.
    pub advice: String,
    /// Errors and times.
    pub rows: Vec<Row>,
    /// Stages and what was left out.
    pub notes: Vec<PathNotes>,
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

/// Images that every path makes.
fn request() -> Request {
    Request::default()
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
        self.scenes.len() * self.sensors.len() * (Path::all(true).len() + 2)
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
                let mut one = One { scene, sensor, effort: &self.effort, engines: &mut engines };
                let finding = one.run(&mut progress);
                findings
                    .push(finding.map_err(|e| e.at(format!("sensor {:?}", sensor.spec().name)).in_file(&scene.name))?);
            }
        }
        Ok(Findings { findings, adapter: engines.adapter() })
    }
}

/// The measurement of one scene and sensor.
struct One<'a> {
    scene: &'a Scene,
    sensor: &'a Sensor,
    effort: &'a Effort,
    engines: &'a mut Engines,
}

/// What the reference says at one pose.
struct Truth {
    plan: FramePlan,
    images: Images,
}

impl One<'_> {
    fn run(&mut self, progress: &mut impl FnMut(&str)) -> Result<Finding> {
        // Lines may be cut: what changes most comes first.
        let place = format!("{}, {}", self.sensor.spec().name, self.scene.name);
        progress(&format!("the truth: {place}"));
        let truths = self.scene.poses.iter().map(|pose| self.truth(pose)).collect::<Result<Vec<_>>>()?;
        let (mut rows, mut notes) = (Vec::new(), Vec::new());
        for path in Path::all(self.engines.has_gpu()) {
            progress(&format!("{}, {}: {place}", path.engine(), path.variant(self.engines)));
            if let Some(view) = path.view.of(self.sensor)? {
                self.image_rows(&path, &view, &truths, &mut rows, &mut notes)?;
            }
        }
        progress(&format!("features: {place}"));
        features::rows(self, &truths, &mut rows, &mut notes)?;
        pareto::mark(&mut rows);
        let preview = png::preview_png(&truths[0].images, self.sensor, Output::Range)?;
        Ok(Finding {
            scene: self.scene.name.clone(),
            sensor: self.sensor.spec().name.clone(),
            size: (self.sensor.width(), self.sensor.height()),
            advice: advice::of(&self.scene.name, &self.sensor.spec().name, &rows),
            rows,
            notes,
            preview,
        })
    }

    fn truth(&self, pose: &Pose) -> Result<Truth> {
        let plan = FramePlan::new(&self.scene.world, self.sensor, pose, &request());
        let mut images = Images::default();
        reference::render(&plan, &mut images)?;
        Ok(Truth { plan, images })
    }

    /// Runs one path at all poses and compares its images with the truth.
    fn image_rows(
        &mut self,
        path: &Path,
        view: &views::Seen,
        truths: &[Truth],
        rows: &mut Vec<Row>,
        notes: &mut Vec<PathNotes>,
    ) -> Result<()> {
        let world = path.index.map(|s| self.scene.world.reindexed(s, crate::index::Params::tuned(s)));
        let world = world.as_ref().unwrap_or(&self.scene.world);
        let (mut timing, mut errors) = (Timing::default(), ImageErrors::default());
        for (pose, truth) in self.scene.poses.iter().zip(truths) {
            let mut images = Images::default();
            let drawer = self.engines.drawer(path.which)?;
            timing.measure(self.effort, || drawer.draw(world, &view.sensor, pose, &mut images))?;
            let (truth_images, shown) = view.beside(&truth.images, &images);
            // A part of the image is judged by its own sensor: pixels have their places there.
            let own = FramePlan::new(&self.scene.world, &view.judge, pose, &request());
            let plan = if view.whole { &truth.plan } else { &own };
            let exact = view.exact.then_some(path.precision());
            errors.add(&errors::compare_images(&truth_images, &shown, plan, exact)?);
        }
        errors.missing_share = view.missing_share(self.sensor);
        let (engine, variant) = (path.engine().to_owned(), path.variant(self.engines));
        let template = Row {
            family: path.family(self.engines),
            label: path.view.label().to_owned(),
            ..self.row(&engine, &variant, &timing)
        };
        rows.extend(errors.kinds().into_iter().map(|(error_kind, error, bound)| Row {
            error_kind,
            error,
            bound,
            ..template.clone()
        }));
        notes.push(timing.notes(engine, variant));
        Ok(())
    }

    /// A row without its error.
    fn row(&self, engine: &str, variant: &str, timing: &Timing) -> Row {
        Row {
            scene: self.scene.name.clone(),
            sensor: self.sensor.spec().name.clone(),
            engine: engine.to_owned(),
            variant: variant.to_owned(),
            error_kind: "",
            error: 0.0,
            bound: None,
            median_ms: timing.median(),
            p95_ms: timing.p95(),
            pareto: false,
            runs: timing.runs(),
            family: String::new(),
            label: String::new(),
        }
    }
}

/// The arithmetic by which an engine is judged.
fn precision_of(gpu: bool) -> Precision {
    if gpu { Precision::F32 } else { Precision::F64 }
}
