//! Results of a tracker.

use crate::matching::{Rejection, Shape};
use glam::DMat2;

/// The predicted position of a feature.
#[derive(Clone, Debug, PartialEq)]
pub struct Window {
    /// The feature's number.
    pub id: u32,
    /// Expected position.
    pub shape: Shape,
    /// Covariance of each defining point as detected, pixels squared.
    pub covariances: Vec<DMat2>,
    /// x0, y0, x1, y1 of the box that holds the feature with the stated probability, clipped to the image. In a
    /// 360-degree image x1 may exceed the width.
    pub bounds: [f64; 4],
}

/// A feature and its detection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match {
    /// The feature's number.
    pub id: u32,
    /// Index of the detection.
    pub detection: usize,
    /// Squared Mahalanobis distance from the expected position.
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
    /// Too much time has passed since the last frame.
    Gap,
    /// A full prediction no longer shows it.
    NotPredicted,
}

/// Result of matching a frame's detections to the tracks.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MatchOutcome {
    /// Features found.
    pub matched: Vec<Match>,
    /// Features not found, or whose detection may well be another feature's. Their positions are extrapolated.
    pub missed: Vec<u32>,
    /// Tracks of waiting features that begin, because detections can distinguish them now.
    pub begun: Vec<u32>,
    /// Tracks that ended.
    pub ended: Vec<(u32, End)>,
    /// Indices of detections that match no track.
    pub unmatched: Vec<usize>,
    /// Detections with invalid values.
    pub rejected: Vec<(usize, Rejection)>,
    /// Groups of candidates too large for an optimal assignment; above 0 only in extreme clutter.
    pub greedy_groups: usize,
}

/// Result of seeding from a full prediction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SeedOutcome {
    /// Tracks started.
    pub begun: Vec<u32>,
    /// Tracks kept, because their history is better known than the prediction.
    pub kept: Vec<u32>,
    /// Tracks that ended.
    pub ended: Vec<(u32, End)>,
    /// Features that detections cannot distinguish from a followed one yet: its window would hold them, too.
    pub waiting: Vec<u32>,
    /// Features that cannot be followed.
    pub refused: Vec<(u32, Rejection)>,
}
