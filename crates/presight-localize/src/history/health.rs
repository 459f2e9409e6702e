//! Whether tracks are enough to go on without a full prediction.

use super::options::ImageExtent;
use super::track::Track;
use std::fmt;

/// Why a full prediction is wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PredictionTrigger {
    /// There was none yet.
    Start,
    /// The last two frames were too far apart in time.
    Gap,
    /// Too few tracks are left.
    TooFew,
    /// Tracks are in too few parts of the image.
    BadlySpread,
    /// Too many of the tracks since the last full prediction are gone.
    Thinned,
    /// So many frames have passed as the caller allows.
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

/// Whether tracks are enough to go on without a full prediction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Health {
    /// Tracks.
    pub tracks: usize,
    /// Ninths of the image, three by three, that hold one.
    pub spread: usize,
    /// Share of the tracks at the last full prediction that is left.
    pub share: f64,
    /// Mean square of innovations by their predicted variances, as learnt: 1 where the noise is as detections say.
    pub noise_scale: f64,
    /// Why a full prediction is wanted; `None` if it is not.
    pub wants: Option<PredictionTrigger>,
}

/// Ninths of the image that hold a track.
pub(super) fn spread(tracks: &[Track], image: &ImageExtent) -> usize {
    let mut held = [false; 9];
    for track in tracks {
        let p = track.shape.centre();
        let part = |x: f64, size: u32| ((3.0 * (x + 0.5) / f64::from(size)) as usize).min(2);
        held[3 * part(p.y, image.height) + part(p.x, image.width)] = true;
    }
    held.iter().filter(|h| **h).count()
}
