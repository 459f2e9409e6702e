//! The report of supervision.

use super::intruders::Intrusion;
use super::state::CellState;

/// Number of cells of each state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellCounts {
    /// Free.
    pub free: usize,
    /// With a confirmed surface of the model.
    pub known: usize,
    /// With a part of an intrusion.
    pub intruded: usize,
    /// Not seen, by reason, in the order of [`UnseenReason::ALL`](super::UnseenReason::ALL).
    pub unseen: [usize; 7],
}

/// The report on the frames of one stamp.
#[derive(Clone, Debug)]
pub struct Report {
    /// Seconds, as in the frame.
    pub stamp: f64,
    /// States by cell, numbered as in [`super::Cells`].
    pub cells: Vec<CellState>,
    /// Shares of the corridor's volume in cells whose centre no ray reaches, by reason in the order of
    /// [`UnseenReason::ALL`](super::UnseenReason::ALL). Gaps between rays are ignored here.
    pub hidden: [f64; 7],
    /// Unknown objects in the corridor, by distance along it.
    pub intrusions: Vec<Intrusion>,
    /// Time until the first intrusion is reached at the speed of the options, seconds; `None` without an intrusion, or
    /// at speed 0.
    pub time_to_reach: Option<f64>,
    /// False without a pose. All surfaces are then reported as intrusions, because they cannot be compared with the
    /// model.
    pub is_compared: bool,
    /// True if objects in the corridor are assumed to reach the heights that the sensors see.
    pub is_upright_assumed: bool,
    /// True if the deadline ended the evaluation early.
    pub is_given_up: bool,
}

impl Report {
    /// Number of cells of each state.
    pub fn counts(&self) -> CellCounts {
        let mut counts = CellCounts::default();
        for cell in &self.cells {
            match cell {
                CellState::Free => counts.free += 1,
                CellState::Known(_) => counts.known += 1,
                CellState::Intruded => counts.intruded += 1,
                CellState::Unseen(reason) => counts.unseen[*reason as usize] += 1,
            }
        }
        counts
    }

    /// The cells as letters, see [`CellState::letter`].
    pub fn letters(&self) -> String {
        self.cells.iter().map(|cell| cell.letter()).collect()
    }
}
