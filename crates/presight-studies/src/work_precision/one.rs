//! The measurement of one scene and sensor.

use super::engines::Engines;
use super::errors::{self, ImageErrors};
use super::path::{Path, PathName};
use super::results::{Finding, PathNotes, Row};
use super::setup::{Effort, Scene};
use super::timing::{TimedPath, Timing, by_turns};
use super::views::{StudyView, request};
use super::{advice, features, pareto};
use presight_model::error::{Error, Result};
use presight_model::geometry::{Pose, SensorPose};
use presight_model::sensor::Sensor;
use presight_model::world::World;
use presight_pictures as png;
use presight_render::plan::{FramePlan, Images, Output};
use presight_render::reference;

/// A callback that receives the name of each step.
pub(super) type Progress<'a> = &'a mut dyn FnMut(&str);

/// The study of one scene and sensor.
pub(super) struct SceneStudy<'a> {
    pub scene: &'a Scene,
    pub sensor: &'a Sensor,
    pub effort: &'a Effort,
    pub engines: &'a mut Engines,
    /// Paths that could not be measured, and why. One impossible path must not end the study of the others.
    pub not_measured: Vec<String>,
}

/// The reference image at one pose.
pub(super) struct Truth {
    pub plan: FramePlan,
    pub images: Images,
}

/// A path to an image while it is measured.
struct ImagePath {
    path: Path,
    view: StudyView,
    world: World,
    errors: ImageErrors,
}

impl SceneStudy<'_> {
    pub fn run(&mut self, progress: Progress<'_>) -> Result<Finding> {
        // The step comes first, because long lines can be cut.
        let place = self.place();
        progress(&format!("the truth: {place}"));
        let truths = self.scene.poses.iter().map(|pose| self.truth(pose)).collect::<Result<Vec<_>>>()?;
        let (mut rows, mut notes) = (Vec::new(), Vec::new());
        self.images(&truths, &mut rows, &mut notes, progress)?;
        progress(&format!("features: {place}"));
        let features = features::rows(self, &truths, &mut rows, &mut notes, progress)?;
        let not_measured = std::mem::take(&mut self.not_measured);
        pareto::mark(&mut rows);
        let (scene, sensor) = (self.scene.name.clone(), self.sensor.spec().name.clone());
        let seen_share = seen_share(&truths);
        Ok(Finding {
            size: (self.sensor.width(), self.sensor.height()),
            advice: advice::of(&scene, &sensor, seen_share, features, &rows),
            scene,
            sensor,
            seen_share,
            features,
            rows,
            notes,
            not_measured,
            preview: png::preview_png(&truths[0].images, self.sensor, Output::Range)?,
        })
    }

    /// Records that a path cannot be measured.
    pub fn leave_out(&mut self, path: &PathName, why: &Error) {
        self.not_measured.push(format!("{}, {}: {why}", path.engine, path.variant));
    }

    fn place(&self) -> String {
        format!("{}, {}", self.sensor.spec().name, self.scene.name)
    }

    fn truth(&self, pose: &Pose) -> Result<Truth> {
        let plan = FramePlan::new(&self.scene.world, self.sensor, pose, request())?;
        let mut images = Images::default();
        reference::render(&plan, &mut images)?;
        Ok(Truth { plan, images })
    }

    /// Compares the images of all paths with the truth, and times them.
    fn images(
        &mut self,
        truths: &[Truth],
        rows: &mut Vec<Row>,
        notes: &mut Vec<PathNotes>,
        progress: Progress<'_>,
    ) -> Result<()> {
        let mut all = Vec::new();
        for path in Path::all(self.engines.has_gpu()) {
            let view = match path.view.of(self.sensor) {
                Ok(Some(view)) => view,
                Ok(None) => continue,
                Err(e) => {
                    let named = path.named(self.engines, self.sensor);
                    self.leave_out(&named, &e);
                    continue;
                }
            };
            let world = match path.index {
                Some(scheme) => self.scene.world.reindexed(&scheme.tuned()),
                None => self.scene.world.clone(),
            };
            let missing_share = view.missing_share(self.sensor);
            let errors = ImageErrors::of_all_but(missing_share);
            all.push(TimedPath::new(ImagePath { path, view, world, errors }));
        }
        let place = self.place();
        // All timed runs reuse these buffers, as a careful user would.
        let mut images = Images::default();
        for (pose, truth) in self.scene.poses.iter().zip(truths) {
            for one in &mut all {
                let named = one.what.path.named(self.engines, self.sensor);
                progress(&format!("{}, {}: {place}", named.engine, named.variant));
                self.compare(one, pose, truth)?;
            }
            let draw = |one: &mut ImagePath| {
                let predictor = self.engines.predictor(one.path.which)?;
                predictor.predict_images(&one.world, &one.view.sensor, &SensorPose::new(*pose), request(), &mut images)
            };
            by_turns(self.effort, &mut all, draw, |round| progress(&format!("images by turns, {round}: {place}")))?;
        }
        for TimedPath { what, timing } in all {
            let named = what.path.named(self.engines, self.sensor);
            let template = self.row(&named, &timing);
            rows.extend(what.errors.kinds().into_iter().map(|(error_kind, error, bound)| Row {
                error_kind,
                error,
                bound,
                ..template.clone()
            }));
            notes.push(timing.notes(&named));
        }
        Ok(())
    }

    /// Makes the first run of a path at a pose, and compares its images with the truth.
    fn compare(
        &mut self,
        TimedPath { what, timing }: &mut TimedPath<ImagePath>,
        pose: &Pose,
        truth: &Truth,
    ) -> Result<()> {
        let (view, mut images) = (&what.view, Images::default());
        let predictor = self.engines.predictor(what.path.which)?;
        timing.warm(|| {
            predictor.predict_images(&what.world, &view.sensor, &SensorPose::new(*pose), request(), &mut images)
        })?;
        let (truth_images, shown) = view.beside(&truth.images, &images);
        // A part of the image is compared using its own sensor, to which its pixels belong.
        let own = (!view.whole).then(|| FramePlan::new(&self.scene.world, &view.judge, pose, request())).transpose()?;
        let plan = own.as_ref().unwrap_or(&truth.plan);
        let exact = view.exact.then_some(what.path.precision());
        what.errors.add(&errors::compare_images(&truth_images, &shown, plan, exact)?);
        Ok(())
    }

    /// A row without an error.
    pub fn row(&self, named: &PathName, timing: &Timing) -> Row {
        Row {
            scene: self.scene.name.clone(),
            sensor: self.sensor.spec().name.clone(),
            engine: named.engine.to_owned(),
            variant: named.variant.clone(),
            error_kind: "",
            error: 0.0,
            bound: None,
            median_ms: timing.median(),
            quartiles_ms: timing.quartiles(),
            p95_ms: timing.p95(),
            pareto: false,
            runs: timing.runs(),
            default: named.default,
            turns_ms: timing.turns(),
            errors: Vec::new(),
            how: named.how.clone(),
            family: named.family.clone(),
            label: named.label.clone(),
        }
    }
}

/// The fraction of pixels that show a polygon.
fn seen_share(truths: &[Truth]) -> f64 {
    let ids = || truths.iter().flat_map(|t| &t.images.polygon_id);
    ids().filter(|id| **id != 0).count() as f64 / ids().count().max(1) as f64
}
