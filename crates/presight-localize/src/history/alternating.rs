//! Alternates full predictions and predictions from history.

use super::health::PredictionTrigger;
use super::outcome::{MatchOutcome, SeedOutcome, Window};
use super::track::Seed;
use super::tracker::Tracker;
use crate::matching::Detection;
use glam::{DVec2, DVec3};
use presight_model::error::Result;

/// Origin of a frame's windows.
#[derive(Clone, Debug, PartialEq)]
pub enum Source {
    /// The tracks' history alone.
    History,
    /// A full prediction.
    Full {
        /// Why it was made.
        why: PredictionTrigger,
        /// The changes to the tracks.
        seeded: SeedOutcome,
    },
}

/// Maps a point in the world (metres) to its pixel (column, row); see [`super::view`].
pub type PointProjection<'a> = &'a dyn Fn(DVec3) -> Option<DVec2>;

/// One frame's windows.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameWindows {
    /// Origin of the windows.
    pub source: Source,
    /// Predicted positions of all tracked features.
    pub windows: Vec<Window>,
}

/// Makes full predictions when the tracks do not suffice, and otherwise predicts from history (paper section 3.4).
///
/// ```
/// use glam::{DMat2, DVec2};
/// use presight::localize::{AlternatingTracker, Detection, ExpectedProperties, ImageExtent, Seed, Shape};
/// use presight::localize::{Source, Tracker, TrackerOptions};
///
/// // Twenty points move to the right at 60 pixels per second. A full prediction knows their positions.
/// let at = |i: u32, time: f64| DVec2::new(30.0 * f64::from(i % 5) + 60.0 * time, 100.0 * f64::from(i / 5) + 50.0);
/// let full = |time: f64| -> presight::Result<Vec<Seed>> {
///     let seed = |i: u32| Seed {
///         id: i + 1,
///         shape: Shape::Point(at(i, time)),
///         covariances: vec![DMat2::IDENTITY],
///         properties: ExpectedProperties::default(),
///         points_world: Vec::new(),
///     };
///     Ok((0..20).map(seed).collect())
/// };
/// let tracker = Tracker::new(TrackerOptions::new(ImageExtent::new(640, 480)).with_least_spread(2))?;
/// let mut alternating = AlternatingTracker::new(tracker, None);
/// for k in 0..20 {
///     let time = 0.05 * f64::from(k);
///     let frame = alternating.predict(time, None, || full(time))?;
///     assert_eq!(frame.source == Source::History, k > 0);
///     // An extractor would search in `frame.windows`.
///     let found: Vec<Detection> = (0..20).map(|i| Detection::point(at(i, time), 0.5)).collect();
///     assert_eq!(alternating.correct(time, &found)?.matched.len(), 20);
/// }
/// assert_eq!(alternating.history_share(), 0.95);
/// # Ok::<(), presight::Error>(())
/// ```
#[derive(Clone, Debug)]
pub struct AlternatingTracker {
    tracker: Tracker,
    /// Largest number of frames from one full prediction to the next.
    every: Option<u32>,
    since: u32,
    full: u64,
    history: u64,
}

impl AlternatingTracker {
    /// Makes a full prediction whenever the tracker's health requires one, and at least every `every` frames.
    pub fn new(tracker: Tracker, every: Option<u32>) -> Self {
        Self { tracker, every, since: 0, full: 0, history: 0 }
    }

    /// The tracker.
    pub fn tracker(&self) -> &Tracker {
        &self.tracker
    }

    /// Returns the windows of the frame at `time` (seconds). `full` is called if a full prediction is needed and
    /// returns its seeds. `view` is passed to [`Tracker::set_view`] if the motion is known.
    ///
    /// # Errors
    /// The errors of `full`, [`Tracker::seed`] and [`Tracker::predict`].
    pub fn predict(
        &mut self,
        time: f64,
        view: Option<PointProjection<'_>>,
        full: impl FnOnce() -> Result<Vec<Seed>>,
    ) -> Result<FrameWindows> {
        if let Some(view) = view {
            self.tracker.set_view(view);
        }
        let due = self.every.is_some_and(|every| self.since + 1 >= every);
        let gap = self.tracker.time().is_some_and(|last| time - last > self.tracker.options().longest_gap);
        let why = self
            .tracker
            .health()
            .wants
            .or(gap.then_some(PredictionTrigger::Gap))
            .or(due.then_some(PredictionTrigger::Due));
        let source = match why {
            Some(why) => {
                let seeded = self.tracker.seed(time, full()?)?;
                // The flow of new tracks starts at this view, whichever pose the full prediction used.
                if let Some(view) = view {
                    self.tracker.set_view(view);
                }
                (self.since, self.full) = (0, self.full + 1);
                Source::Full { why, seeded }
            }
            None => {
                (self.since, self.history) = (self.since + 1, self.history + 1);
                Source::History
            }
        };
        Ok(FrameWindows { source, windows: self.tracker.predict(time)? })
    }

    /// See [`Tracker::correct`].
    ///
    /// # Errors
    /// The errors of [`Tracker::correct`].
    pub fn correct(&mut self, time: f64, found: &[Detection]) -> Result<MatchOutcome> {
        self.tracker.correct(time, found)
    }

    /// Share of frames predicted from history alone; 0 before the first frame.
    pub fn history_share(&self) -> f64 {
        self.history as f64 / (self.full + self.history).max(1) as f64
    }
}
