//! History-based prediction (paper section 3.4): predicts the positions of features from earlier ones.
//!
//! Between two frames most features move little. A [`Tracker`] follows each feature in the image and returns a small
//! [`Window`] in which to look for it in the next frame. This takes a fraction of the time of a full prediction and
//! needs no world and no engine. Full predictions seed the tracker ([`Seed::of_prediction`]), and the detections in the
//! windows ([`crate::matching::Detection`]) correct it.
//!
//! | step | what it does |
//! |---|---|
//! | [`Tracker::seed`] | starts tracks from a full prediction and ends tracks that the prediction does not show |
//! | [`Tracker::set_view`] | optional: sets the next sensor pose, so that its optical flow is removed |
//! | [`Tracker::predict`] | returns windows that hold each feature with the stated probability |
//! | [`Tracker::correct`] | matches detections to tracks, corrects tracks, drops tracks missed three times in a row |
//! | [`Tracker::health`] | reports whether a full prediction is needed, and why |
//!
//! [`AlternatingTracker`] runs all these steps. `docs/history.md` has the mathematics and the measurements.
//!
//! ```
//! use glam::{DMat2, DVec2};
//! use presight::history::{ImageExtent, Seed, Tracker, TrackerOptions};
//! use presight::matching::{Detection, ExpectedProperties, Shape};
//!
//! let mut tracker = Tracker::new(TrackerOptions::new(ImageExtent::new(640, 480)))?;
//! let at = |time: f64| DVec2::new(100.0 + 80.0 * time, 200.0);
//! let seed = Seed {
//!     id: 1,
//!     shape: Shape::Point(at(0.0)),
//!     covariances: vec![DMat2::IDENTITY],
//!     properties: ExpectedProperties::default(),
//!     points_world: Vec::new(),
//! };
//! tracker.seed(0.0, vec![seed])?;
//! let mut areas = Vec::new();
//! for k in 0..20 {
//!     let time = 0.05 * f64::from(k);
//!     let [x0, y0, x1, y1] = tracker.predict(time)?[0].bounds;
//!     areas.push((x1 - x0) * (y1 - y0));
//!     tracker.correct(time, &[Detection::point(at(time), 0.5)])?;
//! }
//! // The speed was unknown at first.
//! assert!(areas[19] < 0.1 * areas[1]);
//! let speed = tracker.tracks()[0].speeds().next().expect("a point has one");
//! assert!((speed - DVec2::new(80.0, 0.0)).length() < 1.0);
//! # Ok::<(), presight::Error>(())
//! ```

mod adapt;
mod alternating;
mod border;
mod common;
mod health;
mod motion;
mod options;
mod outcome;
mod seed;
mod sightings;
mod track;
mod tracker;
mod window;

pub use alternating::{AlternatingTracker, FrameWindows, PointProjection, Source};
pub use health::{Health, PredictionTrigger};
pub use options::{ImageExtent, TrackerOptions};
pub use outcome::{End, Match, MatchOutcome, SeedOutcome, Window};
pub use seed::view;
pub use track::{Seed, Track};
pub use tracker::{MAX_DETECTIONS, MAX_TRACKS, Tracker};
