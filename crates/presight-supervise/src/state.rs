//! The state of a cell.

use serde::Serialize;

presight_model::words! {
    /// The reason why a cell is not seen.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
    #[serde(rename_all = "snake_case")]
    pub enum UnseenReason {
        /// Outside of the image, or beyond the sensor's reach.
        OutOfView = "out_of_view",
        /// Behind a surface of the model.
        BehindKnown = "behind_known",
        /// Behind an unknown object.
        BehindUnknown = "behind_unknown",
        /// A missing return: dirt, a black or a shiny surface.
        NoReturn = "no_return",
        /// The rays leave gaps as wide as the smallest intruder.
        BetweenRays = "between_rays",
        /// Not evaluated before the deadline.
        Deadline = "deadline",
        /// The corridor is in the world, and the robot's pose is unknown.
        NoPose = "no_pose",
    }
}

impl UnseenReason {
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
