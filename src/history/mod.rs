//! history
mod adapt;
mod alternating;
mod common;
mod health;
mod motion;
mod options;
mod seed;
mod track;
mod tracker;
mod window;

pub use alternating::{Alternating, Frame, Source};
pub use health::{Health, Want};
pub use options::{ImageExtent, TrackerOptions};
pub use seed::view;
pub use track::{Seed, Track};
pub use tracker::{End, MAX_DETECTIONS, MAX_TRACKS, Match, Matches, Seeded, Tracker, Window};
