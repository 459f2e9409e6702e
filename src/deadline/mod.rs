//! Deadlines: a prediction that has to be there in time, and what it gives up for that (paper section 3.3).
//!
//! Polygons are drawn nearest first. Whenever the drawing stops, the image is therefore exact up to a known range: to the nearest
//! polygon that was not drawn. Samples nearer than that are final; all others are left open. That keeps a deadline without
//! any estimate. Estimates only save work that would be in vain:
//!
//! | means | when | what it gives up |
//! |---|---|---|
//! | [`DegradationKind::Radius`] | after selection, when even a low estimate of the time is too long | what is farther away than a radius |
//! | [`DegradationKind::Clock`] | between batches of polygons, when what is left of the time is needed for the images | what was not drawn |
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

pub use clock::{Clock, SystemClock, Watch};

use serde::{Deserialize, Serialize};

/// How time was saved.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DegradationKind {
    /// What is farther away than a radius was not asked for.
    Radius,
    /// The drawing stopped when the time was up.
    Clock,
}

/// A means that was taken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DegradationStep {
    /// Which.
    pub means: DegradationKind,
    /// Milliseconds after the call.
    pub at_ms: f64,
    /// Metres: what is farther away was not asked for or, where the drawing stopped, is not known in some part of the image.
    pub metres: f64,
}

/// What a prediction gave up to be there in time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Degradation {
    /// Metres: every sample nearer than this is there. Beyond it some are not.
    pub complete_to: f64,
    /// Samples that were given up: they are NaN with id 0 although the sensor has a ray there.
    pub samples: u64,
    /// The means that were taken, in order.
    pub means: Vec<DegradationStep>,
}

impl Degradation {
    /// One line, for people.
    pub fn summary(&self) -> String {
        let by = |m: &DegradationStep| match m.means {
            DegradationKind::Radius => format!("after {:.2} ms the radius was cut to {:.2} m", m.at_ms, m.metres),
            DegradationKind::Clock => format!("after {:.2} ms the drawing stopped", m.at_ms),
        };
        let means: Vec<String> = self.means.iter().map(by).collect();
        format!("{} samples given up, complete to {:.3} m: {}", self.samples, self.complete_to, means.join(", "))
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
    /// When drawing had ended and only images were left to make, milliseconds from the call on.
    pub drawn_ms: f64,
    /// What was given up; `None` if everything is there.
    pub given_up: Option<Degradation>,
}
