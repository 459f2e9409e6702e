//! From evidence to findings: objects that are gone, moved, new, recognized, or still in doubt.

pub(crate) mod boxes;
pub(crate) mod classify;
pub(crate) mod decision;
pub(crate) mod findings;
pub(crate) mod fit;
pub(crate) mod groups;
pub(crate) mod moves;
pub(crate) mod parts;
pub(crate) mod planner;
pub(crate) mod policy;
pub(crate) mod program;
pub(crate) mod recognize;
pub(crate) mod report;
pub(crate) mod rivals;
pub(crate) mod shapes;
