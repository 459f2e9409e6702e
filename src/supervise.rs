//! Supervision of the corridor ahead of a robot by its measurements: free, known, intruded or unseen cells. It is not a
//! safety device.
#![doc = include_str!("../docs/supervise.md")]

#[doc(inline)]
pub use presight_supervise::{
    CellCounts, CellState, Cells, Intrusion, Report, SuperviseOptions, Supervisor, UnseenReason,
};
