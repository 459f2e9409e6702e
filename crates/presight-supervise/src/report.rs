//! The report of supervision.

use super::intruders::Intrusion;
use serde::Serialize;

/// The reason why a cell is not seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum UnseenReason {
    /// Outside of the image, or beyond the sensor's reach.
    OutOfView,
    /// Behind a surface of the model.
    BehindKnown,
    /// Behind an unknown object.
    BehindUnknown,
    /// A missing return: dirt, a black or a shiny surface.
    NoReturn,
    /// The rays leave gaps as wide as the smallest intruder.
    BetweenRays,
    /// Not evaluated before the deadline.
    Deadline,
    /// The corridor is in the world, and the robot's pose is unknown.
    NoPose,
}

impl UnseenReason {
    /// All reasons, in the order of [`CellCounts::unseen`].
    pub const ALL: [Self; 7] = [
        Self::OutOfView,
        Self::BehindKnown,
        Self::BehindUnknown,
        Self::NoReturn,
        Self::BetweenRays,
        Self::Deadline,
        Self::NoPose,
    ];

    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::OutOfView => "out_of_view",
            Self::BehindKnown => "behind_known",
            Self::BehindUnknown => "behind_unknown",
            Self::NoReturn => "no_return",
            Self::BetweenRays => "between_rays",
            Self::Deadline => "deadline",
            Self::NoPose => "no_pose",
        }
    }

    /// The letter of a cell in files.
    pub fn letter(self) -> char {
        ['o', 'b', 'u', 'n', 'r', 'd', 'p'][self as usize]
    }
}

/// The state of a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellState {
    /// Rays pass through it without a gap as wide as the smallest intruder.
    Free,
    /// A confirmed surface of the model is in it: the object's index.
    Known(u32),
    /// Part of an intrusion is in it.
    Intruded,
    /// Not seen.
    Unseen(UnseenReason),
}

impl CellState {
    /// The letter in files: `f` free, `k` known, `i` intruded, others as [`UnseenReason::letter`].
    pub fn letter(self) -> char {
        match self {
            Self::Free => 'f',
            Self::Known(_) => 'k',
            Self::Intruded => 'i',
            Self::Unseen(reason) => reason.letter(),
        }
    }
}

/// Number of cells of each state.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CellCounts {
    /// Free.
    pub free: usize,
    /// With a confirmed surface of the model.
    pub known: usize,
    /// With a part of an intrusion.
    pub intruded: usize,
    /// Not seen, by reason, in the order of [`UnseenReason::ALL`].
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
    /// [`UnseenReason::ALL`]. Gaps between rays are ignored here.
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
