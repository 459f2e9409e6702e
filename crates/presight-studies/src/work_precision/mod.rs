//! Error against run time of every path from a scene to an image, and of every setting that trades error for run time.
//!
//! | truth | used for |
//! |---|---|
//! | images of the reference engine | ids, ranges, silhouettes |
//! | a ray to every sample of every feature | visible fractions |
//! | projected random samples of the errors of pose and feature | how often a region of interest misses its feature |
//!
//! `path` lists the paths, and `how` describes their flags. `errors` compares images, `features` features, and
//! `regions` regions of interest. `timing` measures times, and `advice` recommends paths. `approximations`
//! measures the cost of predicting a lidar as a simpler one.

mod advice;
mod approximations;
mod engines;
mod errors;
mod features;
mod how;
mod one;
mod pareto;
mod path;
mod regions;
mod results;
mod setup;
mod show;
mod study;
mod tables;
mod timing;
mod views;

pub use approximations::{Approximation, ApproximationCost, LIDARS, approximations_to_csv, is_approximated};
pub use results::{Finding, Findings, PathNotes, Row, StageTime};
pub use setup::{Effort, Scene};
pub use show::{to_csv, to_html, to_json};
pub use study::{Study, fisheye};
