//! A family, its cases and its findings.

use crate::stability::subjects::Subject;
use presight_model::error::Result;
use presight_model::geometry::Pose;
use presight_model::sensor::Sensor;
use presight_model::world::World;

presight_model::words! {
    /// The outcome of a case.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
    #[serde(rename_all = "lowercase")]
    pub enum Outcome {
        /// Correct, with the error within its bound.
        Ok = "ok",
        /// Refused with a typed error before any prediction.
        Rejected = "rejected",
        /// Wrong, or with the error beyond its bound.
        Fault = "fault",
    }
}

/// The result of one engine at one difficulty.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// The engine; `all` for a case refused on input, `sensor` for rays that all engines share.
    pub engine: String,
    /// The largest error, in the family's unit.
    pub error: f64,
    /// The product's published bound; infinite if it has none.
    pub bound: f64,
    /// The outcome.
    pub outcome: Outcome,
    /// Pixels that differ from the truth in their polygon, or in hitting one at all, as the bounds allow: at an
    /// outline, or where the true polygon was left out as edge-on.
    pub other: usize,
    /// Polygons that the engine left out as edge-on, summed over images.
    pub edge_on: usize,
    /// Description of the fault or error, or other notes; may be empty.
    pub note: String,
}

impl Finding {
    /// The finding of a refused case.
    pub fn rejected(error: &presight_model::error::Error) -> Self {
        let note = error.to_string();
        let (engine, outcome) = ("all".into(), Outcome::Rejected);
        Self { engine, error: f64::NAN, bound: f64::NAN, outcome, other: 0, edge_on: 0, note }
    }

    /// A finding from an error and its bound.
    pub fn of(engine: impl Into<String>, error: f64, bound: f64) -> Self {
        let ok = error <= bound;
        let note = if ok { String::new() } else { format!("the error {error:e} exceeds the bound {bound:e}") };
        let outcome = if ok { Outcome::Ok } else { Outcome::Fault };
        Self { engine: engine.into(), error, bound, outcome, other: 0, edge_on: 0, note }
    }
}

/// Cases of one increasing difficulty.
pub trait Family {
    /// The name in files.
    fn name(&self) -> &'static str;

    /// One sentence about the difficulty and the measured error.
    fn about(&self) -> &'static str;

    /// Label of the difficulty, with its unit.
    fn axis(&self) -> &'static str;

    /// Label of the error, with its unit.
    fn error(&self) -> &'static str {
        "relative error of the range"
    }

    /// The difficulties, easiest first; fewer for a quick study.
    fn difficulties(&self, quick: bool) -> Vec<f64>;

    /// Measures every engine at one difficulty. A case that is refused on input is a finding, not an error.
    ///
    /// # Errors
    /// Engine failures.
    fn measure(&self, difficulty: f64, quick: bool, subjects: &mut [Subject]) -> Result<Vec<Finding>>;
}

/// One scene with one sensor.
#[derive(Clone, Debug)]
pub struct Case {
    /// The world; all its polygons are opaque and two-sided.
    pub world: World,
    /// The sensor, without range limits.
    pub sensor: Sensor,
    /// Pose of the sensor, body axes.
    pub pose: Pose,
}

/// Powers of ten from one exponent to another; for a quick study every third and the last.
pub(super) fn powers(from: i32, to: i32, quick: bool) -> Vec<f64> {
    let step = if quick { 3 } else { 1 };
    let mut all: Vec<i32> = (0..(to - from).abs()).step_by(step).map(|k| from + k * (to - from).signum()).collect();
    all.push(to);
    all.into_iter().map(|e| 10f64.powi(e)).collect()
}
