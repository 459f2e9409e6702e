//! Samples a segment for a pinhole camera: the image is a single straight part.

use super::{MAX_SEGMENT_SAMPLES, Part, Piece, Run, Sampler};
use crate::Reason;
use glam::{DVec2, DVec3};
use presight_model::sensor::Camera;

/// Visits parts of a segment outside the image, behind the camera or in front of it.
fn before_camera(a: DVec3, b: DVec3, [from, to]: [f64; 2], visit: &mut impl FnMut(Part)) {
    let z = |t: f64| a.z + t * (b.z - a.z);
    let mut put = |t: [f64; 2], behind: bool| {
        let reason = if behind { Reason::BehindSensor } else { Reason::OutsideImage };
        visit(Part::One(Piece::Outside { t, reason }));
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
    /// Samples a segment, whose image is straight.
    pub(super) fn straight(&self, camera: &Camera, a: DVec3, b: DVec3, visit: &mut impl FnMut(Part)) {
        let Some(run) = self.clip(camera, a, b) else { return before_camera(a, b, [0.0, 1.0], visit) };
        let [from, to] = run.t;
        if from > 0.0 {
            before_camera(a, b, [0.0, from], visit);
        }
        visit(Part::Run(run));
        if to < 1.0 {
            before_camera(a, b, [to, 1.0], visit);
        }
    }

    /// Positive inside the four sides of the image, and in front of the camera; linear in space.
    fn sides(&self, camera: &Camera, p: DVec3) -> [f64; 5] {
        let (x, y) = (camera.fx * p.x, camera.fy * p.y);
        let (left, top) = (camera.cx + 0.5, camera.cy + 0.5);
        [x + left * p.z, (self.size.x - left) * p.z - x, y + top * p.z, (self.size.y - top) * p.z - y, p.z]
    }

    /// The reason why no part of the points' convex hull is in a pinhole camera's image, if one test shows it: all of
    /// it is behind the camera, or in front of it and outside one side of the image.
    pub fn beside(&self, points: &[DVec3]) -> Option<Reason> {
        /// Rounding may put a point this far outside a side into the image, relative to the distance.
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

    /// The part of a segment in the image; `None` if there is none.
    fn clip(&self, camera: &Camera, a: DVec3, b: DVec3) -> Option<Run> {
        // Inside all four sides means in front of the camera.
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
        let count = (length / self.step).ceil().clamp(1.0, MAX_SEGMENT_SAMPLES as f64) as usize;
        Some(Run { t: [from, to], ends: [start, end], scales: [start.z, end.z], pixels, count, length })
    }
}
