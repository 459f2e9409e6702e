//! Correction of models from before the exploration.

mod rough;

pub(crate) use rough::{corrected, explained, opened};
