//! Models that are known before an exploration.

mod rough;

pub(crate) use rough::{corrected, explained, opened};
