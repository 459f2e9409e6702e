//! Supervision of the path ahead of a robot by the measurements of its sensors. It is not a safety device.
#![doc = include_str!("../docs/supervise.md")]

#[doc(inline)]
pub use presight_supervise::{
    CellCounts, CellState, Cells, Intrusion, Report, SuperviseOptions, Supervisor, UnseenReason,
};
