//! The stored environment: one file, `.presight`, that holds the environment and the log of all its changes.
#![doc = include_str!("../docs/stored-environments.md")]

#[doc(inline)]
pub use presight_store::{
    ChangeBatch, ChangeEvidence, Edit, EditPose, Existing, Info, LogEntry, Note, ProposedChange, SceneMerge,
    ShapeSource, Store, apply_line, check, create, feature_change, feature_line, info, log, read, read_world,
};
