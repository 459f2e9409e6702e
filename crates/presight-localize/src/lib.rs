//! Localization: matching, history, verdicts, extraction, estimates and the localizer.
//!
//! Use it through the crate `presight`, which gives the same names.

pub mod estimate;
pub mod extract;
pub mod history;
pub mod localize;
pub mod matching;
pub mod motion;
pub mod simulate;
pub mod verdict;
