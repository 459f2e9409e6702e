//! Keeps a model up to date: differences between prediction and measurement become evidence, and evidence becomes
//! changes.
//!
//! Use it through the crate `presight`, which gives the same names.

mod change;
mod decide;
mod evidence;
mod learner;
mod observe;
mod options;

pub use change::pending::{Applied, PendingChanges};
pub use change::refine::RefinedPose;
pub use decide::boxes::UprightBox;
pub use decide::findings::{BestView, DoubtfulObject, Finding, FindingKind, PlannedView, SiteFindings};
pub use decide::policy::{Action, Policy};
pub use decide::program::ProgramRecognizer;
pub use decide::recognize::{Proposal, Recognizer};
pub use decide::shapes::{Library, LibraryShape, Recognized};
pub use evidence::objects::Evidence;
pub use evidence::voxels::{OccupancyThreshold, Voxel, Voxels};
pub use learner::{Learner, Tally};
pub use options::LearnOptions;
