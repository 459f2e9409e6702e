//! Supervision: whether the way ahead of a robot is free, by what its sensors measured. It is not a safety device.
#![doc = include_str!("../docs/supervise.md")]

#[doc(inline)]
pub use presight_supervise::{
    CellCounts, CellState, Cells, Intrusion, Report, SuperviseOptions, Supervisor, UnseenReason,
};
