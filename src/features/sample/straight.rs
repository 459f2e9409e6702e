//! A segment's straight image in a pinhole camera, in equal steps.

use super::{MAX_SEGMENT_SAMPLES, Piece, Sample, Sampler};
use crate::features::Reason;
use crate::sensor::Camera;
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
fn before_camera(a: DVec3, b: DVec3, [from, to]: [f64; 2], visit: &mut impl FnMut(Piece)) {
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

impl Sampler<'_> {
    /// A pinhole camera: the image of a segment is straight.
    pub(super) fn straight(&self, camera: &Camera, a: DVec3, b: DVec3, visit: &mut impl FnMut(Piece)) {
        let Some(part) = self.clip(camera, a, b) else { return before_camera(a, b, [0.0, 1.0], visit) };
        part.before(a, b, visit);
        let (mut t0, mut p0) = part.bound(0);
        for i in 0..part.count {
            let (t1, p1) = part.bound(i + 1);
            let weight = part.length * part.step;
            let (at, pixel) = part.middle(i);
            visit(Piece::Inside(Sample { t: [t0, t1], at, pixel, ends: [p0, p1], weight }));
            (t0, p0) = (t1, p1);
        }
        part.after(a, b, visit);
    }

    /// The part of a segment in the image of a pinhole camera; `None` for other sensors, and if there is none.
    pub(crate) fn straight_part(&self, a: DVec3, b: DVec3) -> Option<Straight> {
        self.clip(self.pinhole?, a, b)
    }

    /// Positive inside the four sides of the image, and in front: linear in space.
    fn sides(&self, camera: &Camera, p: DVec3) -> [f64; 5] {
        let (x, y) = (camera.fx * p.x, camera.fy * p.y);
        let (left, top) = (camera.cx + 0.5, camera.cy + 0.5);
        [x + left * p.z, (self.size.x - left) * p.z - x, y + top * p.z, (self.size.y - top) * p.z - y, p.z]
    }

    /// Why nothing of the convex hull of some points is in a pinhole camera's image, where one look tells: all of it is behind the
    /// camera, or before it and beside one side of the image.
    pub(crate) fn beside(&self, points: &[DVec3]) -> Option<Reason> {
        /// What is beside a side by less may be in the image by rounding, relative to the distance.
        const SLACK: f64 = 1e-9;
        let camera = self.pinhole?;
        if points.iter().all(|p| p.z <= 0.0) {
            return Some(Reason::BehindSensor);
        }
        let all = |side: usize, far: f64| {
            points.iter().all(|p| p.z > 0.0 && self.sides(camera, *p)[side] < -SLACK * far * p.length())
        };
        let far = camera.fx.max(camera.fy) + self.size.x + self.size.y;
        (0..4).any(|side| all(side, far)).then_some(Reason::OutsideImage)
    }

    fn clip(&self, camera: &Camera, a: DVec3, b: DVec3) -> Option<Straight> {
        // Together the four sides put it in front.
        let (mut from, mut to) = (0.0f64, 1.0f64);
        for (s, e) in self.sides(camera, a).into_iter().zip(self.sides(camera, b)) {
            match (s >= 0.0, e >= 0.0) {
                (true, true) => {}
                (false, false) => to = -1.0,
                (false, true) => from = from.max(s / (s - e)),
                (true, false) => to = to.min(s / (s - e)),
            }
        }
        let at = |t: f64| if t == 1.0 { b } else { a + t * (b - a) };
        let (start, end) = (at(from), at(to.max(0.0)));
        if !(from < to && start.z > 0.0 && end.z > 0.0) {
            return None;
        }
        let place = |p: DVec3| DVec2::new(camera.fx * (p.x / p.z) + camera.cx, camera.fy * (p.y / p.z) + camera.cy);
        let pixels = [place(start), place(end)];
        let length = pixels[0].distance(pixels[1]);
        let count = (length / self.step).ceil().clamp(1.0, MAX_SEGMENT_SAMPLES as f64);
        Some(Straight { t: [from, to], ends: [start, end], pixels, count: count as usize, length, step: 1.0 / count })
    }
}
