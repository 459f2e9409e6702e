//! Which detection belongs to which expected feature: gates, costs, and an assignment that is globally optimal.
//!
//! 1. [`Matcher::candidates`] pairs each expected feature with the detections that may be it: near enough by Mahalanobis
//!    distance, and alike in the properties that both sides know.
//! 2. `assign` picks the pairs with the least total cost, each feature and each detection once. Not being seen has a cost, too.
//!
//! The cost of a pair is the negative logarithm of a likelihood ratio: the detection is the feature, against the detection
//! is clutter, spread evenly over the image (and over the range of each property). Costs of pairs with other numbers of
//! dimensions are therefore comparable. With innovation n of covariance S, probability of detection `P_D`, and the density c of
//! clutter over all dimensions:
//!
//! ```text
//! cost of a pair       = 1/2 n' S^-1 n + 1/2 ln det(2 pi S) + ln c - ln P_D
//! cost of not being seen = -ln(1 - P_D)
//! ```
//!
//! (Y. Bar-Shalom, X. R. Li, Multitarget-Multisensor Tracking, 1995, section 6.3; the assignment after H. W. Kuhn 1955 and J. Munkres
//! 1957.)

mod assign;
mod bins;
mod detection;
mod distance;
mod matcher;

pub use assign::{Assignment, CandidatePair, MAX_GROUP_WORK, assign};
pub use detection::{Detection, DetectionProperties, ExpectedProperties, Marker, Rejection, Shape, UncertainValue};
pub use distance::{Aligned, align, floored, turn_apart, unwrap};
pub use distance::{Distance, chi_squared_quantile};
pub use matcher::{Candidates, ExpectedFeature, MAX_CANDIDATES, Matcher, PropertyNoise};
