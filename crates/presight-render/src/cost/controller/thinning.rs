//! The stride: every k-th column and row, where thinned images are expected to have more samples than whole ones that are stopped. Chosen
//! after selection it costs nothing; the engine may still choose it after the first wave, of which it knows more.

use super::{Controller, DeadlineFrame, SLOW, seconds};
use crate::cost::{Forecast, Key, TimeEstimate, WorkCounts};
use presight_model::sensor::{ImagePart, STRIDES, Sensor};
use std::time::Duration;

/// Thinned frames from which their costs are learnt before they are believed, and before the spread of their times is.
const LEARNT: u64 = 3;
const WELL_LEARNT: u64 = 30;
/// Until then, of what whole frames take: the shares of drawing and of images that do not shrink with the number of samples.
const FIXED_DRAWING: f64 = 0.4;
const FIXED_IMAGES: f64 = 0.4;

/// So many times what a slow frame takes: nothing will be given up.
const PLENTY: f64 = 8.0;

/// Frames that a share was seen in before they count for less, and as how many frames its first value counts.
const REMEMBERED: f64 = 50.0;
const FIRST_VALUE: f64 = 4.0;
/// Steps up to the estimated time, and in all.
const STEPS: f64 = 8.0;
const BINS: usize = 13;

/// The share of the samples to be drawn that is there when the drawing stops, by the share of the estimated time that there was for it.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stopping([(f64, f64); BINS]);

impl Default for Stopping {
    /// What is drawn last shows last: a square, with estimates that are off by some 10 %.
    fn default() -> Self {
        Self(std::array::from_fn(|i| ((0.85 * (i as f64 / STEPS).powi(2)).min(1.0), FIRST_VALUE)))
    }
}

impl Stopping {
    /// The share to be expected.
    pub fn there(&self, time: f64) -> f64 {
        let at = (time * STEPS).clamp(0.0, (BINS - 1) as f64);
        let first = (at as usize).min(BINS - 2);
        let [low, high] = [self.0[first].0, self.0[first + 1].0];
        low + (high - low) * (at - first as f64)
    }

    /// Learns from a frame; no time lets less be expected than a shorter one.
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
    /// The key of an estimate for thinned images.
    pub(super) fn key_at(timed: &DeadlineFrame, forecast: Forecast, stride: u32) -> Key {
        let mut key = timed.key_of(forecast);
        if stride > 1 {
            key.geometry = format!("{}, one in {stride}", key.geometry);
        }
        key
    }

    /// What drawing or images of a stride take; scaled from whole ones until it is learnt.
    pub(super) fn at_stride(
        &self,
        timed: &DeadlineFrame,
        (forecast, counts): (Forecast, &WorkCounts),
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

    /// What images of a stride take.
    pub(super) fn images(&self, timed: &DeadlineFrame, stride: u32) -> TimeEstimate {
        self.at_stride(timed, (Forecast::Images, &timed.of_images()), stride)
    }

    /// Time to be kept for images of a stride. Half of the time is kept at most, unless they take longer on average: a slow frame that may
    /// come is no reason to give up all.
    pub(super) fn kept_for_images(&self, timed: &DeadlineFrame, stride: u32, left: Duration) -> Duration {
        let images = self.images(timed, stride);
        let mean = if images.frames == 0 { Duration::ZERO } else { seconds(SLOW * images.mean) };
        seconds(images.upper).min(mean.max(left / 2))
    }

    /// The share of all samples to be expected of a stride when so much time is left after selection.
    fn expected(&self, timed: &DeadlineFrame, stride: u32, left: Duration) -> f64 {
        let images = self.kept_for_images(timed, stride, left);
        let features = self.reserve(timed, left.saturating_sub(images));
        let time = left.saturating_sub(images + features).as_secs_f64();
        let drawing = self.at_stride(timed, (Forecast::Selection, &timed.counts), stride);
        let stopping = self.stopping.get(&Self::key_at(timed, Forecast::Selection, stride));
        stopping.cloned().unwrap_or_default().there(time / drawing.mean) * timed.share(stride)
    }

    /// Whether so much time is left after selection that even a slow frame needs a small part of it.
    pub(super) fn has_plenty(&self, timed: &DeadlineFrame, left: Duration) -> bool {
        let drawing = self.costs.estimate(&timed.key_of(Forecast::Selection), &timed.counts);
        let images = self.images(timed, 1);
        let is_known = drawing.frames > 0 && images.frames > 0;
        is_known && PLENTY * (drawing.upper + images.upper) < left.as_secs_f64()
    }

    /// The stride of which most samples are to be expected; the least of those that are as good.
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
    /// Strides that the engine can draw, but for 1.
    pub(super) fn strides(&self) -> impl DoubleEndedIterator<Item = u32> + use<> {
        STRIDES.into_iter().take(if self.draws_parts { STRIDES.len() } else { 0 })
    }

    /// The share of all samples that a stride draws.
    pub(super) fn share(&self, stride: u32) -> f64 {
        let [width, height] = self.size;
        f64::from(width.div_ceil(stride)) * f64::from(height.div_ceil(stride)) / (f64::from(width) * f64::from(height))
    }
}

/// All columns and rows of this stride.
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
        // By hand, from 0.2125 at a half: (4 x 0.2125 + 0.7125) / 5 = 0.3125, which a quarter of the time does not reach.
        stopping.learn(0.5, 0.7125);
        assert!((stopping.there(0.5) - 0.3125).abs() < 1e-12);
        assert!((stopping.there(0.25) - 0.053125).abs() < 1e-12);
        // Nothing at the whole time, again and again: shorter ones expect no more.
        (0..200).for_each(|_| stopping.learn(1.0, 0.0));
        assert!(stopping.there(0.5) < 0.05 && stopping.there(1.0) < 0.05, "{stopping:?}");
        let grows = (0..150).map(|i| stopping.there(0.01 * f64::from(i))).is_sorted();
        assert!(grows, "{stopping:?}");
    }
}
