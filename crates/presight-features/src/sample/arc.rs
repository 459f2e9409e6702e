//! Samples segments with curved images: halves the arc of directions between the ends until its image is short.

use super::{MAX_SEGMENT_SAMPLES, Part, Piece, Run, Sample, Sampler};
use glam::{DVec2, DVec3};

/// Length of the arc pieces to start with, pixels. Shorter parts of an image between two places outside it are missed.
const COARSE: f64 = 8.0;
/// Maximum number of initial pieces of an arc.
const MAX_COARSE: f64 = 4096.0;
/// Maximum length of an image piece that may be sampled as a straight line, pixels.
const RUN: f64 = 12.0;
/// Maximum distance of such a piece's middle from the middle of the line, pixels.
const BENT: f64 = 1.0 / 64.0;
/// Maximum number of halvings of an arc; only arcs near a pole need many.
const MAX_DEPTH: u32 = 40;

impl Sampler<'_> {
    /// Number of arc pieces to start with.
    fn coarse_pieces(&self, angle: f64) -> f64 {
        (angle / (COARSE * self.pixel_angle)).ceil().clamp(1.0, MAX_COARSE)
    }

    /// Any sensor: halves the arc of directions from a to b, which have the interval `span` of the feature's length.
    pub(super) fn arc(&self, a: DVec3, b: DVec3, span: [f64; 2], visit: &mut impl FnMut(Part)) {
        let (near, far) = (a.length(), b.length());
        let angle = a.cross(b).length().atan2(a.dot(b));
        if !(angle > 1e-12 && near > 0.0 && far > 0.0) {
            // The line of sight runs along the segment, so its image is a point.
            return visit(Part::One(match self.point(a.lerp(b, 0.5)) {
                Piece::Inside(sample) => Piece::Inside(Sample { t: span, ..sample }),
                Piece::Outside { reason, .. } => Piece::Outside { t: span, reason },
            }));
        }
        let t_at = |phi: f64| {
            let (x, y) = (near * phi.sin(), far * (angle - phi).sin());
            if phi <= 0.0 || x <= 0.0 {
                0.0
            } else if phi >= angle || y <= 0.0 {
                1.0
            } else {
                x / (x + y)
            }
        };
        let end = |phi: f64| {
            let t = t_at(phi);
            let at = a + t * (b - a);
            End { phi, t: span[0] + t * (span[1] - span[0]), at, range: at.length(), pixel: self.project(at) }
        };
        let pieces = self.coarse_pieces(angle);
        let mut left = MAX_SEGMENT_SAMPLES;
        // The last piece ends exactly at the end of the arc, without rounding.
        let phi = |i: u32| if f64::from(i) == pieces { angle } else { angle * f64::from(i) / pieces };
        let mut from = end(phi(0));
        for i in 1..=pieces as u32 {
            let mut to = end(phi(i));
            // Past the sensor's centre t hardly changes, and rounding could reverse it.
            to.t = to.t.max(from.t);
            self.halve(&from, &to, MAX_DEPTH, &end, &mut left, visit);
            from = to;
        }
    }

    fn halve(
        &self,
        from: &End,
        to: &End,
        depth: u32,
        end: &impl Fn(f64) -> End,
        left: &mut usize,
        visit: &mut impl FnMut(Part),
    ) {
        let middle = || {
            let m = end(0.5 * (from.phi + to.phi));
            End { t: m.t.clamp(from.t, to.t), ..m }
        };
        let t = [from.t, to.t];
        let apart = from.pixel.zip(to.pixel).map(|(p, q)| self.distance(p, q));
        let short = apart.is_some_and(|d| d <= self.step);
        let last =
            depth == 0 || *left == 0 || to.phi - from.phi <= 0.25 * self.step * self.pixel_angle && apart.is_none();
        if short || last {
            let m = middle();
            *left = left.saturating_sub(1);
            let inside = m.pixel.filter(|pixel| self.holds(m.at, *pixel));
            return visit(Part::One(match inside {
                Some(pixel) => Piece::Inside(Sample {
                    t,
                    at: m.at,
                    pixel,
                    ends: [from.pixel.unwrap_or(pixel), to.pixel.unwrap_or(pixel)],
                    weight: apart.unwrap_or(0.0).min(self.step),
                }),
                None => self.outside(m.at, t),
            }));
        }
        if apart.is_some_and(|d| d <= RUN) && self.run(from, to, &middle(), left, visit) {
            return;
        }
        let off = |pixel: DVec2| {
            let out = (DVec2::splat(-0.5) - pixel).max(pixel - (self.size - 0.5)).max(DVec2::ZERO);
            out.max_element()
        };
        let skipped = match (from.pixel, to.pixel, apart) {
            (Some(p), Some(q), Some(d)) => off(p).min(off(q)) > d + 2.0,
            (None, None, _) => true,
            _ => false,
        };
        if skipped {
            return visit(Part::One(self.outside(middle().at, t)));
        }
        let m = middle();
        self.halve(from, &m, depth - 1, end, left, visit);
        self.halve(&m, to, depth - 1, end, left, visit);
    }

    /// Samples a piece of an arc whose image is straight within [`BENT`]; returns false if it is not.
    fn run(&self, from: &End, to: &End, middle: &End, left: &mut usize, visit: &mut impl FnMut(Part)) -> bool {
        let (Some(p), Some(q), Some(m)) = (from.pixel, to.pixel, middle.pixel) else { return false };
        // Beams may be higher or lower than a row, so each sample must be tested.
        let plain = self.cone.is_none() && self.beams.is_none();
        let length = p.distance(q);
        let count = (length / self.step).ceil().max(1.0);
        if !(plain && m.distance(0.5 * (p + q)) <= BENT && count as usize <= *left) || length > RUN {
            return false;
        }
        *left -= count as usize;
        let (t, ends, scales) = ([from.t, to.t], [from.at, to.at], [from.range, to.range]);
        let run = Run { t, ends, scales, pixels: [p, q], count: count as usize, length };
        // The image is convex, so the piece is inside if both ends are.
        if self.holds(from.at, p) && self.holds(to.at, q) {
            visit(Part::Run(run));
            return true;
        }
        for sample in run.samples() {
            let is_inside = self.holds(sample.at, sample.pixel);
            visit(Part::One(if is_inside { Piece::Inside(sample) } else { self.outside(sample.at, sample.t) }));
        }
        true
    }

    /// Distance in the image, across the seam if that is shorter.
    fn distance(&self, p: DVec2, q: DVec2) -> f64 {
        let mut by = (p - q).abs();
        if let Some(turn) = self.turn {
            by.x = by.x.min((turn - by.x).abs());
        }
        by.length()
    }
}

/// A place on an arc.
struct End {
    phi: f64,
    t: f64,
    at: DVec3,
    range: f64,
    pixel: Option<DVec2>,
}
