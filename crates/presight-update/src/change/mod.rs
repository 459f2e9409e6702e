//! From findings to changes of the model.

pub(crate) mod edits;
pub(crate) mod existence;
pub(crate) mod features;
pub(crate) mod pending;
pub(crate) mod proposals;
pub(crate) mod refine;
pub(crate) mod world;
