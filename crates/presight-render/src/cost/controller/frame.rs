//! State of one prediction with a deadline.

use crate::cost::{Forecast, Key, WorkCounts};
use crate::deadline::{DegradationStep, Priority, Watch};
use crate::plan::Run;
use presight_model::sensor::{ImagePart, Sensor};
use std::time::Duration;

/// Time for uncounted work: learning, and the return to the caller.
pub(super) const MARGIN: Duration = Duration::from_micros(100);

/// State of a prediction with a deadline.
#[derive(Debug)]
pub struct DeadlineFrame {
    pub(super) limit: Duration,
    pub(super) watch: Watch,
    pub(super) key: Key,
    pub(super) priority: Priority,
    /// True if the engine can thin and narrow images.
    pub(super) draws_parts: bool,
    /// Image width and height, and number of images.
    pub(super) size: [u32; 2],
    pub(super) images: u64,
    /// Times after the call: start of selection, end of selection, images finished.
    pub(super) begun: Duration,
    pub(super) selected: Duration,
    pub(super) images_made: Duration,
    /// The work of drawing, before a cut.
    pub(super) counts: WorkCounts,
    pub(super) cut: Vec<DegradationStep>,
    /// The stride chosen after selection.
    pub(super) stride: u32,
    /// Ratio of the time available for drawing to its estimate.
    pub(super) time: Option<f64>,
    pub(super) first_estimate: Option<f64>,
    /// Tiles or a row in the plane, if it was planned as a whole.
    pub(super) whole: Option<Forecast>,
    /// Expected work of features, before any was found.
    pub(super) features: WorkCounts,
    /// Number of features found, and ascending numbers of features left out.
    pub found: u64,
    /// Ascending numbers of features left out.
    pub left_out: Vec<u32>,
}

impl DeadlineFrame {
    pub(super) fn new(
        limit: Duration,
        watch: Watch,
        key: Key,
        priority: &Priority,
        size: [u32; 2],
        images: u64,
    ) -> Self {
        let zero = Duration::ZERO;
        let (begun, selected, images_made) = (zero, zero, zero);
        let (counts, features, cut, first_estimate) = (WorkCounts::default(), WorkCounts::default(), Vec::new(), None);
        let (priority, found, left_out) = (priority.clone(), 0, Vec::new());
        Self {
            limit,
            watch,
            key,
            priority,
            draws_parts: true,
            size,
            images,
            begun,
            selected,
            images_made,
            counts,
            cut,
            stride: 1,
            time: None,
            first_estimate,
            whole: None,
            features,
            found,
            left_out,
        }
    }

    /// Records the placed features, with regions of interest if requested; selection begins now.
    pub fn expect_features(&mut self, features: usize, regions: bool) {
        let features = features as u64;
        self.features = WorkCounts { features, regions: if regions { features } else { 0 }, ..WorkCounts::default() };
        self.begun = self.watch.elapsed();
    }

    /// Records that the images are finished; features follow.
    pub fn images_are_made(&mut self) {
        // The clock may have been set back.
        self.images_made = self.watch.elapsed().max(self.selected);
    }

    /// Time left for features.
    pub(super) fn left(&self) -> Duration {
        self.limit.saturating_sub(self.watch.elapsed() + MARGIN)
    }

    /// Work for this number of features.
    pub(super) fn of_features(&self, features: u64) -> WorkCounts {
        WorkCounts { features, regions: self.features.regions.min(features), ..WorkCounts::default() }
    }

    pub(super) fn key_of(&self, forecast: Forecast) -> Key {
        Key { forecast, ..self.key.clone() }
    }

    pub(super) fn pixels(&self) -> u64 {
        self.size.map(u64::from).iter().product()
    }

    pub(super) fn of_images(&self) -> WorkCounts {
        WorkCounts { pixels_resolved: self.pixels() * self.images, ..WorkCounts::default() }
    }
}

/// A reserved time, including the margin.
pub(super) fn seconds(s: f64) -> Duration {
    Duration::from_secs_f64(s.min(1e6)) + MARGIN
}

pub(super) fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1e3
}

pub(super) fn counts_of(runs: &[Run]) -> WorkCounts {
    let polygons = runs.iter().map(|r| u64::from(r.count)).sum();
    WorkCounts { runs: runs.len() as u64, polygons, ..WorkCounts::default() }
}

/// The whole image at this stride.
pub(super) fn part_of(sensor: &Sensor, stride: u32) -> Option<ImagePart> {
    (stride > 1).then(|| ImagePart { stride, ..sensor.whole() })
}
