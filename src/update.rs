//! What differs between prediction and measurement becomes evidence, and evidence becomes changes of the model.
#![doc = include_str!("../docs/update.md")]
#![doc = include_str!("../docs/minor-changes.md")]

#[doc(inline)]
pub use presight_update::{
    Action, Applied, BestView, DoubtfulObject, Evidence, Finding, FindingKind, LearnOptions, Learner, Library,
    LibraryShape, PendingChanges, PlannedView, Policy, ProgramRecognizer, Proposal, Recognized, Recognizer,
    SiteFindings, Tally, UprightBox,
};
