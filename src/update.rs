//! What differs between prediction and measurement becomes evidence, and evidence becomes changes of the model.
#![doc = include_str!("../docs/update.md")]
#![doc = include_str!("../docs/minor-changes.md")]

#[doc(inline)]
pub use presight_update::{
    Action, Applied, Doubt, Evidence, Finding, Findings, LearnOptions, Learner, Library, Look, Occupied, Policy,
    ProgramRecognizer, Proposal, Recognized, Recognizer, Refined, Shape, Sight, Tally, UprightBox, Voxel, Voxels,
    Waiting, What, change_lines,
};
