//! From views to evidence: on objects and their parts, on new objects, on poses and on features.

pub(crate) mod drive;
pub(crate) mod features;
pub(crate) mod file;
pub(crate) mod joint;
pub(crate) mod knowledge;
pub(crate) mod objects;
pub(crate) mod voxels;
