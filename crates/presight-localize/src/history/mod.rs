//! History-based prediction (paper section 3.4): predicts where features will be in the next image from where they
//! were.
//!
//! Between two frames most features move little. A [`Tracker`] filters the motion of each feature in the image and
//! returns a small [`Window`] in which to search for it in the next frame. This takes a fraction of the time of a full
//! prediction and needs no world and no engine. Full predictions seed the tracker ([`Seed::of_prediction`]), and the
//! detections in the windows ([`crate::matching::Detection`]) correct it.
//!
//! | step | effect |
//! |---|---|
//! | [`Tracker::seed`] | starts tracks from a full prediction and ends the tracks of other features |
//! | [`Tracker::predict`] | returns windows that hold each feature with the stated probability |
//! | [`Tracker::correct`] | matches detections to tracks, corrects them, and drops tracks missed three times in a row |
//!
//! `docs/history.md` has the mathematics.

mod filter;
mod options;
mod seed;
mod track;
mod tracker;
mod window;

pub use options::{ImageExtent, TrackerOptions};
pub use seed::Seed;
pub use track::Track;
pub use tracker::{End, Match, MatchOutcome, Tracker};
pub use window::Window;
