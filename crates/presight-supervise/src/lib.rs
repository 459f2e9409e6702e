//! Is the way ahead free, and what does the model answer: supervision of a corridor by what sensors measure, and queries.
//!
//! Use it through the crate `presight`, which gives the same names.

mod grid;
mod intruders;
mod look;
mod pixels;
pub mod query;
mod rays;
mod report;
mod supervisor;
mod windows;

pub use grid::Cells;
pub use intruders::Intrusion;
pub use report::{CellCounts, CellState, Report, UnseenReason};
pub use supervisor::{SuperviseOptions, Supervisor};
