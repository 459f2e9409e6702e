//! Differences between site and model, from the frames of a drive.

use super::errors::{Failed, apart, usage};
use super::measured::{Frame, Step};
use super::process::Shared;
use super::scene::Scene;
use presight::environment::Environment;
use presight::tools::{create_folder, write_atomically};
use presight::update::{LearnOptions, Learner as Ours, Policy, SiteFindings};
use presight::{Error, World};
use pyo3::prelude::*;
use std::io::Write;
use std::path::PathBuf;

/// Learns what differs between a site and its model, as `presight update` does: objects that are gone, moved or new.
///
/// `model_sigma` is the standard deviation of the model's surfaces, metres. The scene's version at the start is used.
///
/// >>> import presight
/// >>> room, start = presight.Scene.example(), [1, 1.5, 0.5, 0, 0, 0]
/// >>> scanner = presight.Sensor.load("laser-scanner").replace(range_sigma=0.01)
/// >>> localizer, learner = presight.Localizer(room, init=start), presight.Learner(room)
/// >>> frame = presight.Frame(scanner, 0.0, presight.predict(room, scanner, start).range)
/// >>> learner.observe(localizer.step(frame), frame)
/// >>> learner.findings()
/// []
#[pyclass(frozen, module = "presight")]
pub struct Learner {
    world: World,
    /// Names the version of the model: ids of changes begin with it.
    version: String,
    options: LearnOptions,
    learner: Shared<Ours>,
}

impl Learner {
    fn with<R>(&self, work: impl FnOnce(&mut Ours) -> Result<R, Failed>) -> Result<R, Failed> {
        self.learner.with(|| Ours::new(self.options), work)
    }

    /// The findings so far, with the environment that they are about.
    pub fn found(&self) -> Result<(SiteFindings, &Environment), Failed> {
        let findings = self.with(|learner| Ok(learner.findings(&self.world)))?;
        Ok((findings, self.world.environment()))
    }
}

#[pymethods]
impl Learner {
    #[new]
    #[pyo3(signature = (scene, model_sigma = 0.0))]
    fn new(py: Python<'_>, scene: &Bound<'_, Scene>, model_sigma: f64) -> PyResult<Self> {
        if !(model_sigma >= 0.0 && model_sigma.is_finite()) {
            return Err(usage(py, "model_sigma", format!("{model_sigma}"), "give finite metres of at least 0"));
        }
        let scene = scene.get();
        apart(py, || {
            let seen = scene.seen();
            let is_store = seen.path.extension().is_some_and(|e| e.eq_ignore_ascii_case("presight"));
            let version = match is_store {
                true => presight::store::info(&seen.path)?.head,
                false => seen.world.environment().content_hash().to_string(),
            };
            let version = version.chars().take(12).collect();
            let options = LearnOptions::default().with_model_sigma(model_sigma);
            Ok(Self { world: seen.world, version, options, learner: Shared::new() })
        })
    }

    /// Takes in a frame and the localizer's step of it. Raises `Error` if they are of different times.
    fn observe(&self, py: Python<'_>, step: &Bound<'_, Step>, frame: &Bound<'_, Frame>) -> PyResult<()> {
        let (step, frame) = (&step.get().0, &frame.get().0);
        if step.stamp != frame.stamp {
            let what = format!("the step is of {} s, the frame of {} s", step.stamp, frame.stamp);
            return Err(usage(py, "frame", what, "give the frame of the step"));
        }
        apart(py, || self.with(|learner| Ok(learner.observe(&self.world, step, &[&*step.moving(frame)])?)))
    }

    /// Ends a drive: its last views count now. Until then they wait until the robot has driven on without getting lost.
    fn end_drive(&self, py: Python<'_>) -> PyResult<()> {
        apart(py, || {
            self.with(|learner| {
                learner.end_drive();
                Ok(())
            })
        })
    }

    /// The findings so far, a line each.
    fn findings(&self, py: Python<'_>) -> PyResult<Vec<String>> {
        apart(py, || Ok(self.found()?.0.changes.iter().map(ToString::to_string).collect()))
    }

    /// Writes `changes.jsonl`, which `presight env apply` reads, into a folder, and returns the number of changes. `time` is the UTC of
    /// stamp 0, seconds; stamps over 1e9 are UTC.
    #[pyo3(signature = (folder, time = 0.0))]
    fn write(&self, py: Python<'_>, folder: PathBuf, time: f64) -> PyResult<usize> {
        apart(py, || {
            let changes = self.with(|learner| {
                let findings = learner.findings(&self.world);
                Ok(learner.changes(&findings, &self.world, (&self.version, time), &Policy::parse("")?)?)
            })?;
            create_folder(&folder)?;
            let lines = changes.iter().map(|change| Ok(change.line()? + "\n")).collect::<Result<String, Error>>()?;
            write_atomically(&folder.join("changes.jsonl"), |file| file.write_all(lines.as_bytes()))?;
            Ok(changes.len())
        })
    }

    fn __repr__(&self) -> String {
        format!("<presight.Learner of {}>", self.version)
    }
}
