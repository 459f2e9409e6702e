//! The parts of a segment's image. Where the image is straight, or nearly so, its samples are equal steps.

use super::{Piece, Sample};
use glam::{DVec2, DVec3};

/// A part of a segment.
pub(crate) enum Part {
    Run(Run),
    One(Piece),
}

impl Part {
    /// Visits its samples in order, or its only piece.
    pub fn pieces(&self, visit: &mut impl FnMut(Piece)) {
        match self {
            Self::Run(run) => run.samples().for_each(|sample| visit(Piece::Inside(sample))),
            Self::One(piece) => visit(*piece),
        }
    }
}

/// Neighbouring samples of a segment, all of them in the image.
///
/// Share s of the image corresponds to share s p / (s p + (1 - s) q) of the line between the ends in space. In a
/// pinhole camera p and q are the depths of the ends, and this is exact. Elsewhere samples have equal angles, p and q
/// are the ranges of the ends, and the error is of second order in the angle.
pub(crate) struct Run {
    /// Interval of the feature's length, and its ends, image frame.
    pub t: [f64; 2],
    pub ends: [DVec3; 2],
    /// Depths of the ends in a pinhole camera, ranges elsewhere.
    pub scales: [f64; 2],
    /// The ends in the image, pixels.
    pub pixels: [DVec2; 2],
    /// Number of samples.
    pub count: usize,
    /// Length in the image, pixels.
    pub length: f64,
}

impl Run {
    #[inline]
    fn along(&self, s: f64) -> f64 {
        let [p, q] = self.scales;
        s * p / (s * p + (1.0 - s) * q)
    }

    #[inline]
    fn step(&self) -> f64 {
        1.0 / self.count as f64
    }

    /// Length in the image per sample, pixels.
    pub fn weight(&self) -> f64 {
        self.length * self.step()
    }

    /// The bound between samples `i - 1` and `i`: its share of the feature's length, and its place in the image.
    #[inline]
    pub fn bound(&self, i: usize) -> (f64, DVec2) {
        let s = i as f64 * self.step();
        match i {
            0 => (self.t[0], self.pixels[0]),
            i if i == self.count => (self.t[1], self.pixels[1]),
            _ => (self.t[0] + self.along(s) * (self.t[1] - self.t[0]), self.pixels[0].lerp(self.pixels[1], s)),
        }
    }

    #[inline]
    pub fn middle(&self, i: usize) -> (DVec3, DVec2) {
        let half = (i as f64 + 1.0) * self.step() - 0.5 * self.step();
        (self.ends[0].lerp(self.ends[1], self.along(half)), self.pixels[0].lerp(self.pixels[1], half))
    }

    /// The fractional number of the sample at a share of the feature's length; whole numbers are middles of samples.
    /// Shares outside the run give its ends.
    #[inline]
    pub fn number(&self, t: f64) -> f64 {
        let [p, q] = self.scales;
        let part = ((t - self.t[0]) / (self.t[1] - self.t[0])).clamp(0.0, 1.0);
        part * q / (part * q + (1.0 - part) * p) * self.count as f64 - 0.5
    }

    /// Places along its image: both ends, and intermediate places at most `apart` pixels from each other.
    pub fn places(&self, apart: f64) -> impl Iterator<Item = DVec2> {
        let (steps, [from, to]) = ((self.length / apart).ceil().max(1.0), self.pixels);
        (0..=steps as u32).map(move |i| from.lerp(to, f64::from(i) / steps))
    }

    pub fn samples(&self) -> impl Iterator<Item = Sample> + '_ {
        let weight = self.weight();
        let mut last = self.bound(0);
        (0..self.count).map(move |i| {
            let from = std::mem::replace(&mut last, self.bound(i + 1));
            let (at, pixel) = self.middle(i);
            Sample { t: [from.0, last.0], at, pixel, ends: [from.1, last.1], weight }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_of_the_middles() {
        let ends = [DVec3::new(2.0, 0.0, 0.0), 5.0 * DVec3::new(0.2f64.cos(), 0.2f64.sin(), 0.0)];
        let pixels = [DVec2::new(3.0, 4.0), DVec2::new(15.0, 4.0)];
        let run = Run { t: [0.25, 0.5], ends, scales: [2.0, 5.0], pixels, count: 24, length: 12.0 };
        let d = ends[1] - ends[0];
        let t = |at: DVec3| 0.25 + 0.25 * (at - ends[0]).dot(d) / d.length_squared();
        for (i, sample) in run.samples().enumerate() {
            assert!((run.number(t(sample.at)) - i as f64).abs() < 1e-9);
            assert_eq!(sample.at, run.middle(i).0);
            assert!(sample.t[0] < t(sample.at) && t(sample.at) < sample.t[1]);
            // The middle of another sample has a different number.
            assert!((run.number(t(run.middle((i + 1) % 24).0)) - i as f64).abs() > 0.9);
        }
        // Two steps of 6 pixels would exceed the limit of 5.
        let places: Vec<f64> = run.places(5.0).map(|place| place.x).collect();
        assert_eq!(places, [3.0, 7.0, 11.0, 15.0]);
        assert_eq!([0.0, 0.25, 0.5, 1.0].map(|t| run.number(t)), [-0.5, -0.5, 23.5, 23.5]);
    }
}
