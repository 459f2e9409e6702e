//! Decides when tracks no longer suffice and a full prediction is needed.

use super::options::ImageExtent;
use super::track::Track;
use std::fmt;

/// Why a full prediction is needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PredictionTrigger {
    /// No full prediction has been made yet.
    Start,
    /// The last two frames were too far apart in time.
    Gap,
    /// Too few tracks are left.
    TooFew,
    /// Tracks are in too few parts of the image.
    BadlySpread,
    /// Too many of the tracks since the last full prediction are gone.
    Thinned,
    /// The caller's limit of frames between full predictions is reached.
    Due,
}

impl fmt::Display for PredictionTrigger {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Start => "there was no full prediction yet",
            Self::Gap => "too much time has passed since the last frame",
            Self::TooFew => "too few features are tracked",
            Self::BadlySpread => "tracked features are in too few parts of the image",
            Self::Thinned => "many tracked features are gone since the last full prediction",
            Self::Due => "as many frames as allowed have passed since the last full prediction",
        })
    }
}

/// How well the tracks cover the image, and whether a full prediction is needed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Health {
    /// Number of tracks.
    pub tracks: usize,
    /// Number of cells of a 3 x 3 grid over the image that hold a track.
    pub spread: usize,
    /// Share of the tracks since the last full prediction that is left.
    pub share: f64,
    /// Learnt ratio of squared innovations to their predicted variances. 1 if detections state their noise correctly.
    pub noise_scale: f64,
    /// Why a full prediction is needed; `None` if it is not.
    pub wants: Option<PredictionTrigger>,
}

/// Number of cells of a 3 x 3 grid over the image that hold a track.
pub(super) fn spread(tracks: &[Track], image: &ImageExtent) -> usize {
    let mut held = [false; 9];
    for track in tracks {
        let p = track.shape.centre();
        let part = |x: f64, size: u32| ((3.0 * (x + 0.5) / f64::from(size)) as usize).min(2);
        held[3 * part(p.y, image.height) + part(p.x, image.width)] = true;
    }
    held.iter().filter(|h| **h).count()
}
