//! Detects features in measured images, either only where they are predicted or, with the same code, everywhere.
//!
//! | what | in | by |
//! |---|---|---|
//! | edges | grey images | [`edges_near`] |
//! | corners | grey images | [`corners_in`] |
//! | fiducials | grey images | `FiducialFinder` (feature `fiducials`) |
//! | depth edges | range images | [`jumps_near`] |
//! | reflectors | scans with intensities | [`reflectors_in`] |
//!
//! Each detection has the covariance of its measurement. [`find_features`] searches all edges, corners, fiducials and
//! reflectors of a prediction. [`classify`] decides which were matched and, from nearby ranges, why others were not.

mod classes;
mod corners;
mod edges;
#[cfg(all(test, feature = "fiducials"))]
mod fiducial_tests;
#[cfg(feature = "fiducials")]
mod fiducials;
mod findings;
mod jumps;
mod lines;
#[cfg(test)]
mod range_tests;
mod reflectors;
mod region;
mod tags;
#[cfg(test)]
mod tests;

pub use classes::{Classes, FeatureClass, classify, verdicts_along};
pub use corners::{CornerOptions, corners_in};
pub use edges::{EdgeOptions, ExpectedEdge, edges_near};
#[cfg(feature = "fiducials")]
pub use fiducials::FiducialFinder;
pub use findings::{FeatureFinding, FeatureFindings, FindOptions, MeasuredRanges, find_features};
pub use jumps::{JumpOptions, jumps_near};
pub use lines::FoundEdge;
pub use reflectors::{FoundReflector, ReflectorOptions, range_to, reflectors_in};
pub use region::PixelBox;
pub use tags::is_sought;
