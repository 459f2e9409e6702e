//! A segment's straight image in a pinhole camera, in equal steps.

use super::Reason;
use super::sample::Piece;
use glam::{DVec2, DVec3};

/// What a pinhole camera sees of a segment, in equal steps of its straight image.
pub(crate) struct Straight {
    /// Part of the segment's length, and where it begins and ends, image frame.
    pub t: [f64; 2],
    pub ends: [DVec3; 2],
    /// The same in the image, pixels.
    pub pixels: [DVec2; 2],
    /// Samples.
    pub count: usize,
    /// Pixels.
    pub length: f64,
    /// One by the count.
    pub step: f64,
}

impl Straight {
    /// At a share of the image's length the part of the length in space: 1 / z is linear in the image.
    #[inline]
    fn along(&self, s: f64) -> f64 {
        let [p, q] = self.ends;
        s * p.z / (s * p.z + (1.0 - s) * q.z)
    }

    /// Where sample `i` begins and the one before it ends, on the segment and in the image.
    #[inline]
    pub fn bound(&self, i: usize) -> (f64, DVec2) {
        let s = i as f64 * self.step;
        match i {
            0 => (self.t[0], self.pixels[0]),
            i if i == self.count => (self.t[1], self.pixels[1]),
            _ => (self.t[0] + self.along(s) * (self.t[1] - self.t[0]), self.pixels[0].lerp(self.pixels[1], s)),
        }
    }

    /// The middle of sample `i` in space and in the image.
    #[inline]
    pub fn middle(&self, i: usize) -> (DVec3, DVec2) {
        let s = (i as f64 + 0.5) * self.step;
        let [p, q] = self.ends;
        (p + self.along(s) * (q - p), self.pixels[0].lerp(self.pixels[1], s))
    }

    /// At which sample, with a fraction, a part of the length of what is seen lies: whole numbers are middles.
    #[inline]
    pub fn number(&self, part: f64) -> f64 {
        let [p, q] = self.ends;
        part * q.z / (part * q.z + (1.0 - part) * p.z) * self.count as f64 - 0.5
    }

    /// The same of a place on it.
    #[inline]
    pub fn number_at(&self, at: DVec3) -> f64 {
        let [a, b] = self.ends;
        self.number((at - a).dot(b - a) / (b - a).length_squared())
    }

    /// What of the segment a to b comes before what is seen.
    pub fn before(&self, a: DVec3, b: DVec3, visit: &mut impl FnMut(Piece)) {
        if self.t[0] > 0.0 {
            before_camera(a, b, [0.0, self.t[0]], visit);
        }
    }

    /// What of the segment a to b comes after it.
    pub fn after(&self, a: DVec3, b: DVec3, visit: &mut impl FnMut(Piece)) {
        if self.t[1] < 1.0 {
            before_camera(a, b, [self.t[1], 1.0], visit);
        }
    }
}

/// Parts of a segment outside a pinhole image: behind the camera, or beside the image.
pub(super) fn before_camera(a: DVec3, b: DVec3, [from, to]: [f64; 2], visit: &mut impl FnMut(Piece)) {
    let z = |t: f64| a.z + t * (b.z - a.z);
    let mut put = |t: [f64; 2], behind: bool| {
        let reason = if behind { Reason::BehindSensor } else { Reason::OutsideImage };
        visit(Piece::Outside { t, reason });
    };
    let (start, end) = (z(from) <= 0.0, z(to) <= 0.0);
    let between = a.z / (a.z - b.z);
    if start == end || !(between > from && between < to) {
        return put([from, to], z(0.5 * (from + to)) <= 0.0);
    }
    put([from, between], start);
    put([between, to], end);
}
