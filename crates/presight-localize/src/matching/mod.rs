//! Matches detections to expected features by gates, costs and a globally optimal assignment.
//!
//! 1. [`Matcher::candidates`] pairs each expected feature with the detections within its gate: near enough by
//!    Mahalanobis distance, and similar in the properties that both sides know.
//! 2. `assign` picks the pairs with the lowest total cost. It uses each feature and each detection once. A feature
//!    without a detection also has a cost.
//!
//! The cost of a pair is the negative logarithm of a likelihood ratio. It compares "the detection is the feature" with
//! "the detection is clutter", where clutter is uniform over the image and over the range of each property. Costs of
//! pairs with different numbers of dimensions are therefore comparable. With innovation n of covariance S, probability
//! of detection `P_D`, and the density c of clutter over all dimensions:
//!
//! ```text
//! cost of a pair       = 1/2 n' S^-1 n + 1/2 ln det(2 pi S) + ln c - ln P_D
//! cost of not being seen = -ln(1 - P_D)
//! ```
//!
//! (Y. Bar-Shalom, X. R. Li, Multitarget-Multisensor Tracking, 1995, section 6.3; the assignment follows H. W. Kuhn
//! 1955 and J. Munkres 1957.)

mod assign;
mod bins;
mod detection;
mod distance;
mod matcher;

pub use assign::{Assignment, CandidatePair, MAX_GROUP_WORK, assign};
pub(crate) use detection::MAX_OUTLINE;
pub use detection::{
    Detection, DetectionProperties, ExpectedFeature, ExpectedProperties, Marker, Rejection, Shape, UncertainValue,
};
pub(crate) use distance::{aligned, floored, unwrap};
pub use matcher::{Candidates, MAX_CANDIDATES, Matcher, PropertyNoise};
