//! Numerical stability: checks that the error of every engine stays within its published bound.
//!
//! Each [`Family`] has cases of increasing difficulty along one axis. Errors are measured against a truth computed with
//! a hundred digits. An error beyond its bound is a fault; a case that is refused with a typed error is not. Any type
//! that implements [`Family`] can be added to a [`Study`].

mod big;
mod families;
mod fold;
mod judge;
mod lens;
mod oracle;
mod output;
mod study;
mod subjects;
#[cfg(test)]
mod tests;
mod truth;

pub use families::{Family, Finding, Outcome, all};
pub use output::{RunInfo, faults, to_csv, to_html, to_json};
pub use study::{Row, Study};
pub use subjects::{BoxSetting, Subject, subjects};
