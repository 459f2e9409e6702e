//! Deadlines: a prediction that must finish in time, and the parts that it gives up for that (paper section 3.3).
//!
//! Polygons are drawn nearest first. Whenever drawing stops, the image is therefore exact up to a known range, the
//! distance of the nearest undrawn polygon. Nearer samples are final; all others are marked as given up. This keeps a
//! deadline without any estimate. Estimates only avoid useless work:
//!
//! - [`DegradationKind::Radius`], after selection, if even a low estimate of the time is too long: surfaces beyond a
//!   radius
//! - [`DegradationKind::Angle`], then, if even the minimum radius is too much: columns away from a heading
//! - [`DegradationKind::Stride`], after the setup of the first wave, if thinning keeps more samples than stopping
//!   early: all but every k-th column and row
//! - [`DegradationKind::Clock`], between batches of polygons, when the time left is needed for the later steps:
//!   surfaces not drawn yet
//! - [`DegradationKind::Features`], between features, if the next ones do not fit: features with the least image length
//!
//! A sample that was given up is NaN with id 0, never `+inf`. [`Degradation`] lists the losses; without it, NaN means
//! that the pixel has no ray. [`presight_model::ErrorKind::Deadline`] means that not even an empty image can be made in
//! time. `docs/deadline.md` has details and measurements.

mod clock;
mod priority;

pub use clock::{Clock, SystemClock, Watch};
pub use priority::Priority;

use presight_model::limits::LISTED_PROBLEMS;
use serde::{Deserialize, Deserializer, Serialize};
use std::time::Duration;

/// Ratio of the time left to the expected time above which the image is not thinned, and a wave is drawn without
/// reading the clock.
pub(crate) const PLENTY: f64 = 8.0;

/// An engine that supports deadlines, as the key for learnt costs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DeadlineEngine {
    /// `cpu` or `gpu`.
    pub name: &'static str,
    /// Adapter and driver of the GPU engine.
    pub adapter: Option<String>,
    /// CPU threads.
    pub threads: usize,
    /// True if it draws parts of images bit-equal to whole images, so that the angle may shrink.
    pub draws_parts: bool,
}

/// A way of saving time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DegradationKind {
    /// Surfaces beyond a radius were not drawn.
    Radius,
    /// Columns away from a heading were not drawn.
    Angle,
    /// Only every k-th column and row was drawn.
    Stride,
    /// Drawing stopped because the time was up.
    Clock,
    /// Some features were left out.
    Features,
}

/// A way of saving time that was used.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DegradationStep {
    /// The kind.
    pub means: DegradationKind,
    /// Milliseconds after the call.
    pub at_ms: f64,
    /// Metres. Radius: surfaces beyond it were left out. Clock: surfaces beyond it may be missing somewhere.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub metres: Option<f64>,
}

/// The drawn columns of an image, seen from above.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opening {
    /// Degrees from the sensor's forward axis to the middle of these columns, counter-clockwise.
    pub heading_deg: f64,
    /// Degrees from the first of these columns to the last.
    pub opening_deg: f64,
}

/// The parts that a prediction gave up to finish in time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Degradation {
    /// Metres: every sample nearer than this is present, among the columns and rows that `stride` and `opening` leave;
    /// beyond it some are missing. Infinite (null in files) if none of them is missing.
    #[serde(deserialize_with = "infinite_if_null")]
    pub complete_to: f64,
    /// Number of samples given up: NaN with id 0, although the sensor has a ray there.
    pub samples: u64,
    /// Only columns and rows at multiples of this number were drawn; 1 means all.
    #[serde(default = "every")]
    pub stride: u32,
    /// The drawn columns; `None` if all were drawn.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub opening: Option<Opening>,
    /// Ascending numbers of the features left out.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub features: Vec<u32>,
    /// The ways of saving time that were used, in order.
    pub means: Vec<DegradationStep>,
}

fn every() -> u32 {
    1
}

fn infinite_if_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}

/// Nothing given up: complete to infinity.
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
    /// Metres: every sample of the whole image nearer than this is present. 0 if columns or rows were left out.
    pub fn complete_everywhere_to(&self) -> f64 {
        if self.stride > 1 || self.opening.is_some() { 0.0 } else { self.complete_to }
    }

    /// A summary in one line.
    pub fn summary(&self) -> String {
        let means: Vec<String> = self.means.iter().map(|m| self.in_words(m)).collect();
        let (samples, complete_to) = (self.samples, self.complete_to);
        let images = match complete_to.is_finite() {
            true => format!("{samples} samples given up, complete to {complete_to:.3} m"),
            false => format!("{samples} samples given up"),
        };
        format!("{images}: {}", means.join(", "))
    }

    /// Describes a step.
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

    /// Explains in sentences which part of an image with this many pixels was given up, and why.
    pub fn explanation(&self, pixels: u64) -> Vec<String> {
        let mut lines = Vec::new();
        if self.samples > 0 {
            let share = 100.0 * self.samples as f64 / pixels.max(1) as f64;
            lines.push(format!("{} of {pixels} samples ({share:.0} %) are not predicted", self.samples));
            let of =
                if self.complete_everywhere_to() == self.complete_to { "Every sample" } else { "Every drawn sample" };
            if self.complete_to.is_finite() {
                lines.push(format!("{of} nearer than {:.3} m is present", self.complete_to));
            }
        }
        lines.extend(self.means.iter().map(|taken| {
            let why = match taken.means {
                DegradationKind::Radius => "by the learnt costs, farther surfaces cannot be drawn in time",
                DegradationKind::Angle => "even the least radius takes too long",
                DegradationKind::Stride => "this keeps more samples than stopping early",
                DegradationKind::Clock => "the time left was needed for the steps after drawing",
                DegradationKind::Features => "the time was up",
            };
            format!("{}: {why}", self.in_words(taken))
        }));
        if !self.features.is_empty() {
            let ids: Vec<String> = self.features.iter().take(LISTED_PROBLEMS).map(u32::to_string).collect();
            let more = if self.features.len() > LISTED_PROBLEMS { ", .." } else { "" };
            lines.push(format!("features left out: {}{more}", ids.join(", ")));
        }
        lines
    }
}

/// A deadline and how it was kept.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DeadlineOutcome {
    /// The deadline, milliseconds after the call.
    pub deadline_ms: f64,
    /// The actual time.
    pub time_ms: f64,
    /// Estimate for the work that was done, by the unit costs learnt before.
    pub estimate_ms: f64,
    /// Estimate at the end of selection; `None` if costs were unknown or something was given up.
    pub first_estimate_ms: Option<f64>,
    /// When drawing ended and only images were left to make, milliseconds after the call.
    pub drawn_ms: f64,
    /// When the images were finished, milliseconds after the call.
    pub images_ms: f64,
    /// The first wave of polygons, if it was finished.
    #[doc(hidden)]
    pub wave: Option<Wave>,
    /// The parts given up; `None` if the prediction is complete.
    pub given_up: Option<Degradation>,
}

impl DeadlineOutcome {
    /// The outcome of a drawing that ended this long after the call.
    pub(crate) fn drawn(after: Duration, given_up: Option<Degradation>) -> Self {
        Self { drawn_ms: 1e3 * after.as_secs_f64(), given_up, ..Self::default() }
    }
}

/// The first wave of polygons: estimated and actual time of its drawing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Wave {
    /// Number of polygons set up.
    pub polygons: u64,
    /// Pixels in the bounding boxes of the polygons: an upper bound of the samples tested.
    pub samples: u64,
    /// Estimate of the drawing time by learnt unit costs; 0 without any.
    pub estimate_ms: f64,
    /// The actual time of the drawing.
    pub time_ms: f64,
}
