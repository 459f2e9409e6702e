//! History: features followed from frame to frame, and detections matched to them.
//!
//! ```
//! use glam::{DMat2, DVec2};
//! use presight::history::{Detection, ExpectedProperties, ImageExtent, Seed, Shape, Tracker, TrackerOptions};
//!
//! let mut tracker = Tracker::new(TrackerOptions::new(ImageExtent::new(640, 480)))?;
//! let at = |time: f64| DVec2::new(100.0 + 80.0 * time, 200.0);
//! let seed = Seed {
//!     id: 1,
//!     shape: Shape::Point(at(0.0)),
//!     covariances: vec![DMat2::IDENTITY],
//!     properties: ExpectedProperties::default(),
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
#![doc = include_str!("../docs/history.md")]

#[doc(inline)]
pub use presight_localize::history::{
    End, ImageExtent, Match, MatchOutcome, Seed, Track, Tracker, TrackerOptions, Window,
};
#[doc(inline)]
pub use presight_localize::matching::{Detection, DetectionProperties, ExpectedProperties, Matcher, Shape};
