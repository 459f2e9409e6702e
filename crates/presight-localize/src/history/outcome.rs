//! What a tracker answers.

use crate::matching::{Rejection, Shape};
use glam::DMat2;

/// Where a feature will be found.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// The feature's number.
    pub id: u32,
    /// Where it is expected.
    pub shape: Shape,
    /// Covariance of each defining point as it will be detected, pixels squared.
    pub covariances: Vec<DMat2>,
    /// x0, y0, x1, y1: holds the feature with the stated probability, clipped to the image. Where the image goes round, x1 may be
    /// beyond the width.
    pub bounds: [f64; 4],
}

/// A feature and the detection that is it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// The feature's number.
    pub id: u32,
    /// Index of the detection.
    pub detection: usize,
    /// Squared Mahalanobis distance from where it was expected.
    pub distance_squared: f64,
    /// Dimensions of that distance.
    pub dimensions: u32,
}

/// Why a track ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum End {
    /// It was missed too often in a row.
    Lost,
    /// It left the image.
    Left,
    /// The last frame is too long ago.
    Gap,
    /// A full prediction does not show it any more.
    NotPredicted,
}

/// What became of a frame's detections and of the tracks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MatchOutcome {
    /// Features found.
    pub matched: Vec<Match>,
    /// Features not found: their histories are extrapolated.
    pub missed: Vec<u32>,
    /// Tracks that ended.
    pub ended: Vec<(u32, End)>,
    /// Detections that are no tracked feature.
    pub unmatched: Vec<usize>,
    /// Detections that nothing can be computed from.
    pub rejected: Vec<(usize, Rejection)>,
    /// Groups of candidates too large for an optimal assignment; 0 but for absurd clutter.
    pub greedy_groups: usize,
}

/// What a full prediction did to the tracks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeedOutcome {
    /// Tracks begun.
    pub begun: Vec<u32>,
    /// Tracks that go on: their histories know more than the prediction.
    pub kept: Vec<u32>,
    /// Tracks that ended.
    pub ended: Vec<(u32, End)>,
    /// Features that cannot be followed.
    pub refused: Vec<(u32, Rejection)>,
}
