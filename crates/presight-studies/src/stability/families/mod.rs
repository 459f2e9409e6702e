//! The families of cases, each along one growing difficulty.
//!
//! A family is anything that implements [`Family`]; [`all`] is the list. Most are scenes, of which a table in `scenes` holds
//! name, difficulty and a function that makes the cases; their judge is the same.

mod boxes;
mod lens;
mod scenes;
mod shapes;

use super::subjects::Subject;
use presight::Result;
use presight::World;
use presight::geometry::Pose;
use presight::sensor::Sensor;

/// How a case ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// Right, and the error within its bound.
    Ok,
    /// Refused with a typed error before anything was predicted.
    Rejected,
    /// Wrong, or the error beyond its bound.
    Fault,
}

impl Outcome {
    /// As in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Rejected => "rejected",
            Self::Fault => "fault",
        }
    }
}

/// What became of one engine at one difficulty.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// The engine; `all` for what was refused at the door, `sensor` for rays that all engines share.
    pub engine: String,
    /// The greatest error, in the family's unit.
    pub error: f64,
    /// The bound that the product publishes for it; infinite where it says that nothing is known.
    pub bound: f64,
    /// How it ended.
    pub outcome: Outcome,
    /// Pixels that show another polygon than the truth, or nothing where it shows one, and may: at an outline, or where the
    /// truth's polygon was left out as edge-on.
    pub other: usize,
    /// Polygons that the engine left out as edge-on, summed over images.
    pub edge_on: usize,
    /// The fault or the error's text, or what else there is to say; may be empty.
    pub note: String,
}

impl Finding {
    /// Of what was refused.
    pub fn rejected(error: &presight::Error) -> Self {
        let note = error.to_string();
        let (engine, outcome) = ("all".into(), Outcome::Rejected);
        Self { engine, error: f64::NAN, bound: f64::NAN, outcome, other: 0, edge_on: 0, note }
    }

    /// Of an error and its bound.
    pub fn of(engine: impl Into<String>, error: f64, bound: f64) -> Self {
        let ok = error <= bound;
        let note = if ok { String::new() } else { format!("off by {error:e}, the bound is {bound:e}") };
        let outcome = if ok { Outcome::Ok } else { Outcome::Fault };
        Self { engine: engine.into(), error, bound, outcome, other: 0, edge_on: 0, note }
    }
}

/// Cases along one growing difficulty.
pub trait Family {
    /// As files name it.
    fn name(&self) -> &'static str;

    /// One sentence: what grows, and what is measured.
    fn about(&self) -> &'static str;

    /// What the difficulty is, with its unit.
    fn axis(&self) -> &'static str;

    /// What the error is, with its unit.
    fn error(&self) -> &'static str {
        "relative error of the range"
    }

    /// The difficulties, easiest first; fewer for a quick study.
    fn difficulties(&self, quick: bool) -> Vec<f64>;

    /// Tries every engine at one difficulty. Errors at the door are findings, not errors.
    ///
    /// # Errors
    /// Those of an engine that breaks down.
    fn measure(&self, difficulty: f64, quick: bool, subjects: &mut [Subject]) -> Result<Vec<Finding>>;
}

/// One scene before one sensor.
#[derive(Clone, Debug)]
pub struct Case {
    /// Everything is opaque and seen from both sides.
    pub world: World,
    /// Without range limits.
    pub sensor: Sensor,
    /// Body axes.
    pub pose: Pose,
}

/// Every family.
pub fn all() -> Vec<Box<dyn Family>> {
    let mut all: Vec<Box<dyn Family>> = Vec::new();
    all.extend(scenes::SCENES.iter().map(|s| Box::new(*s) as Box<dyn Family>));
    all.extend([lens::Fold::INSIDE, lens::Fold::BEYOND].map(|f| Box::new(f) as Box<dyn Family>));
    all.extend(boxes::ALL.map(|b| Box::new(b) as Box<dyn Family>));
    all
}

/// Powers of ten from one exponent to another, each or, for a quick study, every third.
pub(super) fn powers(from: i32, to: i32, quick: bool) -> Vec<f64> {
    let step = if quick { 3 } else { 1 };
    let mut all: Vec<i32> = (0..(to - from).abs()).step_by(step).map(|k| from + k * (to - from).signum()).collect();
    all.push(to);
    all.into_iter().map(|e| 10f64.powi(e)).collect()
}
