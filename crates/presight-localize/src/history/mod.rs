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

mod adapt;
mod alternating;
mod border;
mod common;
mod health;
mod lend;
mod motion;
mod options;
mod outcome;
mod seed;
mod sightings;
mod track;
mod tracker;
mod unaided;
mod window;

pub use alternating::{AlternatingTracker, FrameWindows, PointProjection, Source};
pub use health::{Health, PredictionTrigger};
pub use options::{ImageExtent, TrackerOptions};
pub use outcome::{End, Match, MatchOutcome, SeedOutcome, Window};
pub use seed::view;
pub use track::{Seed, Track};
pub use tracker::{MAX_DETECTIONS, MAX_TRACKS, Tracker};
