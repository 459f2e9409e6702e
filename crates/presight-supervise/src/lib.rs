//! Supervision of a corridor by the measurements of sensors, and queries to the model.
//!
//! Use it through the crate `presight`, which gives the same names.

mod grid;
mod intruders;
mod look;
mod options;
mod pixels;
pub mod query;
mod rays;
mod report;
mod state;
mod supervisor;
mod windows;

pub use grid::Cells;
pub use intruders::Intrusion;
pub use options::SuperviseOptions;
pub use report::{CellCounts, Report};
pub use state::{CellState, UnseenReason};
pub use supervisor::Supervisor;
