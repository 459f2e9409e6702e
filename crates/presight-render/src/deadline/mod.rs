//! Deadlines: a prediction that has to be there in time, and what it gives up for that (paper section 3.3).
//!
//! Polygons are drawn nearest first. Whenever the drawing stops, the image is therefore exact up to a known range: to the nearest
//! polygon that was not drawn. Samples nearer than that are final; all others are left open. That keeps a deadline without
//! any estimate. Estimates only save work that would be in vain:
//!
//! | means | when | what it gives up |
//! |---|---|---|
//! | [`DegradationKind::Radius`] | after selection, when even a low estimate of the time is too long | what is farther away than a radius |
//! | [`DegradationKind::Angle`] | then, when even the least radius is too much | what is off a heading |
//! | [`DegradationKind::Stride`] | after the setup of the first wave, when thinning leaves more samples than stopping in time | all but every k-th column and row |
//! | [`DegradationKind::Clock`] | between batches of polygons, when what is left of the time is needed for what follows | what was not drawn |
//! | [`DegradationKind::Features`] | between features, when the next ones do not fit | features with the least image length |
//!
//! A sample that was given up is NaN with id 0, never `+inf`. [`Degradation`] says what was given up; without it NaN means that there
//! is no ray. [`crate::ErrorKind::Deadline`] is the answer where not even an image of nothing can be made in time. `docs/deadline.md`
//! has the details and what was measured.
//!
//! ```
//! use presight::{Backend, Environment, ErrorKind, Options, Pose, Predictor, Request, World};
//! use std::time::Duration;
//! let world = World::new(Environment::new());
//! let sensor = presight::preset("laser-scanner")?;
//! let mut predictor = Predictor::new(Options::new(Backend::Cpu).with_threads(1))?;
//! let within = |time| Request::default().with_deadline(time);
//! let seen = predictor.predict(&world, &sensor, &Pose::IDENTITY, &within(Duration::from_secs(10)))?;
//! assert_eq!(seen.degradation(), None);
//! let impossible = predictor.predict(&world, &sensor, &Pose::IDENTITY, &within(Duration::from_nanos(1)));
//! assert_eq!(impossible.unwrap_err().kind(), ErrorKind::Deadline);
//! # Ok::<(), presight::Error>(())
//! ```

mod clock;
mod priority;

pub use clock::{Clock, SystemClock, Watch};
pub use priority::Priority;

use serde::{Deserialize, Deserializer, Serialize};

/// An engine that keeps deadlines; what frames cost is learnt for each.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeadlineEngine {
    /// `cpu` or `gpu`.
    pub name: &'static str,
    /// Adapter and driver of the GPU engine.
    pub adapter: Option<String>,
    /// CPU threads.
    pub threads: usize,
    /// It draws parts of images with the bits of the whole ones, so that the angle may shrink.
    pub draws_parts: bool,
}

/// How time was saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DegradationKind {
    /// What is farther away than a radius was not asked for.
    Radius,
    /// What is off a heading was not asked for.
    Angle,
    /// Only every k-th column and row was drawn.
    Stride,
    /// The drawing stopped when the time was up.
    Clock,
    /// Some features were not asked for.
    Features,
}

/// A means that was taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DegradationStep {
    /// Which.
    pub means: DegradationKind,
    /// Milliseconds after the call.
    pub at_ms: f64,
    /// Metres: what is farther away was not asked for or, where the drawing stopped, is not known in some part of the image.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub metres: Option<f64>,
}

/// The columns of an image that were asked for, seen from above.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opening {
    /// Degrees from the sensor's forward axis to the middle of these columns, counter-clockwise.
    pub heading_deg: f64,
    /// Degrees from the first of these columns to the last.
    pub opening_deg: f64,
}

/// What a prediction gave up to be there in time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Degradation {
    /// Metres: every sample nearer than this is there, of the columns and rows that `stride` and `opening` leave. Beyond it some
    /// are not. Infinite, which files show as null, if all of those are there.
    #[serde(deserialize_with = "infinite_if_null")]
    pub complete_to: f64,
    /// Samples that were given up: they are NaN with id 0 although the sensor has a ray there.
    pub samples: u64,
    /// Only columns and rows whose numbers are multiples of this were drawn; 1 is all of them.
    #[serde(default = "every")]
    pub stride: u32,
    /// The columns that were asked for, unless it were all.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub opening: Option<Opening>,
    /// Rising numbers of the features that were not asked for.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub features: Vec<u32>,
    /// The means that were taken, in order.
    pub means: Vec<DegradationStep>,
}

fn every() -> u32 {
    1
}

fn infinite_if_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}

/// Nothing given up yet: complete to infinity.
impl Default for Degradation {
    fn default() -> Self {
        Self {
            complete_to: f64::INFINITY,
            samples: 0,
            stride: 1,
            opening: None,
            features: Vec::new(),
            means: Vec::new(),
        }
    }
}

impl Degradation {
    /// Metres: every sample of the whole image nearer than this is there. That is 0 where columns and rows were left out.
    pub fn complete_everywhere_to(&self) -> f64 {
        if self.stride > 1 || self.opening.is_some() { 0.0 } else { self.complete_to }
    }

    /// One line, for people.
    pub fn summary(&self) -> String {
        let means: Vec<String> = self.means.iter().map(|m| self.in_words(m)).collect();
        let (samples, complete_to) = (self.samples, self.complete_to);
        let images = match complete_to.is_finite() {
            true => format!("{samples} samples given up, complete to {complete_to:.3} m"),
            false => format!("{samples} samples given up"),
        };
        format!("{images}: {}", means.join(", "))
    }

    /// A means that was taken.
    fn in_words(&self, taken: &DegradationStep) -> String {
        let done = match (taken.means, self.opening) {
            (DegradationKind::Radius, _) => format!("the radius was cut to {:.2} m", taken.metres.unwrap_or(f64::NAN)),
            (DegradationKind::Angle, Some(Opening { heading_deg, opening_deg })) => {
                format!("the image was narrowed to {opening_deg:.1} degrees around {heading_deg:.1}")
            }
            (DegradationKind::Angle, None) => "the image was narrowed".to_owned(),
            (DegradationKind::Stride, _) => {
                format!("only one in {} columns and rows was drawn from then on", self.stride)
            }
            (DegradationKind::Clock, _) => "the drawing stopped".to_owned(),
            (DegradationKind::Features, _) => format!("{} features were left out", self.features.len()),
        };
        format!("after {:.2} ms {done}", taken.at_ms)
    }

    /// Sentences for people: what was given up of an image of so many pixels, and why.
    pub fn explanation(&self, pixels: u64) -> Vec<String> {
        let mut lines = Vec::new();
        if self.samples > 0 {
            let share = 100.0 * self.samples as f64 / pixels.max(1) as f64;
            lines.push(format!("{} of {pixels} samples ({share:.0} %) are not predicted", self.samples));
            let of = if self.complete_everywhere_to() == self.complete_to { "Every sample" } else { "Every one drawn" };
            if self.complete_to.is_finite() {
                lines.push(format!("{of} nearer than {:.3} m is there", self.complete_to));
            }
        }
        lines.extend(self.means.iter().map(|taken| {
            let why = match taken.means {
                DegradationKind::Radius => "the costs learnt say that what is farther cannot be drawn in time",
                DegradationKind::Angle => "even the least radius takes too long",
                DegradationKind::Stride => "that leaves more samples than stopping in time",
                DegradationKind::Clock => "the time left was needed for what follows the drawing",
                DegradationKind::Features => "the time was up",
            };
            format!("{}: {why}", self.in_words(taken))
        }));
        if !self.features.is_empty() {
            const LISTED: usize = 20;
            let ids: Vec<String> = self.features.iter().take(LISTED).map(u32::to_string).collect();
            let more = if self.features.len() > LISTED { ", .." } else { "" };
            lines.push(format!("features that were not asked for: {}{more}", ids.join(", ")));
        }
        lines
    }
}

/// A deadline and how it was kept.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DeadlineOutcome {
    /// What was allowed, milliseconds from the call on.
    pub deadline_ms: f64,
    /// What it took.
    pub time_ms: f64,
    /// What it should have taken by the unit costs learnt before, from what was done.
    pub estimate_ms: f64,
    /// What it should have taken when the selection had ended, if anything had been learnt by then and nothing was given up.
    pub first_estimate_ms: Option<f64>,
    /// When drawing had ended and only images were left to make, milliseconds from the call on.
    pub drawn_ms: f64,
    /// When the images were there, milliseconds from the call on.
    pub images_ms: f64,
    /// The first wave of polygons, if it was drawn to its end.
    pub wave: Option<Wave>,
    /// What was given up; `None` if everything is there.
    pub given_up: Option<Degradation>,
}

/// The first wave of polygons: what its drawing should take by its setup, and what it took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Wave {
    /// Polygons that were set up.
    pub polygons: u64,
    /// Pixels in the boxes around their images: more samples are not tested.
    pub samples: u64,
    /// What the drawing should have taken by the unit costs learnt before; 0 if nothing had been learnt.
    pub estimate_ms: f64,
    /// What it took.
    pub time_ms: f64,
}
