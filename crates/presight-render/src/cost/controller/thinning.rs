//! The stride: draws every k-th column and row if that gives more samples than a whole image that is stopped. Choosing
//! it after selection costs nothing; the engine may also choose it after its first wave, when it knows more.

use super::control::{Controller, SLOW};
use super::frame::{DeadlineFrame, seconds};
use crate::cost::{Forecast, Key, TimeEstimate, WorkCounts};
use crate::deadline::PLENTY;
use presight_model::sensor::STRIDES;
use std::time::Duration;

/// Number of thinned frames after which their learnt costs are used, and after which the spread of their times is.
const LEARNT: u64 = 3;
const WELL_LEARNT: u64 = 30;
/// Until then estimates scale from whole frames; these shares of drawing and images do not shrink with the samples.
const FIXED: f64 = 0.4;

impl Controller {
    /// The key for estimates of thinned images.
    pub(super) fn key_at(timed: &DeadlineFrame, forecast: Forecast, stride: u32) -> Key {
        let mut key = timed.key_of(forecast);
        if stride > 1 {
            key.geometry = format!("{}, one in {stride}", key.geometry);
        }
        key
    }

    /// Estimates drawing or images at a stride; scaled from whole images until enough was learnt.
    pub(super) fn at_stride(
        &self,
        timed: &DeadlineFrame,
        forecast: Forecast,
        counts: &WorkCounts,
        stride: u32,
    ) -> TimeEstimate {
        let whole = self.costs.estimate(&timed.key_of(forecast), counts);
        if stride == 1 {
            return whole;
        }
        let learnt = self.costs.estimate(&Self::key_at(timed, forecast, stride), counts);
        let scale = match learnt.frames {
            WELL_LEARNT.. => return learnt,
            LEARNT.. => learnt.mean / whole.mean,
            _ => FIXED + (1.0 - FIXED) * timed.share(stride),
        };
        TimeEstimate {
            mean: whole.mean * scale,
            upper: whole.upper * scale,
            lower: whole.lower * scale,
            frames: whole.frames,
        }
    }

    /// Estimates the images of a stride.
    pub(super) fn images(&self, timed: &DeadlineFrame, stride: u32) -> TimeEstimate {
        self.at_stride(timed, Forecast::Images, &timed.of_images(), stride)
    }

    /// Time to reserve for images of a stride: at most half of the time left, unless the mean needs more. A rare slow
    /// frame does not justify giving up everything.
    pub(super) fn kept_for_images(&self, timed: &DeadlineFrame, stride: u32, left: Duration) -> Duration {
        let images = self.images(timed, stride);
        let mean = if images.frames == 0 { Duration::ZERO } else { seconds(SLOW * images.mean) };
        seconds(images.upper).min(mean.max(left / 2))
    }

    /// Expected share of all samples at a stride, with this much time left after selection.
    fn expected(&self, timed: &DeadlineFrame, stride: u32, left: Duration) -> f64 {
        let images = self.kept_for_images(timed, stride, left);
        let features = self.reserve(timed, left.saturating_sub(images));
        let time = left.saturating_sub(images + features).as_secs_f64();
        let drawing = self.at_stride(timed, Forecast::Selection, &timed.counts, stride);
        let stopping = self.stopping.get(&Self::key_at(timed, Forecast::Selection, stride));
        stopping.cloned().unwrap_or_default().there(time / drawing.mean) * timed.share(stride)
    }

    /// True if the time left after selection is a large multiple of a slow frame's time.
    pub(super) fn has_plenty(&self, timed: &DeadlineFrame, left: Duration) -> bool {
        let drawing = self.costs.estimate(&timed.key_of(Forecast::Selection), &timed.counts);
        let images = self.images(timed, 1);
        let is_known = drawing.frames > 0 && images.frames > 0;
        is_known && PLENTY * (drawing.upper + images.upper) < left.as_secs_f64()
    }

    /// The stride with the most expected samples; the smallest of equals.
    pub(super) fn stride(&self, timed: &DeadlineFrame, left: Duration) -> u32 {
        let whole = self.costs.estimate(&timed.key_of(Forecast::Selection), &timed.counts);
        if whole.frames == 0 {
            return 1;
        }
        if self.has_plenty(timed, left) {
            return 1;
        }
        let mut best = (self.expected(timed, 1, left), 1);
        for stride in timed.strides() {
            let samples = self.expected(timed, stride, left);
            if samples > best.0 {
                best = (samples, stride);
            }
        }
        best.1
    }
}

impl DeadlineFrame {
    /// Strides that the engine can draw, except 1.
    pub(super) fn strides(&self) -> impl DoubleEndedIterator<Item = u32> + use<> {
        STRIDES.into_iter().take(if self.draws_parts { STRIDES.len() } else { 0 })
    }

    /// Share of all samples that a stride draws.
    pub(super) fn share(&self, stride: u32) -> f64 {
        let [width, height] = self.size;
        f64::from(width.div_ceil(stride)) * f64::from(height.div_ceil(stride)) / (f64::from(width) * f64::from(height))
    }
}
