//! The stride: draws every k-th column and row if that gives more samples than a whole image that is stopped. Choosing
//! it after selection costs nothing; the engine may also choose it after its first wave, when it knows more.

use super::{Controller, DeadlineFrame, SLOW, seconds};
use crate::cost::{Forecast, Key, TimeEstimate, WorkCounts};
use presight_model::sensor::{ImagePart, STRIDES, Sensor};
use std::time::Duration;

/// Number of thinned frames after which their learnt costs are used, and after which the spread of their times is.
const LEARNT: u64 = 3;
const WELL_LEARNT: u64 = 30;
/// Until then estimates scale from whole frames; these shares of drawing and images do not shrink with the samples.
const FIXED_DRAWING: f64 = 0.4;
const FIXED_IMAGES: f64 = 0.4;

/// With this multiple of a slow frame's time, nothing will be given up.
const PLENTY: f64 = 8.0;

/// Number of frames after which an average forgets, and the weight of its initial value in frames.
const REMEMBERED: f64 = 50.0;
const FIRST_VALUE: f64 = 4.0;
/// Bins up to the estimated time, and in total.
const STEPS: f64 = 8.0;
const BINS: usize = 13;

/// Expected share of the drawn samples when drawing stops, by the ratio of available to estimated time.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stopping([(f64, f64); BINS]);

impl Default for Stopping {
    /// The samples of far polygons come last: a square, and estimates are off by about 10 %.
    fn default() -> Self {
        Self(std::array::from_fn(|i| ((0.85 * (i as f64 / STEPS).powi(2)).min(1.0), FIRST_VALUE)))
    }
}

impl Stopping {
    /// Returns the expected share.
    pub fn there(&self, time: f64) -> f64 {
        let at = (time * STEPS).clamp(0.0, (BINS - 1) as f64);
        let first = (at as usize).min(BINS - 2);
        let [low, high] = [self.0[first].0, self.0[first + 1].0];
        low + (high - low) * (at - first as f64)
    }

    /// Learns from a frame. The curve stays monotonic in time.
    pub fn learn(&mut self, time: f64, there: f64) {
        let at = (time * STEPS).round().clamp(0.0, (BINS - 1) as f64) as usize;
        let (mean, frames) = &mut self.0[at];
        *frames = (*frames + 1.0).min(REMEMBERED);
        *mean += (there - *mean) / *frames;
        let mean = *mean;
        self.0[..at].iter_mut().for_each(|(lower, _)| *lower = lower.min(mean));
        self.0[at..].iter_mut().for_each(|(higher, _)| *higher = higher.max(mean));
    }
}

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
        let fixed = if forecast == Forecast::Images { FIXED_IMAGES } else { FIXED_DRAWING };
        let learnt = self.costs.estimate(&Self::key_at(timed, forecast, stride), counts);
        let scale = match learnt.frames {
            WELL_LEARNT.. => return learnt,
            LEARNT.. => learnt.mean / whole.mean,
            _ => fixed + (1.0 - fixed) * timed.share(stride),
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

/// The whole image at this stride.
pub(super) fn part_of(sensor: &Sensor, stride: u32) -> Option<ImagePart> {
    (stride > 1).then(|| ImagePart { stride, ..sensor.whole() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_follow_what_was_seen() {
        let mut stopping = Stopping::default();
        assert_eq!((stopping.there(0.0), stopping.there(9.0)), (0.0, 1.0));
        // By hand, from 0.2125 at a half: (4 x 0.2125 + 0.7125) / 5 = 0.3125, above the curve's value at a quarter.
        stopping.learn(0.5, 0.7125);
        assert!((stopping.there(0.5) - 0.3125).abs() < 1e-12);
        assert!((stopping.there(0.25) - 0.053125).abs() < 1e-12);
        // Repeated zeros at the full time also pull down shorter times.
        (0..200).for_each(|_| stopping.learn(1.0, 0.0));
        assert!(stopping.there(0.5) < 0.05 && stopping.there(1.0) < 0.05, "{stopping:?}");
        let grows = (0..150).map(|i| stopping.there(0.01 * f64::from(i))).is_sorted();
        assert!(grows, "{stopping:?}");
    }
}
